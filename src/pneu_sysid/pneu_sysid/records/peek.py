# SPDX-License-Identifier: Apache-2.0
"""What numbers a recording holds, whatever they mean, and an outline to know each by."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from pneu_common.errors import InputError
from pneu_sim.channels import TextFormat
from pneu_sysid.records.container import bag_topics, collect
from pneu_sysid.records.decode import (
    attribute_of,
    columns_of,
    fields_of,
    getter_of,
    split_field,
    typestore_of,
)
from pneu_sysid.records.recording import Finding
from pneu_sysid.records.text import numbers_of, read_rows

Floats = NDArray[np.float64]

LARGEST_BYTES = 4096
"""Of a message; images and clouds of points are no signals."""
DEEPEST = 4
"""Messages inside of each other."""
WIDEST = 16
"""Elements of an array that are told one by one."""
MOST = 400
"""Numbers of a recording."""
POINTS = 120
"""Of an outline."""
LEFT_OUT = ("header.stamp", "stamp")
"""Fields that say when, not what."""


@dataclass(frozen=True)
class Peeked:
    """One number of a recording.

    Attributes:
        topic: Topic that it comes on; empty in a text file.
        type: Type of its messages.
        field: Path of the number in a message, or the column of a text file.
        count: How many there are.
        least: Least of them; NaN where none is finite.
        most: Most of them.
        outline: (points,) some of them, evenly, NaN where none is.
    """

    topic: str
    type: str
    field: str
    count: int
    least: float
    most: float
    outline: tuple[float, ...]


def peek(path: Path, layout: TextFormat) -> list[Peeked]:
    """All numbers of a recording, in the order of topics and fields, or of columns.

    Args:
        path: Bag or text file.
        layout: Of the rows of a text file.

    Raises:
        InputError: It cannot be read.
    """
    if path.is_dir() or path.name.endswith((".mcap", ".mcap.zstd")):
        return _of_bag(path)
    rows, lines, names, _ = read_rows(path, layout)
    width = min(len(row) for row in rows)
    out = []
    for k in range(width):
        name = names[k] if k < len(names) else str(k)
        found: list[Finding] = []
        try:
            values = numbers_of(path, name, rows, lines, k, layout, found)
        except InputError:  # a column of words
            continue
        out.append(_peeked("", "", name, values))
    return out[:MOST]


def _of_bag(path: Path) -> list[Peeked]:
    every = set(bag_topics(path))
    topics, _ = collect(path, every)
    out: list[Peeked] = []
    for name in sorted(topics):
        for msgtype, topic in sorted(topics[name].items()):
            size = sum(map(len, topic.data))
            if not topic.data or topic.encoding != "cdr" or size > LARGEST_BYTES * len(topic.data):
                continue
            where = f"{path}: topic '{name}' ({msgtype})"
            try:
                store = typestore_of(where, topic, name, [])
                messages = columns_of(where, store, topic)
            except InputError:  # of which nothing can be told; it may be wanted by nobody
                continue
            first = next(messages.kinds())
            for field in _paths_of(store, msgtype, first, "", 0):
                steps = split_field(where, field)
                values = messages.numbers(field, getter_of(steps))
                out.append(_peeked(name, msgtype, field, values))
                if len(out) >= MOST:
                    return out
    return out


def _paths_of(store: Typestore, msgtype: str, message: Any, path: str, depth: int) -> Iterator[str]:
    """Paths of the numbers of a type, arrays as long as a message has them."""
    for name, (kind, detail) in fields_of(store, msgtype).items():
        here = f"{path}.{name}" if path else name
        if here in LEFT_OUT:
            continue
        count = None
        if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            kind, detail = detail[0]
            count = min(len(reduce(getattr, map(attribute_of, here.split(".")), message)), WIDEST)
        if kind == Nodetype.NAME:
            if count is None and depth < DEEPEST:
                yield from _paths_of(store, detail, message, here, depth + 1)
        elif detail[0] not in ("string", "wstring", "wchar", "bool"):
            yield from [here] if count is None else [f"{here}[{k}]" for k in range(count)]


def _peeked(topic: str, msgtype: str, field: str, values: Floats) -> Peeked:
    finite = values[np.isfinite(values)]
    least, most = (float(finite.min()), float(finite.max())) if finite.size else (np.nan,) * 2
    at = np.unique(np.linspace(0, max(len(values) - 1, 0), POINTS).astype(np.int64))
    some = values[at[: len(values)]]
    outline = tuple(np.where(np.isfinite(some), some, np.nan).tolist())
    return Peeked(topic, msgtype, field, len(values), least, most, outline)
