# SPDX-License-Identifier: Apache-2.0
"""Bags that are damaged, unusual or cannot be written: one clear sentence, or the rest of the data.

Files are made by the writers and changed at known places, so that it is known what has to be left.
"""

import contextlib
import errno
import os
import resource
import signal
import struct
import threading
import time
import zlib

import lz4.frame
import pytest
import zstandard
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.writer import IndexType, Writer

from pneu_common import files
from pneu_common.errors import InputError
from pneu_graph.bag.bag_writer import Attachment, BagWriter
from pneu_graph.bag.info import _size, info_text
from pneu_graph.bag.metadata import LOST_KEY, File, Topic, read_metadata
from pneu_graph.bag.qos import parse_profiles
from pneu_graph.bag.reader import MAGIC, BagReader, side_records
from pneu_graph.bag.recording import Recording
from pneu_graph.bag.recover import recover_bag
from pneu_graph.bag.unpacking import Allowance, DamagedError, chunk_records

pytestmark = pytest.mark.kernel_free

A, B = "/rig/a", "/rig/b"
CHUNKS = 4
EACH = 6
"""Messages of a chunk, in turns of A and B."""


def message(number):
    """Topic, data, log and publish time."""
    return (
        (A, B)[number % 2],
        b"\0\1\0\0" + number.to_bytes(4, "little"),
        1000 + 10 * number,
        number,
    )


def write_bag(folder, finished=True, damage=None):
    """A bag of one file, with an attachment and a record; returns the file and its chunks.

    Args:
        folder: Its folder.
        finished: Whether it has an index.
        damage: The chunk of which a byte is changed; None is none.
    """
    writer = BagWriter(folder)
    writer.attach(Attachment("rig.yaml", b"pneu_rig: 1\n", "application/yaml", 5))
    writer.add_record("pneu", {"operator": "me"})
    for topic in (A, B):
        writer.add_topic(Topic(topic, f"std_msgs/msg/{topic[-1].upper()}"), f"string {topic[-1]}\n")
    for number in range(CHUNKS * EACH):
        writer.write(*message(number))
        if number % EACH == EACH - 1:
            writer.flush()
    writer.attach(Attachment("late.txt", b"the end", "text/plain", 6))
    (path,) = folder.glob("*.mcap")
    assert writer.close() == []
    with path.open("rb") as stream:
        chunks = make_reader(stream).get_summary().chunk_indexes
    assert len(chunks) == CHUNKS
    data = bytearray(path.read_bytes())
    if damage is not None:
        data[chunks[damage].chunk_start_offset + 9 + 60] ^= 0x55
    path.write_bytes(data if finished else data[:-20])
    return path, chunks


def contents(bag, **which):
    return [(m.topic, m.data, m.log_time_ns, m.publish_time_ns) for m in bag.messages(**which)]


