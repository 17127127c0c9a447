# SPDX-License-Identifier: Apache-2.0
"""How much later, and how much larger, a measured signal is than a predicted one."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

Floats = NDArray[np.float64]

LONGEST_S = 0.05
"""Largest shift that is looked for."""
SCANNED = 61
"""Shifts that the first, coarse search tries."""
ITERATIONS = 12


@dataclass(frozen=True)
class Shift:
    """``measured(t) = offset + gain * predicted(t - lag)``, one offset per roll-out.

    Attributes:
        lag_s: How much later the measurement is.
        gain: Measured change per predicted change.
        std_error_s: Standard error of the lag.
    """

    lag_s: float
    gain: float
    std_error_s: float


def estimate_shift(
    measured: Floats, predicted: Floats, dt_s: float, longest_s: float = LONGEST_S
) -> Shift | None:
    """Estimates lag and gain by least squares: a scan over whole shifts, then Gauss-Newton.

    Args:
        measured: (n_starts, samples) readings, NaN where missing.
        predicted: (n_starts, samples) predictions, finite.
        dt_s: Sample interval, s.
        longest_s: Largest shift looked for; at most a quarter of a roll-out.

    Returns:
        The estimate, or None where the signals move too little to tell, or agree best beyond
        the largest shift.
    """
    samples = measured.shape[1]
    reach = min(samples // 4, max(2, round(longest_s / dt_s)))
    if reach < 2:
        return None
    inner = slice(reach, samples - reach)
    y = measured[:, inner]
    weight = np.isfinite(y).astype(float)
    usable = weight.sum(axis=1) > 8
    if not usable.any():
        return None
    y, weight, model = y[usable], weight[usable], predicted[usable]
    total = weight.sum(axis=1, keepdims=True)

    def centred(x: Floats) -> Floats:
        x = np.where(weight > 0.0, x, 0.0)
        return (x - x.sum(axis=1, keepdims=True) / total) * weight

    y = centred(y)
    whole = np.unique(np.linspace(-reach, reach, min(SCANNED, 2 * reach + 1)).round().astype(int))
    costs = []
    for k in whole:
        m = centred(model[:, reach - k : samples - reach - k])
        power = float(np.vdot(m, m))
        cross = float(np.vdot(m, y))
        costs.append(-(max(cross, 0.0) ** 2) / power if power > 0.0 else 0.0)
    lag = float(whole[int(np.argmin(costs))])
    if min(costs) >= 0.0:
        return None
    spline = CubicSpline(np.arange(samples), model, axis=1)
    slope = spline.derivative()
    at = np.arange(reach, samples - reach, dtype=float)
    gain = 1.0
    basis = np.zeros((y.size, 2))
    r = y
    for _ in range(ITERATIONS):
        where = np.clip(at - lag, 0.0, samples - 1.0)
        m, d = centred(spline(where)), centred(slope(where))
        power = float(np.vdot(m, m))
        if power <= 0.0:
            return None
        gain = float(np.vdot(m, y)) / power
        r = y - gain * m
        basis = np.stack([m.ravel(), -gain * d.ravel()], axis=1)
        step = float(np.linalg.lstsq(basis, r.ravel(), rcond=None)[0][1])
        lag += float(np.clip(step, -1.0, 1.0))
        if abs(lag) > reach:
            return None
        if abs(step) < 1e-6:
            break
    normal = basis.T @ basis
    freedom = max(float(weight.sum()) - total.size - 2.0, 1.0)
    if np.linalg.cond(normal) > 1e14:
        return None
    variance = float(np.vdot(r, r)) / freedom * float(np.linalg.inv(normal)[1, 1])
    std_error = float(np.sqrt(variance)) * dt_s
    # Worse than a sample known: rest, drift or noise, not a wave to line up.
    return Shift(lag * dt_s, gain, std_error) if std_error < dt_s else None
