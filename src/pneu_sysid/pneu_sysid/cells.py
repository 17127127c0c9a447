# SPDX-License-Identifier: Apache-2.0
"""What a rig's cells get wrong of a prediction, and how readings are weighed that know of it.

Cells smear fronts. Numbers that a recording hardly shows, such as the length of a pipe behind a
valve or the diameter of one through which little flows, would be fitted to that error, since it
lasts and noise does not. So it counts as a part of the noise: at every sensor some amount, unknown
beforehand, of what halving the cells changes. A little of it is like no amount of that; where a
front is so steep that cells get tens of deviations wrong, that little is more than the noise.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

HALF = 0.5
"""Cells so many times as long tell what the rig's own get wrong."""
ORDER = 1.25
"""Halving cells takes away a part of their error that goes by this order: of tubes with fast valves
1.2 to 1.3, between that of shocks (1) and that of smooth flow (2)."""


def own_share(longer: float) -> float:
    """Error of cells over the difference between it and that of longer ones.

    Args:
        longer: So many times as long.
    """
    return 1.0 / (longer**ORDER - 1.0)


WHOLE = 1.0 + own_share(1.0 / HALF)
"""All of the error over what halving the cells takes away of it."""
REMAINS = 0.1
"""Share of what cells get wrong of a reading that no such amount explains: 0.03 to 0.09 of plants
with cells a quarter as long and another flux, where cells get four deviations and more wrong."""
MOST = 2.0
"""Deviations of what cells may get wrong, beyond which it is something else that smears fronts."""


def weights_of(doubt: Floats, remains: float = REMAINS) -> Floats:
    """What readings count beside those of which cells get nothing wrong, of the same shape.

    Args:
        doubt: What cells may get wrong of each, in noise deviations.
        remains: Share of that which no amount of it explains.
    """
    return np.asarray(1.0 / np.sqrt(1.0 + np.square(remains * doubt)))


def without_doubt(r: Floats, doubt: Floats) -> Floats:
    """Residuals as they are to be squared where an amount of something known may be in them.

    With that amount of deviation one, beside noise of deviation one and what is like no amount of
    it (``REMAINS``), the least squares of what is returned are the generalised least squares of
    what is given (Aitken 1936), for each sensor by itself.

    Args:
        r: (..., n_stretches, horizon, n_taps) residuals in noise deviations.
        doubt: (n_stretches, horizon, n_taps) one deviation of what may be in them, likewise.
    """
    weights = weights_of(doubt)
    r, doubt = r * weights, doubt * weights
    square = np.sum(doubt**2, axis=(0, 1))
    # inverse root of the covariance 1 + d d^T: shortens what goes along with d
    root = np.sqrt(1.0 + square)
    amount = amounts_in(r, doubt) * root / (1.0 + root)
    return np.asarray(r - doubt * amount[..., None, None, :])


def amounts_in(r: Floats, doubt: Floats) -> Floats:
    """(..., n_taps) how much of what may be in residuals is found in them, in its deviations.

    Args:
        r: (..., n_stretches, horizon, n_taps) residuals in noise deviations.
        doubt: (n_stretches, horizon, n_taps) one deviation of what may be in them, likewise.
    """
    along = np.einsum("...smt,smt->...t", r, doubt)
    return np.asarray(along / (1.0 + np.sum(doubt**2, axis=(0, 1))))


def error_of_cells(r: Floats, doubt: Floats) -> Floats:
    """(n_taps,) sum of squares of what cells are found to get wrong, in noise deviations.

    As much as is found of what they may get wrong, but no more than they can.

    Args:
        r: (n_stretches, horizon, n_taps) residuals in noise deviations.
        doubt: (n_stretches, horizon, n_taps) one deviation of what may be in them, likewise.
    """
    rest = r - np.clip(amounts_in(r, doubt), -MOST, MOST) * doubt
    return np.asarray(np.maximum(np.sum(r**2 - rest**2, axis=(0, 1)), 0.0))


def words_on_cells(dx_m: float, wrong: Mapping[str, float]) -> list[str]:
    """What cells get wrong, where that is more than the noise of a sensor.

    Args:
        dx_m: Length of the cells, m.
        wrong: By sensor their error over its noise.
    """
    named = ", ".join(f"{sensor} {times:.1f}" for sensor, times in wrong.items() if times > 1.0)
    if not named:
        return []
    return [
        f"cells of {dx_m:g} m get more than the noise wrong at {named} (times), which no number was"
        " fitted to; a shorter grid.dx_m predicts it better"
    ]
