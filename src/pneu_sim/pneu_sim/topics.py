# SPDX-License-Identifier: Apache-2.0
"""The signals of a rig as message topics: names, types, fields, and values into and out of them.

Nothing here imports ROS; messages are only touched as objects that a node hands in. The rig file's
channels say where a signal is. A signal without a channel, or with one for text files only, is
where the conventions of the live graph have it: commands together on ``valve/command``, each tap on
``taps/<tap>/pressure``.
"""

import importlib
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pneu_common.errors import InputError
from pneu_sim.channels import Channel
from pneu_sim.rig.schema import Rig

COMMAND_TOPIC = "valve/command"
APPLIED_TOPIC = "valve/applied"
TAPS_TOPIC = "taps/pressures"
VALVE_COMMAND = "pneu_msgs/msg/ValveCommand"
TAP_PRESSURES = "pneu_msgs/msg/TapPressures"
FLUID_PRESSURE = "sensor_msgs/msg/FluidPressure"
FLOAT64 = "std_msgs/msg/Float64"

NAMED_VALUES = {VALVE_COMMAND: "voltage_v", TAP_PRESSURES: "pressure_pa"}
"""Types whose values belong to the names they carry, whatever their order."""

_STEP = re.compile(r"([A-Za-z]\w*)(?:\[(\d+)\])?$")
_LONGEST = 1024  # an index beyond this is a slip of the pen, not a message


@dataclass(frozen=True)
class Signal:
    """One command or tap inside the messages of a topic.

    Attributes:
        name: Name of the command or tap.
        topic: Topic, relative or absolute.
        type: Message type in its long form, such as ``std_msgs/msg/Float64``.
        path: Steps to the number: field names, each with an index or None.
        scale: SI units per raw unit.
        offset: SI value at raw zero.
    """

    name: str
    topic: str
    type: str
    path: tuple[tuple[str, int | None], ...]
    scale: float = 1.0
    offset: float = 0.0

    def read(self, message: Any) -> float | None:
        """The signal's value in a message.

        Args:
            message: Message of the signal's type.

        Returns:
            In SI units, not necessarily finite; None where the message says nothing of the signal.
        """
        named = NAMED_VALUES.get(self.type)
        if named is not None and len(message.name):
            for name, value in zip(message.name, getattr(message, named), strict=False):
                if name == self.name:
                    return float(value) * self.scale + self.offset
            return None
        value = message
        for field, index in self.path:
            value = getattr(value, field)
            if index is not None:
                if index >= len(value):
                    return None
                value = value[index]
        return float(value) * self.scale + self.offset

    def write(self, message: Any, value: float) -> None:
        """Puts the signal's value into a message; sequences grow as needed, filled up with NaN.

        Args:
            message: Message of the signal's type.
            value: In SI units.
        """
        raw = (value - self.offset) / self.scale
        *way, (field, index) = self.path
        for step, i in way:
            message = getattr(message, step) if i is None else getattr(message, step)[i]
        if index is None:
            kind = type(getattr(message, field))
            setattr(message, field, raw if kind is float else kind(round(raw)))
            return
        values = [float(v) for v in getattr(message, field)]
        values += [math.nan] * (index + 1 - len(values))
        values[index] = raw
        setattr(message, field, values)
        if NAMED_VALUES.get(self.type) == field:
            names = [*message.name, *[""] * (len(values) - len(message.name))]
            names[index] = self.name
            message.name = names


@dataclass(frozen=True)
class Topic:
    """One topic and the signals of a rig that its messages carry.

    Attributes:
        name: Topic, relative or absolute.
        type: Message type in its long form.
        signals: The signals.
    """

    name: str
    type: str
    signals: tuple[Signal, ...]

    def read(self, message: Any) -> dict[str, float]:
        """What a message says of the rig's signals.

        Args:
            message: Message of this topic.

        Returns:
            SI values by name of those signals that the message has a number for; not necessarily
            finite.
        """
        found = {signal.name: signal.read(message) for signal in self.signals}
        return {name: value for name, value in found.items() if value is not None}

    def message(self, values: Mapping[str, float], stamp: Any | None = None) -> Any | None:
        """A message of this topic.

        Args:
            values: SI values by name of signal.
            stamp: ``builtin_interfaces.msg.Time`` for the header, where the type has one.

        Returns:
            The message; None where `values` has none of the signals.
        """
        if not any(signal.name in values for signal in self.signals):
            return None
        message = message_class(self.type)()
        header = getattr(message, "header", None)
        if header is not None:
            if stamp is not None:
                header.stamp = stamp
            if len(self.signals) == 1:
                header.frame_id = self.signals[0].name
        elif stamp is not None and hasattr(message, "stamp"):
            message.stamp = stamp
        for signal in self.signals:
            if signal.name in values:
                signal.write(message, values[signal.name])
        return message


