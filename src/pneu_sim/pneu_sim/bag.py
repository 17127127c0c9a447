# SPDX-License-Identifier: Apache-2.0
"""Writing signals of a rig as a rosbag2 MCAP recording, on the topics that the rig file names."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_common.files import check_name_is_text, scratch_beside
from pneu_runtime import interfaces
from pneu_sim.channels import Channel
from pneu_sim.rig.schema import Rig
from pneu_sim.signals import Motion, Signal
from pneu_sim.topics import (
    FLOAT64,
    FLUID_PRESSURE,
    JOINT_STATE,
    JOINTS_TOPIC,
    NAMED_VALUES,
    VALVE_COMMAND,
    encoder_channel,
    encoder_topics,
    same_topic,
)

FIELD_OF = {FLUID_PRESSURE: "fluid_pressure", FLOAT64: "data"}
"""Message types that are written, and the field that holds the number."""

NAMED_FIELDS = {kind: NAMED_VALUES[kind][0] for kind in (VALVE_COMMAND, JOINT_STATE)}
"""Those with the values of several signals, and where they are; told by name."""

JOINTS_IN_BAG = f"/{JOINTS_TOPIC}"
"""Topic of the joints; topics in a bag are absolute."""

FIRST_STAMP_S = 1.0
"""Where recordings without a clock time begin: a stamp of zero would count as absent."""


def write_bag(
    path: str | Path,
    rig: Rig,
    commands: Mapping[str, Signal],
    pressures: Mapping[str, Signal],
    start_time_s: float = 0.0,
    replace: bool = False,
    motion: Motion | None = None,
    encoders: Mapping[str, Signal] | None = None,
) -> None:
    """Writes a recording, every signal at its own times, whole or not at all.

    Pressures go out as stamped ``FluidPressure`` and commands as ``Float64``, unless the channel
    names the other type; scale and offset of the channel are undone. NaN samples are left out.
    Commands of a ``ValveCommand`` go out in one message where they change at one instant, by name.
    Joints go out together as ``JointState`` on ``/joint_states``; and so does what encoders read,
    those of one topic and instant together, or as a ``Float64`` where the channel says so.

    Args:
        path: Folder of the bag, or a file that ends in ``.mcap``; must not exist yet.
        rig: Rig whose channels say which topics the signals have.
        commands: Volts per command; they may begin before time 0.
        pressures: Absolute pressures per tap, Pa.
        start_time_s: Clock time of time 0, Unix time; where it is 0, the first sample is at
            ``FIRST_STAMP_S`` or later.
        replace: Whether an ``.mcap`` file that exists is replaced.
        motion: Where the joints of bodies were; None, or of no joint, writes nothing.
        encoders: Readings per encoder, rad or m.

    Raises:
        InputError: The path exists or cannot be written, or a signal has no topic or a message type
            that is not written.
    """
    path = Path(path)
    if path.exists() and not (replace and path.is_file() and path.suffix == ".mcap"):
        raise InputError(f"{path}: exists already; a recording is written to a new path")
    signals = [
        _signal(path, f"commands.{name}", rig.commands.get(name), FLOAT64, name, signal)
        for name, signal in commands.items()
    ] + [
        _signal(path, f"taps.{name}", rig.taps.get(name), FLUID_PRESSURE, name, signal)
        for name, signal in pressures.items()
    ]
    of_encoders = encoders or {}
    read = {
        name: _signal(
            path, f"encoders.{name}", None, JOINT_STATE, name, signal, encoder_channel(rig, name)
        )
        for name, signal in of_encoders.items()
    }
    signals += [signal for signal in read.values() if signal.kind != JOINT_STATE]
    valves = [signal for signal in signals if signal.kind == VALVE_COMMAND]
    signals = [signal for signal in signals if signal.kind != VALVE_COMMAND]
    groups = [
        _together(topic, VALVE_COMMAND, [one for one in valves if one.topic == topic])
        for topic in dict.fromkeys(signal.topic for signal in valves)
    ]
    groups += [
        _together(
            topic.name, JOINT_STATE, [read[one.name] for one in topic.signals if one.name in read]
        )
        for topic in encoder_topics(rig)
        if topic.type == JOINT_STATE and any(one.name in read for one in topic.signals)
    ]
    if motion is not None and not motion.positions:
        motion = None
    if motion is not None:
        groups.append(_Group(JOINTS_IN_BAG, JOINT_STATE, motion))
    if not signals and not groups:
        raise InputError(f"{path}: found no signal to write, at least one is needed")
    topics = [signal.topic for signal in signals]
    for signal in signals:
        if topics.count(signal.topic) > 1:
            raise InputError(
                f"{path}: {signal.name}: topic {signal.topic!r} is that of another signal of the"
                " rig too; a bag needs one for each"
            )
        if any(same_topic(group.topic, signal.topic) for group in groups):
            raise InputError(
                f"{path}: {signal.name}: topic {signal.topic!r} is that of the rig's joints or"
                " valves; a bag needs one for each"
            )
    shared = [group.topic for group in groups]
    if len(set(shared)) < len(shared):
        topic = next(topic for topic in shared if shared.count(topic) > 1)
        raise InputError(
            f"{path}: topic {topic!r} is that of valves, encoders or joints at once; a bag needs"
            " one for each"
        )
    times = [s.time_s for s in (*commands.values(), *pressures.values(), *of_encoders.values())]
    times += [] if motion is None else [motion.time_s]
    earliest_s = min((float(time_s[0]) for time_s in times if len(time_s)), default=0.0)
    begin_s = start_time_s
    if begin_s + min(earliest_s, 0.0) <= 0.0:
        begin_s = FIRST_STAMP_S - min(earliest_s, 0.0)
    begin_ns = round(begin_s * 1e9)
    check_name_is_text(path.name, "metadata.yaml of a bag")
    with scratch_beside(path) as aside:
        name = path.name.removesuffix(".mcap")
        _write(aside / name, signals, begin_ns, groups, rig.name)
        written = aside / name
        if path.suffix == ".mcap":
            written = next(written.glob("*.mcap"))
        os.replace(written, path)


@dataclass(frozen=True)
class _Channel:
    """What is written of a signal.

    Attributes:
        topic: Topic.
        kind: Message type.
        name: Name of the command or tap.
        time_ns: (n,) times after the start of the recording, ns.
        raw: (n,) values as the topic carries them.
    """

    topic: str
    kind: str
    name: str
    time_ns: NDArray[np.int64]
    raw: NDArray[np.float64]


@dataclass(frozen=True)
class _Group:
    """Signals that are written together, by name.

    Attributes:
        topic: Topic, absolute.
        kind: Message type, one of ``NAMED_FIELDS``.
        rows: The values as the topic carries them, as positions; NaN where nothing is told.
    """

    topic: str
    kind: str
    rows: Motion


def _signal(
    path: Path,
    where: str,
    part: Any,
    usual: str,
    name: str,
    signal: Signal,
    channel: Channel | None = None,
) -> _Channel:
    """A signal as its channel in the rig file wants it written."""
    channel = channel or getattr(part, "channel", None)
    if channel is None or channel.topic is None:
        raise InputError(f"{path}: {where} has no topic in the rig file, which a bag needs")
    kind = channel.type or usual
    if kind.count("/") == 1:
        kind = kind.replace("/", "/msg/")
    # Of a valve's voltage the name counts, not its number; joints may also be told by number.
    field = channel.field.partition("[")[0] if kind == VALVE_COMMAND else channel.field
    written = FIELD_OF | NAMED_FIELDS
    if written.get(kind) != field:
        raise InputError(
            f"{path}: {where}: found field {channel.field!r} of {kind}, written are"
            f" {', '.join(f'{field!r} of {t}' for t, field in written.items())}"
        )
    time_s, values = np.asarray(signal.time_s), np.asarray(signal.values, dtype=float)
    if time_s.shape != values.shape:
        raise InputError(
            f"{path}: {where}: found {time_s.size} times of {values.size} values, one each needed"
        )
    good = np.isfinite(values)
    raw = (values[good] - channel.offset) / channel.scale
    return _Channel(channel.topic, kind, name, np.rint(time_s[good] * 1e9).astype(np.int64), raw)


def _together(topic: str, kind: str, channels: list[_Channel]) -> _Group:
    """Signals of one topic at all their times; NaN where one has no value."""
    time_ns = np.unique(np.concatenate([channel.time_ns for channel in channels]))
    values = {}
    for channel in channels:
        row = np.full(time_ns.size, np.nan)
        row[np.searchsorted(time_ns, channel.time_ns)] = channel.raw
        values[channel.name] = row
    return _Group(f"/{topic.lstrip('/')}", kind, Motion(1e-9 * time_ns, values, {}))


def _write(
    folder: Path,
    channels: list[_Channel],
    begin_ns: int,
    groups: list[_Group],
    frame: str,
) -> None:
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(interfaces.full_text(VALVE_COMMAND), VALVE_COMMAND))
    header = store.types["std_msgs/msg/Header"]
    time = store.types["builtin_interfaces/msg/Time"]
    topics = [(channel.topic, channel.kind) for channel in channels]
    time_ns = [channel.time_ns for channel in channels]
    rows = [channel.raw for channel in channels]
    for group in groups:
        topics.append((group.topic, group.kind))
        time_ns.append(np.rint(group.rows.time_s * 1e9).astype(np.int64))
        rows.append(np.arange(group.rows.time_s.size, dtype=float))

    def message(k: int, value: float, stamp: int) -> Any:
        """A message of the k-th topic, of a value or of the row of that number."""
        kind = topics[k][1]
        if kind == FLOAT64:
            return store.types[kind](value)
        at = time(stamp // 10**9, stamp % 10**9)
        if kind == FLUID_PRESSURE:
            return store.types[kind](header(at, channels[k].name), value, 0.0)
        row, of = int(value), groups[k - len(channels)].rows
        told = [n for n, position in of.positions.items() if np.isfinite(position[row])]
        place, speed = (
            np.array([values[name][row] for name in told if name in values], dtype=float)
            for values in (of.positions, of.speeds)
        )
        if kind == VALVE_COMMAND:
            return store.types[kind](header(at, frame), told, place)
        return store.types[kind](header(at, frame), told, place, speed, np.zeros(0))

    # In the order of time, as a recorder writes; at one instant commands come before readings.
    which = np.repeat(np.arange(len(rows)), [of.size for of in rows])
    after_ns = np.concatenate(time_ns)
    reading = np.array([kind != VALVE_COMMAND for _, kind in topics])
    order = np.lexsort((reading[which], after_ns))  # keeps what is equal in its order
    values = np.concatenate(rows)
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = [
            writer.add_connection(topic, kind, typestore=store) for topic, kind in topics
        ]
        for after, k, value in zip(
            after_ns[order].tolist(), which[order].tolist(), values[order].tolist(), strict=True
        ):
            stamp = begin_ns + after
            data = store.serialize_cdr(message(k, value, stamp), topics[k][1])
            writer.write(connections[k], stamp, data)
