# SPDX-License-Identifier: Apache-2.0
"""A batch of rigs laid out for a GPU: the rig outermost, all that one has in one piece.

On the processor the rig is the innermost index, so that vector registers hold rigs; on a GPU a
block of threads has one rig, whose slots lie side by side. All that is not of slots (ends, ports,
chambers, bodies) is little, and what single threads wait for: it is `near`, in the memory that a
block shares. What is known of a rig before it runs (shapes, schemes, the gas) is written into the
kernel as numbers.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_sim import kernel

Array = NDArray[Any]

MEMORIES = ("near", "floats", "ints", "numbers", "tables")
"""Flat memories by their names in a kernel."""
INTEGERS = ("ints", "tables")
SHARED_BY_ALL = ("numbers", "tables")
"""Those that all rigs have in common."""
COMMON: dict[type, tuple[str, ...]] = {
    kernel.Steps: ("table",),
    kernel.Ends: ("table",),
    kernel.Regulators: ("table",),
    kernel.Ports: ("table",),
    kernel.Reservoirs: ("ripple_of",),
    kernel.Sides: ("table",),
    kernel.Chambers: ("small",),
    kernel.Cylinders: ("table", "moves"),
    kernel.Bodies: ("table", "driven_by"),
    kernel.Term: ("table",),
    kernel.Taps: ("spread_slot", "spread_chamber"),
    kernel.Encoders: ("of",),
}
"""Arrays that all rigs of a batch share, by the group they are in."""
SCRATCH: dict[type, tuple[str, ...]] = {
    kernel.Bodies: (
        "q", "v", "force", "mass", "x", "lever", "along", "answer", "most", "impulse", "soft",
        "damping", "bent", "loose", "row", "there_q", "there_x", "there_lever",
    )
}  # fmt: skip
"""Arrays of which every rig needs its own here, whatever is in them."""
HOT: dict[type, tuple[str, ...]] = {kernel.Cells: ("state", "work")}
"""Arrays of slots that every pass is at: near as well, where there is room for them."""
LONG: dict[type, tuple[str, ...]] = {
    kernel.Taps: ("time", "measured", "gain", "readings"),
    kernel.Encoders: ("time", "measured", "gain", "push", "readings"),
    kernel.Record: kernel.Record._fields,
}
"""Arrays whose length is that of a recording, for which no kernel is compiled anew."""
WRITTEN: dict[type, tuple[str, ...]] = {
    kernel.Cells: ("state", "work", "wall", "soft"),
    kernel.Sides: ("kept",),
    kernel.Term: ("flow",),
    kernel.Ends: ("velocity", "flow", "give", "joint", "ported"),
    kernel.Regulators: ("state",),
    kernel.Ports: ("flow", "opening"),
    kernel.Reservoirs: ("pressure", "supplied", "drawn"),
    kernel.Chambers: ("par", "state", "work"),
    kernel.Cylinders: ("state", "work"),
    kernel.Bodies: ("state", "heat"),
    kernel.Taps: ("next", "shown", "felt", "error", "readings"),
    kernel.Encoders: ("next", "shown", "felt", "shift", "readings"),
    kernel.Record: kernel.Record._fields,
}
"""Arrays that steps change."""


def view_name(shape: tuple[int, ...]) -> str:
    """Name by which a kernel's source calls a view of some shape.

    Args:
        shape: The shape.
    """
    return "view_" + "_".join(str(n) for n in shape)


@dataclass
class _Part:
    """Where an array went.

    Attributes:
        array: As the processor has it.
        laid: The rig outermost, or as it is where all rigs share it.
        where: Name of the memory it is in.
        offset: Where it begins there, of one rig.
        written: Whether steps change it.
        flat: Whether slots and lanes are one index.
    """

    array: Array
    laid: Array
    where: str
    offset: int
    written: bool
    flat: bool


class Batch:
    """Groups of arrays in flat memory, how a kernel finds them, and the way back.

    Attributes:
        lanes: Rigs.
        size: Entries of one rig in each memory; of all rigs in those that they share.
        shapes: Shapes of arrays in it.
    """

    def __init__(self, lanes: int, hot: bool) -> None:
        """Has no arrays yet.

        Args:
            lanes: Rigs.
            hot: Whether what of slots every pass is at is near.
        """
        self.lanes, self._hot = lanes, hot
        self.size = dict.fromkeys(MEMORIES, 0)
        self.shapes: set[tuple[int, ...]] = set()
        self._parts: list[_Part] = []
        self._known: dict[tuple[int, tuple[int, ...]], str] = {}
        self._long: list[tuple[Array, Array, bool]] = []

    def group(self, group: Any) -> str:
        """An expression by which a kernel has a group of rig ``b``.

        Args:
            group: As the processor takes it; or a tuple of them, a number, None.
        """
        if not isinstance(group, tuple):
            return repr(group.item() if isinstance(group, np.generic) else group)
        if not hasattr(group, "_fields"):
            return f"({''.join(self.group(part) + ', ' for part in group)})"
        kind = type(group)
        told = []
        for name, value in zip(group._fields, group, strict=True):
            if isinstance(value, np.ndarray):
                told.append(self.array(kind, name, value))
            elif kind is kernel.Cells and name == "lanes":
                told.append("1")
            else:
                told.append(self.group(value))
        return f"{kind.__name__}({', '.join(told)})"

    def array(self, kind: type, name: str, array: Array) -> str:
        """An expression by which a kernel has an array; the same one for the same memory.

        Args:
            kind: The group that it is in.
            name: Its name there.
            array: As the processor takes it.
        """
        common, scratch = (name in of.get(kind, ()) for of in (COMMON, SCRATCH))
        flat = kind is kernel.Cells
        key = (array.ctypes.data, array.shape)
        if array.size > 0 and not scratch and key in self._known:
            return self._known[key]
        written = name in WRITTEN.get(kind, ())
        if common:
            laid = array
        elif scratch:
            laid = np.zeros((self.lanes, *array.shape))
        elif flat:
            laid = np.moveaxis(array.reshape(len(array), -1, self.lanes), -1, 0)
        else:
            laid = np.moveaxis(array, -1, 0)[..., None]
        if name in LONG.get(kind, ()):
            told = f"long[{len(self._long)}][b]"
            self._long.append((array, laid, written))
        else:
            near = not flat or (self._hot and name in HOT[kernel.Cells])
            told = self._place(array, laid, common, written, flat, near)
        self._known[key] = told
        return told

    def _place(
        self, array: Array, laid: Array, common: bool, written: bool, flat: bool, near: bool
    ) -> str:
        """Gives an array its place in flat memory."""
        real = laid.dtype == np.float64
        if common:
            where = "numbers" if real else "tables"
        elif real:
            where = "near" if near else "floats"
        else:
            where = "ints"
        shape = laid.shape if common else laid.shape[1:]
        offset = self.size[where]
        self._parts.append(_Part(array, laid, where, offset, written, flat))
        self.size[where] += int(np.prod(shape))
        self.shapes.add(shape)
        return f"{view_name(shape)}({where}, {where}_begin + {offset})"

    def memory(self, real: type) -> dict[str, Array]:
        """The flat memory itself, filled.

        Args:
            real: Floating-point numbers in it.
        """
        types: dict[str, Any] = dict.fromkeys(MEMORIES, real) | dict.fromkeys(INTEGERS, np.int64)
        filled: dict[str, Array] = {}
        for where, size in self.size.items():
            own = [part for part in self._parts if part.where == where]
            if where in SHARED_BY_ALL:
                pieces = [part.laid.reshape(-1) for part in own]
                whole = np.concatenate(pieces) if pieces else np.zeros(0)
            else:
                whole = np.empty((self.lanes, size), types[where])
                for part in own:
                    n = part.laid[0].size
                    whole[:, part.offset : part.offset + n] = part.laid.reshape(self.lanes, -1)
                whole = whole.reshape(-1)
            filled[where] = whole.astype(types[where])
        return filled

    def long(self, real: type) -> list[Array]:
        """Arrays as long as a recording.

        Args:
            real: Floating-point numbers in them.
        """
        return [np.ascontiguousarray(laid, dtype=real) for _, laid, _ in self._long]

    def take_back(self, memory: Mapping[str, Array], long: Sequence[Array]) -> None:
        """Takes over what steps have changed.

        Args:
            memory: As it is now; without what rigs share.
            long: Arrays as long as a recording.
        """
        now = {where: flat.reshape(self.lanes, -1) for where, flat in memory.items()}
        for part in self._parts:
            if part.written and part.array.size > 0:
                n = part.laid[0].size
                mine = now[part.where][:, part.offset : part.offset + n]
                laid = np.moveaxis(mine.reshape(part.laid.shape), 0, -1)
                part.array[...] = (laid if part.flat else laid[..., 0, :]).reshape(part.array.shape)
        for (array, _, written), mine in zip(self._long, long, strict=True):
            if written and array.size > 0:
                array[...] = np.moveaxis(mine[..., 0], 0, -1)
