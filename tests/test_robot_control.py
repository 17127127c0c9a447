# SPDX-License-Identifier: Apache-2.0
"""A Kokoro behind Modbus that a controller moves: it follows, and is safe without it."""

import time

import pytest
from tests.live_graph import wait_for
from tests.robot_control import running_robot
from tests.robots import KOKORO

from pneu_policy.control.drive import Drive
from pneu_policy.control.joint import JointGains
from pneu_policy.control.robot_controllers import JointPidController, save_robot_controller
from pneu_sim.rig import load_rig

pytestmark = [pytest.mark.realtime, pytest.mark.takes(50)]


def pid(folder):
    """File of a PID of the elbow."""
    drive = Drive.of_rig(load_rig(KOKORO), "elbow", "forearm", ("head_port", "rod_port"))
    gains = JointGains(4.0, 2.0, 0.2, 0.01)
    save_robot_controller(JointPidController([drive], [gains], 0.008), folder / "pid.yaml", {})
    return folder / "pid.yaml"


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    folder = tmp_path_factory.mktemp("robot")
    with running_robot(folder, KOKORO, pid(folder)) as one:
        yield one


@pytest.mark.long
def test_it_follows_its_targets(robot):
    robot.follow(0.7)


def test_killed_in_the_middle_of_a_move_both_valves_are_safe_in_time(robot):
    wait_for(robot.commanded, 40.0)
    watch = robot.watch()
    begun_s, _ = robot.nodes.kill("robot")
    try:
        wait_for(lambda: robot.resting_since() is not None, 3.0)
        time.sleep(0.2)
        assert robot.resting_since() is not None
        watch.judge(robot.resting_since(), begun_s)
    finally:
        robot.nodes.launch("robot")
    wait_for(robot.commanded, 40.0)


def test_without_targets_it_commands_the_safe_voltage(robot):
    wait_for(robot.commanded, 40.0)
    robot.nodes.kill("joint_target")
    try:
        wait_for(lambda: "no target" in robot.graph.status("robot: control").message, 15.0)
        wait_for(robot.closed, 10.0)
        closed_s = time.monotonic()
        time.sleep(0.3)
        # The bridge may vent them, where the machine is too busy for commands in time.
        assert not robot.opened_since(closed_s)
    finally:
        robot.nodes.launch("joint_target")
    wait_for(robot.commanded, 40.0)
