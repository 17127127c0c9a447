# SPDX-License-Identifier: Apache-2.0
"""Faults of the emulated device, on demand and for a time."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from pneu_common.errors import InputError


@dataclass(frozen=True)
class FaultKind:
    """One kind of fault.

    Attributes:
        name: Name.
        title: What happens, for people.
        at: What it sits at, a ``sensor``, an ``encoder`` or an ``output``; without the name of one
            it sits at all of them. Empty where it sits at the device.
        value: What its number means, and its usual value; None where it has none.
    """

    name: str
    title: str
    at: str = ""
    value: tuple[str, float] | None = None


KINDS = {
    kind.name: kind
    for kind in (
        FaultKind("drop", "the connection is closed and no new one accepted"),
        FaultKind("slow", "every answer is late", value=("delay, s", 0.3)),
        FaultKind("silent", "requests are neither carried out nor answered"),
        FaultKind("exception", "every request is refused", value=("exception code", 4.0)),
        FaultKind("word_order", "the registers of every reading are swapped"),
        FaultKind("frozen", "a sensor keeps its reading", "sensor"),
        FaultKind(
            "out_of_range",
            "a sensor shows what cannot be",
            "sensor",
            ("reading, Pa, rad or m", 1e7),
        ),
        FaultKind(
            "jump", "an encoder reads that much more at once", "encoder", ("by, rad or m", 0.5)
        ),
        FaultKind("dead_valve", "the bus to a valve is dead, behind the device", "output"),
        FaultKind("supply", "the supply pressure is lost"),
        FaultKind("malformed", "answers are random bytes"),
    )
}


@dataclass
class Active:
    """A fault that is present.

    Attributes:
        kind: Its kind.
        until_s: Steady time at which it ends; infinite for not by itself.
        value: Its number.
        channel: The sensor, encoder or output it sits at; empty for all.
        held: Readings it keeps, for ``frozen``.
    """

    kind: FaultKind
    until_s: float
    value: float
    channel: str = ""
    held: dict[str, float] = field(default_factory=dict)


class Faults:
    """The faults that are present, by name."""

    def __init__(
        self, places: Mapping[str, Sequence[str]], changed: Callable[[str, bool], None]
    ) -> None:
        """Starts without any.

        Args:
            places: What faults may sit at: names of each ``sensor``, ``encoder`` and ``output``.
            changed: Called with the name of a fault, and whether it begins or ends.
        """
        self._places = places
        self._changed = changed
        self._active: dict[str, Active] = {}

    def begin(
        self,
        name: str,
        now_s: float,
        duration_s: float | None = None,
        value: float | None = None,
        channel: str = "",
    ) -> Active:
        """Begins a fault.

        Args:
            name: Its kind.
            now_s: Now.
            duration_s: How long it lasts, s; None until it is cleared.
            value: Its number; None is the usual one.
            channel: The sensor, encoder or output it sits at; empty for all.

        Raises:
            InputError: There is no such fault, place for it, or number.
        """
        kind = KINDS.get(name)
        if kind is None:
            raise InputError(f"fault {name!r}: known are {', '.join(KINDS)}")
        if channel and not kind.at:
            raise InputError(f"fault {name!r} does not sit at a sensor, found {channel!r}")
        known = self._places[kind.at] if kind.at else ()
        if kind.at and not known:
            raise InputError(f"fault {name!r}: the device has no {kind.at}")
        if channel and channel not in known:
            raise InputError(f"{kind.at} {channel!r}: the device has {', '.join(known)}")
        if duration_s is not None and not (duration_s > 0.0 and math.isfinite(duration_s)):
            raise InputError(f"duration of fault {name!r}: found {duration_s:g}, must be positive")
        if value is not None and kind.value is None:
            raise InputError(f"fault {name!r} has no number, found {value:g}")
        usual = kind.value[1] if kind.value else math.nan
        active = Active(
            kind,
            math.inf if duration_s is None else now_s + duration_s,
            usual if value is None else value,
            channel,
        )
        self._active[name] = active
        self._changed(name, True)
        return active

    def clear(self, name: str = "") -> list[str]:
        """Ends a fault, or all of them; returns which.

        Args:
            name: Its kind; empty for all.

        Raises:
            InputError: There is no such kind of fault.
        """
        if name and name not in KINDS:
            raise InputError(f"fault {name!r}: known are {', '.join(KINDS)}")
        ended = [one for one in list(self._active) if name in ("", one)]
        for one in ended:
            del self._active[one]
            self._changed(one, False)
        return ended

    def get(self, name: str, now_s: float) -> Active | None:
        """Returns a fault where it is present.

        Args:
            name: Its kind.
            now_s: Now; a fault whose time is over ends.
        """
        active = self._active.get(name)
        if active is not None and now_s >= active.until_s:
            self.clear(name)
            return None
        return active

    def present(self, now_s: float) -> list[str]:
        """Returns the names of the faults that are present.

        Args:
            now_s: Now.
        """
        return [name for name in KINDS if self.get(name, now_s) is not None]
