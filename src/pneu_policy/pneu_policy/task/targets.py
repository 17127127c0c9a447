# SPDX-License-Identifier: Apache-2.0
"""Random pressure targets; see `pneu_policy.task.waves`."""

import math
from dataclasses import dataclass, field

from numpy.typing import ArrayLike

from pneu_common.errors import InputError
from pneu_policy.task.waves import KINDS as KINDS
from pneu_policy.task.waves import Floats, Kind, Wave


@dataclass(frozen=True)
class Target:
    """A random pressure over time.

    Attributes:
        kind: ``smooth``, ``jagged``, ``hold``, or ``mixed``, which takes turns.
        low_pa: Lowest pressure, Pa.
        high_pa: Highest pressure, Pa.
        period_s: Typical time from one extreme or level to the next, s.
        seed: Seed of all randomness.
        turn_s: How long each kind lasts where they take turns, s.
        jitter: Share of the period by which the corners of a jagged target are moved at random.
    """

    kind: Kind
    low_pa: float
    high_pa: float
    period_s: float = 0.5
    seed: int = 0
    turn_s: float = 4.0
    jitter: float = 0.0
    _wave: Wave = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Raises InputError where the numbers make no target."""
        if not (0.0 < self.low_pa < self.high_pa and math.isfinite(self.high_pa)):
            raise InputError(
                f"low_pa, high_pa: found {self.low_pa:g} and {self.high_pa:g}, both are absolute"
                " pressures and low_pa is the smaller one"
            )
        wave = Wave(
            self.kind, self.low_pa, self.high_pa, self.period_s, self.seed, self.turn_s, self.jitter
        )
        object.__setattr__(self, "_wave", wave)

    def at(self, time_s: ArrayLike) -> Floats:
        """The target at some times.

        Args:
            time_s: Times since the start, s; before it the target is that of the start.

        Returns:
            Pressures of the same shape, Pa.
        """
        return self._wave.at(time_s)
