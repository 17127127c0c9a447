# SPDX-License-Identifier: Apache-2.0
"""A bag that is being written: a folder with one MCAP file after the other, and `metadata.yaml`."""

import dataclasses
from pathlib import Path

from pneu_common.errors import InputError
from pneu_common.files import check_name_is_text
from pneu_graph.bag.file_writer import BagFile
from pneu_graph.bag.metadata import BagMetadata, Topic


@dataclasses.dataclass(frozen=True)
class Attachment:
    """Something kept beside the messages.

    Attributes:
        name: Such as ``rig.yaml``.
        data: The content.
        media_type: Such as ``application/yaml``.
        time_ns: When it was taken, ns since the epoch.
    """

    name: str
    data: bytes
    media_type: str
    time_ns: int


class BagWriter:
    """Writes a bag.

    An OSError of any method means that the disk takes no more. Nothing that the files hold is lost
    by it, and `flush` tries again; until it succeeds `ready` is false and nothing may be written.

    Args:
        folder: Folder to create; must not exist.
        max_file_bytes: Size at which the next file begins, bytes; 0: never.
        max_file_s: Time between a file's first and last message at which the next begins, s;
            0: never.

    Raises:
        InputError: The folder exists, cannot be made, or has a name that metadata cannot hold.
    """

    def __init__(self, folder: Path, max_file_bytes: int = 0, max_file_s: float = 0.0) -> None:
        self.folder = folder
        self.metadata = BagMetadata()
        self._max_file_bytes = max_file_bytes
        self._max_file_ns = round(max_file_s * 1e9)
        self._topics: dict[str, tuple[Topic, str]] = {}
        self._attachments: list[Attachment] = []
        self._records: list[tuple[str, dict[str, str]]] = []
        self._file: BagFile | None = None
        self._finishing: BagFile | None = None
        check_name_is_text(folder.name, "metadata.yaml of a bag")
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            raise InputError(f"{folder}: exists already; a bag is written to a new path") from None
        except OSError as error:
            raise InputError(f"{folder}: cannot be made ({error.strerror})") from None
        try:
            self._open()
        except OSError as error:
            raise InputError(f"{folder}: cannot be written ({error.strerror})") from None

    @property
    def ready(self) -> bool:
        """Whether messages can be written now."""
        return self._finishing is None and self._file is not None and not self._file.blocked

    def add_topic(self, topic: Topic, definition: str) -> None:
        """Makes a topic known; it must come before the topic's first message.

        Args:
            topic: The topic.
            definition: Full text of the message type and of the types in it; empty where unknown.
        """
        self._topics[topic.name] = (topic, definition)
        self.metadata.topics.append(topic)
        if self._file is not None:
            self._file.add_topic(topic, definition)

    def attach(self, attachment: Attachment) -> None:
        """Adds an attachment to this file and to those that follow.

        Args:
            attachment: Name and content.
        """
        self._attachments.append(attachment)
        if self._file is not None:
            self._file.attach(**dataclasses.asdict(attachment))

    def add_record(self, name: str, values: dict[str, str]) -> None:
        """Adds a metadata record to this file and to those that follow.

        Args:
            name: Name of the record.
            values: Its texts.
        """
        self._records.append((name, values))
        if self._file is not None:
            self._file.add_metadata(name, values)

    def write(self, topic: str, data: bytes, log_time_ns: int, publish_time_ns: int) -> None:
        """Adds a message. Allowed while `ready`.

        Args:
            topic: Name of a topic that was added.
            data: CDR with its header.
            log_time_ns: When it was received, ns.
            publish_time_ns: When it was sent, ns.

        Raises:
            OSError: The disk is full; the message itself is kept.
        """
        file = self._file
        assert file is not None
        if self._max_file_ns and log_time_ns - file.entry.start_ns >= self._max_file_ns:
            self.split()
            file = self._file
            assert file is not None
        self._topics[topic][0].message_count += 1
        file.write(topic, data, log_time_ns, publish_time_ns)
        if self._max_file_bytes and file.size >= self._max_file_bytes:
            self.split()

    def split(self) -> None:
        """Ends the file in progress and begins the next; does nothing where it is empty.

        Raises:
            OSError: The disk is full.
        """
        if self._file is not None:
            if not self._file.entry.message_count:
                return
            self._finishing, self._file = self._file, None
        self.flush()

    def flush(self) -> None:
        """Brings everything written so far into the files.

        Raises:
            OSError: The disk is full.
        """
        if self._finishing is not None:
            self._finishing.finish(self.metadata)
            self._finishing.close()
            self._finishing = None
            self.metadata.write(self.folder)
        if self._file is None:
            self._open()
        assert self._file is not None
        self._file.flush()

    def close(self) -> list[str]:
        """Ends the bag.

        Returns:
            A sentence for each part that could not be written; empty where all is well.
        """
        faults = []
        for file in (self._finishing, self._file):
            if file is None:
                continue
            try:
                file.finish(self.metadata)
            except OSError as error:
                faults.append(
                    f"{self.folder / file.entry.path}: has no index ({error.strerror});"
                    " it is readable, and `pneu bag recover` completes it"
                )
            file.close()
        self._file = self._finishing = None
        try:
            self.metadata.write(self.folder)
        except OSError as error:
            faults.append(
                f"{self.folder}: metadata.yaml could not be written ({error.strerror});"
                " `pneu bag recover` makes it"
            )
        return faults

    def _open(self) -> None:
        name = f"{self.folder.name}_{len(self.metadata.files)}.mcap"
        file = BagFile(self.folder / name)
        self._file = file
        self.metadata.files.append(file.entry)
        for record, values in self._records:
            file.add_metadata(record, values)
        for attachment in self._attachments:
            file.attach(**dataclasses.asdict(attachment))
        for topic, definition in self._topics.values():
            file.add_topic(topic, definition)
