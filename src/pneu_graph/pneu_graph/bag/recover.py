# SPDX-License-Identifier: Apache-2.0
"""Completing a bag whose recorder was killed: index and summary of the files, `metadata.yaml`."""

import contextlib
from pathlib import Path

from mcap.records import Attachment, Metadata

from pneu_common.errors import InputError
from pneu_common.files import replacing
from pneu_graph.bag.file_writer import METADATA_RECORD, BagFile
from pneu_graph.bag.metadata import BagMetadata
from pneu_graph.bag.reader import BagReader, FileContent, file_messages, side_records


def recover_bag(path: str | Path) -> list[str]:
    """Writes anew what is damaged or lacks its index, from what is whole, and `metadata.yaml`.

    A file is written aside and put in place of the other when it is complete.

    Args:
        path: Folder of a bag, or one MCAP file.

    Returns:
        One sentence per file.

    Raises:
        InputError: There is no bag, or it cannot be written.
    """
    path = Path(path)
    bag = BagReader(path)
    done = []
    for file in bag.files:
        if file.indexed and _is_whole(file):
            done.append(f"{file.path}: complete, {file.entry.message_count} messages")
            continue
        try:
            _rewrite(bag, file)
        except OSError as error:
            raise InputError(f"{file.path}: cannot be written ({error.strerror})") from None
        done.append(
            f"{file.path}: {'written anew' if file.indexed else 'index written'},"
            f" {file.entry.message_count} messages" + (f"; {file.damage}" if file.damage else "")
        )
    if path.is_dir():
        metadata = BagReader(path).metadata
        try:
            metadata.write(path)
        except OSError as error:
            raise InputError(f"{path}: cannot be written ({error.strerror})") from None
        done.append(f"{path / 'metadata.yaml'}: written, {metadata.message_count} messages")
    return done


def _is_whole(file: FileContent) -> bool:
    for _ in file_messages(file, what_is_whole=True):
        pass
    return not file.damage


def _rewrite(bag: BagReader, file: FileContent) -> None:
    with contextlib.ExitStack() as stack:
        aside = stack.enter_context(replacing(file.path))
        aside.unlink()  # it is no other writer's, and a bag's file is made anew
        written = stack.enter_context(contextlib.closing(BagFile(aside)))
        written.entry.path = file.path.name
        for record in side_records(file.path):
            if isinstance(record, Attachment):
                written.attach(record.name, record.data, record.media_type, record.log_time)
            elif isinstance(record, Metadata) and record.name != METADATA_RECORD:
                written.add_metadata(record.name, dict(record.metadata))
        for name, topic in file.topics.items():
            written.add_topic(topic, file.definitions[name])
        for message in file_messages(file, what_is_whole=True):
            written.write(
                message.topic,
                message.data,
                message.log_time_ns,
                message.publish_time_ns,
                message.sequence,
            )
        for name, topic in file.topics.items():
            topic.message_count = written.counts[name]
        file.entry = written.entry
        written.finish(
            BagMetadata(
                files=[written.entry],
                topics=list(file.topics.values()),
                ros_distro=bag.metadata.ros_distro,
            )
        )
