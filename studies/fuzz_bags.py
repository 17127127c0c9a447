# SPDX-License-Identifier: Apache-2.0
"""Spoilt MCAP bags: bytes, records and chunks that lie, messages that no sensor would send."""

import io
import random
import struct
from pathlib import Path
from typing import Any

import zstandard
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_typestore

from pneu_sim.rig.schema import Rig
from studies import fuzz_mutations as spoil

MAGIC = b"\x89MCAP0\r\n"
CHUNK = 0x06
FLOAT64, PRESSURE = "std_msgs/msg/Float64", "sensor_msgs/msg/FluidPressure"
RATE_HZ = 500.0
DEFINITIONS = {
    FLOAT64: "float64 data\n",
    PRESSURE: "std_msgs/Header header\nfloat64 fluid_pressure\nfloat64 variance\n"
    + "=" * 80
    + "\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    + "=" * 80
    + "\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n",
}


def write_bag(rng: random.Random, folder: Path, rig: Rig, good: bytes) -> Path:
    """Writes a bag that is spoilt in one way or another, and gives its path.

    Args:
        rng: Source of the choice.
        folder: Where to.
        rig: Rig whose topics it has.
        good: A sound MCAP file of that rig.
    """
    kind = rng.randrange(10)
    if kind < 2:
        data = spoil.of_bytes(rng, good)
    elif kind < 5:
        data = _records_spoilt(rng, good)
    else:
        data = _strange(rng, rig)
        if rng.random() < 0.2:
            data = _records_spoilt(rng, data)
    if rng.random() < 0.1:
        data = zstandard.compress(data)
        if rng.random() < 0.5:
            data = spoil.of_bytes(rng, data)
    path = folder / rng.choice(("run.mcap", "run.mcap", "run.mcap.zstd", "run"))
    if path.suffix or rng.random() < 0.2:
        path.write_bytes(data)
        return path
    path.mkdir()
    (path / "run_0.mcap").write_bytes(data)
    meta = metadata("run_0.mcap", rng.choice((0, 10, 10**6)))
    if rng.random() < 0.7:
        (path / "metadata.yaml").write_bytes(spoil.of_yaml(rng, meta))
    elif rng.random() < 0.5:
        (path / "metadata.yaml").write_text(meta)
    return path


def metadata(name: str, count: int) -> str:
    """Text of a ``metadata.yaml`` with one file.

    Args:
        name: The file.
        count: Messages it is said to hold.
    """
    return f"""rosbag2_bagfile_information:
  version: 9
  storage_identifier: mcap
  duration: {{nanoseconds: 1000000000}}
  starting_time: {{nanoseconds_since_epoch: 1000000000}}
  message_count: {count}
  topics_with_message_count:
    - topic_metadata:
        name: /valve/voltage
        type: {FLOAT64}
        serialization_format: cdr
        offered_qos_profiles: []
        type_description_hash: ""
      message_count: {count}
  compression_format: ""
  compression_mode: ""
  relative_file_paths: [{name}]
  files:
    - path: {name}
      starting_time: {{nanoseconds_since_epoch: 1000000000}}
      duration: {{nanoseconds: 1000000000}}
      message_count: {count}
  custom_data: ~
  ros_distro: jazzy
"""


def _records(data: bytes) -> list[tuple[int, bytes]]:
    """Operation code and content of every record of a sound file."""
    out, at = [], len(MAGIC)
    while at + 9 <= len(data) - len(MAGIC):
        length = struct.unpack_from("<Q", data, at + 1)[0]
        out.append((data[at], data[at + 9 : at + 9 + length]))
        at += 9 + length
    return out


def _records_spoilt(rng: random.Random, data: bytes) -> bytes:
    """A file with records left out, doubled, moved, with lying lengths or lying chunks."""
    records = _records(data)
    if not records:
        return data
    lies: dict[int, int] = {}
    for _ in range(rng.choice((1, 1, 2, 5))):
        at = rng.randrange(len(records))
        code, body = records[at]
        kind = rng.randrange(7)
        if kind == 0 and len(records) > 1:
            del records[at]
        elif kind == 1:
            records.insert(at, records[at])
        elif kind == 2:
            other = rng.randrange(len(records))
            records[at], records[other] = records[other], records[at]
        elif kind == 3:
            lies[at] = rng.choice((0, 1, len(body) + 1, 2**31, 2**40, 2**63, 2**64 - 1))
        elif kind == 4:
            records[at] = (rng.choice((0, 1, 2, 3, 4, 5, 6, 8, 11, 15, 0x80, 255)), body)
        else:
            chunks = [k for k, (one, _) in enumerate(records) if one == CHUNK]
            if chunks and rng.random() < 0.7:
                at = rng.choice(chunks)
                records[at] = (CHUNK, _chunk_spoilt(rng, records[at][1]))
            else:
                records[at] = (code, spoil.of_bytes(rng, body))
    out = [MAGIC]
    for k, (code, body) in enumerate(records):
        out += [bytes([code]), struct.pack("<Q", lies.get(k, len(body))), body]
    return b"".join([*out, MAGIC])


