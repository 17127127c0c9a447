# SPDX-License-Identifier: Apache-2.0
"""Numbers as 16-bit Modbus registers and back, for every type, word order and byte order.

Modbus itself only says that the two bytes of a register travel most significant first. How devices
spread wider numbers over registers, and whether they swap bytes, differs and is part of the map.
"""

import math
import struct
from collections.abc import Sequence
from typing import Literal

NumberType = Literal["int16", "uint16", "int32", "uint32", "uint64", "float32", "float64"]
Order = Literal["big", "little"]

_FORMATS = {
    "int16": ">h",
    "uint16": ">H",
    "int32": ">i",
    "uint32": ">I",
    "uint64": ">Q",
    "float32": ">f",
    "float64": ">d",
}


def width(kind: NumberType) -> int:
    """Returns how many registers a number takes.

    Args:
        kind: Type of the number.
    """
    return struct.calcsize(_FORMATS[kind]) // 2


def to_registers(
    value: float, kind: NumberType, word_order: Order = "big", byte_order: Order = "big"
) -> list[int]:
    """Returns a number as registers.

    Args:
        value: The number; integers types round it to the nearest.
        kind: Type of the number.
        word_order: ``big`` puts the most significant register first.
        byte_order: ``big`` puts the most significant byte of each register first.

    Raises:
        ValueError: The type cannot hold the number.
    """
    if kind.startswith("float"):
        number: float | int = float(value)
    elif math.isfinite(value):
        number = round(value)
    else:
        raise ValueError(f"{value!r} cannot be sent as {kind}")
    try:
        data = struct.pack(_FORMATS[kind], number)
    except (struct.error, OverflowError):
        raise ValueError(f"{value!r} cannot be sent as {kind}") from None
    words = [int.from_bytes(data[i : i + 2], byte_order) for i in range(0, len(data), 2)]
    return words if word_order == "big" else words[::-1]


def from_registers(
    words: Sequence[int], kind: NumberType, word_order: Order = "big", byte_order: Order = "big"
) -> float:
    """Returns the number that registers hold; may be infinite or not a number.

    Args:
        words: As many registers as the type takes, 0 to 65535 each.
        kind: Type of the number.
        word_order: ``big`` where the most significant register comes first.
        byte_order: ``big`` where the most significant byte of each register comes first.

    Raises:
        ValueError: There are too many or too few registers.
    """
    return float(_unpack(words, kind, word_order, byte_order))


def count_from_registers(
    words: Sequence[int], kind: NumberType, word_order: Order = "big", byte_order: Order = "big"
) -> int:
    """Returns the whole number that registers hold, exactly: a float has 53 bits, uint64 has 64.

    Args:
        words: As many registers as the type takes, 0 to 65535 each.
        kind: Type of the number, a whole one.
        word_order: ``big`` where the most significant register comes first.
        byte_order: ``big`` where the most significant byte of each register comes first.

    Raises:
        ValueError: There are too many or too few registers.
    """
    return int(_unpack(words, kind, word_order, byte_order))


def _unpack(
    words: Sequence[int], kind: NumberType, word_order: Order, byte_order: Order
) -> int | float:
    if len(words) != width(kind):
        raise ValueError(f"found {len(words)} registers for {kind}, needed are {width(kind)}")
    ordered = words if word_order == "big" else words[::-1]
    data = b"".join(word.to_bytes(2, byte_order) for word in ordered)
    number: int | float = struct.unpack(_FORMATS[kind], data)[0]
    return number
