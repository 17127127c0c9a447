# SPDX-License-Identifier: Apache-2.0
"""Messages decoded all at once where they are laid out alike, one by one where they are not.

In CDR a number lies where the lengths before it put it. Messages whose strings and lengths are the
same bytes therefore have every number in the same place, so that one of them is decoded by
``rosbags`` and of the others the numbers are read as columns: a hundredth of the time.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

Floats = NDArray[np.float64]

FEW = 8
"""Fewer messages than this are decoded one by one."""
MOST_LAYOUTS = 64
"""Of one topic; what is laid out otherwise than so many is decoded one by one."""
MOST_MEMBERS = 4096
"""Of a message's arrays of messages and strings; one with more is decoded by itself."""
_HEAD = 4
"""Bytes of the encapsulation; alignment counts from behind them."""
_NUMBERS = {
    "bool": "u1", "byte": "u1", "octet": "u1", "char": "u1", "uint8": "u1", "int8": "i1",
    "uint16": "u2", "int16": "i2", "uint32": "u4", "int32": "i4", "uint64": "u8", "int64": "i8",
    "float32": "f4", "float64": "f8",
}  # fmt: skip


class _OddError(Exception):
    """Signals a message that is not laid out as is known here."""


@dataclass(frozen=True)
class Place:
    """Where numbers lie in a message.

    Attributes:
        offset: Of the first, bytes.
        kind: NumPy's name of their type, with the order of its bytes.
        count: How many, one after another; None is one by itself.
    """

    offset: int
    kind: str
    count: int | None = None


@dataclass
class Layout:
    """Where things lie in a message.

    Attributes:
        numbers: By the path of a field.
        same: Parts of the message, from and to, whose bytes decide it: lengths and strings.
    """

    numbers: dict[str, Place] = field(default_factory=dict)
    same: list[tuple[int, int]] = field(default_factory=lambda: [(0, _HEAD)])


def layout_of(store: Typestore, msgtype: str, raw: bytes) -> Layout | None:
    """Where the numbers of a message lie; None where that is not known.

    Args:
        store: Definitions of types.
        msgtype: Its type.
        raw: It, with its encapsulation.
    """
    if raw[:2] not in (b"\x00\x00", b"\x00\x01"):  # plain CDR, big and little endian
        return None
    try:
        return _Walk(store, raw).of(msgtype)
    except (_OddError, RecursionError):
        return None


class _Walk:
    """A way through one message."""

    def __init__(self, store: Typestore, raw: bytes) -> None:
        self._store, self._raw, self._at = store, raw, 0
        self._order = "<" if raw[1] else ">"
        self._layout = Layout()
        self._members = 0

    def of(self, msgtype: str) -> Layout:
        self._message(msgtype, "")
        return self._layout

    def _message(self, msgtype: str, path: str) -> None:
        for name, (kind, detail) in self._store.fielddefs[msgtype][1]:
            self._field(kind, detail, f"{path}.{name}" if path else name)

    def _field(self, kind: Nodetype, detail: Any, path: str) -> None:
        if kind == Nodetype.NAME:
            self._message(detail, path)
        elif kind == Nodetype.BASE and detail[0] == "string":
            length = self._length()
            begin = _HEAD + self._at
            self._skip(length)
            self._layout.same.append((begin, begin + length))
        elif kind == Nodetype.BASE:
            self._numbers(detail[0], path, None)
        else:
            (inner, of), length = detail
            if kind == Nodetype.SEQUENCE:
                length = self._length()
            if inner == Nodetype.BASE and of[0] in _NUMBERS:
                self._numbers(of[0], path, length)
                return
            self._members += length
            if self._members > MOST_MEMBERS:
                raise _OddError
            for k in range(length):
                self._field(inner, of, f"{path}[{k}]")

    def _numbers(self, name: str, path: str, count: int | None) -> None:
        if name not in _NUMBERS:
            raise _OddError
        size = int(_NUMBERS[name][1])
        if count != 0:
            self._at += -self._at % size
        place = Place(_HEAD + self._at, self._order + _NUMBERS[name], count)
        self._skip(size * (1 if count is None else count))
        self._layout.numbers[path] = place

    def _length(self) -> int:
        self._at += -self._at % 4
        begin = _HEAD + self._at
        self._skip(4)
        self._layout.same.append((begin, begin + 4))
        return int(np.frombuffer(self._raw, f"{self._order}u4", 1, begin)[0])

    def _skip(self, size: int) -> None:
        self._at += size
        if _HEAD + self._at > len(self._raw):
            raise _OddError


