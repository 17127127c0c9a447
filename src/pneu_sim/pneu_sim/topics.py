# SPDX-License-Identifier: Apache-2.0
"""The signals of a rig as message topics: names, types, fields, and values into and out of them.

Nothing here imports ROS; messages are only touched as objects that a node hands in. The rig file's
channels say where a signal is. A signal without a channel, or with one for text files only, is
where the conventions of the live graph have it: commands together on ``valve/command``, each tap on
``taps/<tap>/pressure``, encoders together on ``joint_states``, as everywhere in ROS. The joints of
a rig without encoders have no channels: where they truly are is on ``joint_states``.
"""

import functools
import importlib
import math
import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from pneu_common.errors import InputError
from pneu_common.interfaces import has_interfaces
from pneu_sim.channels import Channel
from pneu_sim.rig.schema import Rig

COMMAND_TOPIC = "valve/command"
APPLIED_TOPIC = "valve/applied"
TAPS_TOPIC = "taps/pressures"
JOINTS_TOPIC = "joint_states"
VALVE_COMMAND = "pneu_msgs/msg/ValveCommand"
TAP_PRESSURES = "pneu_msgs/msg/TapPressures"
FLUID_PRESSURE = "sensor_msgs/msg/FluidPressure"
JOINT_STATE = "sensor_msgs/msg/JointState"
FLOAT64 = "std_msgs/msg/Float64"

NAMED_VALUES = {
    VALVE_COMMAND: ("voltage_v",),
    TAP_PRESSURES: ("pressure_pa",),
    JOINT_STATE: ("position", "velocity", "effort"),
}
"""Types whose values belong to the names they carry, whatever their order, and fields with values.
An element of a JointState that is asked for by its number is that element, whatever its name."""

_STEP = re.compile(r"([A-Za-z]\w*)(?:\[(\d+)\])?$")
_LONGEST = 1024  # an index beyond this is a slip of the pen, not a message


@dataclass(frozen=True)
class Signal:
    """One command, tap or encoder inside the messages of a topic.

    Attributes:
        name: Name of the command, tap or encoder.
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

    @property
    def by_name(self) -> str:
        """Field with the values among which the signal's is found by its name; empty for none."""
        fields = NAMED_VALUES.get(self.type, ())
        if self.type != JOINT_STATE:
            return fields[0] if fields else ""
        field, index = self.path[0]
        return field if len(self.path) == 1 and index is None and field in fields else ""

    def read(self, message: Any) -> float | None:
        """The signal's value in a message.

        Args:
            message: Message of the signal's type.

        Returns:
            In SI units, not necessarily finite; None where the message says nothing of the signal.
        """
        named = self.by_name
        if named and (len(message.name) or self.type == JOINT_STATE):
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

    def raw(self, value: float) -> float:
        """What stands for a value in a message.

        Args:
            value: In SI units.
        """
        return (value - self.offset) / self.scale

    def write(self, message: Any, value: float) -> None:
        """Puts the signal's value into a message; sequences grow as needed, filled up with NaN.

        Args:
            message: Message of the signal's type.
            value: In SI units.
        """
        raw = self.raw(value)
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
        given = [signal for signal in self.signals if signal.name in values]
        named = {signal.by_name for signal in given}
        for field in named - {""}:  # of no others anything is said
            own = [signal for signal in given if signal.by_name == field]
            message.name = [signal.name for signal in own]
            setattr(message, field, [signal.raw(values[signal.name]) for signal in own])
        for signal in given:
            if not signal.by_name:
                signal.write(message, values[signal.name])
        return message


def command_topics(rig: Rig) -> list[Topic]:
    """Topics on which the commands of a rig arrive.

    Args:
        rig: The rig.

    Raises:
        InputError: A channel's field is no path to a number, or one topic has two types.
    """
    usual = _usual_command_channels(rig.commands)
    of_rig = {name: command.channel for name, command in rig.commands.items()}
    return _grouped(f"rig {rig.name!r}", "commands", of_rig, usual, FLOAT64)


