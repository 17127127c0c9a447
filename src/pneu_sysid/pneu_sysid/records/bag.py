# SPDX-License-Identifier: Apache-2.0
"""Channels out of rosbag2 MCAP recordings, decoded by the definitions inside the file.

The container is walked record by record in file order (``mcap``), because a reader
that sorts by time would hide clocks that jump back and messages that came late. The
messages are decoded by ``rosbags`` from the schemas the file carries.
"""

import difflib
import io
import re
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import reduce
from operator import attrgetter
from pathlib import Path, PurePath
from typing import Any, cast

import numpy as np
import zstandard
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel as McapChannel
from mcap.records import Chunk, DataEnd, McapRecord, Message, Schema, Statistics
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from pneu_common.documents import read_yaml
from pneu_common.errors import InputError
from pneu_graph.bag.unpacking import (
    Allowance,
    Bounded,
    WithoutIndex,
    chunk_records,
    unzstd,
)
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
from pneu_sysid.records.recording import Finding, absent
from pneu_sysid.records.stream import STAMP_LIMIT_NS, Role, Stream

OF_JOINTS = NAMED_VALUES[JOINT_STATE]
"""Fields of a ``JointState`` that hold a number for each joint that it names."""
OF_NAMES = {kind: NAMED_VALUES[kind] for kind in (VALVE_COMMAND, TAP_PRESSURES)}
"""Fields of other types with a number for each name; as nodes read them."""
_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"  # no CDR message starts so: its first byte is 0
_DATA_OPCODES = {Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK}
_STEP = re.compile(r"([A-Za-z]\w*)((?:\[\d+\])*)$")
_IDL_SEPARATOR = "=" * 80 + "\n"


@dataclass
class RawTopic:
    """Raw messages of one topic with one type.

    Attributes:
        name: Its name.
        msgtype: Type of its messages.
        schema: Their definition, where the bag has one.
        encoding: How they are encoded.
        count: How many there are.
        arrival: Where in the file each came, of those that were wanted.
        log_ns: When each was written, ns.
        data: They.
    """

    name: str
    msgtype: str
    schema: Schema | None
    encoding: str
    count: int = 0
    arrival: list[int] = field(default_factory=list)
    log_ns: list[int] = field(default_factory=list)
    data: list[bytes] = field(default_factory=list)


Topics = dict[str, dict[str, RawTopic]]  # by topic name, then by message type


def bag_topics(path: Path) -> dict[str, tuple[str, int]]:
    """Return message type and number of messages of every topic in a bag.

    Args:
        path: rosbag2 folder or .mcap file.

    Raises:
        InputError: The bag is missing, damaged or not an MCAP recording.
    """
    topics, _ = collect(path, set())
    return {
        name: (" or ".join(sorted(kinds)), sum(kind.count for kind in kinds.values()))
        for name, kinds in sorted(topics.items())
    }


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
                _check_number(where, store, topic.msgtype, channel.field)
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
            stamp = _stamp_path(store, topic.msgtype)
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
    messages = _decode(where, store, topic)
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


# ---- the container ------------------------------------------------------------------------


def collect(path: Path, wanted: set[str]) -> tuple[Topics, list[Finding]]:
    """Return every topic of all files of a bag, with the messages of the wanted ones.

    Args:
        path: rosbag2 folder or bare .mcap file.
        wanted: Names of topics.

    Raises:
        InputError: The bag is unreadable or cut.
    """
    files, expected, findings = _bag_files(path)
    topics: Topics = {}
    total = 0
    for file in files:
        total = _scan_file(file, wanted, topics, total, findings)
    if expected is not None and total < expected:
        raise InputError(
            f"{path}: the bag is truncated: it holds {total} of the {expected} messages "
            "that metadata.yaml lists"
        )
    return topics, findings