def command_topics(rig: Rig) -> list[Topic]:
    """Topics on which the commands of a rig arrive.

    Args:
        rig: The rig.

    Raises:
        InputError: A channel's field is no path to a number, or one topic has two types.
    """
    usual = {name: i for i, name in enumerate(rig.commands)}
    return _grouped(
        rig,
        [
            _signal(
                rig,
                "commands",
                name,
                command.channel,
                Channel(topic=COMMAND_TOPIC, field=f"voltage_v[{usual[name]}]", type=VALVE_COMMAND),
            )
            for name, command in rig.commands.items()
        ],
    )


def tap_topics(rig: Rig) -> list[Topic]:
    """Topics on which the readings of a rig's taps go out.

    Args:
        rig: The rig.

    Raises:
        InputError: A channel's field is no path to a number, or one topic has two types.
    """
    return _grouped(
        rig,
        [
            _signal(
                rig,
                "taps",
                name,
                tap.channel,
                Channel(topic=f"taps/{name}/pressure", field="fluid_pressure", type=FLUID_PRESSURE),
            )
            for name, tap in rig.taps.items()
        ],
    )


def message_class(type_name: str) -> Any:
    """The class of a message type, from whichever ROS is there.

    Args:
        type_name: Such as ``sensor_msgs/msg/FluidPressure``.

    Raises:
        InputError: There is no such type.
    """
    package, kind, name = long_type(type_name).split("/")
    try:
        return getattr(importlib.import_module(f"{package}.{kind}"), name)
    except (ImportError, AttributeError):
        raise InputError(f"message type {type_name!r}: it is not known here") from None


def long_type(name: str) -> str:
    """A message type in its long form.

    Args:
        name: Such as ``std_msgs/Float64`` or ``std_msgs/msg/Float64``.

    Raises:
        InputError: The name has another shape.
    """
    parts = name.split("/")
    if len(parts) == 2:
        parts.insert(1, "msg")
    if len(parts) != 3 or not all(parts):
        raise InputError(f"message type {name!r}: allowed is the form package/msg/Name")
    return "/".join(parts)


def same_topic(recorded: str, wanted: str) -> bool:
    """Whether a full topic name is the one that a rig file means.

    Args:
        recorded: Full name, such as ``/rig/taps/end/pressure``.
        wanted: Name in the rig file; a relative one is meant in whatever namespace it lies.
    """
    return recorded == wanted or (not wanted.startswith("/") and recorded.endswith(f"/{wanted}"))


def _signal(rig: Rig, part: str, name: str, channel: Channel | None, usual: Channel) -> Signal:
    if channel is None or channel.topic is None:
        channel = usual
    kind = channel.type
    if kind is None:
        kind = FLOAT64 if part == "commands" or channel.field == "data" else FLUID_PRESSURE
    path: list[tuple[str, int | None]] = []
    for step in channel.field.split("."):
        match = _STEP.match(step)
        if match is None or int(match[2] or 0) >= _LONGEST:
            raise InputError(
                f"rig {rig.name!r}: {part}.{name}.channel.field: found {channel.field!r}, allowed"
                " is a path such as 'data', 'a.b' or 'position[0]'"
            )
        path.append((match[1], None if match[2] is None else int(match[2])))
    assert channel.topic is not None
    return Signal(name, channel.topic, long_type(kind), tuple(path), channel.scale, channel.offset)


def _grouped(rig: Rig, signals: Sequence[Signal]) -> list[Topic]:
    topics: dict[str, list[Signal]] = {}
    for signal in signals:
        group = topics.setdefault(signal.topic, [])
        group.append(signal)
        if signal.type != group[0].type:
            raise InputError(
                f"rig {rig.name!r}: topic {signal.topic!r} has the type {group[0].type} for"
                f" {group[0].name!r} and {signal.type} for {signal.name!r}; it can have one"
            )
    return [Topic(name, group[0].type, tuple(group)) for name, group in topics.items()]
