# SPDX-License-Identifier: Apache-2.0
"""Reading rosbag2 MCAP recordings: folders and single files, with index or cut short.

A file without index, as a killed recorder leaves it, is read chunk by chunk up to the last whole
one.
"""

import dataclasses
import heapq
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import (
    Attachment,
    Channel,
    Chunk,
    DataEnd,
    Footer,
    Message,
    Metadata,
    Schema,
    Statistics,
)
from mcap.stream_reader import StreamReader
from mcap.summary import Summary

from pneu_common.errors import InputError
from pneu_graph.bag.metadata import BagMetadata, File, Topic, read_metadata
from pneu_graph.bag.qos import parse_profiles
from pneu_graph.bag.unpacking import Allowance, bounded, chunk_records

MAGIC = b"\x89MCAP0\r\n"

_KINDS = {int(one) for one in Opcode}

# What a cut or damaged file makes the MCAP library raise, and what is below it.
_DAMAGE = (
    McapError,
    zstandard.ZstdError,
    EOFError,
    ValueError,
    KeyError,
    OverflowError,
    RuntimeError,
    struct.error,
)


@dataclasses.dataclass(frozen=True)
class BagMessage:
    """One recorded message.

    Attributes:
        topic: Its topic.
        data: CDR with its header.
        log_time_ns: When it was received, ns.
        publish_time_ns: When it was sent, ns.
        sequence: Number that the publisher gave it; 0 where unknown.
    """

    topic: str
    data: bytes
    log_time_ns: int
    publish_time_ns: int
    sequence: int = 0


@dataclasses.dataclass
class FileContent:
    """What one MCAP file holds, beside the messages.

    Attributes:
        path: The file.
        entry: Times and count.
        topics: The topics by name.
        definitions: Text of the message type by topic.
        indexed: Whether the file has its summary; false where recording was cut short.
        damage: The last damage that was found while records were read; empty where there was none.
    """

    path: Path
    entry: File
    topics: dict[str, Topic]
    definitions: dict[str, str]
    indexed: bool
    damage: str = ""


