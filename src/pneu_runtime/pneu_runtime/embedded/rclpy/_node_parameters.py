# SPDX-License-Identifier: Apache-2.0
"""The parameters of a node: declaring, reading, setting, describing, listing them."""

import copy
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from rcl_interfaces.msg import (
    ListParametersResult,
    ParameterDescriptor,
    ParameterEvent,
    ParameterType,
    ParameterValue,
    SetParametersResult,
)
from rcl_interfaces.msg import Parameter as ParameterMsg
from rcl_interfaces.srv import ListParameters

from rclpy._parameter_rules import RELATIVE_TOLERANCE, check_descriptor
from rclpy.exceptions import (
    InvalidParameterTypeException,
    InvalidParameterValueException,
    ParameterAlreadyDeclaredException,
    ParameterImmutableException,
    ParameterNotDeclaredException,
    ParameterUninitializedException,
)
from rclpy.parameter import PARAMETER_SEPARATOR_STRING, Parameter
from rclpy.validate_parameter_name import validate_parameter_name

if TYPE_CHECKING:
    from rclpy.clock import Clock
    from rclpy.publisher import Publisher

PreSetCallback = Callable[[list[Parameter]], list[Parameter]]
OnSetCallback = Callable[[list[Parameter]], SetParametersResult]
PostSetCallback = Callable[[list[Parameter]], None]


