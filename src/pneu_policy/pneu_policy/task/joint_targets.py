# SPDX-License-Identifier: Apache-2.0
"""Random targets of a joint that show what its mechanics do: jumps, slow ways, and rests.

Dry friction and play show while a joint creeps and turns back, inertia and loads while it jumps,
springs and a centre of mass where it rests, so each is there, over all of its range.
"""

import numpy as np

WAYS_S = (0.0, 0.4, 1.5)
"""How long a way from one target to the next takes, s; 0 is a jump."""
RESTS_S = (0.3, 0.6)
"""How long a target is rested at, s, from and to."""


class JointTargets:
    """Targets one after the other, the same for the same seed."""

    def __init__(self, lower: float, upper: float, seed: int) -> None:
        """Begins in the middle.

        Args:
            lower: Lowest target, rad or m.
            upper: Highest target, likewise.
            seed: Of the draws.
        """
        self._lower, self._upper = lower, upper
        self._rng = np.random.default_rng(seed)
        self._from = self._to = 0.5 * (lower + upper)
        self._begun_s = self._there_s = self._until_s = 0.0

    def at(self, time_s: float) -> float:
        """The target at a time, rad or m.

        Args:
            time_s: No earlier than at the call before, s.
        """
        while time_s >= self._until_s:
            self._from, self._to = self._to, float(self._rng.uniform(self._lower, self._upper))
            self._begun_s = self._until_s
            self._there_s = self._begun_s + float(self._rng.choice(WAYS_S))
            self._until_s = self._there_s + float(self._rng.uniform(*RESTS_S))
        if time_s >= self._there_s:
            return self._to
        share = (time_s - self._begun_s) / (self._there_s - self._begun_s)
        return self._from + share * (self._to - self._from)
