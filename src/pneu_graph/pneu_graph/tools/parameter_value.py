# SPDX-License-Identifier: Apache-2.0
"""Parameter values between messages, Python and YAML."""

from typing import Any

from pneu_common.documents import parse_yaml
from pneu_common.errors import InputError

TYPE_NAMES = (
    "not set",
    "boolean",
    "integer",
    "double",
    "string",
    "byte array",
    "boolean array",
    "integer array",
    "double array",
    "string array",
)
"""By `rcl_interfaces/ParameterType`."""

_FIELDS = (
    "",
    "bool_value",
    "integer_value",
    "double_value",
    "string_value",
    "byte_array_value",
    "bool_array_value",
    "integer_array_value",
    "double_array_value",
    "string_array_value",
)


def python_value(value: Any) -> Any:
    """Returns what a `rcl_interfaces/ParameterValue` holds; None where it is not set.

    Args:
        value: The message.
    """
    if not 0 < value.type < len(_FIELDS):
        return None
    found = getattr(value, _FIELDS[value.type])
    if value.type == 5:
        return [item[0] if isinstance(item, bytes) else int(item) for item in found]
    return list(found) if value.type > 5 else found


def message_value(value: Any) -> Any:
    """Returns a `rcl_interfaces/ParameterValue`.

    Args:
        value: None, a scalar, or a list of one type; whole numbers among floats become floats.

    Raises:
        ValueError: A parameter cannot hold it.
    """
    from rcl_interfaces.msg import ParameterValue

    def made(index: int, found: Any) -> Any:
        return ParameterValue(type=index, **{_FIELDS[index]: found})

    if value is None:
        return ParameterValue()
    if isinstance(value, list | tuple):
        kinds = {type(item) for item in value}
        if not kinds:
            return made(9, [])
        if kinds == {int, float}:
            return made(8, [float(item) for item in value])
        if len(kinds) == 1:
            index = {bool: 6, int: 7, float: 8, str: 9}.get(kinds.pop())
            if index is not None:
                return made(index, list(value))
        raise ValueError(f"a parameter holds a list of one type, found {value!r}")
    index = {bool: 1, int: 2, float: 3, str: 4}.get(type(value))
    if index is None:
        raise ValueError(f"a parameter cannot hold {type(value).__name__} {value!r}")
    return made(index, value)


def from_text(text: str) -> Any:
    """Returns the value that a word of the command line stands for, read as YAML.

    Args:
        text: The word; what is no YAML scalar or list is a string.
    """
    try:
        value = parse_yaml(text, "value", "value")
    except InputError:
        return text
    return value if isinstance(value, bool | int | float | str | list) else text