def tap_topics(rig: Rig) -> list[Topic]:
    """Topics on which the readings of a rig's taps go out.

    Args:
        rig: The rig.

    Raises:
        InputError: A channel's field is no path to a number, or one topic has two types.
    """
    of_rig = {name: tap.channel for name, tap in rig.taps.items()}
    usual = _usual_tap_channels(rig.taps)
    return _grouped(f"rig {rig.name!r}", "taps", of_rig, usual, FLUID_PRESSURE)


def encoder_channel(rig: Rig, name: str) -> Channel:
    """Where readings of an encoder are recorded: as the rig file says, or where they usually are.

    Args:
        rig: The rig.
        name: The encoder's name.
    """
    channel = rig.encoders[name].channel
    if channel is None:
        return Channel(topic=f"/{JOINTS_TOPIC}", field="position", type=JOINT_STATE)
    if channel.topic is None or channel.type is not None:
        return channel
    return channel.model_copy(update={"type": FLOAT64 if channel.field == "data" else JOINT_STATE})


def encoder_topics(rig: Rig) -> list[Topic]:
    """Topics on which the readings of a rig's encoders go out; together, where they share one.

    Args:
        rig: The rig.

    Raises:
        InputError: A channel's field is no path to a number, one topic has two types, or it has a
            name that would have two values.
    """
    where = f"rig {rig.name!r}"
    of_rig = {name: encoder.channel for name, encoder in rig.encoders.items()}
    topics = _grouped(where, "encoders", of_rig, _usual_encoder_channels(of_rig), JOINT_STATE)
    for topic in topics:
        for signal in topic.signals:
            if topic.type == JOINT_STATE and signal.path[0][0] != "position":
                raise InputError(
                    f"{where}: encoders.{signal.name}.channel.field: found"
                    f" {signal.path[0][0]!r}, of a JointState an encoder is the 'position'"
                )
            if bool(signal.by_name) != bool(topic.signals[0].by_name):
                raise InputError(
                    f"{where}: encoders.{signal.name}.channel.field: topic {topic.name!r} has"
                    " encoders by name and by number; it can have one of them"
                )
    return topics


def position_topics(rig: Rig) -> list[Topic]:
    """Topics that tell where a rig's joints are: of its encoders, or of the joints themselves.

    Args:
        rig: The rig.

    Returns:
        The topics; that of joints has no signals of its own: its messages name them.
    """
    if rig.encoders:
        return encoder_topics(rig)
    return [Topic(JOINTS_TOPIC, JOINT_STATE, ())] if rig.moves else []


def usual_encoder_topics(names: Iterable[str]) -> list[Topic]:
    """Topics of encoders where no rig file says others.

    Args:
        names: Names of the encoders.
    """
    usual = _usual_encoder_channels(names)
    return _grouped("topics", "encoders", usual, usual, JOINT_STATE)


def usual_command_topics(names: Iterable[str]) -> list[Topic]:
    """Topics of commands where no rig file says others.

    Args:
        names: Names of the commands.
    """
    usual = _usual_command_channels(names)
    return _grouped("topics", "commands", usual, usual, VALVE_COMMAND)


def usual_tap_topics(names: Iterable[str]) -> list[Topic]:
    """Topics of taps where no rig file says others.

    Args:
        names: Names of the taps.
    """
    usual = _usual_tap_channels(names)
    return _grouped("topics", "taps", usual, usual, FLUID_PRESSURE)


def joint_states(
    positions: Mapping[str, float], speeds: Mapping[str, float], stamp: Any, frame: str
) -> Any:
    """A message of `JOINTS_TOPIC`, with all joints.

    Args:
        positions: Per joint its position, rad or m.
        speeds: Per joint its velocity, rad/s or m/s; empty where none is known.
        stamp: ``builtin_interfaces.msg.Time`` for the header.
        frame: The header's frame: what is simulated or measured.
    """
    message = message_class(JOINT_STATE)(
        name=list(positions),
        position=list(positions.values()),
        velocity=[speeds[name] for name in positions] if speeds else [],
    )
    message.header.stamp = stamp
    message.header.frame_id = frame
    return message


