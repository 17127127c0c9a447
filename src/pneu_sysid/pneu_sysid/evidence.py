# SPDX-License-Identifier: Apache-2.0
"""How much one model explains more than another, and whether that may be chance."""

import numpy as np
from numpy.typing import NDArray

from pneu_sysid.problem import Problem

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def blocks_of(problem: Problem, share: float) -> Ints:
    """(n_stretches, horizon * n_taps) number of the block of time that each reading is in.

    Errors of a model last; readings of one block are one observation of them.

    Args:
        problem: The problem.
        share: Length of a block, as a share of that of the stretches.
    """
    block_s = share * float(np.median(np.diff(problem.span_s, axis=1)))
    time = np.nan_to_num(problem.time_s)
    number = np.floor(time / block_s).astype(np.int64)
    number += problem.of[:, None, None] * (int(number.max()) + 1)
    _, index = np.unique(number.reshape(problem.stretches, -1), return_inverse=True)
    return np.asarray(index.reshape(problem.stretches, -1), dtype=np.int64)


def lead(better: Floats, other: Floats, blocks: Ints, doubtful: Floats | None = None) -> float:
    """By how many standard errors one residual is smaller than another.

    Two models whose predictions differ by D leave squares that differ by ``2 r D + D^2``, r being
    what the better one leaves. The first term is chance: noise makes it scatter by ``2 |D|``, what
    the model does not know by as much as r and D go together in blocks of time.

    Args:
        better: (n_stretches, m) residual in noise deviations.
        other: (n_stretches, m) residual of the other model on the same readings.
        blocks: (n_stretches, m) block of each reading.
        doubtful: (n_stretches, m) what both get wrong in a way that is known, such as by their
            cells: as far as it goes along with what sets them apart, it may favour either.

    Returns:
        The lead; negative where ``other`` is the smaller one, 0 where they agree.
    """
    gain = float(np.sum(other**2) - np.sum(better**2))
    apart = other - better
    left = better if gain >= 0.0 else other
    together = np.bincount(blocks.ravel(), weights=(left * apart).ravel())
    chance = max(float(np.sum(together**2)), float(np.sum(apart**2)))
    if doubtful is not None:
        chance += float(np.sum(doubtful * apart)) ** 2
    scatter = 2.0 * float(np.sqrt(chance))
    return gain / scatter if scatter > 0.0 else 0.0


def share_explained(before: Floats, after: Floats) -> float:
    """Share of a squared residual that is gone; 0 where there was none.

    Args:
        before: Residual, any shape.
        after: Residual of the same shape.
    """
    total = float(np.sum(before * before))
    return 1.0 - float(np.sum(after * after)) / total if total > 0.0 else 0.0


def cosine(a: Floats, b: Floats) -> float:
    """Cosine between two changes of the prediction.

    Args:
        a: (n_stretches, m).
        b: (n_stretches, m).
    """
    norm = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(np.sum(a * b)) / norm if norm > 0.0 else 0.0
