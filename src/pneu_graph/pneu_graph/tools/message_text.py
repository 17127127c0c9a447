# SPDX-License-Identifier: Apache-2.0
"""Messages as YAML text and back, as `ros2 topic echo` and `ros2 topic pub` have them.

Only what every generated message class has is used, so that it works with real rclpy too.
"""

import json
import math
import re
from typing import Any

import numpy as np

from pneu_common.documents import parse_yaml
from pneu_common.errors import InputError
from pneu_graph.nodes.type_support import interface_class

TRUNCATE_LENGTH = 128
"""Elements of an array, or characters of a string, that are shown by default."""

_PLAIN = re.compile(r"[A-Za-z_/.][\w /.\-+(),]*")
_RESERVED = {"true", "false", "yes", "no", "on", "off", "null", "y", "n", ".nan", ".inf"}
_UNPRINTABLE = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\ufeff\ufffe\uffff]")
"""Characters that YAML does not print, or that YAML 1.1 takes for line breaks."""
_SEQUENCE = re.compile(r"(?:sequence<(?P<s>[^,>]+(?:<\d+>)?)(?:, *\d+)?>|(?P<a>.+)\[\d*\])")


def plain(
    value: Any,
    truncate_length: int | None = None,
    no_arr: bool = False,
    no_str: bool = False,
) -> Any:
    """Returns a message, or a field of one, as mappings, lists and scalars.

    Args:
        value: The message or field.
        truncate_length: Longest array and string; None: without limit.
        no_arr: Name arrays instead of showing them.
        no_str: Name strings instead of showing them.
    """
    fields = getattr(value, "get_fields_and_field_types", None)
    if fields is not None:
        shown = {}
        for name, kind in fields().items():
            found = getattr(value, name)
            if no_arr and _SEQUENCE.fullmatch(kind):
                shown[name] = f"<array type: {kind}, length: {len(found)}>"
            elif no_str and isinstance(found, str):
                shown[name] = f"<string length: {len(found)}>"
            else:
                shown[name] = plain(found, truncate_length, no_arr, no_str)
        return shown
    if isinstance(value, str):
        cut = truncate_length is not None and len(value) > truncate_length
        return value[:truncate_length] + "..." if cut else value
    if isinstance(value, bytes):
        return value[0] if len(value) == 1 else list(value)
    if isinstance(value, np.generic):
        return value.item()
    if hasattr(value, "__len__"):
        items = list(value[:truncate_length])
        shown_items = [plain(item, truncate_length, no_arr, no_str) for item in items]
        if len(value) > len(items):
            shown_items.append("...")
        return shown_items
    return value


def yaml_text(value: Any, flow: bool = False) -> str:
    """Returns YAML of mappings, lists and scalars, ending in a line break.

    Args:
        value: As from `plain`.
        flow: On one line, with braces.
    """
    if flow:
        return _flow(value) + "\n"
    if isinstance(value, dict | list) and value:
        return "\n".join(_block(value)) + "\n"
    return _flow(value) + "\n"


def _block(value: Any) -> list[str]:
    lines = []
    if isinstance(value, dict):
        for key, item in value.items():
            if isinstance(item, dict) and item:
                lines += [f"{_scalar(key)}:", *("  " + line for line in _block(item))]
            elif isinstance(item, list) and item:
                lines += [f"{_scalar(key)}:", *_block(item)]
            else:
                lines.append(f"{_scalar(key)}: {_flow(item)}")
        return lines
    for item in value:
        inner = _block(item) if isinstance(item, dict | list) and item else [_flow(item)]
        lines += [("- " if i == 0 else "  ") + line for i, line in enumerate(inner)]
    return lines


def _flow(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_scalar(k)}: {_flow(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(_flow(item) for item in value) + "]"
    return _scalar(value)


def _scalar(value: Any) -> str:
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        if math.isnan(value):
            return ".nan"
        if math.isinf(value):
            return ".inf" if value > 0 else "-.inf"
        text = repr(value)
        # YAML 1.1 takes an exponent for a number only after a point
        return text.replace("e", ".0e") if "e" in text and "." not in text else text
    if isinstance(value, str):
        if value == "...":
            return "'...'"
        if _UNPRINTABLE.search(value):
            quoted = json.dumps(value, ensure_ascii=False)
            return _UNPRINTABLE.sub(lambda found: f"\\u{ord(found[0]):04x}", quoted)
        plainly = _PLAIN.fullmatch(value) and value.lower() not in _RESERVED
        if plainly and value == value.strip() and "," not in value:
            return value
        return "'" + value.replace("'", "''") + "'"
    return str(value)


def parse_values(text: str) -> dict[str, Any]:
    """Reads the values of a message from the command line.

    Args:
        text: YAML mapping; empty: none.

    Raises:
        InputError: It is no YAML mapping.
    """
    values = parse_yaml(text, f"values {text!r}", "mapping of values")
    if values is None or values == "":
        return {}
    if not isinstance(values, dict):
        raise InputError(
            f'values {text!r}: are a mapping such as "{{data: 1.0}}", found {type(values).__name__}'
        )
    return values


def fill(message: Any, values: dict[str, Any], where: str = "", now: Any = None) -> None:
    """Sets fields of a message.

    Args:
        message: Message to change.
        values: Values by field.
        where: Field of an outer message, for the error message.
        now: `builtin_interfaces/Time` for ``stamp: now`` and ``header: auto``.

    Raises:
        InputError: There is no such field, or it cannot hold the value.
    """
    fields = message.get_fields_and_field_types()
    if hasattr(message, "_check_fields"):  # messages of the genuine rclpy check when told to
        message._check_fields = True
    for name, value in values.items():
        path = f"{where}.{name}" if where else str(name)
        if name not in fields:
            raise InputError(
                f"{path}: no such field; {type(message).__name__} has"
                f" {', '.join(fields) or 'no fields'}"
            )
        try:
            setattr(
                message, name, _converted(getattr(message, name), fields[name], value, path, now)
            )
        except (AssertionError, TypeError, ValueError, OverflowError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"{path}: is {fields[name]}, found {value!r}") from None


def _converted(present: Any, kind: str, value: Any, path: str, now: Any) -> Any:
    if hasattr(present, "get_fields_and_field_types"):
        if value == "now" and kind == "builtin_interfaces/Time" and now is not None:
            return now
        if value == "auto" and kind == "std_msgs/Header" and now is not None:
            present.stamp = now
            return present
        if not isinstance(value, dict):
            raise InputError(f"{path}: is {kind}, a mapping; found {value!r}")
        fill(present, value, path, now)
        return present
    sequence = _SEQUENCE.fullmatch(kind)
    if sequence:
        element = sequence["s"] or sequence["a"]
        if not isinstance(value, list):
            raise InputError(f"{path}: is {kind}, a list; found {value!r}")
        if "/" in element:
            items = []
            for i, item in enumerate(value):
                made = interface_class(element)()
                items.append(_converted(made, element, item, f"{path}[{i}]", now))
            return items
        return [_primitive(element, item) for item in value]
    return _primitive(kind, value)


def _primitive(kind: str, value: Any) -> Any:
    if kind in ("double", "float") and isinstance(value, int | str) and not isinstance(value, bool):
        return float(value)
    if kind in ("octet", "byte") and isinstance(value, int):
        return bytes([value])
    return value
