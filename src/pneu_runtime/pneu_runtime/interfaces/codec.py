# SPDX-License-Identifier: Apache-2.0
"""Writes the functions that turn messages into CDR bytes and back.

The bytes are plain CDR (version 1) with the four-byte encapsulation header, as both rmw_cyclonedds
and rmw_fastrtps send them: OMG DDSI-RTPS 2.5, 10.2, and the CORBA 3.3 common data representation.
One function per type is generated as Python source: neighbouring fields whose alignment is known
become one call of `struct`. Every length is compared with the bytes that are left before anything
is allocated, so that hostile input costs no more than its own size.
"""

import array
import struct
import sys
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from pneu_runtime.interfaces.errors import DecodeError, EncodeError
from pneu_runtime.interfaces.model import PRIMITIVES, Field, FieldType
from pneu_runtime.interfaces.registry import Registry

Encoder = Callable[[Any], bytes]
Decoder = Callable[[bytes], Any]

HEADER_LITTLE_ENDIAN = b"\x00\x01\x00\x00"
_SWAP = {"<": sys.byteorder != "little", ">": sys.byteorder != "big"}
_PADS = tuple(bytes(n) for n in range(8))


def build_encoder(registry: Registry, name: str) -> Encoder:
    """Makes the function that writes messages of one type.

    Args:
        registry: Where definitions are found.
        name: Full name of the type.

    Returns:
        Encoder: from a message to little-endian CDR bytes with header.
    """
    return _Writer(registry).build(name)


def build_decoder(
    registry: Registry, name: str, lookup: Callable[[str], type], order: str = "<"
) -> Decoder:
    """Makes the function that reads messages of one type.

    Args:
        registry: Where definitions are found.
        name: Full name of the type.
        lookup: Returns the class of a message by its full name.
        order: `<` for little-endian bytes, `>` for big-endian.

    Returns:
        Decoder: from CDR bytes with header to a message. The header is not looked at.
    """
    return _Reader(registry, lookup, order).build(name)


class _Source:
    """Source under construction, the names it uses, and what is known of the alignment.

    `modulus` and `residue` say: position = residue (mod modulus), counted from after the header.
    """

    def __init__(self, registry: Registry) -> None:
        self.registry = registry
        self.lines: list[str] = []
        self.names: dict[str, Any] = {
            "array": array.array,
            "PADS": _PADS,
            "EncodeError": EncodeError,
            "DecodeError": DecodeError,
            "struct_error": struct.error,
            "new": object.__new__,
            "HEADER": HEADER_LITTLE_ENDIAN,
        }
        self.indent = "    "
        self.modulus, self.residue = 8, 0
        self.run_format = ""
        self.run_values: list[str] = []
        self._counter = 0

    def line(self, text: str) -> None:
        self.lines.append(self.indent + text)

    def fresh(self, prefix: str) -> str:
        self._counter += 1
        return f"{prefix}{self._counter}"

    def use(self, prefix: str, value: Any) -> str:
        """Gives a value a name in the generated function."""
        for name, known in self.names.items():
            if known is value:
                return name
        name = self.fresh(prefix)
        self.names[name] = value
        return name

    def struct_method(self, text: str, method: str) -> str:
        key = f"{method}_" + "".join(
            c if c.isalnum() else {"<": "l", ">": "b"}.get(c, "o") for c in text
        )
        self.names.setdefault(key, getattr(struct.Struct(text), method))
        return key

    def enter(self) -> tuple[str, int, int]:
        saved = (self.indent, self.modulus, self.residue)
        self.indent += "    "
        return saved

    def add_to_run(self, code: str, size: int, value: str) -> bool:
        """Appends a primitive to the current run if its alignment is known."""
        if size > self.modulus:
            return False
        self.run_format += "x" * (-self.residue % size) + code
        self.run_values.append(value)
        self.residue = (self.residue + (-self.residue % size) + size) % self.modulus
        return True

    def compiled(self, head: str, function: str, filename: str) -> Any:
        exec(compile("\n".join([head, *self.lines]) + "\n", filename, "exec"), self.names)
        return self.names[function]

    def minimum_size(self, kind: FieldType, seen: tuple[str, ...] = ()) -> int:
        """Fewest bytes an element of a type takes, padding left aside."""
        if kind.base == "string":
            return 4
        if not kind.is_message:
            return PRIMITIVES[kind.base][0]
        if kind.base in seen:
            return 1
        total = 0
        for field in self.registry.structure(kind.base).wire_fields:
            one = self.minimum_size(field.type, (*seen, kind.base))
            total += {"one": one, "array": one * field.type.count}.get(field.type.kind, 4)
        return total


