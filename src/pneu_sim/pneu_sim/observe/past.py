# SPDX-License-Identifier: Apache-2.0
"""What later readings tell of an earlier state: the memory of a fixed-lag ensemble smoother.

The members of some steps ago are kept as they were after what was read then, and moved along with
those of now by every reading since (Evensen and van Leeuwen 2000, Monthly Weather Review 128, 1852;
fixed-lag: Cohn, Sivakumaran and Todling 1994, ibid. 122, 2838). A wave that a tap has not reached
yet is so known before it comes.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass
class Earlier:
    """The members of an earlier time, by all that was read up to now.

    Attributes:
        time_s: When, s.
        numbers: (numbers, members) of the state (`vector.StateVector`).
        shown: (n_taps + n_encoders, members) what sensors showed by it.
    """

    time_s: float
    numbers: Floats
    shown: Floats


class Past:
    """States of some steps ago, the oldest first.

    Attributes:
        steps: So many steps back what was is still moved.
        states: What is kept.
    """

    def __init__(self, steps: int) -> None:
        """Remembers nothing yet.

        Args:
            steps: How many steps back.
        """
        self.steps = steps
        self.states: deque[Earlier] = deque(maxlen=steps + 1)

    def forget(self) -> None:
        """What was has nothing to do with what follows."""
        self.states.clear()

    def take(self, which: NDArray[np.int64]) -> None:
        """Has members be followed by others.

        Args:
            which: (members,) which of them each is from now on.
        """
        for one in self.states:
            one.numbers, one.shown = one.numbers[:, which], one.shown[:, which]

    def tables(self) -> list[Floats]:
        """(numbers + sensors, members) of every step that a reading of now may still move."""
        there = list(self.states)[-self.steps :] if self.steps else []
        return [np.concatenate([one.numbers, one.shown]) for one in there]

    def put(self, tables: list[Floats], numbers: int) -> None:
        """Sets them as they are after a reading.

        Args:
            tables: As `tables` has them.
            numbers: How many of the rows are of the state.
        """
        kept = list(self.states)[len(self.states) - len(tables) :]
        for one, table in zip(kept, tables, strict=True):
            one.numbers, one.shown = table[:numbers], table[numbers:]

    def keep(self, now: Earlier) -> None:
        """Remembers how it is now, and forgets what is too long ago.

        Args:
            now: The state.
        """
        self.states.append(now)