def _chunk_spoilt(rng: random.Random, body: bytes) -> bytes:
    """A chunk whose sizes, compression or content are not what they are said to be."""
    try:
        return _chunk_lying(rng, body)
    except (struct.error, zstandard.ZstdError):  # it has been spoilt before
        return spoil.of_bytes(rng, body)


def _chunk_lying(rng: random.Random, body: bytes) -> bytes:
    start, end, size, crc = struct.unpack_from("<QQQI", body)
    length = struct.unpack_from("<I", body, 28)[0]
    name = body[32 : 32 + length]
    content = body[40 + length :]
    plain = zstandard.decompress(content, 1 << 24) if name == b"zstd" else content
    kind = rng.randrange(7)
    if kind == 0:
        size = rng.choice((0, 1, size - 1, 2**32, 2**40, 2**63, 2**64 - 1))
    elif kind == 1:
        name = rng.choice((b"", b"lz4", b"zstd", b"bz2", b"\xff", b"zstd "))
    elif kind == 2:
        content, crc = zstandard.compress(spoil.of_bytes(rng, plain)), 0
    elif kind == 3:  # unpacks to far more than the file
        zeros = bytes(rng.choice((1 << 20, 1 << 27)))
        content, crc, name = zstandard.compress(plain + zeros), 0, b"zstd"
        size = rng.choice((size, len(plain) + len(zeros), 12 * 10**9))
    elif kind == 4:  # a frame that does not say how much is in it
        packer = zstandard.ZstdCompressor(write_content_size=False)
        content, crc, name = packer.compress(plain), 0, b"zstd"
        size = rng.choice((size, 2**40, 12 * 10**9))
    elif kind == 5:
        start, end = rng.choice(((end, start), (2**64 - 1, 0), (0, 2**64 - 1)))
    else:
        content = spoil.of_bytes(rng, content)
    head = struct.pack("<QQQI", start, end, size, crc)
    return head + struct.pack("<I", len(name)) + name + struct.pack("<Q", len(content)) + content


def _strange(rng: random.Random, rig: Rig) -> bytes:
    """A sound MCAP file with what no sensor and no recorder would write."""
    store = get_typestore(Stores.ROS2_JAZZY)
    out = io.BytesIO()
    packing = rng.choice((CompressionType.ZSTD, CompressionType.LZ4, CompressionType.NONE))
    writer = Writer(out, chunk_size=rng.choice((200, 2000, 10**6)), compression=packing)
    writer.start(profile=rng.choice(("ros2", "", "ros1")), library="strange")
    faults = {rng.randrange(14) for _ in range(rng.choice((1, 1, 2)))}
    samples = rng.choice((0, 1, 3)) if 0 in faults else 60
    topics: list[tuple[str, str, Any]] = [
        (str(command.channel.topic), FLOAT64, 6.0)
        for command in rig.commands.values()
        if command.channel
    ] + [(str(t.channel.topic), PRESSURE, 2e5) for t in rig.taps.values() if t.channel]
    if 1 in faults:
        topics.pop(rng.randrange(len(topics)))
    if 2 in faults:
        topics.append(rng.choice(topics))
    for topic, kind, level in topics:
        text, encoding, coded = DEFINITIONS[kind], "ros2msg", "cdr"
        if 3 in faults:
            text = rng.choice(("", "float64", "x" * 9, "\0", "string a\n" * 2000, text + "evil y"))
        if 4 in faults:
            encoding = rng.choice(("", "ros2idl", "jsonschema", "protobuf"))
        if 5 in faults:
            coded = rng.choice(("", "json", "ros1", "\x1b"))
        named = rng.choice((kind, "a/msg/B", "", "std_msgs/Float64")) if 6 in faults else kind
        schema = writer.register_schema(named, encoding, text.encode())
        spelt = rng.choice((topic.upper(), "[red]", "", "é")) if 7 in faults else topic
        channel = writer.register_channel(spelt, coded, 0 if 8 in faults else schema)
        for k in range(samples):
            stamp = 1_000_000_000 + round(k * 1e9 / RATE_HZ)
            value = level * (1.0 + 0.001 * rng.random())
            if 9 in faults:
                stamp = rng.choice((stamp, 0, 2**63, 2**64 - 1, stamp - 10**9, stamp + 10**15))
            if 10 in faults:
                stamp = 1_000_000_000 + round((samples - k) * 1e9 / RATE_HZ)
            if 11 in faults:
                value = rng.choice((float("nan"), float("inf"), -1.0, 1e308, 0.0))
            if 12 in faults:
                stamp = 1_000_000_000
            if kind == PRESSURE:
                time = store.types["builtin_interfaces/msg/Time"](
                    rng.choice((-1, 2**31 - 1, 0)) if 13 in faults else min(stamp // 10**9, 10**9),
                    rng.choice((0, 2**32 - 1)) if 13 in faults else stamp % 10**9,
                )
                message = store.types[kind](
                    store.types["std_msgs/msg/Header"](time, "x"), value, 0.0
                )
            else:
                message = store.types[kind](value)
            data = bytes(store.serialize_cdr(message, kind))
            if 13 in faults and rng.random() < 0.05:
                data = spoil.of_bytes(rng, data)
            writer.add_message(channel, stamp, data, stamp)
    writer.finish()
    return out.getvalue()
