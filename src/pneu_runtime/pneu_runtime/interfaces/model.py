# SPDX-License-Identifier: Apache-2.0
"""What an interface definition says, independent of where it was read."""

from dataclasses import dataclass
from typing import Any

# name in a definition -> (bytes on the wire, code of `struct`, code of `array`, name in IDL)
PRIMITIVES: dict[str, tuple[int, str, str, str]] = {
    "bool": (1, "?", "", "boolean"),
    "byte": (1, "B", "", "octet"),
    "int8": (1, "b", "b", "int8"),
    "uint8": (1, "B", "B", "uint8"),
    "int16": (2, "h", "h", "int16"),
    "uint16": (2, "H", "H", "uint16"),
    "int32": (4, "i", "i", "int32"),
    "uint32": (4, "I", "I", "uint32"),
    "int64": (8, "q", "q", "int64"),
    "uint64": (8, "Q", "Q", "uint64"),
    "float32": (4, "f", "f", "float"),
    "float64": (8, "d", "d", "double"),
}

# Keeps a structure without fields from having no size; on the wire, never in the Python class.
EMPTY_FIELD = "structure_needs_at_least_one_member"


@dataclass(frozen=True)
class FieldType:
    """Type of a field.

    Attributes:
        base: A key of `PRIMITIVES`, `string`, or the full name of a message.
        string_bound: Most characters of a string; 0 for any number.
        kind: `one`, `array` (fixed), `bounded` or `sequence`.
        count: Length of an array, or most elements of a bounded sequence; else 0.
    """

    base: str
    string_bound: int = 0
    kind: str = "one"
    count: int = 0

    @property
    def is_message(self) -> bool:
        """Whether it is, or holds, another message."""
        return "/" in self.base

    @property
    def idl_name(self) -> str:
        """The type as rclpy's `get_fields_and_field_types` writes it."""
        if self.is_message:
            package, _, name = self.base.split("/")
            base = f"{package}/{name}"
        elif self.base == "string":
            base = f"string<{self.string_bound}>" if self.string_bound else "string"
        else:
            base = PRIMITIVES[self.base][3]
        if self.kind == "array":
            return f"{base}[{self.count}]"
        if self.kind == "bounded":
            return f"sequence<{base}, {self.count}>"
        return f"sequence<{base}>" if self.kind == "sequence" else base

    @property
    def msg_name(self) -> str:
        """The type as a `.msg` file writes it."""
        if self.is_message:
            package, _, name = self.base.split("/")
            base = f"{package}/{name}"
        else:
            base = self.base + (f"<={self.string_bound}" if self.string_bound else "")
        suffix = {"one": "", "array": f"[{self.count}]", "bounded": f"[<={self.count}]"}
        return base + suffix.get(self.kind, "[]")


@dataclass(frozen=True)
class Field:
    """A field of a message.

    Attributes:
        name: Its name.
        type: Its type.
        default: Value from the definition, None where none is given.
    """

    name: str
    type: FieldType
    default: Any = None


@dataclass(frozen=True)
class Constant:
    """A constant of a message.

    Attributes:
        name: Its name.
        type: A key of `PRIMITIVES`, or `string`.
        value: Its value.
    """

    name: str
    type: str
    value: Any


@dataclass(frozen=True)
class Structure:
    """A message, or one part of a service or an action.

    Attributes:
        name: Full name, such as `std_msgs/msg/String` or `std_srvs/srv/Trigger_Request`.
        fields: In the order of the wire.
        constants: In the order of the definition.
        text: The definition as written; empty where only its content is known.
    """

    name: str
    fields: tuple[Field, ...]
    constants: tuple[Constant, ...] = ()
    text: str = ""

    @property
    def wire_fields(self) -> tuple[Field, ...]:
        """The fields, or the one byte that an empty message is on the wire."""
        return self.fields or (Field(EMPTY_FIELD, FieldType("uint8")),)

    def to_text(self) -> str:
        """Returns the definition as a `.msg` file: the original where it is known."""
        if self.text:
            return self.text
        lines = [f"{c.type} {c.name}={_literal(c.value)}" for c in self.constants]
        for field in self.fields:
            default = "" if field.default is None else f" {_literal(field.default)}"
            lines.append(f"{field.type.msg_name} {field.name}{default}")
        return "\n".join([*lines, ""])


def _literal(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(_literal, value)) + "]"
    return repr(value)
