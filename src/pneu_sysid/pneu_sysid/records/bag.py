# SPDX-License-Identifier: Apache-2.0
"""Channels out of rosbag2 MCAP recordings: which topic, which field, which values."""

import difflib
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from pneu_common.errors import InputError
from pneu_sim.channels import Channel
from pneu_sim.signals import velocity_of
from pneu_sim.topics import (
    JOINT_STATE,
    JOINTS_TOPIC,
    NAMED_VALUES,
    TAP_PRESSURES,
    VALVE_COMMAND,
    same_topic,
)
from pneu_sysid.records.alike import Decoded
from pneu_sysid.records.container import RawTopic, Topics, collect
from pneu_sysid.records.decode import (
    check_number,
    columns_of,
    getter_of,
    messages_of,
    split_field,
    stamp_path,
    typestore_of,
)
from pneu_sysid.records.recording import Finding, absent
from pneu_sysid.records.stream import Role, Stream

OF_JOINTS = NAMED_VALUES[JOINT_STATE]
"""Fields of a ``JointState`` that hold a number for each joint that it names."""
OF_NAMES = {kind: NAMED_VALUES[kind] for kind in (VALVE_COMMAND, TAP_PRESSURES)}
"""Fields of other types with a number for each name; as nodes read them."""


def read_bag(
    path: Path,
    commands: dict[str, Channel],
    pressures: dict[str, Channel],
    positions: dict[str, Channel] | None = None,
    encoders: dict[str, Channel] | None = None,
) -> tuple[list[Stream], list[Finding]]:
    """Read the mapped channels of a bag.

    Args:
        path: rosbag2 folder (metadata.yaml and .mcap files) or bare .mcap file, either
            compressed with zstd by message, chunk or file, or not.
        commands: Held channels by name.
        pressures: Pressure channels by name.
        positions: Channels of spools' positions by name, which the bag may lack.
        encoders: Channels of encoders by name; in a ``JointState`` the name is the joint's.

    Returns:
        One stream per channel in file order, with ``stamp_ns`` set to the log time, and
        the findings about the files. Positions that are not in the bag are among the findings.

    Raises:
        InputError: The bag is unreadable, or a channel's topic, type or field is not in it.
    """
    encoders = encoders or {}
    for name, channel in {**commands, **pressures, **encoders}.items():
        if channel.topic is None:
            raise InputError(f"{path}: channel '{name}' has no topic, which a bag needs")
    positions = positions or {}
    channels_of_bag = [
        channel
        for channels in (commands, pressures, encoders, positions)
        for channel in channels.values()
    ]
    wanted = {t for c in channels_of_bag for t in (c.topic, c.applied) if t}
    topics, findings = collect(path, wanted)
    decoded: dict[tuple[str, str], Decoded] = {}
    streams = []
    roles: list[tuple[Role, dict[str, Channel]]] = [
        ("command", commands),
        ("pressure", pressures),
        ("encoder", encoders),
        ("position", positions),
    ]
    for role, channels in roles:
        for name, channel in channels.items():
            applied = _is_in(topics, channel.applied)
            if role == "position" and not (applied or _is_in(topics, channel.topic)):
                what = f"topic '{channel.topic}' has no message in the bag"
                findings.append(absent(name, what if channel.topic else "it has no topic"))
                continue
            if applied:
                channel = channel.model_copy(update={"topic": channel.applied})
            topic = _find_topic(path, name, channel, topics)
            where = f"{path}: channel '{name}': topic '{topic.name}' ({topic.msgtype})"
            store = typestore_of(where, topic, name, findings)
            of_joint = (
                role == "encoder" and topic.msgtype == JOINT_STATE and channel.field in OF_JOINTS
            )
            named = _named_field(topic.msgtype, channel.field)
            if not of_joint:
                check_number(where, store, topic.msgtype, channel.field)
            key = (topic.name, topic.msgtype)
            if key not in decoded:
                decoded[key] = columns_of(where, store, topic)
            messages = decoded[key]
            if of_joint:
                raw, said = _of_joint(where, messages, name, channel.field)
            elif named and any(len(message.name) for message in messages.kinds()):
                raw, said = _of_name(where, messages, name, named)
            else:
                raw = _values(where, messages, channel.field)
                said = np.ones(raw.size, dtype=bool)
            log_ns = np.array(topic.log_ns, dtype=np.int64)
            stamp = stamp_path(store, topic.msgtype)
            if channel.stamp == "header" and stamp is None:
                raise InputError(
                    f"{where} has no header stamp, but stamp 'header' was asked for "
                    "(allowed here: 'auto' or 'log')"
                )
            streams.append(
                Stream(
                    name=name,
                    role=role,
                    source=f"topic {topic.name}, field {channel.field}",
                    arrival=np.array(topic.arrival, dtype=np.int64),
                    log_ns=log_ns,
                    header_ns=None
                    if stamp is None
                    else messages.stamps_ns(stamp, attrgetter(stamp)),
                    values=channel.convert(raw),
                    stamp_ns=log_ns,
                    applied=applied,
                ).pick(said)
            )
    return streams, findings