def _bag_files(path: Path) -> tuple[list[Path], int | None, list[Finding]]:
    """Return the storage files of a bag in order and its listed number of messages."""
    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    if path.is_file():
        return [path], None, []
    meta_path = path / "metadata.yaml"
    if not meta_path.exists():
        files = sorted(
            (p for p in path.iterdir() if p.name.endswith((".mcap", ".mcap.zstd"))),
            key=lambda p: [int(s) if s.isdigit() else s for s in re.split(r"(\d+)", p.name)],
        )
        if not files:
            raise InputError(
                f"{path}: neither metadata.yaml nor a .mcap file is in this folder, "
                "so it is not a rosbag2 MCAP recording"
            )
        note = f"no metadata.yaml; the {len(files)} .mcap file(s) were read in order of name"
        return files, None, [Finding(path.name, "no_metadata", 1, note)]
    data = read_yaml(meta_path, "description of a bag")
    try:
        info = data["rosbag2_bagfile_information"]
        storage = str(info["storage_identifier"])
        names = [PurePath(str(p)).name for p in info["relative_file_paths"]]
        expected = int(info["message_count"])
    except (KeyError, TypeError, ValueError, OverflowError) as err:  # a size of infinity
        what = " ".join(str(err).split())[:120]
        raise InputError(f"{meta_path}: not valid rosbag2 metadata ({what})") from err
    if storage != "mcap":
        raise InputError(
            f"{path}: the storage is '{storage}', only 'mcap' is read "
            "(convert it with 'ros2 bag convert')"
        )
    for name in names:
        if not (path / name).is_file():
            raise InputError(f"{path}: metadata.yaml lists '{name}', which is not in the folder")
    return [path / name for name in names], expected, []


def _records(file: Bounded, limit: int) -> Iterator[McapRecord]:
    yield from WithoutIndex(
        cast(Any, file), emit_chunks=True, validate_crcs=True, record_size_limit=limit
    ).records


def _scan_file(
    path: Path, wanted: set[str], topics: Topics, arrival: int, findings: list[Finding]
) -> int:
    """Add the messages of one MCAP file to ``topics``; return the running message count."""
    allowance = Allowance(path, path.stat().st_size if path.is_file() else 0)
    file, size = _open(path, allowance)
    schemas: dict[int, Schema] = {}
    channels: dict[int, tuple[RawTopic, bool]] = {}
    first = arrival
    good = 0  # end of the last complete record, in bytes
    data_ended = False
    listed: int | None = None
    damage: str | None = None
    with file:
        try:
            for record in _records(file, size):
                inner = chunk_records(record, allowance) if isinstance(record, Chunk) else [record]
                for item in inner:
                    if isinstance(item, Message):
                        topic, keep = channels[item.channel_id]
                        topic.count += 1
                        if keep:
                            topic.arrival.append(arrival)
                            topic.log_ns.append(min(item.log_time, STAMP_LIMIT_NS))
                            topic.data.append(item.data)
                        arrival += 1
                    elif isinstance(item, Schema):
                        schemas[item.id] = item
                    elif isinstance(item, McapChannel):
                        channels[item.id] = _add_topic(item, schemas, wanted, topics)
                    elif isinstance(item, DataEnd):
                        data_ended = True
                    elif isinstance(item, Statistics):
                        listed = item.message_count
                good = file.tell()
        except InputError:  # before its base, ValueError
            raise
        except (
            McapError,
            zstandard.ZstdError,
            struct.error,
            ValueError,
            KeyError,
            RuntimeError,
            OverflowError,
            MemoryError,
            EOFError,
        ) as err:
            damage = " ".join(str(err).split())[:100] or type(err).__name__
        if damage is not None:
            file.seek(good)
            opcode = file.read(1) if good < size else b""
    if listed is not None and arrival - first < listed:
        raise InputError(
            f"{path}: damaged: it holds {arrival - first} of the {listed} messages that its "
            "summary lists"
        )
    if damage is None:
        return arrival
    if good == 0:
        raise InputError(f"{path}: not an MCAP file, or cut off in its first record ({size} bytes)")
    only_index = (
        data_ended
        or not opcode
        or (opcode[0] not in _DATA_OPCODES and 0 < opcode[0] <= Opcode.DATA_END)
    )
    if not only_index or arrival == first:
        raise InputError(
            f"{path}: truncated or damaged: of {size} bytes only the first {good} are whole "
            f"records, with {arrival - first} messages ('mcap recover' saves what is left)"
        )
    note = (
        f"the file ends after its last whole chunk, at byte {good} of {size}, without "
        f"index or footer; its {arrival - first} messages were read"
    )
    findings.append(Finding(path.name, "truncated", 1, note))
    return arrival


