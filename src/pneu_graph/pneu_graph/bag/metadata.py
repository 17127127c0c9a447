# SPDX-License-Identifier: Apache-2.0
"""`metadata.yaml` of a rosbag2 folder, version 9 as Jazzy writes it; older versions are read."""

import dataclasses
from pathlib import Path
from typing import Any

from pneu_common.documents import read_yaml
from pneu_common.errors import InputError
from pneu_common.files import replacing
from pneu_graph.bag.qos import OfferedQos, parse_profiles

VERSION = 9
FILE_NAME = "metadata.yaml"
ROS_DISTRO = "jazzy"

LOST_KEY = "pneu_lost"
"""Under this name the custom data tell what was lost on the way to the recorder."""

NOTHING_YET_NS = 2**63 - 1
"""Starting time that rosbag2 writes before the first message, ns."""


@dataclasses.dataclass
class Topic:
    """One recorded topic.

    Attributes:
        name: Fully qualified name.
        type: Such as ``sensor_msgs/msg/FluidPressure``.
        type_hash: ``RIHS01_...`` or empty.
        profiles: What the publishers offered.
        message_count: Messages in the bag.
        serialization_format: Always ``cdr`` here.
    """

    name: str
    type: str
    type_hash: str = ""
    profiles: list[OfferedQos] = dataclasses.field(default_factory=list)
    message_count: int = 0
    serialization_format: str = "cdr"


@dataclasses.dataclass
class File:
    """One file of a bag.

    Attributes:
        path: Relative to the folder.
        start_ns: Log time of the first message, ns; NOTHING_YET_NS without messages.
        end_ns: Log time of the last message, ns.
        message_count: Messages in the file.
    """

    path: str
    start_ns: int = NOTHING_YET_NS
    end_ns: int = 0
    message_count: int = 0

    @property
    def duration_ns(self) -> int:
        """Time from the first message to the last, ns."""
        return max(0, self.end_ns - self.start_ns) if self.message_count else 0


@dataclasses.dataclass
class BagMetadata:
    """What `metadata.yaml` says.

    Attributes:
        files: The files, in the order of recording.
        topics: The topics.
        custom_data: Further text values.
        ros_distro: Release of ROS.
        version: Version of the format.
        storage: Storage plugin.
    """

    files: list[File] = dataclasses.field(default_factory=list)
    topics: list[Topic] = dataclasses.field(default_factory=list)
    custom_data: dict[str, str] = dataclasses.field(default_factory=dict)
    ros_distro: str = ROS_DISTRO
    version: int = VERSION
    storage: str = "mcap"

    @property
    def message_count(self) -> int:
        """Messages in all files."""
        return sum(file.message_count for file in self.files)

    @property
    def start_ns(self) -> int:
        """Log time of the first message, ns."""
        return min((file.start_ns for file in self.files), default=NOTHING_YET_NS)

    @property
    def end_ns(self) -> int:
        """Log time of the last message, ns."""
        return max((file.end_ns for file in self.files), default=0)

    @property
    def duration_ns(self) -> int:
        """Time from the first message to the last, ns."""
        return max(0, self.end_ns - self.start_ns) if self.message_count else 0

    def body(self) -> str:
        """Returns the YAML text below `rosbag2_bagfile_information`, as the MCAP record holds."""
        lines = [
            f"version: {VERSION}",
            "storage_identifier: mcap",
            "duration:",
            f"  nanoseconds: {self.duration_ns}",
            "starting_time:",
            f"  nanoseconds_since_epoch: {self.start_ns}",
            f"message_count: {self.message_count}",
            "topics_with_message_count:",
        ]
        for topic in self.topics:
            lines += [
                "  - topic_metadata:",
                f"      name: {topic.name}",
                f"      type: {topic.type}",
                f"      serialization_format: {topic.serialization_format}",
                "      offered_qos_profiles:" + ("" if topic.profiles else " []"),
            ]
            for profile in topic.profiles:
                lines += ["        " + line for line in profile.text().splitlines()]
            lines += [
                f"      type_description_hash: {topic.type_hash or _quoted('')}",
                f"    message_count: {topic.message_count}",
            ]
        if not self.topics:
            lines += ["  []"]
        lines += ['compression_format: ""', 'compression_mode: ""', "relative_file_paths:"]
        lines += [f"  - {_quoted(file.path)}" for file in self.files] or ["  []"]
        lines += ["files:"]
        for file in self.files:
            lines += [
                f"  - path: {_quoted(file.path)}",
                "    starting_time:",
                f"      nanoseconds_since_epoch: {file.start_ns}",
                "    duration:",
                f"      nanoseconds: {file.duration_ns}",
                f"    message_count: {file.message_count}",
            ]
        if not self.files:
            lines += ["  []"]
        if self.custom_data:
            lines += ["custom_data:"]
            lines += [f"  {key}: {_quoted(value)}" for key, value in self.custom_data.items()]
        else:
            lines += ["custom_data: ~"]
        lines += [f"ros_distro: {self.ros_distro}"]
        return "\n".join(lines)

    def write(self, folder: Path) -> None:
        """Writes `metadata.yaml`, whole or not at all.

        Args:
            folder: Folder of the bag.

        Raises:
            OSError: It cannot be written.
        """
        body = "".join(f"  {line}\n" for line in self.body().splitlines())
        with replacing(folder / FILE_NAME) as aside:
            aside.write_text(f"rosbag2_bagfile_information:\n{body}", encoding="utf-8")