def read_joints(
    path: Path, wanted: str = JOINTS_TOPIC
) -> tuple[Stream | None, list[dict[str, float]]]:
    """Read what a bag tells of the joints of bodies, or of encoders.

    Args:
        path: rosbag2 folder or bare .mcap file.
        wanted: The topic that tells it.

    Returns:
        When messages on that topic came, a stream whose values are their numbers, and what
        each says by its own names: positions by joint and, where there are any, velocities by
        `velocity_of` that. None and nothing where the bag has no such topic.

    Raises:
        InputError: The bag is unreadable, or several of its topics may be meant.
    """
    topics, findings = collect(path, {wanted})
    of_joints = {
        name: kinds
        for name, kinds in topics.items()
        if same_topic(name, wanted) and kinds.get(JOINT_STATE) and kinds[JOINT_STATE].count
    }
    if not of_joints:
        return None, []
    channel = Channel(topic=wanted, type=JOINT_STATE)
    topic = _find_topic(path, wanted, channel, of_joints)
    where = f"{path}: topic '{topic.name}' ({topic.msgtype})"
    store = typestore_of(where, topic, wanted, findings)
    messages = messages_of(where, store, topic)
    log_ns = np.array(topic.log_ns, dtype=np.int64)
    stream = Stream(
        name=wanted,
        role="position",
        source=f"topic {topic.name}",
        arrival=np.array(topic.arrival, dtype=np.int64),
        log_ns=log_ns,
        header_ns=_stamps_ns(messages, "header.stamp"),
        values=np.arange(len(messages), dtype=np.float64),
        stamp_ns=log_ns,
    )
    told = []
    for message in messages:
        names = [str(name) for name in message.name]
        said = dict(zip(names, map(float, message.position), strict=False))
        speeds = zip(names, map(float, message.velocity), strict=False)
        told.append(said | {velocity_of(name): speed for name, speed in speeds})
    return stream, told


def _is_in(topics: Topics, wanted: str | None) -> bool:
    """Whether there is a message on a topic."""
    return wanted is not None and any(
        same_topic(full, wanted) and any(kind.count for kind in kinds.values())
        for full, kinds in topics.items()
    )


def _full_type(name: str) -> str:
    """Return a type name in its long form, as in sensor_msgs/msg/FluidPressure."""
    parts = name.split("/")
    return f"{parts[0]}/msg/{parts[1]}" if len(parts) == 2 else name


def _find_topic(path: Path, name: str, channel: Channel, topics: Topics) -> RawTopic:
    assert channel.topic is not None
    matching = [topic for topic in topics if same_topic(topic, channel.topic)]
    if channel.topic not in matching and len(matching) > 1:
        raise InputError(
            f"{path}: channel '{name}': the relative topic '{channel.topic}' may be "
            f"{' or '.join(sorted(matching))} in the bag; name one of them in the rig file"
        )
    full = channel.topic if channel.topic in matching else next(iter(matching), channel.topic)
    kinds = topics.get(full)
    if not kinds:
        near = difflib.get_close_matches(channel.topic, topics, n=3, cutoff=0.5)
        listed = sorted(topics)
        shown = near or listed[:8]
        more = f" and {len(listed) - 8} more" if not near and len(listed) > 8 else ""
        hint = "nearest" if near else "it has"
        raise InputError(
            f"{path}: channel '{name}': no topic '{channel.topic}' in the bag ({hint}: "
            f"{', '.join(shown) or 'no topic at all'}{more})"
        )
    if channel.type is not None:
        wanted = _full_type(channel.type)
        match = {_full_type(kind): topic for kind, topic in kinds.items()}.get(wanted)
        if match is None:
            raise InputError(
                f"{path}: channel '{name}': topic '{full}' has message type "
                f"{' and '.join(sorted(kinds))}, expected {wanted}"
            )
    elif len(kinds) > 1:
        raise InputError(
            f"{path}: channel '{name}': topic '{full}' carries several message types "
            f"({', '.join(sorted(kinds))}); name one with 'type'"
        )
    else:
        match = next(iter(kinds.values()))
    if not match.count:
        raise InputError(
            f"{path}: channel '{name}': topic '{full}' is in the bag but holds no message"
        )
    if match.encoding != "cdr":
        raise InputError(
            f"{path}: channel '{name}': topic '{full}' is encoded as "
            f"'{match.encoding}', only 'cdr' (ROS 2) is read"
        )
    return match