def _open(path: Path, allowance: Allowance) -> tuple[Bounded, int]:
    """Open a storage file, unpacked first where the file as a whole is compressed."""
    try:
        with path.open("rb") as file:
            compressed = file.read(4) == _ZSTD_MAGIC
        if not compressed:
            size = path.stat().st_size
            return Bounded(path.open("rb"), size), size
        # Whole-file compression has no index into it, so it is unpacked in memory.
        with path.open("rb") as file:
            data = unzstd(file, allowance)
        return Bounded(io.BytesIO(data), len(data)), len(data)
    except OSError as err:
        raise InputError(f"{path}: cannot be read ({err.strerror})") from err
    except zstandard.ZstdError as err:
        raise InputError(f"{path}: the zstd compression of the file is damaged ({err})") from err


def _add_topic(
    channel: McapChannel, schemas: dict[int, Schema], wanted: set[str], topics: Topics
) -> tuple[RawTopic, bool]:
    schema = schemas.get(channel.schema_id)
    msgtype = schema.name if schema else "unknown"
    kinds = topics.setdefault(channel.topic, {})
    topic = kinds.setdefault(
        msgtype, RawTopic(channel.topic, msgtype, schema, channel.message_encoding)
    )
    return topic, any(same_topic(channel.topic, name) for name in wanted)


# ---- topics, types and fields ---------------------------------------------------------------


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


def typestore_of(where: str, topic: RawTopic, name: str, findings: list[Finding]) -> Typestore:
    """Return the types that a topic's embedded definition declares.

    Args:
        where: What messages to people begin with.
        topic: The topic.
        name: What findings are said of.
        findings: Receives what was found.

    Raises:
        InputError: There is no definition, or it cannot be read.
    """
    schema = topic.schema
    if schema is None or not schema.data:
        # Recorders write an empty definition when they cannot find the package.
        store = get_typestore(Stores.ROS2_JAZZY)
        if topic.msgtype not in store.fielddefs:
            raise InputError(f"{where}: the bag has no definition of this message type")
        note = f"the bag has no definition of {topic.msgtype}; that of ROS 2 Jazzy was used"
        findings.append(Finding(name, "no_definition", 1, note))
        return store
    store = get_typestore(Stores.EMPTY)
    try:
        text = schema.data.decode()
        if schema.encoding == "ros2msg":
            store.register(get_types_from_msg(text, topic.msgtype))
        elif schema.encoding in ("ros2idl", "omgidl"):
            parts = [text]
            if text.startswith(_IDL_SEPARATOR + "IDL: "):
                parts = [part.split("\n", 1)[1] for part in text.split(_IDL_SEPARATOR)[1:]]
            for part in parts:
                store.register(get_types_from_idl(part))
        else:
            raise InputError(
                f"{where}: the definition is written in '{schema.encoding}' "
                "(allowed: ros2msg, ros2idl)"
            )
    except InputError:
        raise
    except Exception as err:  # a parser fed hostile text raises many kinds
        what = " ".join(str(err).split())[:120]
        raise InputError(f"{where}: the embedded definition cannot be parsed ({what})") from err
    _check_defined(where, store, topic.msgtype, set())
    return store


def _check_defined(where: str, store: Typestore, name: str, seen: set[str]) -> None:
    """Raise unless a message type and all that it consists of are defined, and end somewhere."""
    if name not in store.fielddefs:
        have = ", ".join(sorted(store.fielddefs)) or "nothing"
        raise InputError(f"{where}: the embedded definition has no {name}, it defines {have}")
    if name in seen:
        raise InputError(f"{where}: the embedded definition of {name} contains itself")
    for kind, detail in fields_of(store, name).values():
        if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            kind, detail = detail[0]
        if kind == Nodetype.NAME:
            _check_defined(where, store, detail, {*seen, name})


def fields_of(store: Typestore, msgtype: str) -> dict[str, Any]:
    """Fields of a type and what they hold.

    Args:
        store: Definitions of types.
        msgtype: The type.
    """
    return dict(store.fielddefs[msgtype][1])


def split_field(where: str, path: str) -> list[tuple[str, list[int]]]:
    """Names and indices of which the path of a field consists.

    Args:
        where: What messages to people begin with.
        path: The path.

    Raises:
        InputError: It is none.
    """
    steps = []
    for part in path.split("."):
        match = _STEP.match(part)
        if match is None:
            raise InputError(
                f"{where}: field '{path}' is not a path such as 'data' or 'position[0]'"
            )
        steps.append((match[1], [int(i) for i in re.findall(r"\d+", match[2])]))
    return steps