def without(chunk):
    """All messages but those of a chunk."""
    return [message(k) for k in range(CHUNKS * EACH) if k // EACH != chunk]


@pytest.mark.parametrize("damage", range(CHUNKS))
def test_a_damaged_chunk_of_a_file_with_index_costs_itself_only(tmp_path, damage):
    path, chunks = write_bag(tmp_path / "bag", damage=damage)
    bag = BagReader(tmp_path / "bag")
    with pytest.raises(InputError) as caught:
        contents(bag)
    assert str(caught.value).startswith(f"{path}: is damaged (")
    assert str(caught.value).endswith("); `pneu bag recover` keeps what is whole")
    said = recover_bag(tmp_path / "bag")
    left = (CHUNKS - 1) * EACH
    at = chunks[damage].chunk_start_offset
    assert said[0].startswith(f"{path}: written anew, {left} messages; damaged at byte {at} (")
    assert said[1:] == [f"{tmp_path}/bag/metadata.yaml: written, {left} messages"]
    again = BagReader(tmp_path / "bag")
    assert contents(again) == without(damage)
    assert {one.name: one.message_count for one in again.metadata.topics} == {
        A: left // 2,
        B: left // 2,
    }
    assert read_metadata(tmp_path / "bag") == again.metadata
    assert recover_bag(tmp_path / "bag")[0] == f"{path}: complete, {left} messages"
    found = list(side_records(path))
    assert [one.name for one in found] == ["rosbag2", "rig.yaml", "pneu", "late.txt", "rosbag2"]
    assert found[-1].metadata["serialized_metadata"].count(f"message_count: {left // 2}\n") == 2


@pytest.mark.parametrize("damage", range(1, CHUNKS))
def test_a_damaged_chunk_of_a_cut_file_costs_itself_only(tmp_path, damage):
    path, chunks = write_bag(tmp_path / "bag", finished=False, damage=damage)
    bag = BagReader(tmp_path / "bag")
    assert f"damaged at byte {chunks[damage].chunk_start_offset} (" in bag.files[0].damage
    assert contents(bag) == without(damage)
    assert contents(bag, topics={B}) == [one for one in without(damage) if one[0] == B]
    assert contents(bag, start_ns=1130) == [one for one in without(damage) if one[2] >= 1130]
    recover_bag(path)
    assert contents(BagReader(path)) == without(damage)


def test_zeros_in_place_of_the_end_are_passed_over_at_once(tmp_path):
    """As file systems leave them where power was lost; ten million bytes are a million records."""
    path, chunks = write_bag(tmp_path / "bag")
    at = chunks[2].chunk_start_offset
    with path.open("r+b") as stream:
        stream.truncate(at)
        stream.truncate(10_000_000)
    bag = BagReader(path)
    assert bag.files[0].damage == f"cut inside a record at byte {at}"
    assert contents(bag) == [message(k) for k in range(2 * EACH)]


def test_what_is_recovered_keeps_attachments_and_records(tmp_path):
    path, _ = write_bag(tmp_path / "bag", finished=False)
    recover_bag(path)
    found = list(side_records(path))
    assert [one.name for one in found] == ["rosbag2", "rig.yaml", "pneu", "late.txt", "rosbag2"]
    assert (found[1].data, found[1].media_type, found[1].log_time) == (
        b"pneu_rig: 1\n",
        "application/yaml",
        5,
    )
    assert found[2].metadata == {"operator": "me"}
    assert "message_count: 24" in found[4].metadata["serialized_metadata"]
    assert not (tmp_path / "bag" / "metadata.yaml.part").exists()


def test_topics_and_times_are_chosen_by_chunk(tmp_path):
    """Of a file with index, whose chunks hold one topic alone where nothing else was written."""
    writer = BagWriter(tmp_path / "bag")
    for topic in (A, B):
        writer.add_topic(Topic(topic, "std_msgs/msg/String"), "string data\n")
    expected = []
    for k, topic in enumerate((A, B, B, A)):
        expected.append((topic, bytes([k] * 8), 100 * k + 5, k))
        writer.write(*expected[-1])
        writer.flush()
    assert writer.close() == []
    bag = BagReader(tmp_path / "bag")
    assert contents(bag) == expected
    assert contents(bag, topics={B}) == expected[1:3]
    assert contents(bag, start_ns=105) == expected[1:]
    assert contents(bag, topics={A}, start_ns=106) == expected[3:]
    assert contents(bag, topics=set()) == []


def mcap(path, **options):
    """A file of the library's own writer: one topic on two channels, which take turns."""
    with path.open("wb") as stream:
        writer = Writer(stream, **options)
        writer.start()
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
        both = [writer.register_channel(A, "cdr", schema, {"from": str(k)}) for k in range(2)]
        for k in (0, 3, 1, 2, 4):
            writer.add_message(both[k % 2], 100 + k, bytes([k]), 7 * k, sequence=10 + k)
        writer.finish()


@pytest.mark.parametrize(
    ("options", "indexed"),
    [
        ({}, True),
        ({"use_chunking": False}, True),
        ({"use_statistics": False}, False),
        ({"repeat_channels": False}, False),
        ({"repeat_schemas": False}, False),
        ({"index_types": IndexType.ALL & ~IndexType.CHUNK}, False),
        ({"index_types": IndexType.CHUNK}, True),
    ],
)
def test_a_topic_on_two_channels_is_one(tmp_path, options, indexed):
    """With chunks or without, by log time; a file whose summary is partial is read as well."""
    path = tmp_path / "two.mcap"
    mcap(path, **options)
    bag = BagReader(path)
    assert bag.files[0].indexed == indexed
    (topic,) = bag.metadata.topics
    assert (topic.name, topic.type, topic.message_count) == (A, "std_msgs/msg/String", 5)
    assert bag.definitions == {A: "string data\n"}
    expected = [(A, bytes([k]), 100 + k, 7 * k, 10 + k) for k in range(5)]
    for start_ns in (0, 102):
        found = [
            (m.topic, m.data, m.log_time_ns, m.publish_time_ns, m.sequence)
            for m in bag.messages({A}, start_ns)
        ]
        assert found == [one for one in expected if one[2] >= start_ns]
    assert list(bag.messages({B})) == []


# Inside of a chunk


def record(opcode, content):
    return struct.pack("<BQ", opcode, len(content)) + content


def of_message(number):
    return struct.pack("<HIQQ", 7, number, 100 + number, 200 + number) + bytes([number] * 3)


SOUND = record(5, of_message(1)) + record(0x99, b"private") + record(5, of_message(2))


def chunk(data, compression="", packed=None, **changed):
    of = {"uncompressed_size": len(data), "uncompressed_crc": zlib.crc32(data), **changed}
    return Chunk(
        compression=compression,
        data=data if packed is None else packed,
        message_start_time=0,
        message_end_time=9,
        **of,
    )


def records_of(one):
    return list(chunk_records(one, Allowance("a", 1000)))


@pytest.mark.parametrize(
    ("compression", "pack"),
    [("", None), ("zstd", zstandard.compress), ("lz4", lz4.frame.compress)],
)
def test_the_messages_of_a_chunk_are_read_and_what_else_is_in_it_is_passed_over(compression, pack):
    packed = None if pack is None else pack(SOUND)
    for changed in ({}, {"uncompressed_crc": 0}):
        found = records_of(chunk(SOUND, compression, packed, **changed))
        assert [(m.channel_id, m.sequence, m.log_time, m.publish_time, m.data) for m in found] == [
            (7, 1, 101, 201, b"\1\1\1"),
            (7, 2, 102, 202, b"\2\2\2"),
        ]
    for size in (len(SOUND) - 1, len(SOUND) + 1):
        with pytest.raises(DamagedError, match=f" {size}( |$)"):
            records_of(chunk(SOUND, compression, packed, uncompressed_size=size))
    with pytest.raises(DamagedError, match="the checksum of a chunk is not that of its content"):
        records_of(chunk(SOUND, compression, packed, uncompressed_crc=5))


@pytest.mark.parametrize(
    ("one", "says"),
    [
        (chunk(SOUND, "bz2"), "a chunk is compressed by 'bz2', read are zstd and lz4"),
        (chunk(SOUND + b"\5" * 8), "a chunk ends within the head of a record, 8 bytes of it"),
        (chunk(SOUND + struct.pack("<BQ", 5, 30) + bytes(29)), "30 bytes are named where 29 are"),
        (chunk(record(5, of_message(1)[:21])), "a message has 21 bytes, its head alone 22"),
        (
            chunk(SOUND, "zstd", zstandard.compress(SOUND), uncompressed_size=40),
            "a part unpacks to more than the 40 bytes that it names",
        ),
    ],
)
def test_a_chunk_that_is_not_what_it_says_is_refused_in_one_sentence(one, says):
    with pytest.raises((DamagedError, EOFError)) as caught:
        records_of(one)
    assert str(caught.value).startswith(says)


@pytest.mark.parametrize("ending", [b"", record(15, bytes(4)), record(2, bytes(20))])
@pytest.mark.parametrize("private", [b"", record(0x80, b"private")])
def test_what_follows_the_data_is_no_damage(tmp_path, private, ending):
    """A record of no known kind in front of the end, which is whatever end the file has."""
    schema = record(3, struct.pack("<HI", 1, 1) + b"S" + bytes(8))
    channel = record(
        4, struct.pack("<HHI", 7, 1, 2) + b"/a" + struct.pack("<I", 3) + b"cdr" + bytes(4)
    )
    path = tmp_path / "a.mcap"
    path.write_bytes(
        MAGIC + record(1, bytes(8)) + schema + channel + record(5, of_message(3)) + private + ending
        + (b"garbage" if ending else b"")
    )  # fmt: skip
    bag = BagReader(path)
    assert [m.sequence for m in bag.messages()] == [3]
    assert (bag.files[0].indexed, bag.files[0].damage) == (False, "")


def test_a_message_of_an_unknown_channel_is_damage(tmp_path):
    path = tmp_path / "a.mcap"
    path.write_bytes(MAGIC + record(1, bytes(8)) + record(5, of_message(3)) + b"\5")
    bag = BagReader(path)
    assert list(bag.messages()) == []
    assert bag.files[0].damage == f"cut inside a record at byte {path.stat().st_size - 1}"
    path.write_bytes(MAGIC + record(5, of_message(3)))
    damage = "damaged at byte 8 (a message of channel 7, which is unknown)"
    assert BagReader(path).files[0].damage == damage
    assert info_text(BagReader(path)).splitlines()[-1] == f"Without index:     a.mcap ({damage})"


def test_a_record_that_cannot_be_read_ends_the_reading(tmp_path):
    path, chunks = write_bag(tmp_path / "bag", finished=False)
    at = chunks[1].chunk_start_offset
    data = path.read_bytes()
    path.write_bytes(data[:at] + record(4, b"short") + data[at:])
    bag = BagReader(path)
    assert contents(bag) == [message(k) for k in range(EACH)]
    assert bag.files[0].damage.startswith(f"damaged at byte {at} (")


@pytest.mark.parametrize("claimed", [1 << 40, 1 << 62])
@pytest.mark.parametrize("finished", [True, False])
def test_a_chunk_that_claims_too_much_is_refused_in_one_sentence(tmp_path, finished, claimed):
    path, chunks = write_bag(tmp_path / "bag", finished)
    data = bytearray(path.read_bytes())
    struct.pack_into("<Q", data, chunks[2].chunk_start_offset + 9 + 16, claimed)
    path.write_bytes(data)
    for use in (contents, lambda bag: recover_bag(bag.path)):
        with pytest.raises(InputError) as caught:
            use(BagReader(path))
        assert str(caught.value).startswith(f"{path}: its {len(data)} bytes unpack to more than")


# Folders


def test_a_folder_that_does_not_hold_what_it_says_is_refused(tmp_path):
    folder = tmp_path / "bag"
    path, _ = write_bag(folder)
    text = (folder / "metadata.yaml").read_text()

    def refusal(use=BagReader):
        with pytest.raises(InputError) as caught:
            use(folder)
        return str(caught.value)

    (folder / "metadata.yaml").write_text(text.replace("identifier: mcap", "identifier: sqlite3"))
    assert refusal() == (
        f"{folder}: is stored as 'sqlite3', read is 'mcap'; `ros2 bag convert` makes one of the"
        " other"
    )
    more = text.replace("- bag_0.mcap", "- bag_0.mcap").replace(
        "path: bag_0.mcap", "path: bag_7.mcap"
    )
    (folder / "metadata.yaml").write_text(more)
    assert refusal() == f"{folder}: metadata.yaml names bag_7.mcap, which is missing"
    profile = "offered_qos_profiles: [{depth: [5]}]"
    (folder / "metadata.yaml").write_text(text.replace("offered_qos_profiles: []", profile))
    where = f"{folder}/metadata.yaml"
    assert refusal().startswith(f"{where}: {A}: a QoS profile cannot be read (")
    (folder / "metadata.yaml").unlink()
    assert refusal(read_metadata) == f"{where}: no such file; `pneu bag recover` makes it again"
    assert len(contents(BagReader(folder))) == CHUNKS * EACH
    path.unlink()
    assert refusal() == f"{folder}: holds no .mcap file"
    (folder / "odd.mcap").mkdir()
    assert refusal() == f"{folder}/odd.mcap: cannot be read (Is a directory)"


OLD = """
rosbag2_bagfile_information:
  version: 4
  storage_identifier: mcap
  relative_file_paths: [bag_0.mcap, bag_1.mcap]
  duration: {nanoseconds: 230}
  starting_time: {nanoseconds_since_epoch: 1000}
  message_count: 24
  topics_with_message_count:
  - topic_metadata: {name: /rig/a, type: a/msg/A, serialization_format: cdr,
                     offered_qos_profiles: "- {history: 3, depth: 4}"}
    message_count: 12
  compression_format: ""
  compression_mode: ""
"""


def test_a_description_before_version_5_is_read(tmp_path):
    (tmp_path / "metadata.yaml").write_text(OLD)
    found = read_metadata(tmp_path)
    assert found.files == [File("bag_0.mcap", 1000, 1230, 24), File("bag_1.mcap")]
    assert (found.version, found.start_ns, found.end_ns, found.message_count) == (4, 1000, 1230, 24)
    assert [(t.name, t.profiles[0].depth) for t in found.topics] == [(A, 4)]
    none = OLD.replace("[bag_0.mcap, bag_1.mcap]", "[]")
    (tmp_path / "metadata.yaml").write_text(none)
    assert read_metadata(tmp_path).files == []


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("5", "offered_qos_profiles is a list of mappings, found 5"),
        ("{depth: 5}", "offered_qos_profiles is a list of mappings, found {'depth': 5}"),
        ("- 5", "offered_qos_profiles is a list of mappings, found [5]"),
        ("- {history: sometimes}", "history of a QoS profile is one of system_default, keep_last"),
        ("- {depth: many}", "a QoS profile cannot be read ("),
        ("- {depth: [1]}", "a QoS profile cannot be read ("),
        ("- {depth: .inf}", "a QoS profile cannot be read ("),
        ("- {deadline: 5}", "a QoS profile cannot be read ("),
        ("- {lifespan: {sec: .nan}}", "a QoS profile cannot be read ("),
    ],
)
def test_profiles_that_are_none_are_refused_in_one_sentence(tmp_path, text, says):
    with pytest.raises(InputError) as caught:
        parse_profiles(text, "bag: /t")
    assert str(caught.value).startswith(f"bag: /t: {says}")
    assert "\n" not in str(caught.value)
    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
        writer.register_channel("/t", "cdr", schema, {"offered_qos_profiles": text})
        writer.finish()
    with pytest.raises(InputError) as caught:
        BagReader(path)
    assert str(caught.value).startswith(f"{path}: /t: {says}")


