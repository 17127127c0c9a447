# SPDX-License-Identifier: Apache-2.0
"""What a rig's cells get wrong of a prediction, and how readings are weighed that know of it.

Cells smear fronts. Numbers that a recording hardly shows, such as the length of a pipe behind a
valve or the diameter of one through which little flows, would be fitted to that error, since it
lasts and noise does not. So it counts as a part of the noise: at every sensor some amount, unknown
beforehand, of what halving the cells changes.
"""

import numpy as np
from numpy.typing import NDArray

from pneu_sim.models import kind_of
from pneu_sim.rig.schema import Rig

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


def has_cells(rig: Rig) -> bool:
    """Whether a rig's model has cells that may be too long.

    Args:
        rig: The rig.
    """
    return kind_of(rig).along_lines


def without_doubt(r: Floats, doubt: Floats) -> Floats:
    """Residuals as they are to be squared where an amount of something known may be in them.

    With that amount of deviation one, beside noise of deviation one, the least squares of what is
    returned are the generalised least squares of what is given (Aitken 1936), for each sensor by
    itself.

    Args:
        r: (..., n_stretches, horizon, n_taps) residuals in noise deviations.
        doubt: (n_stretches, horizon, n_taps) one deviation of what may be in them, likewise.
    """
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
