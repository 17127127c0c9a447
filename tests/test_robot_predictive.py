# SPDX-License-Identifier: Apache-2.0
"""A Kokoro behind Modbus that a predictive controller moves: it follows, and is safe without it."""

import pytest
from tests.bridges import ROOT
from tests.live_graph import own_domain, running_graph, wait_for
from tests.robot_control import Robot
from tests.robots import kokoro_lab

FITTED = ROOT / "rigs" / "kokoro_fitted.yaml"
CONTROLLER = ROOT / "policies" / "kokoro_predictive.yaml"


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    folder = tmp_path_factory.mktemp("predictive")
    with own_domain(), running_graph() as graph, kokoro_lab(folder) as lab:
        one = Robot(folder, lab, graph, FITTED, CONTROLLER)
        one.nodes.launch()
        try:
            yield one
            assert not one.nodes.complaints()
        finally:
            one.nodes.close()


def test_it_follows_its_targets(robot):
    robot.follow(0.5)


def test_killed_both_valves_are_safe_and_nothing_is_left_of_it(robot):
    wait_for(robot.commanded, 60.0)
    robot.nodes.kill("robot")
    wait_for(lambda: robot.resting_since() is not None, 5.0)
    robot.nodes.launch("robot")
    wait_for(robot.commanded, 60.0)