@dataclass(frozen=True)
class _Group:
    """Messages that are laid out alike.

    Attributes:
        index: (n,) which of all they are.
        raw: (n, size) they.
        layout: Of all of them.
        first: The first of them, decoded.
    """

    index: NDArray[np.int64]
    raw: NDArray[np.uint8]
    layout: Layout
    first: Any

    def column(self, path: str, element: int | None = None) -> NDArray[Any] | None:
        """(n,) numbers of a field, or of an element of it; None where there is none such."""
        place = self.layout.numbers.get(path)
        if place is None or (element is None) != (place.count is None):
            return None
        if element is not None and not 0 <= element < (place.count or 0):
            return None
        size = int(place.kind[2])
        begin = place.offset + size * (element or 0)
        part = np.ascontiguousarray(self.raw[:, begin : begin + size])
        return part.view(place.kind)[:, 0]


class Decoded:
    """All messages of one topic."""

    def __init__(
        self, data: Sequence[bytes], store: Typestore, msgtype: str, one: Callable[[int], Any]
    ) -> None:
        """Sorts them by how they are laid out.

        Args:
            data: They, with their encapsulation.
            store: Definitions of types.
            msgtype: Their type.
            one: Decodes the one of a number, or raises what is wrong with it.
        """
        self._count = len(data)
        self._groups: list[_Group] = []
        left = np.arange(len(data))
        sizes = np.fromiter(map(len, data), np.int64, len(data))
        while left.size >= FEW and len(self._groups) < MOST_LAYOUTS:
            raw = data[left[0]]
            layout = layout_of(store, msgtype, raw)
            if layout is None:
                break
            alike = left[sizes[left] == len(raw)]
            rows = np.frombuffer(b"".join(data[k] for k in alike), np.uint8)
            rows = rows.reshape(alike.size, len(raw))
            decides = np.concatenate([np.arange(begin, end) for begin, end in layout.same])
            same = (rows[:, decides] == rows[0, decides]).all(axis=1)
            if not same.all():
                rows, alike = rows[same], alike[same]
            self._groups.append(_Group(alike, rows, layout, one(int(alike[0]))))
            left = np.setdiff1d(left, alike, assume_unique=True)
        self._others = left
        self._messages = [one(int(k)) for k in left]

    def __len__(self) -> int:
        """Returns how many there are."""
        return self._count

    def kinds(self) -> Iterator[Any]:
        """One message at least of each layout, decoded."""
        yield from (group.first for group in self._groups)
        yield from self._messages

    def numbers(self, path: str, of: Callable[[Any], float]) -> Floats:
        """(n,) one number of each message; NaN where it has none.

        Args:
            path: Its field, with the indices of elements.
            of: Gets it of a decoded message.
        """
        base, element = path, None
        if path.endswith("]"):
            base, _, index = path[:-1].rpartition("[")
            element = int(index)
        return self._filled(np.float64, lambda g: g.column(base, element), of)

    def stamps_ns(self, path: str, of: Callable[[Any], Any]) -> NDArray[np.int64]:
        """(n,) stamps, ns.

        Args:
            path: Field of the stamp.
            of: Gets it of a decoded message.
        """

        def part(name: str) -> NDArray[np.int64]:
            return self._filled(
                np.int64, lambda g: g.column(f"{path}.{name}"), lambda m: getattr(of(m), name)
            )

        return part("sec") * 1_000_000_000 + part("nanosec")

    def of_name(self, wanted: str, row: str) -> tuple[Floats, NDArray[np.bool_], list[str]]:
        """What messages say of one of the names that they carry.

        Args:
            wanted: The name.
            row: Field with a number for each name.

        Returns:
            (n,) numbers, NaN where nothing is said; (n,) whether anything is; all names.
        """
        named: dict[str, None] = {}
        values = np.full(self._count, np.nan)
        said = np.zeros(self._count, dtype=bool)

        def place(message: Any) -> int | None:
            names = [str(name) for name in message.name]
            named.update(dict.fromkeys(names))
            if wanted not in names or (at := names.index(wanted)) >= len(getattr(message, row)):
                return None
            return at

        order: list[tuple[int, Any, _Group | None]]
        order = [(int(g.index[0]), g.first, g) for g in self._groups]
        order += [(int(k), m, None) for k, m in zip(self._others, self._messages, strict=True)]
        for k, message, group in sorted(order, key=lambda entry: entry[0]):
            at = place(message)
            if at is None:
                continue
            if group is None:
                values[k], said[k] = getattr(message, row)[at], True
            elif (column := group.column(row, at)) is not None:
                values[group.index], said[group.index] = column, True
        return values, said, list(named)

    def _filled(
        self,
        kind: type,
        column: Callable[[_Group], NDArray[Any] | None],
        of: Callable[[Any], Any],
    ) -> NDArray[Any]:
        out: NDArray[Any] = np.empty(self._count, dtype=kind)
        for group in self._groups:
            found = column(group)
            out[group.index] = of(group.first) if found is None else found
        for k, message in zip(self._others, self._messages, strict=True):
            out[k] = of(message)
        return out
