# SPDX-License-Identifier: Apache-2.0
"""What `ros2 bag info` prints of a bag."""

import time

from pneu_graph.bag.metadata import LOST_KEY, NOTHING_YET_NS
from pneu_graph.bag.reader import BagReader


def info_text(bag: BagReader) -> str:
    """Returns the lines of `ros2 bag info`, and what is wrong with a file.

    Args:
        bag: The bag.
    """
    metadata = bag.metadata
    names = [file.entry.path for file in bag.files]
    size = sum(file.path.stat().st_size for file in bag.files)
    lines = [
        _labelled("Files", names),
        _labelled("Bag size", [_size(size)]),
        _labelled("Storage id", ["mcap"]),
        _labelled("ROS Distro", [metadata.ros_distro or "unknown"]),
        _labelled("Duration", [f"{metadata.duration_ns / 1e9:.9f}s"]),
        _labelled("Start", [_instant(metadata.start_ns)]),
        _labelled("End", [_instant(metadata.end_ns if metadata.message_count else 0)]),
        _labelled("Messages", [str(metadata.message_count)]),
        _labelled(
            "Topic information",
            [
                f"Topic: {topic.name} | Type: {topic.type} | Count: {topic.message_count}"
                f" | Serialization Format: {topic.serialization_format}"
                for topic in metadata.topics
            ],
        ),
    ]
    lost = metadata.custom_data.get(LOST_KEY)
    if lost:
        lines.append(_labelled("Lost on the way", lost.split(", ")))
    lines += [
        _labelled(
            "Without index", [f"{file.path.name}{f' ({file.damage})' if file.damage else ''}"]
        )
        for file in bag.files
        if not file.indexed
    ]
    return "\n".join(lines)


def _labelled(label: str, values: list[str]) -> str:
    width = 19
    return "\n".join(
        (f"{label}:" if i == 0 else "").ljust(width) + value
        for i, value in enumerate(values or [""])
    )


def _size(count: float) -> str:
    for unit in ("B", "KiB", "MiB"):
        if count < 1024.0:
            return f"{count:.1f} {unit}" if unit != "B" else f"{count:.0f} B"
        count /= 1024.0
    return f"{count:.1f} GiB"


def _instant(time_ns: int) -> str:
    if time_ns in (0, NOTHING_YET_NS):
        return "none"
    seconds, fraction = divmod(time_ns, 10**9)
    local = time.strftime("%b %e %Y %H:%M:%S", time.localtime(seconds))
    return f"{local}.{fraction:09d} ({seconds}.{fraction:09d})"
