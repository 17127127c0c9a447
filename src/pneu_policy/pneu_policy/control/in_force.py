# SPDX-License-Identifier: Apache-2.0
"""Which command acted when: as a controller told it, or as the bridge says that it was applied.

A command goes by bus and may be late, and a bridge may refuse it and close the valves instead.
Where nobody says what was applied, what was told is taken to have acted in time.
"""

import math
from collections import deque

Command = tuple[float, float]
"""From when on it acts, s, and V."""

SAME_V = 0.02
"""Voltages as near as this are the same: what a register of 12 bits makes of one."""
SAME_S = 1e-7
"""Times that are as near to each other are the same."""
LATE_S = 0.03
"""What was told so long ago and is not what was applied last is not followed, s."""
KEPT_S = 0.25
"""What was told so long ago and not applied since never will be, s."""


class InForce:
    """The commands of a controller over time.

    Attributes:
        followed: Whether what is told is what is applied, by the last that was heard.
    """

    def __init__(self, null_v: float) -> None:
        """Has nothing told.

        Args:
            null_v: What acts until something is, V.
        """
        self._null_v = null_v
        self.reset()

    def reset(self) -> None:
        """Forgets all."""
        self._applied: deque[Command] = deque([(-math.inf, self._null_v)])
        self._told: deque[Command] = deque()
        self.followed, self._heard = True, False

    def tell(self, time_s: float, volts: float) -> None:
        """Takes a command.

        Args:
            time_s: When it begins to act unless it is late, s.
            volts: V.
        """
        self._told.append((time_s, volts))

    def apply(self, time_s: float, volts: float) -> None:
        """Takes what was applied.

        Args:
            time_s: Since when it acts, s.
            volts: V.
        """
        if time_s < self._applied[-1][0]:  # of before what is known already
            return
        self._heard = True
        same = [n for n, (_, told) in enumerate(self._told) if abs(told - volts) < SAME_V]
        again = abs(volts - self._applied[-1][1]) < SAME_V
        if again and 0 not in same:  # a bridge may write the same thing many times
            return
        self._applied.append((time_s, volts))
        self.followed = bool(same)
        for _ in range(same[0] + 1 if same else 0):  # what was told before was overtaken
            self._told.popleft()

    def at(self, time_s: float) -> float:
        """What acts at a time, V.

        Args:
            time_s: The time, s.
        """
        return next(volts for at, volts in reversed(self._course()) if at <= time_s + SAME_S)

    def mean(self, begin_s: float, long_s: float) -> float:
        """Mean of what acts for a while, V.

        Args:
            begin_s: From when on, s.
            long_s: For how long, s.
        """
        first, end_s = self.at(begin_s), begin_s + long_s
        extra, before = 0.0, first
        for at, volts in self._course():
            if begin_s + SAME_S < at < end_s - SAME_S:
                extra += (volts - before) * (end_s - at)
                before = volts
        return first + extra / long_s

    def forget_before(self, time_s: float) -> None:
        """Lets go of what no longer acts, and of commands that a bridge never followed.

        Args:
            time_s: The present, s; nothing of before this will be asked for.
        """
        now_v = self._applied[-1][1]
        while self._heard and self._told and self._told[0][0] < time_s - LATE_S:
            if abs(self._told[0][1] - now_v) >= SAME_V:
                self.followed = False
                break
            self._told.popleft()  # that is what valves have already
        while len(self._applied) > 1 and self._applied[1][0] <= time_s:
            self._applied.popleft()
        while len(self._told) > 1 and self._told[0][0] < time_s - KEPT_S:
            self._told.popleft()

    def _course(self) -> list[Command]:
        """All commands, in order: those that were applied, then those that will be."""
        last_s = self._applied[-1][0]
        ahead = [one for one in self._told if one[0] > last_s] if self.followed else []
        return [*self._applied, *ahead]
