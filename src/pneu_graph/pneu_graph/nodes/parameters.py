# SPDX-License-Identifier: Apache-2.0
"""Parameters of a node, declared once: name, default, range and meaning are fields of a class.

A node has them as attributes of one object, which follow what is set later::

    @dataclass
    class MineParameters(Parameters):
        rate_hz: float = parameter(50.0, "Messages per second.", within=(1.0, 1000.0))

    self.parameters = MineParameters.declare(self)
    self.parameters.rate_hz
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, Self

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node

from pneu_common.errors import InputError


@dataclasses.dataclass(frozen=True)
class _About:
    description: str
    within: tuple[float, float] | None
    choices: tuple[str, ...]
    read_only: bool


def parameter(
    default: bool | int | float | str | list[str],
    description: str,
    within: tuple[float, float] | None = None,
    choices: Sequence[str] = (),
    read_only: bool = False,
) -> Any:
    """A field that is a parameter.

    Args:
        default: Value where none is given; its type is the parameter's.
        description: What it does, in a sentence, with the unit.
        within: Smallest and largest value allowed.
        choices: Strings allowed.
        read_only: Whether it is fixed once the node is up.
    """
    about = {"about": _About(description, within, tuple(choices), read_only)}
    if isinstance(default, list):
        return dataclasses.field(default_factory=lambda: list(default), metadata=about)
    return dataclasses.field(default=default, metadata=about)


@dataclasses.dataclass
class Parameters:
    """What a node's parameters are; the fields of a subclass, each made by `parameter`."""

    @classmethod
    def declare(cls, node: Node) -> Self:
        """Declares all parameters on a node.

        Args:
            node: The node.

        Returns:
            Their values, which follow what is set later.

        Raises:
            InputError: A given value is none of the choices.
        """
        values = cls()
        about = {f.name: f.metadata["about"] for f in dataclasses.fields(cls)}
        for name, one in about.items():
            value = node.declare_parameter(
                name, getattr(values, name), _descriptor(one, values, name)
            )
            if one.choices and value.value not in one.choices:
                raise InputError(
                    f"parameter {name}: found {value.value!r}, allowed are {', '.join(one.choices)}"
                )
            setattr(values, name, value.value)
        chosen = {name: one.choices for name, one in about.items() if one.choices}
        if chosen:
            node.add_on_set_parameters_callback(_refusing_others(chosen))

        def follow(parameters: list[Any]) -> None:
            for changed in parameters:
                if changed.name in about:
                    setattr(values, changed.name, changed.value)

        node.add_post_set_parameters_callback(follow)
        return values


def _descriptor(about: _About, values: Parameters, name: str) -> ParameterDescriptor:
    """All that is known of a parameter, as a message."""
    descriptor = ParameterDescriptor(description=about.description, read_only=about.read_only)
    if about.within is not None and isinstance(getattr(values, name), float):
        low, high = float(about.within[0]), float(about.within[1])
        descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
    elif about.within is not None:
        whole = IntegerRange(from_value=int(about.within[0]), to_value=int(about.within[1]), step=1)
        descriptor.integer_range = [whole]
    if about.choices:
        descriptor.additional_constraints = f"one of {', '.join(about.choices)}"
    return descriptor


def _refusing_others(choices: dict[str, tuple[str, ...]]) -> Callable[..., SetParametersResult]:
    """A check that knows the strings that parameters may be."""

    def check(parameters: list[Any]) -> SetParametersResult:
        for given in parameters:
            allowed = choices.get(given.name)
            if allowed is not None and given.value not in allowed:
                reason = f"{given.name}: found {given.value!r}, allowed are {', '.join(allowed)}"
                return SetParametersResult(successful=False, reason=reason)
        return SetParametersResult(successful=True)

    return check
