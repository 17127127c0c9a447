# SPDX-License-Identifier: Apache-2.0
"""Parameters of nodes: a name, one of ten types, a value; and reading them from YAML."""

import array
from collections.abc import Mapping
from enum import Enum
from pathlib import Path
from typing import Any, Union

from rcl_interfaces.msg import Parameter as ParameterMsg
from rcl_interfaces.msg import ParameterType, ParameterValue
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

PARAMETER_SEPARATOR_STRING = "."

AllowableParameterValue = Union[
    None,
    bool,
    int,
    float,
    str,
    list[bytes],
    list[bool],
    list[int],
    list[float],
    list[str],
    tuple[Any, ...],
    "array.array[Any]",
]

# Field of rcl_interfaces/msg/ParameterValue that holds a value of each type.
_FIELDS = {
    ParameterType.PARAMETER_BOOL: "bool_value",
    ParameterType.PARAMETER_INTEGER: "integer_value",
    ParameterType.PARAMETER_DOUBLE: "double_value",
    ParameterType.PARAMETER_STRING: "string_value",
    ParameterType.PARAMETER_BYTE_ARRAY: "byte_array_value",
    ParameterType.PARAMETER_BOOL_ARRAY: "bool_array_value",
    ParameterType.PARAMETER_INTEGER_ARRAY: "integer_array_value",
    ParameterType.PARAMETER_DOUBLE_ARRAY: "double_array_value",
    ParameterType.PARAMETER_STRING_ARRAY: "string_array_value",
}
# Python type of the elements of each array type, in the order in which a list is tried on them; an
# empty list counts as the first.
_ELEMENTS: dict[str, type] = {
    "BYTE_ARRAY": bytes,
    "BOOL_ARRAY": bool,
    "INTEGER_ARRAY": int,
    "DOUBLE_ARRAY": float,
    "STRING_ARRAY": str,
}
_SCALARS: dict[str, type] = {"BOOL": bool, "INTEGER": int, "DOUBLE": float, "STRING": str}


class Parameter:
    """A named value of a node, with its type."""

    class Type(Enum):
        """Types a parameter can have, with the numbers of rcl_interfaces/msg/ParameterType."""

        NOT_SET = ParameterType.PARAMETER_NOT_SET
        BOOL = ParameterType.PARAMETER_BOOL
        INTEGER = ParameterType.PARAMETER_INTEGER
        DOUBLE = ParameterType.PARAMETER_DOUBLE
        STRING = ParameterType.PARAMETER_STRING
        BYTE_ARRAY = ParameterType.PARAMETER_BYTE_ARRAY
        BOOL_ARRAY = ParameterType.PARAMETER_BOOL_ARRAY
        INTEGER_ARRAY = ParameterType.PARAMETER_INTEGER_ARRAY
        DOUBLE_ARRAY = ParameterType.PARAMETER_DOUBLE_ARRAY
        STRING_ARRAY = ParameterType.PARAMETER_STRING_ARRAY

        @classmethod
        def from_parameter_value(cls, parameter_value: Any) -> "Parameter.Type":
            """Return the type of a Python value; TypeError where it has none.

            Args:
                parameter_value: The value; an empty list counts as BYTE_ARRAY.
            """
            if parameter_value is None:
                return cls.NOT_SET
            for name, kind in _SCALARS.items():
                if isinstance(parameter_value, kind):
                    return cls[name]
            if isinstance(parameter_value, list | tuple | array.array):
                for name, kind in _ELEMENTS.items():
                    if all(isinstance(element, kind) for element in parameter_value):
                        return cls[name]
                raise TypeError(
                    "The given value is not a list of one of the allowed types"
                    f" '{parameter_value}'."
                )
            raise TypeError(f"The given value is not one of the allowed types '{parameter_value}'.")

        def check(self, parameter_value: Any) -> bool:
            """Return whether a value is of this type.

            Args:
                parameter_value: The value.
            """
            if self is Parameter.Type.NOT_SET:
                return parameter_value is None
            if self.name in _SCALARS:
                return isinstance(parameter_value, _SCALARS[self.name])
            containers: tuple[type, ...] = (list, tuple)
            if self in (Parameter.Type.INTEGER_ARRAY, Parameter.Type.DOUBLE_ARRAY):
                containers += (array.array,)
            fits = isinstance(parameter_value, containers)
            elements: list[Any] = list(parameter_value) if fits else []
            if not fits or not all(isinstance(one, _ELEMENTS[self.name]) for one in elements):
                return False
            return self is not Parameter.Type.BYTE_ARRAY or all(len(one) == 1 for one in elements)

    @classmethod
    def from_parameter_msg(cls, param_msg: ParameterMsg) -> "Parameter":
        """Make a parameter from a message.

        Args:
            param_msg: rcl_interfaces/msg/Parameter.
        """
        type_ = cls.Type(param_msg.value.type)
        field = _FIELDS.get(param_msg.value.type)
        return cls(param_msg.name, type_, getattr(param_msg.value, field) if field else None)

    def __init__(self, name: str, type_: "Parameter.Type | None" = None, value: Any = None) -> None:
        """Make a parameter.

        Args:
            name: Full name, parts separated by dots.
            type_: Its type; found from the value where it is left out.
            value: The value; ValueError where it is not of the type.
        """
        if type_ is None:
            type_ = Parameter.Type.from_parameter_value(value)
        if not isinstance(type_, Parameter.Type):
            raise TypeError(f"type must be an instance of '{Parameter.Type!r}'")
        if not type_.check(value):
            raise ValueError(f"Type '{type_}' and value '{value}' do not agree")
        self._type_ = type_
        self._name = name
        self._value = value

    def __repr__(self) -> str:
        return f"Parameter(name={self._name!r}, type={self._type_.name}, value={self._value!r})"

    @property
    def name(self) -> str:
        """Full name."""
        return self._name

    @property
    def type_(self) -> "Parameter.Type":
        """Type of the value."""
        return self._type_

    @property
    def value(self) -> Any:
        """The value; None where it is not set."""
        return self._value

    def get_parameter_value(self) -> ParameterValue:
        """Return the value as rcl_interfaces/msg/ParameterValue."""
        message = ParameterValue(type=self._type_.value)
        field = _FIELDS.get(self._type_.value)
        if field:
            value = list(self._value) if isinstance(self._value, tuple) else self._value
            setattr(message, field, value)
        return message

    def to_parameter_msg(self) -> ParameterMsg:
        """Return the parameter as rcl_interfaces/msg/Parameter."""
        return ParameterMsg(name=self._name, value=self.get_parameter_value())