# Writing


def test_a_bag_that_cannot_be_made_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    below = tmp_path / "file" / "bag"
    with pytest.raises(InputError, match=f"^{below}: cannot be made \\(Not a directory\\)$"):
        BagWriter(below)
    long = tmp_path / ("n" * 250)  # which the names of its files exceed
    with pytest.raises(InputError, match=f"^{long}: cannot be written \\(File name too long\\)$"):
        BagWriter(long)


def test_an_empty_file_is_not_split(tmp_path):
    writer = BagWriter(tmp_path / "bag")
    writer.split()
    writer.add_topic(Topic(A, "a/msg/A"), "")
    writer.write(*message(0))
    writer.split()
    writer.split()
    assert writer.close() == []
    assert [file.entry.message_count for file in BagReader(tmp_path / "bag").files] == [1, 0]


def test_a_description_that_cannot_be_written_is_told_of(tmp_path):
    folder = tmp_path / "bag"
    writer = BagWriter(folder)
    writer.add_topic(Topic(A, "a/msg/A"), "")
    writer.write(*message(0))
    (folder / "metadata.yaml").mkdir()
    (said,) = writer.close()
    assert said.startswith(f"{folder}: metadata.yaml could not be written (Is a directory);")
    (folder / "metadata.yaml").rmdir()
    assert contents(BagReader(folder)) == [message(0)]