def _quoted(text: str) -> str:
    plain = text and all(c.isalnum() or c in "_-./" for c in text) and text[0] not in "-.~"
    return text if plain else '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


def read_metadata(folder: Path) -> BagMetadata:
    """Reads `metadata.yaml` of a bag.

    Args:
        folder: Folder of the bag.

    Raises:
        InputError: The file is missing or is not what rosbag2 writes.
    """
    path = folder / FILE_NAME
    if not path.exists():
        raise InputError(f"{path}: no such file; `pneu bag recover` makes it again")
    data = read_yaml(path, "description of a bag")
    try:
        info = data["rosbag2_bagfile_information"]
        return _metadata(info, path)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            f"{path}: is no rosbag2 metadata ({type(error).__name__}: {error})"
        ) from None


def _name(found: Any) -> str:
    """The name of a file beside the metadata."""
    if not isinstance(found, str) or Path(found).is_absolute() or ".." in Path(found).parts:
        raise TypeError(f"found {found!r} for the name of a file in the folder")
    return found


def _metadata(info: dict[str, Any], path: Path) -> BagMetadata:
    topics = []
    for entry in info["topics_with_message_count"] or []:
        meta = entry["topic_metadata"]
        topics.append(
            Topic(
                name=str(meta["name"]),
                type=str(meta["type"]),
                type_hash=meta.get("type_description_hash") or "",
                profiles=parse_profiles(
                    meta.get("offered_qos_profiles") or None, f"{path}: {meta['name']}"
                ),
                message_count=int(entry["message_count"]),
                serialization_format=meta.get("serialization_format", "cdr"),
            )
        )
    files = []
    for entry in info.get("files") or []:
        start = int(entry["starting_time"]["nanoseconds_since_epoch"])
        files.append(
            File(
                path=_name(entry["path"]),
                start_ns=start,
                end_ns=start + int(entry["duration"]["nanoseconds"]),
                message_count=int(entry["message_count"]),
            )
        )
    if not files:  # before version 5 the files were not described one by one
        start = int(info["starting_time"]["nanoseconds_since_epoch"])
        paths = [_name(one) for one in info["relative_file_paths"] or []]
        files = [File(path=name) for name in paths]
        if files:
            files[0] = File(
                paths[0],
                start,
                start + int(info["duration"]["nanoseconds"]),
                int(info["message_count"]),
            )
    return BagMetadata(
        files=files,
        topics=topics,
        custom_data=dict(info.get("custom_data") or {}),
        ros_distro=str(info.get("ros_distro") or ""),
        version=int(info["version"]),
        storage=str(info["storage_identifier"]),
    )
