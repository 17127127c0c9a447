# SPDX-License-Identifier: Apache-2.0
"""How late something follows its target: the shift of the target that fits it best (table 9.2)."""

import math

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

LATE_S = 0.25
"""Largest delay that is looked for."""
EARLY_S = 0.10
"""Largest lead that is looked for."""
SEARCH_STEP_S = 0.002


def rms(time_s: Floats, values: Floats) -> float:
    """Root mean square over time, by the trapezoidal rule.

    Args:
        time_s: (n,) increasing times, s.
        values: (n,) values there.
    """
    return float(np.sqrt(np.trapezoid(values**2, time_s) / (time_s[-1] - time_s[0])))


def latency(
    time_s: Floats, values: Floats, target_time_s: Floats, target: Floats
) -> tuple[float, float]:
    """The delay of a target that fits best, finer than the samples.

    Args:
        time_s: (n,) times of what followed it, s.
        values: (n,) where that was.
        target_time_s: (m,) times of the target, s; linear between.
        target: (m,) the target.

    Returns:
        The delay, positive where the target is followed late, s, and the root mean square that is
        left. The delay of a target that does not move is NaN.
    """

    def error(delay_s: float) -> float:
        return rms(time_s, values - np.interp(time_s - delay_s, target_time_s, target))

    near = (target_time_s >= time_s[0]) & (target_time_s <= time_s[-1])
    if np.ptp(target[near]) == 0.0:
        return math.nan, error(0.0)
    # Whole multiples, so that no delay at all is one of them.
    steps = np.arange(-round(EARLY_S / SEARCH_STEP_S), round(LATE_S / SEARCH_STEP_S) + 1)
    delays = SEARCH_STEP_S * steps
    errors = [error(float(delay)) for delay in delays]
    best = float(delays[int(np.argmin(errors))])
    low, high = max(best - SEARCH_STEP_S, -EARLY_S), min(best + SEARCH_STEP_S, LATE_S)
    from scipy.optimize import minimize_scalar  # slow to import; a list of commands does without

    finer = minimize_scalar(error, bounds=(low, high), method="bounded", options={"xatol": 1e-6})
    if finer.fun < min(errors):
        return float(finer.x), float(finer.fun)
    return best, float(min(errors))
