# SPDX-License-Identifier: Apache-2.0
"""Messages as they lie in the files of a rosbag2 recording, by topic and type.

The container is walked record by record in file order (``mcap``), because a reader
that sorts by time would hide clocks that jump back and messages that came late.
"""

import io
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path, PurePath
from typing import Any, cast

import zstandard
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, DataEnd, McapRecord, Message, Schema, Statistics

from pneu_common.documents import read_yaml
from pneu_common.errors import InputError
from pneu_graph.bag.unpacking import (
    Allowance,
    Bounded,
    WithoutIndex,
    chunk_records,
    unzstd,
)
from pneu_sim.topics import same_topic
from pneu_sysid.records.recording import Finding
from pneu_sysid.records.stream import STAMP_LIMIT_NS

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"  # no CDR message starts so: its first byte is 0
_DATA_OPCODES = {Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK}


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
                    elif isinstance(item, Channel):
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
            compressed = file.read(4) == ZSTD_MAGIC
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
    channel: Channel, schemas: dict[int, Schema], wanted: set[str], topics: Topics
) -> tuple[RawTopic, bool]:
    schema = schemas.get(channel.schema_id)
    msgtype = schema.name if schema else "unknown"
    kinds = topics.setdefault(channel.topic, {})
    topic = kinds.setdefault(
        msgtype, RawTopic(channel.topic, msgtype, schema, channel.message_encoding)
    )
    return topic, any(same_topic(channel.topic, name) for name in wanted)
