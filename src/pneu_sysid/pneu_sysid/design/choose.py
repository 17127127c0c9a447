# SPDX-License-Identifier: Apache-2.0
"""Which of many pieces to play: greedily, then exchanged one for another as long as that gains."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Worth = Callable[[Floats], float]
"""What a sum of matrices is worth."""

ROUNDS = 6
"""Of exchanges; the second rarely finds any."""


def choose(of_pieces: Floats, count: int, allowed: Sequence[int], worth: Worth) -> list[int]:
    """Pieces that together are worth most; one may be played several times.

    Fedorov's exchange (1972) from a greedy start.

    Args:
        of_pieces: (n_pieces, C, C) what each tells.
        count: How many.
        allowed: Those that may be played.
        worth: What a sum is worth.

    Returns:
        (count,) which, in no order.
    """
    chosen: list[int] = []
    total = np.zeros(of_pieces.shape[1:])
    for _ in range(count):
        best = max(allowed, key=lambda k: worth(total + of_pieces[k]))
        chosen.append(best)
        total = total + of_pieces[best]
    now = worth(total)
    for _ in range(ROUNDS):
        before = now
        for place, old in enumerate(list(chosen)):
            rest = total - of_pieces[old]
            values = {k: worth(rest + of_pieces[k]) for k in allowed}
            best = max(values, key=lambda k: values[k])
            chosen[place], total, now = best, rest + of_pieces[best], values[best]
        if now <= before + 1e-6 * abs(before):
            break
    return chosen