def check_joints_topic(rig: Rig, topics: Iterable[Topic]) -> None:
    """Raises InputError where a command or tap is on the topic of the rig's encoders or joints.

    Args:
        rig: The rig.
        topics: Those of its commands and taps.
    """
    taken = {f"/{JOINTS_TOPIC}": "joints"} if rig.moves else {}
    taken |= {f"/{topic.name.lstrip('/')}": "encoders" for topic in encoder_topics(rig)}
    for topic in topics:
        for name, whose in taken.items():
            if same_topic(name, topic.name):
                raise InputError(
                    f"rig {rig.name!r}: channel of {topic.signals[0].name!r}: topic {topic.name!r}"
                    f" is that of the rig's {whose}; give it another"
                )


def only(topics: Iterable[Topic], names: Collection[str]) -> list[Topic]:
    """Those topics that carry some signals, and these alone.

    Args:
        topics: The topics.
        names: Names of the signals.
    """
    parts = [
        replace(topic, signals=tuple(s for s in topic.signals if s.name in names))
        for topic in topics
    ]
    return [part for part in parts if part.signals]


def _usual_command_channels(names: Iterable[str]) -> dict[str, Channel]:
    return {
        name: Channel(topic=COMMAND_TOPIC, field=f"voltage_v[{i}]", type=VALVE_COMMAND)
        for i, name in enumerate(names)
    }


def _usual_tap_channels(names: Iterable[str]) -> dict[str, Channel]:
    return {
        name: Channel(topic=f"taps/{name}/pressure", field="fluid_pressure", type=FLUID_PRESSURE)
        for name in names
    }


def _usual_encoder_channels(names: Iterable[str]) -> dict[str, Channel]:
    return {name: Channel(topic=JOINTS_TOPIC, field="position", type=JOINT_STATE) for name in names}


@functools.lru_cache(maxsize=64)
def message_class(type_name: str) -> Any:
    """The class of a message type, from whichever ROS is there.

    Args:
        type_name: Such as ``sensor_msgs/msg/FluidPressure``.

    Raises:
        InputError: There is no such type.
    """
    package, kind, name = long_type(type_name).split("/")
    try:
        if not has_interfaces(package, kind):
            raise ImportError
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


def _signal(where: str, name: str, channel: Channel, untyped: str) -> Signal:
    kind = channel.type or (FLOAT64 if channel.field == "data" else untyped)
    path: list[tuple[str, int | None]] = []
    for step in channel.field.split("."):
        match = _STEP.match(step)
        if match is None or int(match[2] or 0) >= _LONGEST:
            raise InputError(
                f"{where}.{name}.channel.field: found {channel.field!r}, allowed is a path such as"
                " 'data', 'a.b' or 'position[0]'"
            )
        path.append((match[1], None if match[2] is None else int(match[2])))
    assert channel.topic is not None
    return Signal(name, channel.topic, long_type(kind), tuple(path), channel.scale, channel.offset)


def _grouped(
    rig: str,
    part: str,
    channels: Mapping[str, Channel | None],
    usual: Mapping[str, Channel],
    untyped: str,
) -> list[Topic]:
    """Signals by topic; each where its channel has it, or where it usually is."""
    topics: dict[str, list[Signal]] = {}
    for name, channel in channels.items():
        if channel is None or channel.topic is None:
            channel = usual[name]
        signal = _signal(f"{rig}: {part}", name, channel, untyped)
        group = topics.setdefault(signal.topic, [])
        group.append(signal)
        if signal.type != group[0].type:
            raise InputError(
                f"{rig}: topic {signal.topic!r} has the type {group[0].type} for"
                f" {group[0].name!r} and {signal.type} for {signal.name!r}; it can have one"
            )
    return [Topic(name, group[0].type, tuple(group)) for name, group in topics.items()]
