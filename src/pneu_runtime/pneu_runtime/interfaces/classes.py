# SPDX-License-Identifier: Apache-2.0
"""Python classes of messages, with the behaviour of those that rosidl generates for rclpy.

A field is a property over a slot, so that a wrong type is refused where it is set rather than
where the message is sent. rclpy of Jazzy makes these checks only where `ROS_PYTHON_CHECK_FIELDS`
is 1; here they are always made, because the bytes of an unchecked field would be wrong.
"""

import array
import math
from collections import UserList
from collections.abc import Callable, Mapping
from collections.abc import Sequence as SequenceABC
from collections.abc import Set as SetABC
from typing import Any, ClassVar

import numpy as np

from pneu_runtime.interfaces.model import PRIMITIVES, Field, FieldType, Structure

FLOAT32_MAX = 3.4028234663852886e38
UNSET: Any = type("_Unset", (), {"__repr__": lambda self: "<unset>"})()

MessageLookup = Callable[[str], type]


class Message:
    """Base of all message classes."""

    __slots__ = ()
    _fields_and_field_types: ClassVar[dict[str, str]] = {}
    _full_name = ""

    @classmethod
    def get_fields_and_field_types(cls) -> dict[str, str]:
        """Returns the names of the fields and their types as IDL writes them."""
        return dict(cls._fields_and_field_types)

    def __repr__(self) -> str:
        cls = type(self)
        texts = []
        for name in cls._fields_and_field_types:
            value = getattr(self, name)
            text = repr(value.tolist()) if isinstance(value, array.array) else repr(value)
            texts.append(f"{name}={text}")
        return f"{cls.__module__}.{cls.__name__}({', '.join(texts)})"

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, type(self)):
            return False
        for name in self._fields_and_field_types:
            mine, theirs = getattr(self, name), getattr(other, name)
            if isinstance(mine, np.ndarray):
                if not np.array_equal(mine, theirs):
                    return False
            elif mine != theirs:
                return False
        return True

    __hash__ = None  # type: ignore[assignment]


def build_class(structure: Structure, module: str, lookup: MessageLookup) -> type[Message]:
    """Makes the class of a message.

    Args:
        structure: The definition.
        module: Name of the module where users find the class, such as `std_msgs.msg`.
        lookup: Returns the class of another message by its full name.

    Returns:
        type[Message]: the class.
    """
    short = structure.name.split("/")[-1]
    namespace: dict[str, Any] = {
        "__module__": module,
        "__qualname__": short,
        "__doc__": f"Message of type {structure.name}.",
        "__slots__": [f"_{field.name}" for field in structure.fields],
        "_full_name": structure.name,
        "_fields_and_field_types": {field.name: field.type.idl_name for field in structure.fields},
    }
    for constant in structure.constants:
        value = constant.value
        namespace[constant.name] = bytes([value]) if constant.type == "byte" else value
    makers: dict[str, Callable[[], Any]] = {}
    checks: dict[str, Callable[[Any], Any]] = {}
    for field in structure.fields:
        makers[field.name] = _default_maker(field, lookup)
        checks[field.name] = _checker(field, lookup)
        if field.default is not None:
            namespace[f"{field.name.upper()}__DEFAULT"] = makers[field.name]()
    namespace["__init__"] = _build_init(structure, makers, checks)
    for field in structure.fields:
        namespace[field.name] = _build_property(field, checks[field.name])
    return type(short, (Message,), namespace)


def _build_init(
    structure: Structure,
    makers: Mapping[str, Callable[[], Any]],
    checks: Mapping[str, Callable[[Any], Any]],
) -> Callable[..., None]:
    """Writes `__init__`: a plain function is several times faster than a loop over the fields."""
    lines = ["def __init__(self, **_given):"]
    names: dict[str, Any] = {}
    lines.append("    if not _given:")
    for index, field in enumerate(structure.fields):
        value = _simple_default(field)
        if value is None:
            names[f"make{index}"] = makers[field.name]
            value = f"make{index}()"
        lines.append(f"        self._{field.name} = {value}")
    lines.append("        return")
    lines.append("    _take = _given.pop")
    lines.append("    _take('check_fields', None)")
    names["UNSET"] = UNSET
    for index, field in enumerate(structure.fields):
        value = _simple_default(field) or f"make{index}()"
        names[f"check{index}"] = checks[field.name]
        lines += [
            f"    _value = _take({field.name!r}, UNSET)",
            f"    self._{field.name} = {value} if _value is UNSET else check{index}(_value)",
        ]
    lines += [
        "    if _given:",
        "        raise AssertionError('Invalid arguments passed to constructor: '",
        "                             + ', '.join(sorted(_given)))",
    ]
    exec("\n".join(lines), names)
    init: Callable[..., None] = names["__init__"]
    return init


def _simple_default(field: Field) -> str | None:
    """Source of an immutable default; None where a new object must be made every time."""
    if field.type.is_message or field.type.kind != "one":
        return None
    return repr(_scalar_default(field.type.base, field.default))


def _scalar_default(base: str, value: Any) -> Any:
    if base == "string":
        return value or ""
    if base == "byte":
        return bytes([value or 0])
    if base == "bool":
        return bool(value)
    return float(value or 0) if base.startswith("float") else int(value or 0)


def _default_maker(field: Field, lookup: MessageLookup) -> Callable[[], Any]:
    kind, base, count = field.type.kind, field.type.base, field.type.count
    if field.type.is_message:
        nested = lookup(base)
        if kind == "one":
            return nested
        return (lambda: [nested() for _ in range(count)]) if kind == "array" else list
    if kind == "one":
        value = _scalar_default(base, field.default)
        return lambda: value
    values = [_scalar_default(base, one) for one in field.default or ()]
    code = "" if base == "string" else PRIMITIVES[base][2]
    if kind == "array":
        values = values or [_scalar_default(base, None)] * count
        if code:
            dtype = np.dtype(PRIMITIVES[base][1])
            return lambda: np.array(values, dtype=dtype)
    elif code:
        return lambda: array.array(code, values)
    return lambda: list(values)