def _item(kind: FieldType) -> FieldType:
    return FieldType(kind.base, kind.string_bound)


class _Writer(_Source):
    def build(self, name: str) -> Encoder:
        self.line("buf = bytearray()")
        self.message(name, "msg")
        self.flush()
        self.line("return HEADER + buf")
        encode = self.compiled("def encode(msg):", "encode", f"<cdr encoder of {name}>")
        return encode

    def flush(self) -> None:
        if self.run_values:
            pack = self.struct_method("<" + self.run_format, "pack")
            self.line(f"buf += {pack}({', '.join(self.run_values)})")
        elif self.run_format:
            self.line(f"buf += PADS[{len(self.run_format)}]")
        self.run_format, self.run_values = "", []

    def primitive(self, code: str, size: int, value: str) -> None:
        if not self.add_to_run(code, size, value):
            self.flush()
            self.line(f"buf += PADS[-len(buf) & {size - 1}]")
            self.modulus, self.residue = size, 0
            self.add_to_run(code, size, value)

    def message(self, name: str, value: str) -> None:
        structure = self.registry.structure(name)
        if not structure.fields:
            self.primitive("B", 1, "0")
        for field in structure.fields:
            self.field(field, f"{value}._{field.name}")

    def field(self, field: Field, value: str) -> None:
        kind = field.type
        if kind.kind == "one":
            self.single(kind, value, field.name)
            return
        if not value.isidentifier():
            local = self.fresh("v")
            self.line(f"{local} = {value}")
            value = local
        if kind.kind == "array":
            self.line(f"if len({value}) != {kind.count}:")
            self.line(f"    raise EncodeError({field.name!r} + ' must hold {kind.count} elements')")
        else:
            if kind.kind == "bounded":
                self.line(f"if len({value}) > {kind.count}:")
                self.line(
                    f"    raise EncodeError({field.name!r} + ' holds more than {kind.count}')"
                )
            self.primitive("I", 4, f"len({value})")
        if not kind.is_message and kind.base != "string":
            self.block(kind, value)
        else:
            self.loop(kind, value, field.name)

    def single(self, kind: FieldType, value: str, name: str) -> None:
        if kind.is_message:
            local = self.fresh("m")
            self.line(f"{local} = {value}")
            self.message(kind.base, local)
        elif kind.base == "string":
            local = self.fresh("s")
            self.line(f"{local} = {value}.encode() + b'\\0'")
            if kind.string_bound:
                self.line(f"if len({local}) > {kind.string_bound + 1}:")
                self.line(
                    f"    raise EncodeError({name!r} + ' is longer than {kind.string_bound} bytes')"
                )
            self.primitive("I", 4, f"len({local})")
            self.flush()
            self.line(f"buf += {local}")
            self.modulus, self.residue = 1, 0
        elif kind.base == "byte":
            self.primitive("c", 1, value)
        else:
            size, code, _, _ = PRIMITIVES[kind.base]
            self.primitive(code, size, value)

    def block(self, kind: FieldType, value: str) -> None:
        """Numbers in a row: the memory of the array is what goes on the wire."""
        size, code, array_code, _ = PRIMITIVES[kind.base]
        self.flush()
        start = min(self.modulus, 4)
        saved = None
        if kind.kind != "array":
            self.line(f"if {value}:")
            saved = self.enter()
        if size > self.modulus:
            self.line(f"buf += PADS[-len(buf) & {size - 1}]")
        elif self.residue % size:
            self.line(f"buf += PADS[{-self.residue % size}]")
        if kind.base == "byte":
            self.line(f"buf += b''.join({value})")
        elif kind.base == "bool":
            self.line(f"buf += bytes({value})")
        elif kind.kind == "array":
            dtype = self.use("dtype", np.dtype("<" + code))
            self.line(f"buf += {value}.astype({dtype}, copy=False).tobytes()")
        else:
            if _SWAP["<"]:
                self.line(f"{value} = array({array_code!r}, {value})")
                self.line(f"{value}.byteswap()")
            self.line(f"buf += {value}.tobytes()")
        if saved:
            self.indent = saved[0]
            self.modulus, self.residue = min(size, start), 0
        else:
            self.modulus, self.residue = size, 0

    def loop(self, kind: FieldType, value: str, name: str) -> None:
        self.flush()
        local = self.fresh("i")
        self.line(f"for {local} in {value}:")
        saved = self.enter()
        self.modulus, self.residue = 1, 0
        self.single(_item(kind), local, name)
        self.flush()
        self.indent = saved[0]
        self.modulus, self.residue = 1, 0


