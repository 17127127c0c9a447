# SPDX-License-Identifier: Apache-2.0
"""Parameters that are fields of a class: declared with all that is known, and followed later."""

from dataclasses import dataclass

import pytest

from tests.live_graph import own_domain  # isort: skip

import rclpy
from rcl_interfaces.msg import ParameterType
from rclpy.node import Node
from rclpy.parameter import Parameter

from pneu_common.errors import InputError
from pneu_graph.nodes.parameters import Parameters, parameter


@dataclass
class Common(Parameters):
    rate_hz: float = parameter(50.0, "Messages per second.", within=(1.0, 1000.0))
    seed: int = parameter(3, "Seed.", within=(0, 9), read_only=True)


@dataclass
class Mine(Common):
    kind: str = parameter("fast", "How.", choices=("fast", "slow"))
    names: list[str] = parameter([""], "Names.")
    loop: bool = parameter(False, "Begin again.")


@pytest.fixture
def nodes():
    context = rclpy.Context()
    with own_domain():
        rclpy.init(context=context)
    made = []

    def make(**given):
        overrides = [Parameter(name, value=value) for name, value in given.items()]
        made.append(Node("mine", context=context, parameter_overrides=overrides))
        return made[-1]

    yield make
    for node in made:
        node.destroy_node()
    rclpy.shutdown(context=context)


def test_defaults_and_what_is_given(nodes):
    assert Mine.declare(nodes()) == Mine(50.0, 3, "fast", [""], False)
    found = Mine.declare(nodes(rate_hz=20.0, kind="slow", names=["a", "b"], seed=4))
    assert (found.rate_hz, found.kind, list(found.names), found.seed) == (
        20.0,
        "slow",
        ["a", "b"],
        4,
    )


def test_all_that_is_known_is_declared(nodes):
    node = nodes()
    Mine.declare(node)
    rate, seed, kind = node.describe_parameters(["rate_hz", "seed", "kind"])
    assert rate.description == "Messages per second." and not rate.read_only
    (within,) = rate.floating_point_range
    assert (within.from_value, within.to_value) == (1.0, 1000.0)
    (within,) = seed.integer_range
    assert (within.from_value, within.to_value) == (0, 9) and seed.read_only
    assert kind.type == ParameterType.PARAMETER_STRING
    assert kind.additional_constraints == "one of fast, slow"


def test_what_is_set_later_is_followed_or_refused(nodes):
    node = nodes()
    mine = Mine.declare(node)
    assert node.set_parameters([Parameter("rate_hz", value=7.0)])[0].successful
    assert mine.rate_hz == 7.0
    for name, value in (("rate_hz", 0.5), ("seed", 5), ("kind", "odd")):
        result = node.set_parameters([Parameter(name, value=value)])[0]
        assert not result.successful and name in result.reason
    assert mine == Mine(7.0, 3, "fast", [""], False)


def test_a_choice_that_is_none_is_refused_at_once(nodes):
    with pytest.raises(InputError, match="parameter kind: found 'odd', allowed are fast, slow"):
        Mine.declare(nodes(kind="odd"))