def get_parameter_value(string_value: str) -> ParameterValue:
    """Read a value as YAML does, as `ros2 param set` has to; what fits no type stays a string.

    Args:
        string_value: The text.
    """
    try:
        value = _read_yaml(string_value)
    except YAMLError:
        value = string_value
    return _value_message(value, string_value)


def _value_message(value: Any, text: str) -> ParameterValue:
    """Message of a value read from YAML; `text` is the value where no type fits."""
    if isinstance(value, list) and not value:
        return ParameterValue(type=ParameterType.PARAMETER_BOOL_ARRAY)
    if value is not None:
        try:
            return Parameter("", value=value).get_parameter_value()
        except TypeError:  # a mixed list, a mapping or a date
            return ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=text)
    return ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=text)


def _read_yaml(source: str | Path) -> Any:
    """Plain Python values of a YAML 1.1 document, in which `yes` and `on` are booleans."""
    reader = YAML(typ="safe", pure=True)
    reader.version = (1, 1)
    return reader.load(source)


def parameter_value_to_python(parameter_value: ParameterValue) -> Any:
    """Return the Python value of a message; None where it is not set.

    Args:
        parameter_value: rcl_interfaces/msg/ParameterValue; RuntimeError where its type is unknown.
    """
    if parameter_value.type == ParameterType.PARAMETER_NOT_SET:
        return None
    field = _FIELDS.get(parameter_value.type)
    if field is None:
        raise RuntimeError(f"unexpected parameter type {parameter_value.type}")
    value = getattr(parameter_value, field)
    return list(value) if field.endswith("array_value") else value


def parameter_dict_from_yaml_file(
    parameter_file: str,
    use_wildcard: bool = False,
    target_nodes: list[str] | None = None,
    namespace: str = "",
) -> dict[str, ParameterMsg]:
    """Read a file as `ros2 param dump` writes it.

    Args:
        parameter_file: Path of the file.
        use_wildcard: Whether the entries of `/**` count; those of named nodes win over them.
        target_nodes: Nodes whose parameters are read; all where it is None.
        namespace: Put before each parameter name.

    Returns:
        dict[str, Parameter]: messages by full parameter name.
    """
    content = _read_yaml(Path(parameter_file))
    if not isinstance(content, Mapping):
        raise RuntimeError(f"Param file {parameter_file} does not contain selected parameters")
    keys = ["/**"] if use_wildcard and "/**" in content else []
    if target_nodes:
        for node in target_nodes:
            if node not in content:
                raise RuntimeError(
                    f"Param file does not contain parameters for {node}, "
                    f"only for nodes: {list(content)}"
                )
        keys += target_nodes
    else:
        keys += [key for key in content if key != "/**"]
    if not keys:
        raise RuntimeError("Param file does not contain selected parameters")
    merged: dict[str, Any] = {}
    for key in keys:
        entry = content[key]
        if not isinstance(entry, Mapping) or "ros__parameters" not in entry:
            raise RuntimeError(
                f"Invalid structure of parameter file for node {key}, "
                "expected same format as provided by ros2 param dump"
            )
        merged.update(flatten_parameters(entry["ros__parameters"] or {}, namespace))
    return {
        name: ParameterMsg(name=name, value=_value_message(value, str(value)))
        for name, value in merged.items()
    }


def flatten_parameters(tree: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Turn nested mappings into dotted names.

    Args:
        tree: Parameters, in which groups are mappings.
        prefix: Put before each name.

    Returns:
        dict[str, object]: values by full name.
    """
    flat: dict[str, Any] = {}
    for name, value in tree.items():
        if isinstance(value, Mapping):
            flat |= flatten_parameters(value, f"{prefix}{name}{PARAMETER_SEPARATOR_STRING}")
        else:
            flat[f"{prefix}{name}"] = value
    return flat