def test_a_bag_that_cannot_be_recovered_in_its_place_is_told_of(tmp_path, monkeypatch):
    folder = tmp_path / "bag"
    writer = BagWriter(folder)
    writer.add_topic(Topic(A, "a/msg/A"), "")
    writer.write(*message(0))
    assert not writer.close()

    def refuse(path):
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(files, "new_beside", refuse)
    (folder / "metadata.yaml").unlink()
    with pytest.raises(
        InputError, match=f"^{folder}: cannot be written \\(Read-only file system\\)$"
    ):
        recover_bag(folder)
    path = folder / "bag_0.mcap"
    os.truncate(path, path.stat().st_size - 20)
    with pytest.raises(
        InputError, match=f"^{path}: cannot be written \\(Read-only file system\\)$"
    ):
        recover_bag(folder)
    assert contents(BagReader(folder)) == [message(0)]


@contextlib.contextmanager
def full_disk(size):
    """Files of this process may not grow beyond a size."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, ignored)


def test_what_comes_while_a_file_cannot_be_ended_is_in_the_next_one(tmp_path):
    folders = [tmp_path / name / "bag" for name in ("never full", "full")]
    for folder in folders:
        writer = BagWriter(folder)
        writer.add_topic(Topic(A, "a/msg/A"), "string a\n")
        writer.write(*message(0))
        writer.flush()
        assert writer.ready
        if folder == folders[0]:
            writer.split()
            assert writer.close() == []
    with full_disk((folder / "bag_0.mcap").stat().st_size):
        with pytest.raises(OSError, match="File too large"):
            writer.split()
        assert not writer.ready
        writer.add_topic(Topic(B, "b/msg/B"), "string b\n")
        writer.attach(Attachment("rig.yaml", b"pneu_rig: 1\n", "application/yaml", 5))
        writer.add_record("pneu", {"operator": "me"})
        with pytest.raises(OSError, match="File too large"):
            writer.flush()
    writer.flush()
    assert writer.ready
    writer.write(*message(1))
    writer.write(*message(2))
    assert writer.close() == []
    first = [(one / "bag_0.mcap").read_bytes() for one in folders]
    assert first[0] == first[1]
    bag = BagReader(folder)
    assert contents(bag) == [message(k) for k in range(3)]
    assert [sorted(file.topics) for file in bag.files] == [[A], [A, B]]
    names = [[one.name for one in side_records(file.path)] for file in bag.files]
    assert names == [["rosbag2", "rosbag2"], ["rosbag2", "pneu", "rig.yaml", "rosbag2"]]
    for file in bag.files:
        with file.path.open("rb") as stream:
            assert len(list(make_reader(stream, validate_crcs=True).iter_messages())) in (1, 2)


def test_a_disk_that_refuses_is_told_of_once_and_nothing_waits_for_it(tmp_path):
    folder = tmp_path / "bag"
    told, stuck, goes_on = [], threading.Event(), threading.Event()

    def report(sentence):
        told.append(sentence)
        stuck.set()
        assert goes_on.wait(60.0)

    writer = BagWriter(folder)
    recording = Recording(writer, 10**6, report=report)
    recording.add_topic(Topic(A, "a/msg/A"), "string a\n")
    recording.write(*message(0))
    assert recording.snapshot() == "the recorder does not run in snapshot mode"
    assert recording.split() == ""
    recording.write(*message(2))
    with full_disk(100):
        assert stuck.wait(60.0)
        begun_s = time.monotonic()
        assert recording.split(0.01) == "the disk has not answered for 0.01 s"
        assert time.monotonic() - begun_s < 20.0
        goes_on.set()
        assert [recording.split() for _ in range(2)] == ["File too large"] * 2
        assert recording.status().fault == "File too large"
    stuck.clear()
    assert stuck.wait(60.0)
    assert recording.split() == ""
    assert told == [
        f"{folder}: cannot be written (File too large); messages are dropped until it can",
        f"{folder}: is written again after 0 lost messages",
    ]
    recording.tell_lost({"/b": 7, "/a": 3})
    assert recording.close() == []
    bag = BagReader(folder)
    assert contents(bag) == [message(0), message(2)]
    assert bag.metadata.custom_data == {LOST_KEY: "/a 3, /b 7"}
    assert info_text(bag).splitlines()[-2:] == ["Lost on the way:   /a 3", " " * 19 + "/b 7"]


def test_what_comes_after_a_split_that_failed_is_counted_as_lost(tmp_path, monkeypatch):
    """From the same moment on, not from when it is flushed the next time."""
    monkeypatch.setattr("pneu_graph.bag.recording.FLUSH_PERIOD_S", 1000.0)
    told = []
    recording = Recording(BagWriter(tmp_path / "bag"), 10**6, report=told.append)
    recording.add_topic(Topic(A, "a/msg/A"), "string a\n")
    recording.write(*message(0))
    with full_disk(100):
        assert recording.split() == "File too large"
        recording.write(*message(2))
        assert recording.split() == "File too large"
    assert recording.status().dropped == 1
    assert recording.split() == ""
    recording.write(*message(4))
    assert recording.close() == []
    assert told[1:] == [f"{tmp_path}/bag: is written again after 1 lost messages"]
    assert contents(BagReader(tmp_path / "bag")) == [message(0), message(4)]


@pytest.mark.parametrize(
    ("count", "text"),
    [
        (1023, "1023 B"),
        (1024, "1.0 KiB"),
        (1_572_864, "1.5 MiB"),
        ((1 << 30) - 1, "1024.0 MiB"),
        (1 << 30, "1.0 GiB"),
        (3 << 40, "3072.0 GiB"),
    ],
)
def test_sizes_are_said_in_their_unit(count, text):
    assert _size(count) == text
