# SPDX-License-Identifier: Apache-2.0
"""How wide a rig is as a whole, which pressures hardly tell.

Lines, chambers and ports that are all wider by the same factor carry and hold as much more: every
pressure stays as it is, but for what friction and heat at the walls make of it. An estimation may
so end in a valley of its own, with bores far from what the file says and walls that make up for it.
Whether there is a better one where the bores are as the file has them is seen by going there.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pneu_sim.rig.schema import FitParameter

Floats = NDArray[np.float64]

SIZES = ("pipes.*.area_m2", "chambers.*.volume_m3")
"""What a rule or a datasheet tells well; their priors hold the scale."""
WITH_IT = (
    "area_m2",
    "volume_m3",
    "volume_from_m3",
    "volume_to_m3",
    "conductance_m3_s_pa",
    "heat_w_per_k",
    "convection_m2",
)
"""Ends of the paths of what grows with the scale ..."""
AGAINST_IT = "droop_pa_s_per_kg"
"""... and of what falls with it."""


def off_scale(
    fitted: Sequence[FitParameter], values: Floats, centres: Sequence[float]
) -> tuple[float, float]:
    """By how much a rig as a whole is wider than was known beforehand.

    Args:
        fitted: What was estimated.
        values: (P,) estimates; logarithms where the parameter is logarithmic.
        centres: The same as known beforehand.

    Returns:
        Natural logarithm of the factor, the mean of all sizes by what was known of each, and the
        same in its standard deviations.
    """
    apart, weights = [], []
    for p, value, centre in zip(fitted, values, centres, strict=True):
        names = p.path.split(".")
        if len(names) != 3 or f"{names[0]}.*.{names[2]}" not in SIZES or not p.log or p.std is None:
            continue
        apart.append(float(value) - float(centre))
        weights.append((float(np.exp(centre)) / p.std) ** 2)
    if not apart:
        return 0.0, 0.0
    shift = float(np.average(apart, weights=weights))
    return shift, shift * float(np.sqrt(np.sum(weights)))


def rescaled(fitted: Sequence[FitParameter], values: Floats, shift: float) -> Floats:
    """Estimates of a rig that is narrower as a whole, with the same pressures but for its walls.

    Args:
        fitted: What was estimated.
        values: (P,) estimates; logarithms where the parameter is logarithmic.
        shift: Natural logarithm of the factor.
    """
    out = np.array(values, dtype=float)
    for k, p in enumerate(fitted):
        name = p.path.rsplit(".", 1)[1]
        by = -shift if name in WITH_IT else shift if name == AGAINST_IT else 0.0
        low, high = (np.log([p.lower, p.upper])) if p.log else (p.lower, p.upper)
        out[k] = np.clip(out[k] + by if p.log else out[k] * np.exp(by), low, high)
    return out
