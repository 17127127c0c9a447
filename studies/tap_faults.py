# SPDX-License-Identifier: Apache-2.0
"""What can be the matter with a tap: frozen, off, late, lost, from some time on."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from pneu_sysid.observed.follow import Spoil

OFF_PA = 20e3
LATE_S = 0.02


@dataclass
class Fault:
    """A tap that fails.

    Attributes:
        tap: The tap.
        begin_s: From when on, s.
        end_s: Until when, s.
    """

    tap: str
    begin_s: float
    end_s: float = math.inf

    def __call__(self, time_s: float, read: dict[str, float]) -> dict[str, float]:
        """See `pneu_sysid.observed.follow.Spoil`.

        Args:
            time_s: Time, s.
            read: By tap.
        """
        failing = self.begin_s <= time_s < self.end_s
        return {**read, self.tap: self.shown(time_s, read[self.tap], failing)}

    def shown(self, time_s: float, true: float, failing: bool) -> float:
        """What the tap reads.

        Args:
            time_s: Time, s.
            true: What it would read.
            failing: Whether it fails now.
        """
        return math.nan if failing else true


@dataclass
class Frozen(Fault):
    """It reads on and on what it read."""

    held: float = math.nan

    def shown(self, time_s: float, true: float, failing: bool) -> float:
        """See `Fault.shown`.

        Args:
            time_s: Time, s.
            true: What it would read.
            failing: Whether it fails now.
        """
        if not failing:
            self.held = true
        return self.held


@dataclass
class Off(Fault):
    """It is off by something."""

    def shown(self, time_s: float, true: float, failing: bool) -> float:
        """See `Fault.shown`.

        Args:
            time_s: Time, s.
            true: What it would read.
            failing: Whether it fails now.
        """
        return true + OFF_PA if failing else true


@dataclass
class Late(Fault):
    """It has a first-order lag."""

    lagging: float = math.nan
    before_s: float = math.nan

    def shown(self, time_s: float, true: float, failing: bool) -> float:
        """See `Fault.shown`.

        Args:
            time_s: Time, s.
            true: What it would read.
            failing: Whether it fails now.
        """
        if not failing or math.isnan(self.lagging):
            self.lagging = true
        else:
            share = 1.0 - math.exp(-(time_s - self.before_s) / LATE_S)
            self.lagging += share * (true - self.lagging)
        self.before_s = time_s
        return self.lagging


FAULTS: dict[str, Callable[[str, float], Spoil]] = {
    "frozen": Frozen,
    f"off by {OFF_PA / 1e3:g} kPa": Off,
    f"late by {1e3 * LATE_S:g} ms": Late,
}
