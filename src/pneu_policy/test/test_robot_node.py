# SPDX-License-Identifier: Apache-2.0
"""The node that moves joints: its law on the graph, and what is missing, late or wrong."""

import math
import time
from pathlib import Path

import numpy as np
import pytest

from tests.graph_fixtures import domain, graph  # isort: skip
from tests.live_graph import wait_for  # isort: skip

from pneu_msgs.msg import ValveCommand
from rclpy.duration import Duration
from sensor_msgs.msg import FluidPressure, JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from pneu_common.errors import InputError
from pneu_graph.nodes import common
from pneu_policy.control.identity import robot_identity
from pneu_policy.control.joint import JointGains
from pneu_policy.control.robot_controllers import (
    Drive,
    JointPidController,
    load_robot_controller,
    save_robot_controller,
)
from pneu_policy.control.robot_policy import RobotPolicy
from pneu_policy.control.robot_recipe import RobotRecipe
from pneu_policy.nodes.joint_target import JointTargetNode
from pneu_policy.nodes.robot import RobotNode
from pneu_sim.rig import load_rig

pytestmark = pytest.mark.realtime

__all__ = ["domain", "graph"]  # fixtures

ROOT = Path(__file__).parents[3]
KOKORO = ROOT / "rigs" / "kokoro.yaml"
TAPS = ("head_port", "rod_port")


@pytest.fixture
def pid(tmp_path):
    """A proportional controller: 5 V and 4 V/rad on either side."""
    drive = Drive.of_rig(load_rig(KOKORO), "elbow", "forearm", TAPS)
    one = JointPidController([drive], [JointGains(4.0)], 0.01)
    save_robot_controller(one, tmp_path / "p.yaml", {})
    return tmp_path / "p.yaml"


class Body:
    """An elbow and pressures that the test sets, with targets, published until it stops."""

    def __init__(self, graph):
        self.elbow, self.target, self.ahead_s = 0.1, [0.3, 0.3], 0.2
        self.readings = self.targets = True
        self.noise = 1.0
        probe = self.probe = graph.probe
        self.taps = {
            tap: probe.create_publisher(FluidPressure, f"/taps/{tap}/pressure", 10) for tap in TAPS
        }
        self.joints = probe.create_publisher(JointState, "/joint_states", 10)
        self.wanted = probe.create_publisher(JointTrajectory, "joint_target", common.COMMAND_QOS)
        self.commands = graph.listen(ValveCommand, "valve/command", common.COMMAND_QOS)
        self.names = ["other", "elbow"]
        probe.create_timer(0.01, self.tick, clock=common.steady_clock())
        wait_for(lambda: self.joints.get_subscription_count() == 1)

    def tick(self):
        now = self.probe.get_clock().now().to_msg()
        self.noise = -self.noise
        for publisher in self.taps.values():
            message = FluidPressure(fluid_pressure=3e5 + self.noise)
            message.header.stamp = now
            publisher.publish(message)
        if self.readings:
            message = JointState(name=["elbow"], position=[self.elbow])
            message.header.stamp = now
            self.joints.publish(message)
        if self.targets:
            due = np.linspace(0.0, self.ahead_s, len(self.target))
            points = [
                JointTrajectoryPoint(
                    positions=[9.0, value][: len(self.names)],
                    time_from_start=Duration(seconds=float(at)).to_msg(),
                )
                for value, at in zip(self.target, due, strict=True)
            ]
            message = JointTrajectory(joint_names=self.names, points=points)
            message.header.stamp = now
            self.wanted.publish(message)

    def volts(self):
        if not self.commands:
            return {}
        last = self.commands[-1]
        return dict(zip(last.name, last.voltage_v, strict=True))

    def settles_at(self, head, rod):
        def there():
            volts = self.volts()
            return volts and (
                volts["head"] == pytest.approx(head, abs=1e-6)
                and volts["rod"] == pytest.approx(rod, abs=1e-6)
            )

        wait_for(there)


def test_it_opens_both_valves_by_the_law_of_its_file(graph, pid):
    graph.add(RobotNode, autostart=True, rig=str(KOKORO), controller=str(pid))
    body = Body(graph)
    body.settles_at(5.0 + 4.0 * 0.2, 5.0 - 4.0 * 0.2)
    body.elbow = 0.45
    body.settles_at(5.0 - 4.0 * 0.15, 5.0 + 4.0 * 0.15)
    assert "tracking" in graph.status("robot: control").message


@pytest.mark.parametrize("what", ["encoder", "target", "nan", "joint"])
def test_without_what_it_needs_both_valves_are_safe(graph, pid, what):
    graph.add(RobotNode, autostart=True, rig=str(KOKORO), controller=str(pid))
    body = Body(graph)
    body.settles_at(5.8, 4.2)
    if what == "encoder":
        body.readings = False
    elif what == "target":
        body.targets = False
    elif what == "nan":
        body.elbow = math.nan
    else:
        body.names = ["other", "shoulder"]
    body.settles_at(5.0, 5.0)
    said = {
        "encoder": "no pressure reading",
        "target": "no target",
        "nan": "reading is no number",
        "joint": "no target",
    }
    wait_for(lambda: graph.status("robot: control").message.startswith(said[what]), 5.0)
    body.readings = body.targets = True
    body.elbow, body.names = 0.1, ["other", "elbow"]
    body.settles_at(5.8, 4.2)


