# SPDX-License-Identifier: Apache-2.0
"""The identification node on a graph: the action to its end, cancelled, and the live watch."""

import time
from pathlib import Path

import pytest

from tests.graph_fixtures import domain, graph  # isort: skip
from tests.live_graph import wait_for  # isort: skip

from action_msgs.msg import GoalStatus
from diagnostic_msgs.msg import DiagnosticStatus
from pneu_msgs.action import Identify
from pneu_msgs.msg import EncoderResiduals, TapResiduals, ValveCommand
from rclpy.action import ActionClient

from pneu_graph.nodes import common
from pneu_sim.nodes.simulator import SimulatorNode
from pneu_sim.rig import load_rig, save_rig
from pneu_sim.rig.schema import AttachedEffect
from pneu_sysid.nodes.identify import IdentifyNode

pytestmark = pytest.mark.realtime

__all__ = ["domain", "graph"]  # fixtures

ROOT = Path(__file__).parents[3]
BAG = str(ROOT / "data/bags/a_healthy_2")
RIG = str(ROOT / "rigs/rig_a_fitted.yaml")
LAB = ROOT / "rigs/lab.yaml"


class Client:
    """A client of the action that keeps what it is told."""

    def __init__(self, graph):
        self.client = ActionClient(graph.probe, Identify, "identify/identify")
        assert self.client.wait_for_server(timeout_sec=5.0)
        self.stages = []

    def send(self, task, output, bag=BAG):
        goal = Identify.Goal(task=task, bag=bag, rig=RIG, output=str(output))
        sent = self.client.send_goal_async(
            goal, feedback_callback=lambda m: self.stages.append(m.feedback)
        )
        wait_for(sent.done)
        return sent.result()

    def result(self, handle, seconds=60.0):
        got = handle.get_result_async()
        wait_for(got.done, seconds)
        return got.result()


@pytest.mark.long
def test_a_comparison_reports_progress_and_where_its_result_is(graph, tmp_path):
    graph.add(IdentifyNode, workers=2)
    client = Client(graph)
    handle = client.send("compare", tmp_path / "report.html")
    assert handle.accepted
    answer = client.result(handle)
    assert answer.status == GoalStatus.STATUS_SUCCEEDED
    assert answer.result.success and answer.result.message == ""
    assert answer.result.result_file == str(tmp_path / "report.json")
    assert (tmp_path / "report.html").is_file()
    assert client.stages[-1].progress == 1.0


@pytest.mark.long
def test_a_cancelled_goal_ends_its_process_and_leaves_nothing(graph, tmp_path):
    graph.add(IdentifyNode, workers=1)
    client = Client(graph)
    handle = client.send("learn", tmp_path / "learned")
    wait_for(lambda: client.stages, 30.0)
    second = client.send("compare", tmp_path / "other.html")
    assert not second.accepted  # one at a time
    began = time.monotonic()
    cancelled = handle.cancel_goal_async()
    wait_for(cancelled.done)
    answer = client.result(handle)
    assert time.monotonic() - began < 4.0
    assert answer.status == GoalStatus.STATUS_CANCELED
    assert answer.result.message == "cancelled"
    assert list(tmp_path.iterdir()) == []
    third = client.send("compare", tmp_path / "other.html")
    assert third.accepted and client.result(third).result.success


def test_bad_input_aborts_with_its_sentence(graph, tmp_path):
    graph.add(IdentifyNode)
    client = Client(graph)
    answer = client.result(client.send("fit", tmp_path / "x.yaml", bag="nowhere"))
    assert answer.status == GoalStatus.STATUS_ABORTED
    assert "bag: found 'nowhere'" in answer.result.message


@pytest.mark.long
@pytest.mark.parametrize("leak_m2", [0.0, 1e-7])
def test_the_watch_tells_a_changed_rig_from_the_one_it_knows(graph, tmp_path, leak_m2):
    plant = load_rig(LAB)
    if leak_m2:
        where = {"area_m2": leak_m2, "position_m": 1.0}
        plant.effects = [AttachedEffect(effect="leak", place="tube", parameters=where)]
    save_rig(plant, tmp_path / "plant.yaml")
    residuals = graph.listen(TapResiduals, "taps/residuals", 10)
    graph.add(SimulatorNode, rig=str(tmp_path / "plant.yaml"), publish_rate_hz=250.0)
    graph.add(IdentifyNode, watch_rig=str(LAB))
    publisher = graph.probe.create_publisher(ValveCommand, "valve/command", common.COMMAND_QOS)
    count = iter(range(1_000_000))

    def command():
        message = ValveCommand(name=["voltage"], voltage_v=[6.2 if next(count) % 60 < 30 else 4.4])
        message.header.stamp = graph.probe.get_clock().now().to_msg()
        publisher.publish(message)

    graph.probe.create_timer(0.02, command)
    wait_for(lambda: len(residuals) >= 4, 15.0)
    newest = residuals[-1]
    assert list(newest.name) == list(plant.taps) and newest.window_s == 0.5
    assert newest.noise_floor_pa[0] == pytest.approx(250.0)
    if leak_m2:  # measured minus model, and the model has gas that has leaked from the rig
        end = list(plant.taps).index("end")
        wait_for(lambda: min(r.residual_pa[end] for r in residuals) < -2000.0, 10.0)
    # A stall of the machine spoils a window or two: what counts is where the verdict settles.
    level = DiagnosticStatus.ERROR if leak_m2 else DiagnosticStatus.OK
    wait_for(lambda: graph.status("model lab").level == level, 10.0)
    message = graph.status("model lab").message
    assert ("does not describe the rig" if leak_m2 else "as expected") in message


@pytest.mark.long
def test_the_watch_follows_a_joint_by_its_name(graph):
    """A robot that sways: its angle's residual is told in rad, apart from the taps' in Pa."""
    path = str(LAB.with_name("kokoro.yaml"))
    rig = load_rig(path)
    angles = graph.listen(EncoderResiduals, "encoders/residuals", 10)
    pressures = graph.listen(TapResiduals, "taps/residuals", 10)
    graph.add(SimulatorNode, rig=path, publish_rate_hz=250.0)
    graph.add(IdentifyNode, watch_rig=path)
    count = iter(range(1_000_000))
    publisher = graph.probe.create_publisher(ValveCommand, "valve/command", common.COMMAND_QOS)

    def command():
        swing = 0.3 if next(count) % 16 < 8 else -0.3
        publisher.publish(ValveCommand(name=["head", "rod"], voltage_v=[5.0 + swing, 5.0 - swing]))

    graph.probe.create_timer(0.02, command)
    wait_for(lambda: len(angles) >= 2 and len(pressures) >= 2, 20.0)
    newest = angles[-1]
    assert list(newest.name) == ["elbow"] and list(newest.unit) == ["rad"]
    assert 0.0 <= newest.rms[0] < 2.0 and abs(newest.residual[0]) < 4.0
    assert list(pressures[-1].name) == list(rig.taps)
