# SPDX-License-Identifier: Apache-2.0
"""How far a port is open at a voltage: the points of its opening curve and what lies between."""

import numpy as np
from numpy.typing import NDArray

from pneu_sim.monotone import monotone_cubic
from pneu_sim.rig.schema import Opening

Floats = NDArray[np.float64]

LEAST_EXPONENT = 0.2
"""A power law goes on towards null with no smaller exponent."""


def opening_at(opening: Opening, null_v: float, volts: Floats) -> Floats:
    """Opening of a curve with points of its own, leakage not counted.

    Args:
        opening: The curve; not one that mirrors another.
        null_v: Voltage at which the spool closes.
        volts: Where it is asked; beyond the outermost points it stays at theirs.

    Returns:
        The openings, dimensionless, in the shape of ``volts``.
    """
    x, y = np.array(opening.voltage_v), np.array(opening.fraction)
    if opening.interpolation == "cubic":
        return monotone_cubic(x, y, np.clip(volts, x[0], x[-1]))
    sign = 1.0 if x[-1] > null_v else -1.0
    order = np.argsort(np.abs(x - null_v))
    s, f = np.abs(x - null_v)[order], y[order]
    at = np.maximum(sign * (np.asarray(volts) - null_v), 0.0)
    out = np.zeros_like(at)
    ls, lf = np.log(s), np.log(f)
    inside = at >= s[0]
    out[inside] = np.exp(monotone_cubic(ls, lf, np.minimum(np.log(at[inside]), ls[-1])))
    exponent = max((lf[1] - lf[0]) / (ls[1] - ls[0]), LEAST_EXPONENT)
    below = ~inside & (at > 0.0)
    out[below] = f[0] * (at[below] / s[0]) ** exponent
    return out
