# SPDX-License-Identifier: Apache-2.0
"""Messages from and to plain dictionaries, as YAML on a command line gives and shows them."""

import array
import math
from collections.abc import Mapping
from typing import Any, TypeVar

import numpy as np

from pneu_common.errors import InputError
from pneu_runtime.interfaces.catalogue import message_class, registry, type_name
from pneu_runtime.interfaces.classes import Message
from pneu_runtime.interfaces.model import PRIMITIVES, Field, FieldType

M = TypeVar("M")


def from_dict(message_type: type[M], mapping: Mapping[str, Any] | None) -> M:
    """Makes a message from plain values; fields that are not given keep their defaults.

    Args:
        message_type: The message class.
        mapping: Values by field name, nested for nested messages. None stands for no values.

    Returns:
        The message.

    Raises:
        InputError: A field does not exist or its value does not fit; the text names the field.
    """
    return _from_dict(message_type, mapping, "")


def to_dict(msg: Any) -> dict[str, Any]:
    """Returns the fields of a message as plain values that YAML and JSON can write.

    Args:
        msg: The message.

    Returns:
        dict: by field name, in the order of the definition; a `byte` is an integer.
    """
    return {name: _plain(getattr(msg, name)) for name in type(msg)._fields_and_field_types}


def _plain(value: Any) -> Any:
    if isinstance(value, Message):
        return to_dict(value)
    if isinstance(value, bytes):
        return value[0]
    if isinstance(value, (array.array, np.ndarray)):
        return value.tolist()
    return [_plain(item) for item in value] if isinstance(value, list) else value


def _from_dict(cls: Any, mapping: Any, where: str) -> Any:
    name = type_name(cls)
    if mapping is None or mapping == "":
        mapping = {}
    if not isinstance(mapping, Mapping):
        raise InputError(
            f"{where or name}: {_shown(mapping)} where the fields of {name} are needed, as in"
            " {field: value}."
        )
    fields = {field.name: field for field in registry().structure(name).fields}
    message = cls()
    for key, value in mapping.items():
        path = f"{where}.{key}" if where else str(key)
        if key not in fields:
            allowed = ", ".join(fields) or "none"
            raise InputError(f"{path}: {name} has no such field; its fields are: {allowed}.")
        try:
            setattr(message, key, _value(fields[key], value, path))
        except AssertionError as error:
            raise InputError(f"{path}: {_shown(value)}: {error}.") from error
    return message


def _value(field: Field, value: Any, path: str) -> Any:
    kind = field.type
    if kind.kind == "one":
        return _scalar(kind, value, path)
    if kind.base == "uint8" and isinstance(value, bytes):
        return value
    if isinstance(value, (str, bytes, Mapping)) or not hasattr(value, "__iter__"):
        raise InputError(f"{path}: {_shown(value)} where a list is needed ({kind.idl_name}).")
    one = FieldType(kind.base, kind.string_bound)
    return [_scalar(one, item, f"{path}[{index}]") for index, item in enumerate(value)]


def _scalar(kind: FieldType, value: Any, path: str) -> Any:
    if kind.is_message:
        if isinstance(value, Message):
            return value
        return _from_dict(message_class(kind.base), value, path)
    wanted = PRIMITIVES[kind.base][3] if kind.base in PRIMITIVES else "string"
    if kind.base == "string":
        if isinstance(value, str):
            return value
    elif kind.base == "bool":
        if isinstance(value, (bool, np.bool_)):
            return bool(value)
    elif kind.base.startswith("float"):
        number = _number(value)
        if number is not None:
            return number
    elif isinstance(value, (int, np.integer)) and not isinstance(value, bool):
        if kind.base != "byte":
            return int(value)
        if 0 <= value <= 255:
            return bytes([int(value)])
    elif kind.base == "byte" and isinstance(value, bytes) and len(value) == 1:
        return value
    raise InputError(f"{path}: {_shown(value)} is no {wanted}.")


def _number(value: Any) -> float | None:
    if isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool):
        return float(value)
    # YAML 1.1 reads 1e5 and nan as strings, which nobody means in a field of numbers
    if isinstance(value, str):
        try:
            number = float(value)
        except ValueError:
            return None
        return number if math.isfinite(number) or value.strip(" .+-").lower() in _NAMED else None
    return None


_NAMED = ("nan", "inf", "infinity")


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