def test_deactivated_it_says_the_safe_voltage_once(graph, pid):
    node = graph.add(RobotNode, autostart=True, rig=str(KOKORO), controller=str(pid))
    body = Body(graph)
    body.settles_at(5.8, 4.2)
    graph.run_in_executor(node.trigger_deactivate)
    body.settles_at(5.0, 5.0)
    count = len(body.commands)
    time.sleep(0.2)
    assert len(body.commands) == count


def test_a_target_that_does_not_reach_far_enough_is_not_followed(graph, tmp_path):
    """A policy that looks 0.1 s ahead."""
    recipe = RobotRecipe(
        encoders={"elbow": {}}, tracked=["elbow"], taps=list(TAPS), commands=["head", "rod"],
        preview_s=[0.0, 0.1], levels=0, past=0, opposed=True,
    )  # fmt: skip
    weights = np.zeros((1, recipe.size), np.float32)
    weights[0, 1] = 0.5  # of the error 0.1 s ahead
    layers = [(weights, np.zeros(1, np.float32))]
    RobotPolicy(layers, recipe, robot_identity(load_rig(KOKORO)), {}).save(tmp_path / "p.npz")
    graph.add(RobotNode, autostart=True, rig=str(KOKORO), controller=str(tmp_path / "p.npz"))
    body = Body(graph)
    body.target = [0.3, 0.3, 0.3]
    body.settles_at(5.0 + 5.0 * 0.1, 5.0 - 5.0 * 0.1)
    body.ahead_s = 0.05
    body.settles_at(5.0, 5.0)
    wait_for(lambda: "it tells 0.05 s ahead" in graph.status("robot: control").message, 5.0)


def test_what_is_no_controller_of_the_rig_is_refused(graph, pid, tmp_path):
    recipe = RobotRecipe(
        encoders={"cart": {}}, tracked=["cart"], taps=["head", "rod"], commands=["head", "rod"],
        levels=0, past=0,
    )  # fmt: skip
    layers = [(np.zeros((2, recipe.size), np.float32), np.zeros(2, np.float32))]
    rail = load_rig(ROOT / "rigs" / "rail.yaml")
    RobotPolicy(layers, recipe, robot_identity(rail), {}).save(tmp_path / "rail.npz")
    text = pid.read_text()
    (tmp_path / "kind.yaml").write_text(text.replace("joint_pid", "magic"))
    (tmp_path / "gain.yaml").write_text(text.replace("kp_v:", "kp:"))
    (tmp_path / "tap.yaml").write_text(text.replace("head_port", "nose"))
    cases = {
        "rail.npz": "trained for rig 'rail', found rig 'kokoro'",
        "kind.yaml": "kind: found 'magic'",
        "gain.yaml": "gains: found 'kp'",
        "tap.yaml": "tap: found 'nose'",
        "none.yaml": "no such controller",
    }
    for name, said in cases.items():
        with pytest.raises(InputError, match=said):
            graph.add(RobotNode, autostart=True, rig=str(KOKORO), controller=str(tmp_path / name))
    with pytest.raises(InputError, match="parameter rig: found nothing"):
        graph.add(RobotNode, autostart=True, controller=str(pid))


def test_a_tuned_controller_comes_back_as_it_was_written(pid):
    rig = load_rig(KOKORO)
    one = load_robot_controller(pid, rig)
    assert isinstance(one, JointPidController)
    assert one.gains == [JointGains(4.0)]
    taps = dict.fromkeys(TAPS, 3e5)
    volts = one.step({"elbow": 0.1}, taps, np.array([[0.3]]))
    assert volts == {"head": pytest.approx(5.8), "rod": pytest.approx(4.2)}


def test_targets_are_the_same_for_the_same_seed(graph):
    heard = graph.listen(JointTrajectory, "joint_target", common.COMMAND_QOS)
    graph.add(JointTargetNode, seed=3, kind="smooth", preview_s=0.2, step_s=0.05)
    wait_for(lambda: len(heard) > 3)
    from pneu_policy.task.waves import Wave

    wave = Wave("smooth", -0.7, 0.7, 0.6, 3, jitter=0.6)
    first = common.from_stamp(heard[0].header.stamp)
    for message in heard[1:4]:
        since = (common.from_stamp(message.header.stamp) - first) * 1e-9
        told = [point.positions[0] for point in message.points]
        due = [p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in message.points]
        np.testing.assert_allclose(due, [0.0, 0.05, 0.1, 0.15, 0.2], atol=1e-9)
        begins = [wave.at(since + at) for at in due]
        assert np.abs(np.array(told) - begins).max() < 0.2  # it may have begun a message before
        assert list(message.joint_names) == ["elbow"]
