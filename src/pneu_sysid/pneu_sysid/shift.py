# SPDX-License-Identifier: Apache-2.0
"""How much later, and how much larger, a measured signal is than a predicted one."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

Floats = NDArray[np.float64]

LONGEST_S = 0.05
"""Largest shift that is looked for."""
VAGUE_S = 2e-3
"""A shift that is known no better than this is none."""
SCANNED = 61
"""Shifts that the first, coarse search tries."""
FEWEST = 8
"""A stretch of fewer readings tells nothing of a shift."""
ITERATIONS = 12


@dataclass(frozen=True)
class Shift:
    """``measured(t) = offset + gain * predicted(t - lag)``, one offset per stretch.

    Attributes:
        lag_s: How much later the measurement is.
        gain: Measured change per predicted change.
        std_error_s: Standard error of the lag.
    """

    lag_s: float
    gain: float
    std_error_s: float


def estimate_shift(
    measured: Floats,
    time_s: Floats,
    predicted: Sequence[tuple[Floats, Floats]],
    of: NDArray[np.int64],
    longest_s: float = LONGEST_S,
) -> Shift | None:
    """Estimates lag and gain by least squares: a scan over whole ticks, then Gauss-Newton.

    Args:
        measured: (n_stretches, horizon) readings, NaN where missing.
        time_s: (n_stretches, horizon) when they were taken, s.
        predicted: Per recording (ticks,) even times and the predicted readings then.
        of: (n_stretches,) recording that each stretch belongs to.
        longest_s: Largest shift looked for.

    Returns:
        The estimate, or None where the signals move too little to tell, or agree best beyond
        the largest shift.
    """
    weight = np.isfinite(measured).astype(float)
    usable = weight.sum(axis=1) > FEWEST
    y, weight, of = measured[usable], weight[usable], of[usable]
    at = np.where(weight > 0.0, time_s[usable], 0.0)
    total = weight.sum(axis=1, keepdims=True)
    splines = [CubicSpline(tick_s, values) for tick_s, values in predicted]
    slopes = [spline.derivative() for spline in splines]
    tick = float(predicted[0][0][1] - predicted[0][0][0])
    reach = max(2, round(longest_s / tick))

    def along(curves: Sequence[CubicSpline], lag: float) -> Floats:
        out = np.zeros_like(at)
        for c, curve in enumerate(curves):
            mine = of == c
            tick_s = predicted[c][0]
            out[mine] = curve(np.clip(at[mine] - lag, tick_s[0], tick_s[-1]))
        return out

    def centred(x: Floats) -> Floats:
        x = np.where(weight > 0.0, x, 0.0)
        return (x - x.sum(axis=1, keepdims=True) / total) * weight

    y = centred(y)
    whole = np.unique(np.linspace(-reach, reach, min(SCANNED, 2 * reach + 1)).round().astype(int))
    costs = []
    for k in whole:
        m = centred(along(splines, k * tick))
        power = float(np.vdot(m, m))
        cross = float(np.vdot(m, y))
        costs.append(-(max(cross, 0.0) ** 2) / power if power > 0.0 else 0.0)
    lag = tick * float(whole[int(np.argmin(costs))])
    if min(costs) >= 0.0:
        return None
    gain = 1.0
    basis = np.zeros((y.size, 2))
    r = y
    for _ in range(ITERATIONS):
        m, d = centred(along(splines, lag)), centred(along(slopes, lag))
        power = float(np.vdot(m, m))
        if power <= 0.0:
            return None
        gain = float(np.vdot(m, y)) / power
        r = y - gain * m
        basis = np.stack([m.ravel(), -gain * d.ravel()], axis=1)
        step = float(np.linalg.lstsq(basis, r.ravel(), rcond=None)[0][1])
        lag += float(np.clip(step, -tick, tick))
        if abs(lag) > reach * tick:
            return None
        if abs(step) < 1e-6 * tick:
            break
    normal = basis.T @ basis
    freedom = max(float(weight.sum()) - total.size - 2.0, 1.0)
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    if np.linalg.cond(normal / np.outer(scale, scale)) > 1e14:
        return None
    std_error = float(np.sqrt(np.vdot(r, r) / freedom * np.linalg.inv(normal)[1, 1]))
    # Worse than that: rest, drift or noise, not a wave to line up.
    return Shift(lag, gain, std_error) if std_error < VAGUE_S else None
