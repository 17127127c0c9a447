# SPDX-License-Identifier: Apache-2.0
"""Reads the `.msg`, `.srv` and `.action` language."""

import re
from typing import Any

from pneu_runtime.interfaces.errors import DefinitionError
from pneu_runtime.interfaces.model import PRIMITIVES, Constant, Field, FieldType, Structure

_TYPE = re.compile(
    r"(?P<base>[A-Za-z][\w/]*)(?:<=(?P<string>\d+))?(?P<array>\[(?P<upto><=)?(?P<count>\d*)\])?"
)
_LINE = re.compile(r"(?P<type>\S+)\s+(?P<name>[A-Za-z]\w*)\s*(?P<rest>.*)", re.DOTALL)


def parse_structure(name: str, text: str) -> Structure:
    """Reads one message, or one part of a service or an action.

    Args:
        name: Full name of what is defined, such as `std_msgs/msg/String`.
        text: The definition.

    Returns:
        Structure: its content.

    Raises:
        DefinitionError: A line cannot be understood.
    """
    package = name.split("/")[0]
    fields: list[Field] = []
    constants: list[Constant] = []
    for raw in text.splitlines():
        line = _without_comment(raw).strip()
        if not line:
            continue
        match = _LINE.fullmatch(line)
        if match is None:
            raise DefinitionError(f"{name}: cannot read the line '{line}'.")
        field_type = _parse_type(name, package, match["type"])
        rest = match["rest"]
        if rest.startswith("="):
            if field_type.is_message or field_type.kind != "one":
                raise DefinitionError(f"{name}: constant '{match['name']}' must be a primitive.")
            value = _parse_value(name, field_type, rest[1:].strip())
            constants.append(Constant(match["name"], field_type.base, value))
        else:
            default = _parse_value(name, field_type, rest) if rest else None
            fields.append(Field(match["name"], field_type, default))
    seen = [field.name for field in fields] + [constant.name for constant in constants]
    for one in seen:
        if seen.count(one) > 1:
            raise DefinitionError(f"{name}: '{one}' is defined twice.")
    return Structure(name, tuple(fields), tuple(constants), text)


def split_parts(name: str, text: str, count: int) -> list[str]:
    """Splits a service or an action definition at its `---` lines.

    Args:
        name: Full name of what is defined.
        text: The definition.
        count: Number of parts: 2 of a service, 3 of an action.

    Returns:
        list[str]: the parts.

    Raises:
        DefinitionError: There are not so many.
    """
    parts = re.split(r"(?m)^---[ \t]*\r?$\n?", text)
    if len(parts) != count:
        raise DefinitionError(
            f"{name}: found {len(parts)} parts, separated by '---', where {count} are needed."
        )
    return parts


def _without_comment(line: str) -> str:
    quote = ""
    for index, character in enumerate(line):
        if quote:
            if character == quote and line[index - 1] != "\\":
                quote = ""
        elif character in "\"'":
            quote = character
        elif character == "#":
            return line[:index]
    return line.split("#", 1)[0] if quote else line


def _parse_type(name: str, package: str, text: str) -> FieldType:
    match = _TYPE.fullmatch(text)
    if match is None:
        raise DefinitionError(f"{name}: '{text}' is no field type.")
    base = match["base"]
    if base == "char":
        base = "uint8"  # what rosidl makes of it, which the type hash depends on
    if base in ("wstring", "float128"):
        raise DefinitionError(f"{name}: fields of type {base} are not supported.")
    if base not in PRIMITIVES and base != "string":
        parts = base.split("/")
        if len(parts) == 1:
            base = f"{package}/msg/{base}"
        elif len(parts) == 2:
            base = f"{parts[0]}/msg/{parts[1]}"
    if match["string"] and base != "string":
        raise DefinitionError(f"{name}: '{text}': only a string is bounded by '<='.")
    kind, count = "one", int(match["count"] or 0)
    if match["array"]:
        kind = "bounded" if match["upto"] else ("array" if match["count"] else "sequence")
        if kind != "sequence" and count == 0:
            raise DefinitionError(f"{name}: '{text}' has no elements.")
    return FieldType(base, int(match["string"] or 0), kind, count)


def _parse_value(name: str, field_type: FieldType, text: str) -> Any:
    if field_type.is_message:
        raise DefinitionError(f"{name}: a message field cannot have the default '{text}'.")
    if field_type.kind != "one":
        if not (text.startswith("[") and text.endswith("]")):
            raise DefinitionError(f"{name}: '{text}' is no list.")
        items = [item for item in _split_list(text[1:-1]) if item]
        return tuple(_parse_scalar(name, field_type.base, item) for item in items)
    return _parse_scalar(name, field_type.base, text)


def _split_list(text: str) -> list[str]:
    items, quote = [""], ""
    for character in text:
        if not quote and character == ",":
            items.append("")
            continue
        if character in "\"'" and quote in ("", character):
            quote = "" if quote else character
        items[-1] += character
    return [item.strip() for item in items]


def _parse_scalar(name: str, base: str, text: str) -> Any:
    try:
        if base == "string":
            if len(text) >= 2 and text[0] == text[-1] and text[0] in "\"'":
                return text[1:-1].replace(f"\\{text[0]}", text[0])
            return text
        if base == "bool":
            return {"true": True, "1": True, "false": False, "0": False}[text.lower()]
        return float(text) if base.startswith("float") else int(text, 0)
    except (ValueError, KeyError):
        raise DefinitionError(f"{name}: '{text}' is no value of type {base}.") from None
