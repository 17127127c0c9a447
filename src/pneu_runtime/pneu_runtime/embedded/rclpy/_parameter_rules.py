# SPDX-License-Identifier: Apache-2.0
"""What a descriptor demands of a value: its type, its range and that it may change."""

import math

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)

from rclpy.parameter import Parameter

# Relative tolerance with which a double lies on a bound or a step of its range.
RELATIVE_TOLERANCE = 1e-6


def _refused(reason: str) -> SetParametersResult:
    return SetParametersResult(successful=False, reason=reason)


def check_descriptor(
    parameter: Parameter, descriptor: ParameterDescriptor, declared: bool, check_read_only: bool
) -> SetParametersResult:
    """Compare a parameter with its descriptor, whose name and dynamic type are set from it.

    Args:
        parameter: The parameter with its new value.
        descriptor: Its descriptor.
        declared: Whether a parameter of that name exists.
        check_read_only: Whether a read-only parameter is refused.

    Returns:
        SetParametersResult: with the reason where it does not comply.
    """
    descriptor.name = parameter.name
    if check_read_only and descriptor.read_only:
        return _refused(f"Trying to set a read-only parameter: {parameter.name}.")
    if descriptor.dynamic_typing:
        descriptor.type = parameter.type_.value
    elif parameter.type_ == Parameter.Type.NOT_SET:
        if declared:
            return _refused("Static parameter cannot be undeclared")
    elif parameter.type_.value != descriptor.type:
        return _refused(
            f"Wrong parameter type, expected '{Parameter.Type(descriptor.type)}'"
            f" got '{parameter.type_}'"
        )
    if parameter.type_ == Parameter.Type.INTEGER and descriptor.integer_range:
        return check_integer_range(parameter, descriptor.integer_range[0])
    if parameter.type_ == Parameter.Type.DOUBLE and descriptor.floating_point_range:
        return check_floating_point_range(parameter, descriptor.floating_point_range[0])
    return SetParametersResult(successful=True)


def check_integer_range(parameter: Parameter, limits: IntegerRange) -> SetParametersResult:
    """Check that an integer lies on a step of its range; both bounds are always allowed.

    Args:
        parameter: The parameter.
        limits: The range; step 0 allows everything between the bounds.
    """
    low, high = sorted((limits.from_value, limits.to_value))
    value = parameter.value
    if not low <= value <= high:
        return _refused(
            f"Parameter {parameter.name} out of range. Min: {low}, Max: {high}, value: {value}"
        )
    if value != high and limits.step != 0 and (value - low) % limits.step != 0:
        return _refused(
            f"The parameter value for {parameter.name} is not a valid step. "
            f"Min: {low}, max: {high}, value: {value}, step: {limits.step}"
        )
    return SetParametersResult(successful=True)


def check_floating_point_range(
    parameter: Parameter, limits: FloatingPointRange
) -> SetParametersResult:
    """Check that a double lies near a step of its range; both bounds are always allowed.

    Args:
        parameter: The parameter.
        limits: The range; step 0 allows everything between the bounds.
    """
    low, high = sorted((limits.from_value, limits.to_value))
    value = parameter.value
    if any(math.isclose(value, bound, rel_tol=RELATIVE_TOLERANCE) for bound in (low, high)):
        return SetParametersResult(successful=True)
    if value != min(max(value, low), high):  # NaN is out of every range
        return _refused(
            f"Parameter {parameter.name} out of range Min: {low}, Max: {high}, value: {value}"
        )
    if limits.step != 0.0:
        nearest = low + round((value - low) / limits.step) * limits.step
        if not math.isclose(nearest, value, rel_tol=RELATIVE_TOLERANCE):
            return _refused(
                f"The parameter value for {parameter.name} is not close enough to a valid step. "
                f"Min: {low}, max: {high}, value: {value}, step: {limits.step}"
            )
    return SetParametersResult(successful=True)