class BagReader:
    """A bag, opened for reading.

    Args:
        path: Folder of a bag, or one MCAP file.

    Raises:
        InputError: There is no bag, or it is not in MCAP files.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.files = [scan_file(file) for file in bag_files(self.path)]
        self.metadata = self._gathered()

    @property
    def definitions(self) -> dict[str, str]:
        """Text of the message type by topic."""
        return {topic: text for file in self.files for topic, text in file.definitions.items()}

    def messages(self, topics: set[str] | None = None, start_ns: int = 0) -> Iterator[BagMessage]:
        """Yields messages by log time; the files one after the other.

        Args:
            topics: Only these; None for all.
            start_ns: Only messages from this log time on, ns.
        """
        for file in self.files:
            if file.entry.message_count and file.entry.end_ns >= start_ns:
                yield from file_messages(file, topics, start_ns)

    def _gathered(self) -> BagMetadata:
        """Metadata from the files themselves: they are right where `metadata.yaml` is not."""
        gathered = BagMetadata(files=[file.entry for file in self.files])
        topics: dict[str, Topic] = {}
        for file in self.files:
            for topic in file.topics.values():
                if topic.name in topics:
                    topics[topic.name].message_count += topic.message_count
                else:
                    topics[topic.name] = dataclasses.replace(topic)
        if self.path.is_dir() and (self.path / "metadata.yaml").exists():
            stated = read_metadata(self.path)
            gathered.ros_distro, gathered.version = stated.ros_distro, stated.version
            gathered.custom_data = stated.custom_data
            for topic in stated.topics:
                # rosbag2 lists topics that never had a message, the file may not
                topics.setdefault(topic.name, dataclasses.replace(topic, message_count=0))
                own = topics[topic.name]
                own.profiles = own.profiles or topic.profiles
                own.type_hash = own.type_hash or topic.type_hash
        gathered.topics = list(topics.values())
        return gathered


def bag_files(path: Path) -> list[Path]:
    """Returns the MCAP files of a bag in the order of recording.

    Args:
        path: Folder of a bag, or one MCAP file.

    Raises:
        InputError: There is no bag, or it is in another storage.
    """
    if path.is_file():
        return [path]
    if not path.is_dir():
        raise InputError(f"{path}: no such bag")
    found = sorted(path.glob("*.mcap"), key=_file_number)
    if (path / "metadata.yaml").exists():
        stated = read_metadata(path)
        if stated.storage != "mcap":
            raise InputError(
                f"{path}: is stored as {stated.storage!r}, read is 'mcap';"
                " `ros2 bag convert` makes one of the other"
            )
        named = [path / file.path for file in stated.files]
        missing = [file.name for file in named if not file.exists()]
        if missing:
            raise InputError(f"{path}: metadata.yaml names {', '.join(missing)}, which is missing")
        # A killed recorder leaves a last file that the metadata of its earlier splits do not name.
        return named + [file for file in found if file not in named]
    if not found:
        raise InputError(f"{path}: holds no .mcap file")
    return found


def _file_number(path: Path) -> tuple[int, str]:
    digits = path.stem.rpartition("_")[2]
    return (int(digits) if digits.isdigit() else 0, path.name)


def scan_file(path: Path) -> FileContent:
    """Reads what an MCAP file holds, beside the messages.

    Args:
        path: The file.

    Raises:
        InputError: It is no MCAP file or cannot be read.
    """
    try:
        with bounded(path) as stream:
            if path.stat().st_size < len(MAGIC) or stream.read(len(MAGIC)) != MAGIC:
                raise InputError(f"{path}: is no MCAP file")
            stream.seek(0)
            try:
                summary = make_reader(stream).get_summary()
            except _DAMAGE:
                summary = None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    statistics = summary.statistics if summary is not None else None
    if summary is None or statistics is None or not _tells_all(summary, statistics):
        return _scan_records(path)
    content = FileContent(path, File(path.name), {}, {}, indexed=True)
    if statistics.message_count:
        content.entry = File(
            path.name,
            statistics.message_start_time,
            statistics.message_end_time,
            statistics.message_count,
        )
    for channel in summary.channels.values():
        count = statistics.channel_message_counts.get(channel.id, 0)
        _add_channel(content, channel, summary.schemas.get(channel.schema_id), count)
    return content


def _tells_all(summary: Summary, statistics: Statistics) -> bool:
    """Whether a summary repeats all that is needed to read a file by its index."""
    schemas = {channel.schema_id for channel in summary.channels.values()} - {0}  # 0 is none
    return (
        statistics.chunk_count == len(summary.chunk_indexes)
        and statistics.channel_message_counts.keys() <= summary.channels.keys()
        and schemas <= summary.schemas.keys()
    )


def _add_channel(
    content: FileContent, channel: Channel, schema: Schema | None, count: int
) -> Topic:
    where = f"{content.path}: {channel.topic}"
    if channel.topic not in content.topics:
        content.topics[channel.topic] = Topic(
            name=channel.topic,
            type=schema.name if schema else "",
            type_hash=channel.metadata.get("topic_type_hash", ""),
            profiles=parse_profiles(channel.metadata.get("offered_qos_profiles", ""), where),
            message_count=0,
            serialization_format=channel.message_encoding,
        )
        content.definitions[channel.topic] = schema.data.decode(errors="replace") if schema else ""
    topic = content.topics[channel.topic]
    topic.message_count += count
    return topic


def _scan_records(path: Path) -> FileContent:
    content = FileContent(path, File(path.name), {}, {}, indexed=False)
    schemas: dict[int, Schema] = {}
    by_channel: dict[int, Topic] = {}
    for _, parts in sound_records(path, content):
        for inner in parts:
            if isinstance(inner, Schema):
                schemas[inner.id] = inner
            elif isinstance(inner, Channel):
                by_channel[inner.id] = _add_channel(content, inner, schemas.get(inner.schema_id), 0)
            elif isinstance(inner, Message):
                by_channel[inner.channel_id].message_count += 1
                entry = content.entry
                entry.message_count += 1
                entry.start_ns = min(entry.start_ns, inner.log_time)
                entry.end_ns = max(entry.end_ns, inner.log_time)
    return content


def sound_records(
    path: Path, content: FileContent | None = None
) -> Iterator[tuple[Any, list[Any]]]:
    """Yields the records of a file's data section up to the last one that is whole.

    Each comes with the records inside of it, where it is a chunk, else with itself as a list. A
    chunk whose content is damaged is left out.

    Args:
        path: The file, which begins as an MCAP file does.
        content: Where to note damage.

    Raises:
        InputError: A chunk unpacks to more than is allowed.
    """
    known: set[int] = set()  # channels
    with bounded(path) as stream:
        size = path.stat().st_size
        allowance = Allowance(path, size)
        stream.seek(len(MAGIC))
        records = StreamReader(
            stream, skip_magic=True, emit_chunks=True, record_size_limit=size
        ).records
        while True:
            at = stream.tell()
            # The library reads short at the end of the file, so the length is checked first.
            head = stream.read(min(9, size - at))
            stream.seek(at)
            end = at + 9 + int.from_bytes(head[1:], "little")
            # (no kind is 0; file systems leave zeros where power was lost)
            if len(head) < 9 or end > size or not head[0]:
                if content is not None and head:
                    content.damage = f"cut inside a record at byte {at}"
                return
            if head[0] not in _KINDS:  # which the library passes over together with what follows
                stream.seek(end)
                continue
            record = None
            try:
                record = next(records)
                if isinstance(record, DataEnd | Footer):
                    return
                parts: list[Any] = [record]
                if isinstance(record, Chunk):
                    parts = list(chunk_records(record, allowance))
                found = known | {part.id for part in parts if isinstance(part, Channel)}
                for part in parts:
                    if isinstance(part, Message) and part.channel_id not in found:
                        raise ValueError(
                            f"a message of channel {part.channel_id}, which is unknown"
                        )
            except InputError:  # before its base, ValueError
                raise
            except _DAMAGE as error:
                if content is not None:
                    content.damage = _damaged(at, error)
                if record is None:  # the library goes no further
                    return
                continue
            known = found
            yield record, parts


def _damaged(at: int, error: Exception) -> str:
    return f"damaged at byte {at} ({' '.join(str(error).split())})"


def side_records(path: Path) -> Iterator[Attachment | Metadata]:
    """Yields attachments and metadata records of a file.

    Args:
        path: The file.
    """
    for record, _ in sound_records(path):
        if isinstance(record, Attachment | Metadata):
            yield record


def file_messages(
    file: FileContent,
    topics: set[str] | None = None,
    start_ns: int = 0,
    what_is_whole: bool = False,
) -> Iterator[BagMessage]:
    """Yields the messages of one file by log time.

    Args:
        file: The file, as it was scanned.
        topics: Only these; None for all.
        start_ns: Only messages from this log time on, ns.
        what_is_whole: Whether damaged chunks of a file with index are left out, and noted in its
            content; those of a file without index always are.

    Raises:
        InputError: A file with index is damaged, or a chunk unpacks to more than is allowed.
    """
    if not file.indexed:
        yield from _messages_in_turn(file, topics, start_ns)
        return
    try:
        yield from _indexed_messages(file, topics, start_ns, what_is_whole)
    except InputError:  # before its base, ValueError
        raise
    except _DAMAGE as error:
        raise InputError(
            f"{file.path}: is damaged ({' '.join(str(error).split())});"
            " `pneu bag recover` keeps what is whole"
        ) from None


def _messages_in_turn(
    file: FileContent, topics: set[str] | None, start_ns: int
) -> Iterator[BagMessage]:
    """Messages by log time of a file that is read from its beginning to its end."""
    names: dict[int, str] = {}
    waiting: list[tuple[int, int, BagMessage]] = []
    order = 0
    for record, parts in sound_records(file.path, file):
        # Recorders write in the order of receipt, so only neighbouring chunks overlap in time.
        begin = record.message_start_time if isinstance(record, Chunk) else None
        while waiting and begin is not None and waiting[0][0] < begin:
            yield heapq.heappop(waiting)[2]
        for inner in parts:
            if isinstance(inner, Channel):
                names[inner.id] = inner.topic
            elif isinstance(inner, Message) and inner.log_time >= start_ns:
                topic = names[inner.channel_id]
                if topics is None or topic in topics:
                    order += 1
                    entry = (inner.log_time, order, _bag_message(topic, inner))
                    heapq.heappush(waiting, entry)
    while waiting:
        yield heapq.heappop(waiting)[2]


def _indexed_messages(
    file: FileContent, topics: set[str] | None, start_ns: int, what_is_whole: bool
) -> Iterator[BagMessage]:
    """Messages by log time of a file with index, chunk by chunk."""
    with bounded(file.path) as stream:
        allowance = Allowance(file.path, file.path.stat().st_size)
        summary = make_reader(stream).get_summary()
        assert summary is not None  # or the file would have been scanned as one without index
        if not summary.chunk_indexes:
            yield from _messages_in_turn(file, topics, start_ns)
            return
        names = {number: channel.topic for number, channel in summary.channels.items()}
        waiting: list[tuple[int, int, int, BagMessage]] = []
        for index in sorted(
            summary.chunk_indexes, key=lambda one: (one.message_start_time, one.chunk_start_offset)
        ):
            offsets = index.message_index_offsets
            wanted = topics is None or any(names[number] in topics for number in offsets)
            if index.message_end_time < start_ns or (offsets and not wanted):
                continue
            while waiting and waiting[0][0] < index.message_start_time:
                yield heapq.heappop(waiting)[3]
            try:
                stream.seek(index.chunk_start_offset + 9)
                chunk = Chunk.read(ReadDataStream(stream))
                messages = [
                    (part, names[part.channel_id])
                    for part in chunk_records(chunk, allowance)
                    if isinstance(part, Message)
                ]
            except _DAMAGE as error:
                if not what_is_whole:
                    raise
                file.damage = _damaged(index.chunk_start_offset, error)
                continue
            for number, (message, topic) in enumerate(messages):
                if message.log_time >= start_ns and (topics is None or topic in topics):
                    key = (message.log_time, index.chunk_start_offset, number)
                    heapq.heappush(waiting, (*key, _bag_message(topic, message)))
        while waiting:
            yield heapq.heappop(waiting)[3]


def _bag_message(topic: str, message: Message) -> BagMessage:
    return BagMessage(topic, message.data, message.log_time, message.publish_time, message.sequence)