class ParameterMixin:
    """Part of `Node`; needs its name, clock and publisher of parameter events."""

    PARAM_REL_TOL = RELATIVE_TOLERANCE
    """Relative tolerance for comparing floating point parameter values."""

    if TYPE_CHECKING:
        _clock: Clock
        _parameter_event_publisher: Publisher

        def get_fully_qualified_name(self) -> str:
            """Name of the node with its namespace, which `Node` provides."""

    def _init_parameters(
        self,
        overrides: Mapping[str, Parameter],
        allow_undeclared_parameters: bool,
        automatically_declare_parameters_from_overrides: bool,
    ) -> None:
        """Start with no parameter, or with one for each override."""
        self._parameters: dict[str, Parameter] = {}
        self._descriptors: dict[str, ParameterDescriptor] = {}
        self._parameter_overrides = dict(overrides)
        self._allow_undeclared_parameters = allow_undeclared_parameters
        self._pre_set_parameters_callbacks: list[PreSetCallback] = []
        self._on_set_parameters_callbacks: list[OnSetCallback] = []
        self._post_set_parameters_callbacks: list[PostSetCallback] = []
        if automatically_declare_parameters_from_overrides:
            self.declare_parameters(
                "",
                [
                    (name, parameter.value, ParameterDescriptor())
                    for name, parameter in self._parameter_overrides.items()
                ],
                ignore_override=True,
            )

    # Declaring

    def declare_parameter(
        self,
        name: str,
        value: Any = None,
        descriptor: ParameterDescriptor | None = None,
        ignore_override: bool = False,
    ) -> Parameter:
        """Declare and initialise a parameter.

        Args:
            name: Full name.
            value: Default value, or a `Parameter.Type` for one that has to be given from outside.
            descriptor: Description, range, read_only and dynamic_typing; its name and type are
                replaced by those of the parameter.
            ignore_override: Whether a value given from outside is passed over.

        Returns:
            Parameter: with the value it got.
        """
        if value is None and descriptor is None:
            return self.declare_parameters("", [(name,)], ignore_override)[0]
        descriptor = ParameterDescriptor() if descriptor is None else descriptor
        return self.declare_parameters("", [(name, value, descriptor)], ignore_override)[0]

    def declare_parameters(
        self,
        namespace: str,
        parameters: Sequence[
            tuple[str] | tuple[str, Any] | tuple[str, Any, ParameterDescriptor] | tuple[Any, ...]
        ],
        ignore_override: bool = False,
    ) -> list[Parameter]:
        """Declare several parameters; see `declare_parameter`.

        Args:
            namespace: Put before each name with a dot, unless it is empty.
            parameters: Tuples of name, value or type, and descriptor; the last two can be left out.
            ignore_override: Whether values given from outside are passed over.

        Returns:
            list[Parameter]: with the values they got.
        """
        declared: list[Parameter] = []
        descriptors: dict[str, ParameterDescriptor] = {}
        for index, entry in enumerate(parameters):
            name, value, descriptor = self._declaration(namespace, index, entry)
            if not ignore_override and name in self._parameter_overrides:
                value = self._parameter_overrides[name].value
            declared.append(Parameter(name, value=value))
            descriptors[name] = descriptor
        existing = [one.name for one in declared if one.name in self._parameters]
        if existing:
            raise ParameterAlreadyDeclaredException(existing)
        for parameter in declared:
            descriptor = descriptors[parameter.name]
            result = self._set_checked([parameter], descriptors, keep_not_set=True)
            if not result.successful:
                if result.reason.startswith("Wrong parameter type"):
                    expected = Parameter.Type(descriptor.type).name
                    raise InvalidParameterTypeException(parameter, expected)
                raise InvalidParameterValueException(parameter.name, parameter.value, result.reason)
        return [self._parameters[one.name] for one in declared]

    @staticmethod
    def _declaration(
        namespace: str, index: int, entry: tuple[Any, ...]
    ) -> tuple[str, Any, ParameterDescriptor]:
        """Full name, default value and typed descriptor of one entry of `declare_parameters`."""
        if not 1 <= len(entry) <= 3:
            raise TypeError(
                f"Invalid parameter tuple length at index {index} in parameters list: "
                f"{entry}; expecting length between 1 and 3"
            )
        name = entry[0]
        if not isinstance(name, str):
            raise TypeError(
                f"First element {name} at index {index} in parameters list is not a str."
            )
        if namespace:
            name = f"{namespace}.{name}"
        validate_parameter_name(name)
        second = entry[1] if len(entry) > 1 else None
        given = entry[2] if len(entry) > 2 else ParameterDescriptor()
        if not isinstance(given, ParameterDescriptor):
            raise TypeError(
                f"Third element {given} at index {index} in parameters list "
                "is not a ParameterDescriptor."
            )
        # A copy: the same descriptor is often used for several parameters.
        descriptor = copy.deepcopy(given)
        if len(entry) == 1:
            warnings.warn(
                f"when declaring parameter named '{name}', declaring a parameter only providing "
                "its name is deprecated. Pass a default value, a type, or a descriptor with "
                "dynamic_typing=True",
                stacklevel=4,
            )
            descriptor.dynamic_typing = True
        if isinstance(second, Parameter.Type):
            if second == Parameter.Type.NOT_SET:
                raise ValueError(
                    f"Cannot declare parameter {{{name}}} as statically typed of type NOT_SET"
                )
            if descriptor.dynamic_typing:
                raise ValueError(
                    f"When declaring parameter {{{name}}} passing a descriptor with "
                    "`dynamic_typing=True` is not allowed when the parameter type is provided"
                )
            descriptor.type = second.value
            return name, None, descriptor
        value = second
        if isinstance(value, ParameterValue):
            value = Parameter.from_parameter_msg(ParameterMsg(name=name, value=value)).value
        if not descriptor.dynamic_typing:
            descriptor.type = Parameter.Type.from_parameter_value(value).value
            if descriptor.type == ParameterType.PARAMETER_NOT_SET:
                raise ValueError(
                    "Cannot declare a statically typed parameter with default value "
                    "of type PARAMETER_NOT_SET"
                )
        return name, value, descriptor

    def undeclare_parameter(self, name: str) -> None:
        """Remove a parameter, which must not be read-only.

        Args:
            name: Full name.
        """
        if not self.has_parameter(name):
            raise ParameterNotDeclaredException(name)
        if self._descriptors[name].read_only:
            raise ParameterImmutableException(name)
        del self._parameters[name]
        del self._descriptors[name]

    # Reading

    def has_parameter(self, name: str) -> bool:
        """Return whether a parameter is declared.

        Args:
            name: Full name.
        """
        return name in self._parameters

    def get_parameter_types(self, names: Iterable[str]) -> list[Any]:
        """Return the types of several parameters; see `get_parameter_type`.

        Args:
            names: Full names.
        """
        names = list(names)
        if not all(isinstance(name, str) for name in names):
            raise TypeError("All names must be instances of type str")
        return [self.get_parameter_type(name) for name in names]

    def get_parameter_type(self, name: str) -> Any:
        """Return the number of a parameter's type, NOT_SET for an allowed undeclared one.

        Args:
            name: Full name.
        """
        if self.has_parameter(name):
            return self._parameters[name].type_.value
        if self._allow_undeclared_parameters:
            return Parameter.Type.NOT_SET
        raise ParameterNotDeclaredException(name)

    def get_parameters(self, names: Iterable[str]) -> list[Parameter]:
        """Return several parameters; see `get_parameter`.

        Args:
            names: Full names.
        """
        names = list(names)
        if not all(isinstance(name, str) for name in names):
            raise TypeError("All names must be instances of type str")
        return [self.get_parameter(name) for name in names]

    def get_parameter(self, name: str) -> Parameter:
        """Return a parameter; one that is not set for an allowed undeclared one.

        Args:
            name: Full name.
        """
        if self.has_parameter(name):
            parameter = self._parameters[name]
            if parameter.type_ != Parameter.Type.NOT_SET or self._descriptors[name].dynamic_typing:
                return parameter
            raise ParameterUninitializedException(name)
        if self._allow_undeclared_parameters:
            return Parameter(name, Parameter.Type.NOT_SET, None)
        raise ParameterNotDeclaredException(name)

    def get_parameter_or(self, name: str, alternative_value: Parameter | None = None) -> Parameter:
        """Return a parameter, or the alternative where it is undeclared or has no value.

        Args:
            name: Full name.
            alternative_value: The alternative; by default a parameter that is not set.
        """
        parameter = self._parameters.get(name)
        if parameter is not None and parameter.type_ != Parameter.Type.NOT_SET:
            return parameter
        if alternative_value is None:
            return Parameter(name, Parameter.Type.NOT_SET)
        return alternative_value

    def get_parameters_by_prefix(self, prefix: str) -> dict[str, Parameter]:
        """Return the parameters of a group by their names within it.

        Args:
            prefix: Name of the group; all parameters where it is empty.
        """
        start = prefix + PARAMETER_SEPARATOR_STRING if prefix else ""
        return {
            name.removeprefix(start): parameter
            for name, parameter in self._parameters.items()
            if name.startswith(start)
        }

    def list_parameters(self, prefixes: list[str], depth: int) -> ListParametersResult:
        """Return names of parameters and the groups they are in.

        Args:
            prefixes: Groups or full names to list; all where it is empty.
            depth: Levels of names to list, 0 for all.
        """
        if not isinstance(prefixes, list):
            raise TypeError("The prefixes argument must be a list")
        if not all(isinstance(prefix, str) for prefix in prefixes):
            raise TypeError("All prefixes must be instances of type str")
        if not isinstance(depth, int):
            raise TypeError("The depth must be instance of type int")
        if depth < 0:
            raise ValueError("The depth must be greater than or equal to zero")
        separator = PARAMETER_SEPARATOR_STRING

        def near(name: str) -> bool:
            everything = depth == ListParameters.Request.DEPTH_RECURSIVE
            return everything or name.count(separator) < depth

        def listed(name: str) -> bool:
            if not prefixes:
                return near(name)
            return any(
                name == prefix
                or (name.startswith(prefix + separator) and near(name[len(prefix) + 1 :]))
                for prefix in prefixes
            )

        names = [name for name in self._parameters if listed(name)]
        groups = dict.fromkeys(name.rpartition(separator)[0] for name in names if separator in name)
        return ListParametersResult(names=names, prefixes=list(groups))

    # Setting

    def set_parameters(self, parameter_list: Iterable[Parameter]) -> list[SetParametersResult]:
        """Set parameters one after the other.

        Args:
            parameter_list: Parameters with their new values; one that is not set is undeclared.

        Returns:
            list[SetParametersResult]: one for each, with the reason where it was refused.
        """
        return [self.set_parameters_atomically([parameter]) for parameter in parameter_list]

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Set all parameters or, where one is refused, none.

        Args:
            parameter_list: Parameters with their new values; one that is not set is undeclared.

        Returns:
            SetParametersResult: with the reason where they were refused.
        """
        if self._pre_set_parameters_callbacks:
            modified: list[Parameter] = []
            for callback in list(self._pre_set_parameters_callbacks):
                modified.extend(callback(parameter_list))
            parameter_list = modified
            if not parameter_list:
                return SetParametersResult(
                    successful=False,
                    reason="parameter list cannot be empty, this might be due to "
                    "pre_set_parameters_callback modifying the original parameters list.",
                )
        if not all(isinstance(parameter, Parameter) for parameter in parameter_list):
            raise TypeError(f"parameter must be instance of type '{Parameter!r}'")
        if not self._allow_undeclared_parameters:
            undeclared = [one.name for one in parameter_list if one.name not in self._parameters]
            if undeclared:
                raise ParameterNotDeclaredException(undeclared)
        return self._set_checked(parameter_list)

    def _set_checked(
        self,
        parameters: list[Parameter],
        descriptors: Mapping[str, ParameterDescriptor] | None = None,
        keep_not_set: bool = False,
    ) -> SetParametersResult:
        """Set all or none; new descriptors lift the ban on changing read-only parameters."""
        for parameter in parameters:
            descriptor = (self._descriptors if descriptors is None else descriptors).get(
                parameter.name
            )
            if descriptor is None:  # undeclared and allowed to be
                continue
            declared = self.has_parameter(parameter.name)
            result = check_descriptor(parameter, descriptor, declared, descriptors is None)
            if not result.successful:
                return result
        for on_set in list(self._on_set_parameters_callbacks):
            result = on_set(parameters)
            if not result.successful:
                return result

        event = ParameterEvent(node=self.get_fully_qualified_name())
        for parameter in parameters:
            if parameter.type_ == Parameter.Type.NOT_SET and not keep_not_set:
                event.deleted_parameters.append(parameter.to_parameter_msg())
                self._parameters.pop(parameter.name, None)
                self._descriptors.pop(parameter.name, None)
                continue
            if descriptors is not None:
                self._descriptors[parameter.name] = descriptors[parameter.name]
            elif parameter.name not in self._descriptors:
                self._descriptors[parameter.name] = ParameterDescriptor(
                    name=parameter.name, type=parameter.type_.value, dynamic_typing=True
                )
            is_new = self.get_parameter_or(parameter.name).type_ == Parameter.Type.NOT_SET
            changes = event.new_parameters if is_new else event.changed_parameters
            changes.append(parameter.to_parameter_msg())
            self._parameters[parameter.name] = parameter
        event.stamp = self._clock.now().to_msg()
        self._parameter_event_publisher.publish(event)
        for post_set in list(self._post_set_parameters_callbacks):
            post_set(parameters)
        return SetParametersResult(successful=True)

    # Callbacks; the newest is called first

    def add_pre_set_parameters_callback(self, callback: PreSetCallback) -> None:
        """Call a function before parameters are checked; it returns the list to set instead.

        Args:
            callback: Takes and returns a list of parameters.
        """
        self._pre_set_parameters_callbacks.insert(0, callback)

    def add_on_set_parameters_callback(self, callback: OnSetCallback) -> None:
        """Let a function decide whether parameters are set; it must have no side effects.

        Args:
            callback: Takes a list of parameters and returns a SetParametersResult.
        """
        self._on_set_parameters_callbacks.insert(0, callback)

    def add_post_set_parameters_callback(self, callback: PostSetCallback) -> None:
        """Call a function after parameters have been set.

        Args:
            callback: Takes the list of parameters.
        """
        self._post_set_parameters_callbacks.insert(0, callback)

    def remove_pre_set_parameters_callback(self, callback: PreSetCallback) -> None:
        """Undo `add_pre_set_parameters_callback`; ValueError where it was not added.

        Args:
            callback: The function.
        """
        self._pre_set_parameters_callbacks.remove(callback)

    def remove_on_set_parameters_callback(self, callback: OnSetCallback) -> None:
        """Undo `add_on_set_parameters_callback`; ValueError where it was not added.

        Args:
            callback: The function.
        """
        self._on_set_parameters_callbacks.remove(callback)

    def remove_post_set_parameters_callback(self, callback: PostSetCallback) -> None:
        """Undo `add_post_set_parameters_callback`; ValueError where it was not added.

        Args:
            callback: The function.
        """
        self._post_set_parameters_callbacks.remove(callback)

    # Describing

    def describe_parameter(self, name: str) -> ParameterDescriptor:
        """Return the descriptor of a parameter; an empty one for an allowed undeclared one.

        Args:
            name: Full name.
        """
        if name in self._descriptors:
            return self._descriptors[name]
        if self._allow_undeclared_parameters:
            return ParameterDescriptor()
        raise ParameterNotDeclaredException(name)

    def describe_parameters(self, names: Iterable[str]) -> list[ParameterDescriptor]:
        """Return the descriptors of several parameters; see `describe_parameter`.

        Args:
            names: Full names.
        """
        return [self.describe_parameter(name) for name in names]

    def set_descriptor(
        self,
        name: str,
        descriptor: ParameterDescriptor,
        alternative_value: ParameterValue | None = None,
    ) -> ParameterValue:
        """Replace the descriptor of a parameter, and its value where that does not comply.

        Args:
            name: Full name.
            descriptor: The new descriptor.
            alternative_value: Taken where the present value does not comply.

        Returns:
            ParameterValue: the value afterwards.
        """
        if not self.has_parameter(name):
            if not self._allow_undeclared_parameters:
                raise ParameterNotDeclaredException(name)
            return self.get_parameter(name).get_parameter_value()
        if self.describe_parameter(name).read_only:
            raise ParameterImmutableException(name)
        candidates = [self.get_parameter(name)]
        if alternative_value is not None:
            message = ParameterMsg(name=name, value=alternative_value)
            candidates.append(Parameter.from_parameter_msg(message))
        for candidate in candidates:
            result = check_descriptor(candidate, descriptor, True, False)
            if result.successful:
                self._parameters[name] = candidate
                self._descriptors[name] = descriptor
                return candidate.get_parameter_value()
        raise InvalidParameterValueException(name, candidates[-1].value, result.reason)
