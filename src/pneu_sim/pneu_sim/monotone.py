# SPDX-License-Identifier: Apache-2.0
"""Monotone cubic interpolation, as the opening curves of valves are drawn through their points.

SciPy has the same (`PchipInterpolator`, with which the tests compare), but importing it takes more
time and memory than all else that a rig file, a simulator or an emulated laboratory needs to start.
"""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def monotone_cubic(x: Floats, y: Floats, at: Floats) -> Floats:
    """A curve through points that nowhere overshoots them; two points make a line.

    F. N. Fritsch and J. Butland, A method for constructing local monotone piecewise cubic
    interpolants, SIAM J. Sci. Stat. Comput. 5 (1984); end slopes by three points, as in C. Moler,
    Numerical Computing with MATLAB, 3.6.

    Args:
        x: Rising positions of the points, shape (n,), n at least 2.
        y: Values there, shape (n,).
        at: Positions asked for, any shape; beyond the ends the last cubic goes on.

    Returns:
        The values, of the shape of ``at``.
    """
    step, slope = np.diff(x), np.diff(y) / np.diff(x)
    if x.size == 2:
        return np.asarray(y[0] + slope[0] * (at - x[0]))
    incline = np.zeros_like(y)
    # Weighted harmonic mean of the slopes on both sides; level where they differ in sign.
    left, right = slope[:-1], slope[1:]
    same = left * right > 0.0
    w_left = (2.0 * step[1:] + step[:-1])[same]
    w_right = (step[1:] + 2.0 * step[:-1])[same]
    incline[1:-1][same] = (w_left + w_right) / (w_left / left[same] + w_right / right[same])
    incline[0] = _end(step[0], step[1], slope[0], slope[1])
    incline[-1] = _end(step[-1], step[-2], slope[-1], slope[-2])
    k = np.clip(np.searchsorted(x, at, side="right") - 1, 0, x.size - 2)
    t = at - x[k]
    second = (3.0 * slope[k] - 2.0 * incline[k] - incline[k + 1]) / step[k]
    third = (incline[k] + incline[k + 1] - 2.0 * slope[k]) / step[k] ** 2
    return np.asarray(y[k] + t * (incline[k] + t * (second + t * third)))


def _end(near: float, far: float, slope: float, beyond: float) -> float:
    """Slope at an end from three points, kept from bending back."""
    found = ((2.0 * near + far) * slope - near * beyond) / (near + far)
    if found * slope <= 0.0:
        return 0.0
    if slope * beyond <= 0.0 and abs(found) > 3.0 * abs(slope):
        return 3.0 * slope
    return found
