# SPDX-License-Identifier: Apache-2.0
"""What an encoder must not say: beyond a limit, too fast, a jump, or nothing new while gas pushes.

A joint at rest may read the same bit for bit for ever, so that a reading stands still proves
nothing by itself. But friction and load hold no more than some force; where the gas pushes with
more, and not into a stop, the joint moves, and an encoder that shows none of it is broken.
"""

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

SPEED_OVER_S = 0.04
"""Speeds are told over so long: the times of two readings are known to some milliseconds only."""

UNSURE_S = 0.01
"""So much later or earlier than is said may a reading have been taken, without a device's clock."""

REACH = 0.02
"""Share of a joint's travel within which it counts as being at a stop."""

BEYOND = 0.05
"""Share of a joint's travel beyond its stops that is still allowed: stops give way to a blow."""


@dataclass(frozen=True)
class FrozenLimits:
    """When a reading that stays as it is must be wrong.

    Attributes:
        force: Taps that push, each with its area, m^2 (or m^3 for a torque).
        hold: The most that friction and load hold at rest, N (or N m).
        offset: What pushes besides, N (or N m).
        after_s: For how long that may last.
        still: What counts as no movement, rad or m.
        stops: Lowest and highest position that the joint can have, rad or m.
    """

    force: Mapping[str, float]
    hold: float
    offset: float
    after_s: float
    still: float
    stops: tuple[float, float]


@dataclass(frozen=True)
class EncoderLimits:
    """Limits of one encoder, rad or m.

    Attributes:
        range: Lowest and highest reading that can be true.
        lower: Position below which the bridge trips; -infinite for none.
        upper: Position above which it trips; infinite for none.
        speed: Speed above which it trips; infinite for none.
        impossible: Speed that cannot be; infinite for none.
        resolution: Of its readings.
        frozen: When a reading that stays as it is trips; None is never.
    """

    range: tuple[float, float]
    lower: float = -math.inf
    upper: float = math.inf
    speed: float = math.inf
    impossible: float = math.inf
    resolution: float = 0.0
    frozen: FrozenLimits | None = None


class EncoderWatch:
    """One encoder's readings, and what is wrong with them.

    Attributes:
        seen_s: Steady time of the latest; -infinite before the first.
        value: The latest.
        good: Whether it can be true.
    """

    def __init__(self, name: str, limits: EncoderLimits) -> None:
        """Knows nothing yet.

        Args:
            name: The encoder's name.
            limits: What it goes by.
        """
        self._name, self._limits = name, limits
        self.seen_s, self.value, self.good = -math.inf, math.nan, False
        self.forget()

    def forget(self) -> None:
        """Begins anew: neither movement nor standing still from before counts."""
        self._recent: deque[tuple[float, float]] = deque()
        self._anchor = math.nan
        self._pushed_s = self._pushed_taken_s = math.nan

    def take(
        self, value: float, now_s: float, taken_s: float | None, force: float | None, gap_s: float
    ) -> str:
        """Takes a reading.

        Args:
            value: Position, rad or m.
            now_s: Steady time at which it was acquired.
            taken_s: Time by the clock that readings are told apart by; None where that is not
                known well enough for a speed.
            force: What the gas pushes with; None where that is not known.
            gap_s: After a longer gap nothing follows from the readings before.

        Returns:
            Why the bridge is to trip; empty where nothing speaks against the reading.
        """
        limits, gap = self._limits, now_s - self.seen_s > gap_s
        self.seen_s, self.value = now_s, value
        self.good = limits.range[0] <= value <= limits.range[1]  # false for NaN
        if gap:
            self.forget()
        beyond = self.beyond()
        moved = "" if taken_s is None or not math.isfinite(value) else self._moved(value, taken_s)
        stuck = self._stuck(value, now_s, taken_s, force)
        return beyond or moved or stuck

    def beyond(self) -> str:
        """Says where the latest reading is beyond a limit of the joint; empty where it is not."""
        limits, value = self._limits, self.value
        if not math.isfinite(value):
            return ""
        if value > limits.upper:
            return f"{self._name} is at {value:.4g}, above its limit {limits.upper:.4g}"
        if value < limits.lower:
            return f"{self._name} is at {value:.4g}, below its limit {limits.lower:.4g}"
        return ""

    def _moved(self, value: float, taken_s: float) -> str:
        """Whether it has jumped since the reading before, or moves too fast."""
        limits, recent = self._limits, self._recent
        if recent and taken_s <= recent[-1][0]:  # a clock that began anew
            recent.clear()
        said = ""
        slack = 2.0 * limits.resolution
        if recent:
            passed_s, way = taken_s - recent[-1][0], value - recent[-1][1]
            if abs(way) > limits.impossible * (passed_s + UNSURE_S) + slack:
                said = (
                    f"{self._name} jumped by {way:.4g} in {1e3 * passed_s:.1f} ms, faster than"
                    f" {limits.impossible:.4g}/s"
                )
        recent.append((taken_s, value))
        while len(recent) > 2 and recent[1][0] <= taken_s - SPEED_OVER_S:
            recent.popleft()
        passed_s, way = taken_s - recent[0][0], abs(value - recent[0][1])
        if not said and passed_s >= SPEED_OVER_S and way > limits.speed * passed_s + slack:
            said = (
                f"{self._name} moves at {way / passed_s:.4g}/s, above its limit {limits.speed:.4g}"
            )
        return said

    def _stuck(self, value: float, now_s: float, taken_s: float | None, force: float | None) -> str:
        """Whether it shows no movement while the gas pushes with more than can be held."""
        frozen = self._limits.frozen
        if frozen is None:
            return ""
        if not abs(value - self._anchor) <= frozen.still:  # also from NaN
            self._anchor, self._pushed_s = value, math.nan
        low, high = frozen.stops
        reach = REACH * (high - low)
        into_stop = force is not None and (
            (force > 0.0 and value >= high - reach) or (force < 0.0 and value <= low + reach)
        )
        if force is None or abs(force) <= frozen.hold or into_stop:
            self._pushed_s = math.nan
            return ""
        if math.isnan(self._pushed_s):
            self._pushed_s = now_s
            self._pushed_taken_s = math.nan if taken_s is None else taken_s
        pushed_s = now_s - self._pushed_s
        if taken_s is not None and taken_s >= self._pushed_taken_s:
            # Samples that come late show no less movement than their own time lets the joint have.
            pushed_s = min(pushed_s, taken_s - self._pushed_taken_s)
        if pushed_s < frozen.after_s:
            return ""
        return (
            f"{self._name} is frozen at {value:.4g}: pushed by {abs(force):.4g} for"
            f" {1e3 * pushed_s:.0f} ms it shows no movement; at rest"
            f" {frozen.hold:.4g} can be held"
        )