class _Reader(_Source):
    def __init__(self, registry: Registry, lookup: Callable[[str], type], order: str) -> None:
        super().__init__(registry)
        self.lookup = lookup
        self.order = order

    def build(self, name: str) -> Decoder:
        # `pos` counts from the start of the data, so aligned positions are 4 more than a multiple.
        self.line("end = len(data)")
        self.line("pos = 4")
        self.line("try:")
        self.indent += "    "
        result = self.message(name)
        self.flush()
        self.indent = "    "
        self.line("except (struct_error, UnicodeDecodeError, IndexError) as error:")
        self.line(f"    raise DecodeError(f'{name}: the bytes are cut short or wrong near byte '")
        self.line("                      f'{pos} of {end}: {error}') from error")
        self.line("if end - pos > 3:")
        self.line(f"    raise DecodeError(f'{name}: {{end - pos}} bytes are left over of {{end}}')")
        self.line(f"return {result}")
        decode = self.compiled("def decode(data):", "decode", f"<cdr decoder of {name}>")
        return decode

    def flush(self) -> None:
        if not self.run_format:
            return
        text = self.order + self.run_format
        if self.run_values:
            unpack = self.struct_method(text, "unpack_from")
            self.line(f"{', '.join(self.run_values)}, = {unpack}(data, pos)")
        self.line(f"pos += {struct.calcsize(text)}")
        self.run_format, self.run_values = "", []

    def align(self, size: int) -> None:
        if size > 1:
            self.line(f"pos += (4 - pos) & {size - 1}")

    def primitive(self, code: str, size: int, target: str) -> None:
        if not self.add_to_run(code, size, target):
            self.flush()
            self.align(size)
            self.modulus, self.residue = size, 0
            self.add_to_run(code, size, target)

    def message(self, name: str) -> str:
        """Reads a message into a new variable, whose name is returned."""
        local = self.fresh("m")
        structure = self.registry.structure(name)
        cls = self.lookup(name)
        self.line(f"{local} = new({self.use('C', cls)})")
        if not structure.fields:
            self.primitive("B", 1, self.fresh("unused"))
        for field in structure.fields:
            self.field(field, f"{local}._{field.name}")
        return local

    def field(self, field: Field, target: str) -> None:
        kind = field.type
        if kind.kind == "one":
            self.single(kind, target)
            return
        count = str(kind.count)
        if kind.kind != "array":
            count = self.fresh("n")
            self.primitive("I", 4, count)
            self.flush()
            if kind.kind == "bounded":
                self.line(f"if {count} > {kind.count}:")
                self.line(
                    f"    raise DecodeError(f'{field.name}: {{{count}}} elements where {kind.count}"
                    " are allowed')"
                )
        if not kind.is_message and kind.base != "string":
            self.block(kind, target, count)
        else:
            self.loop(kind, target, count, field.name)

    def single(self, kind: FieldType, target: str) -> None:
        if kind.is_message:
            self.line(f"{target} = {self.message(kind.base)}")
        elif kind.base == "string":
            size = self.fresh("n")
            self.primitive("I", 4, size)
            self.flush()
            self.line(f"if {size}:")
            self.line(f"    pos += {size}")
            self.line("    if pos > end or data[pos - 1]:")
            self.line(
                f"        raise DecodeError(f'a string of {{{size}}} bytes before byte {{pos}}'"
            )
            self.line("                          f' does not end within the {end} bytes')")
            self.line(f"    {target} = str(data[pos - {size}:pos - 1], 'utf-8')")
            self.line("else:")  # some implementations write an empty string without its NUL
            self.line(f"    {target} = ''")
            self.modulus, self.residue = 1, 0
        elif kind.base == "byte":
            self.primitive("c", 1, target)
        else:
            size_bytes, code, _, _ = PRIMITIVES[kind.base]
            self.primitive(code, size_bytes, target)

    def check_left(self, count: str, size: int) -> None:
        self.line(f"if {count} * {size} > end - pos:")
        self.line(
            f"    raise DecodeError(f'{{{count}}} elements near byte {{pos}} do not fit in the'"
        )
        self.line("                      f' {end} bytes')")

    def block(self, kind: FieldType, target: str, count: str) -> None:
        size, code, array_code, _ = PRIMITIVES[kind.base]
        self.flush()
        start = min(self.modulus, 4)
        saved = None
        if kind.kind != "array":
            empty = f"array({array_code!r})" if array_code else "[]"
            self.line(f"if not {count}:")
            self.line(f"    {target} = {empty}")
            self.line("else:")
            saved = self.enter()
        if size > self.modulus:
            self.align(size)
        elif self.residue % size:
            self.line(f"pos += {-self.residue % size}")
        self.check_left(count, size)
        stop = self.fresh("e")
        self.line(f"{stop} = pos + {count} * {size}")
        if kind.base == "byte":
            self.line(f"{target} = [data[k:k + 1] for k in range(pos, {stop})]")
        elif kind.base == "bool":
            self.line(f"{target} = [b != 0 for b in data[pos:{stop}]]")
        elif kind.kind == "array":
            frombuffer = self.use("frombuffer", np.frombuffer)
            wire = self.use("dtype", np.dtype(self.order + code))
            native = self.use("dtype", np.dtype(code))
            self.line(f"{target} = {frombuffer}(data, {wire}, {count}, pos).astype({native})")
        else:
            local = self.fresh("a")
            self.line(f"{local} = array({array_code!r}, data[pos:{stop}])")
            if _SWAP[self.order]:
                self.line(f"{local}.byteswap()")
            self.line(f"{target} = {local}")
        self.line(f"pos = {stop}")
        if saved:
            self.indent = saved[0]
            self.modulus, self.residue = min(size, start), 0
        else:
            self.modulus, self.residue = size, 0

    def loop(self, kind: FieldType, target: str, count: str, name: str) -> None:
        self.flush()
        self.check_left(count, self.minimum_size(_item(kind)))
        items, item = self.fresh("l"), self.fresh("x")
        self.line(f"{items} = []")
        self.line(f"for _ in range({count}):")
        saved = self.enter()
        self.modulus, self.residue = 1, 0
        self.single(_item(kind), item)
        self.flush()
        self.line(f"{items}.append({item})")
        self.indent = saved[0]
        self.line(f"{target} = {items}")
        self.modulus, self.residue = 1, 0


def byte_orders() -> Iterator[str]:
    """Yields the marks of the byte orders a decoder can be built for."""
    yield from _SWAP
