# SPDX-License-Identifier: Apache-2.0
# ruff: noqa: N818  # the names are those of rclpy
"""The exceptions of the API."""

from typing import Any

from rclpy._rclpy_pybind11 import InvalidHandle as InvalidHandle


class NotInitializedException(Exception):
    """Raised where rclpy was not initialised or was shut down.

    Args:
        *args: What was attempted.
    """

    def __init__(self, *args: Any) -> None:
        super().__init__("rclpy.init() has not been called", *args)


class ROSInterruptException(Exception):
    """Raised where waiting was cut short by a shutdown.

    Args:
        *args: What was interrupted.
    """

    def __init__(self, *args: Any) -> None:
        super().__init__("rclpy.shutdown() has been called", *args)


class NoTypeSupportImportedException(Exception):
    """Raised where a message class has no type support.

    Args:
        *args: The class.
    """

    def __init__(self, *args: Any) -> None:
        super().__init__("no type support imported", *args)


class NameValidationException(Exception):
    """Raised where a name breaks the naming rules.

    Args:
        name_type: What kind of name it is, such as "topic name".
        name: The name itself.
        error_msg: The rule that it breaks.
        invalid_index: Where in the name the fault is.
        *args: Further text.
    """

    def __init__(
        self, name_type: str, name: str, error_msg: str, invalid_index: int, *args: Any
    ) -> None:
        marker = " " * (len("  '") + invalid_index) + "^"
        super().__init__(f"Invalid {name_type}: {error_msg}:\n  '{name}'\n{marker}", *args)


class InvalidNamespaceException(NameValidationException):
    """Raised where a namespace breaks the naming rules.

    Args:
        name: The namespace.
        error_msg: The rule that it breaks.
        invalid_index: Where the fault is.
        *args: Further text.
    """

    def __init__(self, name: str, error_msg: str, invalid_index: int, *args: Any) -> None:
        super().__init__("namespace", name, error_msg, invalid_index, *args)


class InvalidNodeNameException(NameValidationException):
    """Raised where a node name breaks the naming rules.

    Args:
        name: The node name.
        error_msg: The rule that it breaks.
        invalid_index: Where the fault is.
        *args: Further text.
    """

    def __init__(self, name: str, error_msg: str, invalid_index: int, *args: Any) -> None:
        super().__init__("node name", name, error_msg, invalid_index, *args)


class InvalidTopicNameException(NameValidationException):
    """Raised where a topic name breaks the naming rules.

    Args:
        name: The topic name.
        error_msg: The rule that it breaks.
        invalid_index: Where the fault is.
        *args: Further text.
    """

    def __init__(self, name: str, error_msg: str, invalid_index: int, *args: Any) -> None:
        super().__init__("topic name", name, error_msg, invalid_index, *args)


class InvalidServiceNameException(NameValidationException):
    """Raised where a service name breaks the naming rules.

    Args:
        name: The service name.
        error_msg: The rule that it breaks.
        invalid_index: Where the fault is.
        *args: Further text.
    """

    def __init__(self, name: str, error_msg: str, invalid_index: int, *args: Any) -> None:
        super().__init__("service name", name, error_msg, invalid_index, *args)


class ParameterException(Exception):
    """Base of the exceptions about parameters.

    Args:
        error_msg: What is wrong.
        parameters: The name of the parameter, or several.
        *args: Further text.
    """

    def __init__(
        self, error_msg: str, parameters: str | list[str] | tuple[str, ...], *args: Any
    ) -> None:
        super().__init__(f"{error_msg}: {parameters}", *args)


class ParameterNotDeclaredException(ParameterException):
    """Raised where an undeclared parameter is used.

    Args:
        parameters: The name of the parameter, or several.
        *args: Further text.
    """

    def __init__(self, parameters: str | list[str] | tuple[str, ...], *args: Any) -> None:
        super().__init__("Invalid access to undeclared parameter(s)", parameters, *args)


class ParameterAlreadyDeclaredException(ParameterException):
    """Raised where a parameter is declared for the second time.

    Args:
        parameters: The name of the parameter, or several.
        *args: Further text.
    """

    def __init__(self, parameters: str | list[str] | tuple[str, ...], *args: Any) -> None:
        super().__init__("Parameter(s) already declared", parameters, *args)


class InvalidParameterException(ParameterException):
    """Raised where a parameter has an invalid name.

    Args:
        parameter: The name.
        *args: Further text.
    """

    def __init__(self, parameter: str, *args: Any) -> None:
        super().__init__("Invalid parameter name", parameter, *args)


class InvalidParameterTypeException(ParameterException):
    """Raised where a parameter would be given a value of another type than it has.

    Args:
        desired_parameter: The parameter as it would be.
        expected_type: The name of the type that it must have.
        *args: Further text.
    """

    def __init__(self, desired_parameter: Any, expected_type: str, *args: Any) -> None:
        super().__init__(
            f"Trying to set parameter '{desired_parameter.name}' to "
            f"'{desired_parameter.value}' of type '{desired_parameter.type_.name}', "
            f"expecting type '{expected_type}'",
            desired_parameter.name,
            *args,
        )


class InvalidParameterValueException(ParameterException):
    """Raised where a parameter was refused a value.

    Args:
        parameter: The name.
        value: The value that was refused.
        reason: Why.
    """

    def __init__(self, parameter: str, value: object, reason: str) -> None:
        super().__init__(
            f"Invalid parameter value ({value}) for parameter. Reason: {reason}", parameter
        )


class ParameterImmutableException(ParameterException):
    """Raised where a read-only parameter would be changed.

    Args:
        parameter: The name.
        *args: Further text.
    """

    def __init__(self, parameter: str, *args: Any) -> None:
        super().__init__("Attempted to modify read-only parameter", parameter, *args)


class ParameterUninitializedException(ParameterException):
    """Raised where a statically typed parameter without a value is read.

    Args:
        parameter: The name.
        *args: Further text.
    """

    def __init__(self, parameter: str, *args: Any) -> None:
        super().__init__("The parameter was not initialized before use", parameter, *args)
