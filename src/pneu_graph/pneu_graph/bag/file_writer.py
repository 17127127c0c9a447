# SPDX-License-Identifier: Apache-2.0
"""One MCAP file of a bag, as rosbag2's storage plugin writes it.

Profile ``ros2``, zstd chunks with CRC, message index, schemas with the full text of their types,
channels with QoS and type hash, and rosbag2's metadata at the beginning and at the end.
"""

from pathlib import Path
from typing import IO, cast

from mcap.writer import CompressionType, Writer

from pneu_graph.bag.metadata import BagMetadata, File, Topic
from pneu_graph.bag.qos import profiles_text
from pneu_graph.bag.spool import Spool

CHUNK_BYTES = 1 << 20
"""Size of a chunk before compression, bytes; viewers want at most 4 MB."""

MESSAGE_OVERHEAD_BYTES = 31
"""What a message takes in a chunk beside its data, bytes."""

METADATA_RECORD = "rosbag2"
METADATA_KEY = "serialized_metadata"


class BagFile:
    """An MCAP file that is being written.

    Args:
        path: File to create; must not exist.
    """

    def __init__(self, path: Path) -> None:
        self.entry = File(path.name)
        self.counts: dict[str, int] = {}
        self._spool = Spool(path)
        self._writer = Writer(
            cast(IO[bytes], self._spool),  # write, tell and flush are all it uses
            chunk_size=2 * CHUNK_BYTES,  # never reached: `write` ends the chunks itself
            compression=CompressionType.ZSTD,
            enable_data_crcs=True,
        )
        self._writer.start(profile="ros2", library="pneu")
        first = BagMetadata(files=[self.entry])
        self._writer.add_metadata(METADATA_RECORD, {METADATA_KEY: first.body()})
        self._schemas: dict[tuple[str, str], int] = {}
        self._channels: dict[str, int] = {}
        self._finished = False
        self._in_chunk = 0

    @property
    def size(self) -> int:
        """Bytes in the file and on their way into it, the chunk in progress uncompressed."""
        return self._spool.tell() + self._in_chunk

    @property
    def blocked(self) -> bool:
        """Whether bytes wait because a commit failed."""
        return self._spool.failed

    def add_topic(self, topic: Topic, definition: str) -> None:
        """Makes a topic known; it must come before the topic's first message.

        Args:
            topic: The topic.
            definition: Full text of the message type and of the types in it.
        """
        key = (topic.type, definition)
        if key not in self._schemas:
            self._schemas[key] = self._writer.register_schema(
                topic.type, "ros2msg" if definition else "", definition.encode()
            )
        self._channels[topic.name] = self._writer.register_channel(
            topic.name,
            topic.serialization_format,
            self._schemas[key],
            {
                "offered_qos_profiles": profiles_text(topic.profiles),
                "topic_type_hash": topic.type_hash,
            },
        )
        self.counts[topic.name] = 0

    def write(
        self, topic: str, data: bytes, log_time_ns: int, publish_time_ns: int, sequence: int = 0
    ) -> None:
        """Adds a message to the chunk in progress, and ends the chunk where it is full.

        Args:
            topic: Name of a topic that was added.
            data: CDR with its header.
            log_time_ns: When it was received, ns.
            publish_time_ns: When it was sent, ns.
            sequence: Number that the publisher gave it; 0 where unknown.

        Raises:
            OSError: A full chunk cannot be written, as for `flush`; the message is kept.
        """
        self._writer.add_message(
            self._channels[topic], log_time_ns, data, publish_time_ns, sequence
        )
        entry = self.entry
        entry.message_count += 1
        entry.start_ns = min(entry.start_ns, log_time_ns)
        entry.end_ns = max(entry.end_ns, log_time_ns)
        self.counts[topic] += 1
        self._in_chunk += len(data) + MESSAGE_OVERHEAD_BYTES
        if self._in_chunk >= CHUNK_BYTES:
            self.flush()

    def attach(self, name: str, data: bytes, media_type: str, time_ns: int) -> None:
        """Adds an attachment.

        Args:
            name: Such as ``rig.yaml``.
            data: The content.
            media_type: Such as ``application/yaml``.
            time_ns: When it was taken, ns since the epoch.
        """
        self._writer.add_attachment(time_ns, time_ns, name, media_type, data)

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Adds a metadata record.

        Args:
            name: Name of the record.
            values: Its texts.
        """
        self._writer.add_metadata(name, values)

    def flush(self) -> None:
        """Ends the chunk in progress and writes everything to the file.

        Raises:
            OSError: The disk takes no more; the file ends after the last whole chunk, and what
                was to be written is kept for the next call.
        """
        self._writer.flush()
        self._in_chunk = 0
        self._spool.commit()

    def finish(self, metadata: BagMetadata) -> None:
        """Writes index and summary. After an OSError it may be called again.

        Args:
            metadata: Of the whole bag, as rosbag2 repeats it at the end of each file.

        Raises:
            OSError: The disk takes no more; the file is readable but has no index.
        """
        if not self._finished:
            self.flush()
            self._writer.add_metadata(METADATA_RECORD, {METADATA_KEY: metadata.body()})
            self._writer.finish()
            self._finished = True
        self._spool.commit()

    def close(self) -> None:
        """Closes the file as it is."""
        self._spool.close()