def _build_property(field: Field, check: Callable[[Any], Any]) -> property:
    slot = f"_{field.name}"
    names: dict[str, Any] = {"check": check}
    exec(
        f"def fget(self):\n    return self.{slot}\n"
        f"def fset(self, value):\n    self.{slot} = check(value)\n",
        names,
    )
    return property(names["fget"], names["fset"], doc=f"Field of type {field.type.idl_name}.")


def _checker(field: Field, lookup: MessageLookup) -> Callable[[Any], Any]:
    """Returns a function that hands back a value as it is stored, or raises AssertionError."""
    if field.type.kind == "one":
        return _scalar_checker(field.name, field.type, lookup)
    return _list_checker(field, lookup)


def _scalar_checker(name: str, kind: FieldType, lookup: MessageLookup) -> Callable[[Any], Any]:
    base, bound = kind.base, kind.string_bound
    if kind.is_message:
        nested = lookup(base)

        def check(value: Any) -> Any:
            if isinstance(value, nested):
                return value
            raise AssertionError(
                f"The '{name}' field must be a sub message of type '{nested.__name__}'"
            )

    elif base == "string":

        def check(value: Any) -> Any:
            if isinstance(value, str) and (not bound or len(value) <= bound):
                return value
            limit = f" and not be longer than {bound} characters" if bound else ""
            raise AssertionError(f"The '{name}' field must be of type 'str'{limit}")

    elif base == "bool":

        def check(value: Any) -> Any:
            if isinstance(value, bool):
                return value
            raise AssertionError(f"The '{name}' field must be of type 'bool'")

    elif base == "byte":

        def check(value: Any) -> Any:
            if isinstance(value, (bytes, bytearray)) and len(value) == 1:
                return bytes(value)
            raise AssertionError(f"The '{name}' field must be of type 'bytes' with length 1")

    elif base == "float64":

        def check(value: Any) -> Any:
            if isinstance(value, float):
                return value
            raise AssertionError(f"The '{name}' field must be of type 'float'")

    elif base == "float32":

        def check(value: Any) -> Any:
            if isinstance(value, float):
                if -FLOAT32_MAX <= value <= FLOAT32_MAX or not math.isfinite(value):
                    return value
                raise AssertionError(f"The '{name}' field must be a float in [-3.4e38, 3.4e38]")
            raise AssertionError(f"The '{name}' field must be of type 'float'")

    else:
        low, high = _integer_range(base)

        def check(value: Any) -> Any:
            if isinstance(value, int):
                if low <= value <= high:
                    return value
                sign = "an unsigned" if low == 0 else "an"
                raise AssertionError(
                    f"The '{name}' field must be {sign} integer in [{low}, {high}]"
                )
            raise AssertionError(f"The '{name}' field must be of type 'int'")

    return check


def _integer_range(base: str) -> tuple[int, int]:
    bits = 8 * PRIMITIVES[base][0]
    return (0, 2**bits - 1) if base.startswith("u") else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)


def _list_checker(field: Field, lookup: MessageLookup) -> Callable[[Any], Any]:
    name, kind, base, count = field.name, field.type.kind, field.type.base, field.type.count
    element = _scalar_checker(name, FieldType(base, field.type.string_bound), lookup)
    code = "" if field.type.is_message or base == "string" else PRIMITIVES[base][2]
    what = {
        "array": f"hold exactly {count} elements",
        "bounded": f"hold at most {count} elements",
    }.get(kind, "hold any number of elements")

    def check_size(value: Any) -> None:
        size = len(value)
        if (kind == "array" and size != count) or (kind == "bounded" and size > count):
            raise AssertionError(f"The '{name}' field must {what}, not {size}")

    def check_elements(value: Any) -> list[Any]:
        if isinstance(value, (str, dict)) or not isinstance(
            value, (SequenceABC, SetABC, UserList, np.ndarray)
        ):
            raise AssertionError(
                f"The '{name}' field must be a sequence of '{base}', not {type(value).__name__}"
            )
        check_size(value)
        if isinstance(value, np.ndarray):
            value = value.tolist()
        for item in value:
            element(item)
        return list(value)

    if not code:

        def check(value: Any) -> Any:
            if type(value) is list:  # kept, as rclpy does: the user may go on to append to it
                check_size(value)
                for item in value:
                    element(item)
                return value
            return check_elements(value)

        return check

    dtype = np.dtype(PRIMITIVES[base][1])

    def as_typed(value: Any) -> Any:
        """An array of the right type from another of numbers, None where it is something else."""
        if isinstance(value, np.ndarray):
            if value.ndim != 1:
                raise AssertionError(f"The '{name}' field must have one dimension")
            if value.dtype == dtype:
                return value
            if value.dtype.kind in "iu" and dtype.kind == "f":
                return value.astype(dtype)
        elif base == "uint8" and isinstance(value, (bytes, bytearray, memoryview)):
            return np.frombuffer(value, dtype)
        return None

    if kind == "array":

        def check(value: Any) -> Any:
            typed = as_typed(value)
            if typed is None:
                return np.array(check_elements(value), dtype=dtype)
            check_size(typed)
            return typed

    else:

        def check(value: Any) -> Any:
            if type(value) is array.array and value.typecode == code:
                check_size(value)
                return value
            typed = as_typed(value)
            if typed is None:
                return array.array(code, check_elements(value))
            check_size(typed)
            return array.array(code, typed.tobytes())

    return check