def _values(where: str, messages: Decoded, path: str) -> np.ndarray:
    steps = split_field(where, path)
    values = messages.numbers(path, getter_of(steps))
    if any(indices for _, indices in steps) and np.isnan(values).all():
        raise InputError(f"{where}: no message has a numeric element '{path}'")
    return values


def _named_field(msgtype: str, path: str) -> str:
    """Field whose values belong to the names beside it, whatever number the path has; or empty."""
    field = path.partition("[")[0]
    return field if field in OF_NAMES.get(_full_type(msgtype), ()) else ""


def _of_joint(
    where: str, messages: Decoded, joint: str, field: str
) -> tuple[np.ndarray, np.ndarray]:
    """(n,) what each message says of a joint by its name, and (n,) whether it says anything."""
    values, said, named = messages.of_name(joint, field)
    if joint not in named:
        raise InputError(
            f"{where}: no joint {joint!r}, it has {', '.join(map(repr, named)) or 'none'}; name the"
            " encoder as the bag does, and the rig's joint in it: encoders: {NAME: {joint: JOINT}}"
        )
    if np.isnan(values).all():
        raise InputError(f"{where}: no message has a {field} of joint {joint!r}")
    return values, said


def _of_name(where: str, messages: Decoded, name: str, field: str) -> tuple[np.ndarray, np.ndarray]:
    """As `_of_joint`, of a command or tap; NaN says nothing of it."""
    values, _, named = messages.of_name(name, field)
    if name not in named:
        raise InputError(
            f"{where}: found values of {', '.join(map(repr, named))}, none of {name!r}; the rig"
            " file names them as the bag does"
        )
    said = ~np.isnan(values)
    if not said.any():
        raise InputError(f"{where}: no message has a number in {field} of {name!r}")
    return values, said


def _stamps_ns(messages: list[Any], path: str) -> np.ndarray:
    stamp = attrgetter(path)
    count = len(messages)
    seconds = np.fromiter((stamp(m).sec for m in messages), np.int64, count)
    nanoseconds = np.fromiter((stamp(m).nanosec for m in messages), np.int64, count)
    return seconds * 1_000_000_000 + nanoseconds


@dataclass(frozen=True)
class Messages:
    """All messages of one topic of a bag.

    Attributes:
        topic: The topic as the bag has it.
        msgtype: Its type.
        stamp_ns: (n,) when: by their headers, or when they were written where they have none.
        messages: They, decoded.
    """

    topic: str
    msgtype: str
    stamp_ns: np.ndarray
    messages: list[Any]


def read_messages(path: Path, wanted: dict[str, str]) -> tuple[dict[str, Messages], list[Finding]]:
    """Read whole messages of a bag.

    Args:
        path: rosbag2 folder or bare .mcap file.
        wanted: Topics by the names that messages to people call them.

    Returns:
        Messages by topic as it was asked for, and the findings about the files.

    Raises:
        InputError: The bag is unreadable, or a topic is not in it.
    """
    topics, findings = collect(path, set(wanted.values()))
    out: dict[str, Messages] = {}
    for name, asked in wanted.items():
        if asked in out:
            continue
        topic = _find_topic(path, name, Channel(topic=asked), topics)
        where = f"{path}: topic '{topic.name}' ({topic.msgtype})"
        store = typestore_of(where, topic, name, findings)
        messages = messages_of(where, store, topic)
        stamp = stamp_path(store, topic.msgtype)
        stamps = np.array(topic.log_ns, dtype=np.int64)
        if stamp is not None and np.any(own := _stamps_ns(messages, stamp)):
            stamps = own
        out[asked] = Messages(topic.name, topic.msgtype, stamps, messages)
    return out, findings
