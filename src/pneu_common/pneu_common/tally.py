# SPDX-License-Identifier: Apache-2.0
"""A tally: how much of a work is done whose parts are done side by side."""

import math
from collections.abc import Callable, Sequence
from threading import Lock


class Tally:
    """Adds up what the threads of a work have done and tells a fraction that never goes back."""

    def __init__(
        self, amounts: Sequence[float], tell: Callable[[float], None] | None = None
    ) -> None:
        """Begin with nothing done.

        Args:
            amounts: How much work each part is, in any unit.
            tell: Called with the fraction of the whole that is done, by one thread at a time.
        """
        self._amounts = [float(a) for a in amounts]
        self._done = [0.0] * len(self._amounts)
        self._tell = tell
        self._lock = Lock()

    def reached(self, part: int, fraction: float) -> None:
        """Say that a fraction of one part is done.

        Args:
            part: Which part.
            fraction: How much of it is done, 0 to 1; more counts as 1.
        """
        if self._tell is None:
            return
        with self._lock:
            done = min(fraction, 1.0) * self._amounts[part]
            self._done[part] = max(self._done[part], done)
            # Exact sums: rounded ones might exceed the whole, or fall as a part grows.
            self._tell(math.fsum(self._done) / math.fsum(self._amounts))

    def of(self, part: int) -> Callable[[float], None]:
        """Return what is to be called with the fraction of one part that is done.

        Args:
            part: Which part.
        """
        return lambda fraction: self.reached(part, fraction)