def _check_number(where: str, store: Typestore, msgtype: str, path: str) -> None:
    """Raise unless a field path leads to one number of the message type."""
    current = msgtype
    steps = split_field(where, path)
    for depth, (name, indices) in enumerate(steps):
        fields = fields_of(store, current)
        if name not in fields:
            raise InputError(
                f"{where} has no field '{path}': the fields of {current} are "
                f"{', '.join(n for n in fields if n != 'structure_needs_at_least_one_member')}"
            )
        kind, detail = fields[name]
        if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            if len(indices) != 1:
                raise InputError(
                    f"{where}: field '{path}': '{name}' is an array, write '{name}[0]'"
                )
            (kind, detail), length = detail
            if fields[name][0] == Nodetype.ARRAY and indices[0] >= length:
                raise InputError(f"{where}: field '{path}': '{name}' has only {length} elements")
        elif indices:
            raise InputError(f"{where}: field '{path}': '{name}' is not an array")
        last = depth == len(steps) - 1
        if kind == Nodetype.NAME:
            if last:
                raise InputError(
                    f"{where}: field '{path}' is a {detail}, not a number: its fields are "
                    f"{', '.join(fields_of(store, detail))}"
                )
            current = detail
        elif not last:
            raise InputError(f"{where}: field '{path}': '{name}' is a {detail[0]}, without fields")
        elif detail[0] in ("string", "wstring", "wchar"):
            raise InputError(f"{where}: field '{path}' is a {detail[0]}, not a number")


def _stamp_path(store: Typestore, msgtype: str) -> str | None:
    """Return the path of a message's own time stamp, if it has one."""
    fields = fields_of(store, msgtype)
    if fields.get("header") == (Nodetype.NAME, "std_msgs/msg/Header"):
        return "header.stamp"
    if fields.get("stamp") == (Nodetype.NAME, "builtin_interfaces/msg/Time"):
        return "stamp"
    return None


# ---- values ---------------------------------------------------------------------------------


def columns_of(where: str, store: Typestore, topic: RawTopic) -> Decoded:
    """The messages of a topic, to be read by field.

    Args:
        where: What messages to people begin with.
        store: Definitions of types.
        topic: The topic.

    Raises:
        InputError: One does not decode.
    """
    one = _decoder(where, store, topic)
    return Decoded(topic.data, store, topic.msgtype, one)


def _decode(where: str, store: Typestore, topic: RawTopic) -> list[Any]:
    one = _decoder(where, store, topic)
    return [one(number) for number in range(len(topic.data))]


def _decoder(where: str, store: Typestore, topic: RawTopic) -> Callable[[int], Any]:
    """What decodes the message of a number; those that are packed one by one are unpacked."""
    allowance = Allowance(where, sum(map(len, topic.data)))

    def refuse(number: int, err: Exception) -> InputError:
        what = " ".join(str(err).split())[:100]
        return InputError(
            f"{where}: message {number + 1} of {topic.count} does not decode ({what})"
        )

    for number, raw in enumerate(topic.data):
        if raw[:4] == _ZSTD_MAGIC:
            try:
                topic.data[number] = unzstd(io.BytesIO(raw), allowance)
            except InputError:
                raise
            except Exception as err:
                raise refuse(number, err) from err

    def one(number: int) -> Any:
        try:
            return store.deserialize_cdr(topic.data[number], topic.msgtype)
        except Exception as err:  # generated code meets hostile bytes
            raise refuse(number, err) from err

    return one


def getter_of(steps: list[tuple[str, list[int]]]) -> Callable[[Any], float]:
    """What gets a number of a message; NaN where an array is too short to have it.

    Args:
        steps: Where, as `split_field` has it.
    """
    if not any(indices for _, indices in steps):
        return attrgetter(".".join(name for name, _ in steps))

    def step(value: Any, part: tuple[str, list[int]]) -> Any:
        value = getattr(value, part[0])
        for index in part[1]:
            value = value[index]
        return value

    def get(message: Any) -> float:
        try:
            return float(reduce(step, steps, message))
        except IndexError:  # a variable-length array may be shorter in some messages
            return float("nan")

    return get


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
        messages = _decode(where, store, topic)
        stamp = _stamp_path(store, topic.msgtype)
        stamps = np.array(topic.log_ns, dtype=np.int64)
        if stamp is not None and np.any(own := _stamps_ns(messages, stamp)):
            stamps = own
        out[asked] = Messages(topic.name, topic.msgtype, stamps, messages)
    return out, findings
