# SPDX-License-Identifier: Apache-2.0
"""A Kokoro behind Modbus that a predictive controller moves: it follows, and is safe without it."""

from pathlib import Path

import pytest
from tests.bridges import ROOT
from tests.live_graph import wait_for
from tests.robot_control import running_robot

pytestmark = [pytest.mark.realtime, pytest.mark.takes(60)]


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    folder = tmp_path_factory.mktemp("predictive")
    controller = ROOT / "policies" / "kokoro_predictive.yaml"
    with running_robot(folder, ROOT / "rigs" / "kokoro_fitted.yaml", controller) as one:
        yield one


def parent_of(process):
    """Of a folder in /proc; None where it has ended, reaped or not."""
    try:
        state, parent = (process / "stat").read_text().rpartition(")")[2].split()[:2]
    except OSError:
        return None
    return None if state == "Z" else int(parent)


@pytest.mark.long
def test_it_follows_its_targets(robot):
    robot.follow(0.5)


@pytest.mark.long  # test_robot_control.py kills the same node with another controller
def test_killed_both_valves_are_safe_and_no_planner_is_left(robot):
    wait_for(robot.commanded, 60.0)
    node = robot.nodes.pids()["robot"]
    begun = [one for one in Path("/proc").glob("[0-9]*") if parent_of(one) == node]
    assert begun
    robot.nodes.kill("robot")
    wait_for(lambda: robot.resting_since() is not None, 5.0)
    wait_for(lambda: not any(map(parent_of, begun)), 10.0)
    assert robot.resting_since() is not None
    robot.nodes.launch("robot")
    wait_for(robot.commanded, 60.0)
