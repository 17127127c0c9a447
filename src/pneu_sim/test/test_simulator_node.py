# SPDX-License-Identifier: Apache-2.0
"""The simulator node on a graph: topics, pace, lock-step, reset, what it says of trouble."""

import itertools
import math
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.graph_fixtures import domain, graph  # isort: skip
from tests.live_graph import wait_for  # isort: skip

from diagnostic_msgs.msg import DiagnosticStatus
from pneu_msgs.msg import LineState, TapPressures, ValveCommand
from pneu_msgs.srv import ResetSimulator, StepSimulator
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from ruamel.yaml import YAML
from sensor_msgs.msg import FluidPressure, JointState

from pneu_common.errors import InputError
from pneu_graph.nodes import common
from pneu_sim.init import TEMPLATES
from pneu_sim.nodes.simulator import SimulatorNode
from pneu_sim.plant import Plant
from pneu_sim.rig import load_rig

pytestmark = [pytest.mark.realtime, pytest.mark.takes(20)]

__all__ = ["domain", "graph"]  # fixtures

LAB = str(Path(__file__).parents[3] / "rigs/lab.yaml")
RATE_HZ = 250.0


def simulator(graph, **parameters):
    return graph.add(SimulatorNode, **{"rig": LAB, "publish_rate_hz": RATE_HZ, **parameters})


def step(seconds):
    request = StepSimulator.Request()
    request.duration.sec = int(seconds)
    request.duration.nanosec = round((seconds % 1.0) * 1e9)
    return request


def command(volts):
    return ValveCommand(name=["voltage"], voltage_v=[volts])


def test_taps_come_one_by_one_and_as_a_set_at_the_stamps_of_their_samples(graph):
    simulator(graph)
    single = graph.listen(FluidPressure, "taps/supply/pressure")
    together = graph.listen(TapPressures, "taps/pressures")
    wait_for(lambda: len(single) > 100 and len(together) > 100)
    stamps = [common.from_stamp(m.header.stamp) for m in list(single)]
    steps = {b - a for a, b in itertools.pairwise(stamps)}
    assert min(steps) == round(1e9 / RATE_HZ)
    assert abs(stamps[-1] - time.time_ns()) < 2e9
    assert single[0].header.frame_id == "supply"
    assert single[0].variance == pytest.approx(250.0**2)
    at = {common.from_stamp(m.header.stamp): m for m in list(together)}
    common_stamps = [m for m in list(single) if common.from_stamp(m.header.stamp) in at]
    assert len(common_stamps) > 50
    for message in common_stamps:
        same = at[common.from_stamp(message.header.stamp)]
        assert list(same.name) == ["supply", "valve_out", "middle", "end", "exhaust"]
        assert same.pressure_pa[0] == message.fluid_pressure
    assert single[-1].fluid_pressure == pytest.approx(635e3, rel=0.01)


def test_commands_open_the_valve_and_their_end_closes_it(graph):
    node = simulator(graph)
    taps = graph.listen(FluidPressure, "taps/end/pressure")
    assert "no command yet" in graph.status("commands").message
    publisher = graph.probe.create_publisher(ValveCommand, "valve/command", common.COMMAND_QOS)
    wait_for(lambda: publisher.get_subscription_count() == 1)
    for _ in range(60):
        publisher.publish(command(7.0))
        time.sleep(0.01)
    assert taps[-1].fluid_pressure > 300e3
    for volts in (math.nan, math.inf):
        publisher.publish(command(volts))
        time.sleep(0.1)  # commands are not queued: the newest one counts
    time.sleep(0.4)
    held = taps[-1].fluid_pressure
    status = graph.status("commands")
    assert status.level == DiagnosticStatus.WARN and "safe state" in status.message
    values = {v.key: v.value for v in status.values}
    assert values["voltage (V)"] == "5" and values["not finite, ignored"] == "2"
    assert taps[-1].fluid_pressure == pytest.approx(held, rel=0.02)  # closed, neither way
    pace = graph.status("pace")
    assert pace.level == DiagnosticStatus.OK, pace.message
    assert node.count_publishers("valve/command") == 1


def test_two_publishers_of_commands_are_noticed(graph):
    simulator(graph)
    for _ in range(2):
        graph.probe.create_publisher(ValveCommand, "valve/command", common.COMMAND_QOS)
    wait_for(lambda: "several publishers" in graph.status("commands").message)


def test_lock_step_keeps_its_own_clock_and_starts_over_at_zero(graph):
    simulator(graph, pace="lock_step", publish_clock=True, command_timeout_s=0.0)
    clock = graph.listen(Clock, "/clock")
    taps = graph.listen(FluidPressure, "taps/end/pressure")
    publisher = graph.probe.create_publisher(ValveCommand, "valve/command", common.COMMAND_QOS)
    wait_for(lambda: publisher.get_subscription_count() == 1)
    publisher.publish(command(6.5))
    time.sleep(0.2)
    done = graph.call(StepSimulator, "simulator/step", step(0.1))
    assert (done.success, common.from_stamp(done.stamp)) == (True, 100_000_000), done.message
    done = graph.call(StepSimulator, "simulator/step", step(0.1))
    assert common.from_stamp(done.stamp) == 200_000_000
    wait_for(lambda: taps and common.from_stamp(taps[-1].header.stamp) == 200_000_000)
    assert taps[-1].fluid_pressure > 150e3
    assert common.from_stamp(clock[-1].clock) == 200_000_000
    time.sleep(0.1)
    assert common.from_stamp(clock[-1].clock) == 200_000_000  # it waits
    refused = graph.call(StepSimulator, "simulator/step", step(0.0051))
    assert not refused.success and "whole number" in refused.message
    reset = graph.call(
        ResetSimulator, "simulator/reset", ResetSimulator.Request(name=["tube"], pressure_pa=[3e5])
    )
    assert reset.success, reset.message
    wait_for(lambda: common.from_stamp(clock[-1].clock) == 0)
    done = graph.call(StepSimulator, "simulator/step", step(0.004))
    wait_for(lambda: common.from_stamp(taps[-1].header.stamp) == 4_000_000)
    assert taps[-1].fluid_pressure == pytest.approx(3e5, rel=0.01)


def test_a_reset_that_cannot_be_is_refused(graph):
    simulator(graph, pace="lock_step")
    for request, told in (
        (ResetSimulator.Request(name=["tube"]), "equally many"),
        (ResetSimulator.Request(name=["tube"], pressure_pa=[-1.0]), "not positive"),
        (ResetSimulator.Request(name=["x"], pressure_pa=[1e5]), "no such part"),
    ):
        answer = graph.call(ResetSimulator, "simulator/reset", request)
        assert not answer.success and told in answer.message


def test_the_state_of_lines_is_for_those_who_listen(graph):
    node = simulator(graph, line_state_rate_hz=50.0)
    lines = graph.listen(LineState, "lines/tube/state")
    wait_for(lambda: len(lines) > 5)
    state = lines[-1]
    assert state.line == "tube"
    assert len(state.position_m) == len(state.density_kg_m3) == len(state.pressure_pa) == 30
    assert state.position_m[0] == pytest.approx(0.025)
    assert all(p == pytest.approx(101e3, rel=0.01) for p in state.pressure_pa)
    gaps = [common.from_stamp(m.header.stamp) for m in lines[:5]]
    assert gaps[1] - gaps[0] == pytest.approx(20e6, rel=0.01)
    assert node.count_publishers("lines/exhaust_tube/state") == 1


def test_what_cannot_keep_real_time_says_so(graph):
    simulator(graph, factor=100.0, dx_m=0.02)
    wait_for(lambda: "cannot keep time" in graph.status("pace").message)


def test_parameters_have_ranges_and_the_rest_is_fixed(graph):
    node = simulator(graph)
    assert node.set_parameters([Parameter("factor", value=2.0)])[0].successful
    assert not node.set_parameters([Parameter("factor", value=1000.0)])[0].successful
    assert not node.set_parameters([Parameter("rig", value="other.yaml")])[0].successful
    for name in node.list_parameters([], 0).names:
        if name not in ("use_sim_time", "start_type_description_service"):
            assert node.describe_parameter(name).description, name


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"rig": ""}, "parameter rig: found nothing"),
        ({"rig": "nowhere.yaml"}, "nowhere.yaml: no such rig file"),
        ({"pace": "fast"}, "allowed are real_time"),
    ],
)
def test_bad_parameters_are_refused_in_a_sentence(graph, changed, told):
    with pytest.raises(InputError, match=told):
        simulator(graph, **changed)


def test_there_is_one_clock(graph):
    graph.probe.create_publisher(Clock, "/clock", 1)
    with pytest.raises(InputError, match="/clock already has a publisher"):
        simulator(graph, publish_clock=True)


def test_it_says_ready_when_it_answers_and_not_while_kernels_are_compiled(graph, tmp_path):
    """Started as users do; where kernels are to be compiled that takes half a minute."""
    command = [
        sys.executable,
        "-m",
        "pneu_common.cli",
        "run",
        "pneu_sim",
        "simulator",
        "--ros-args",
    ]
    command += ["-p", f"rig:={LAB}", "-p", "pace:=lock_step"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        try:
            said = []
            while "ready: rig 'lab'" not in (said or [""])[-1]:
                said.append(process.stderr.readline())
                assert said[-1], said
            client = graph.probe.create_client(ResetSimulator, "/simulator/reset")
            assert client.wait_for_service(timeout_sec=60.0)
            begun = time.monotonic()
            future = client.call_async(ResetSimulator.Request())
            wait_for(future.done)
            assert future.result().success
            assert time.monotonic() - begun < 5.0
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(10.0)


# ---- what moves ----------------------------------------------------------------------------------


def moving(folder, **slide):
    """The template of `pneu init --kind cylinder`, its slide changed."""
    yaml = YAML(typ="safe")
    rig = yaml.load(TEMPLATES / "cylinder.yaml")
    rig["bodies"]["load"]["slide"].update(slide)
    rig["commands"]["voltage"] = {}  # then it is commanded on valve/command
    path = folder / "rig.yaml"
    yaml.dump(rig, path)
    Plant([load_rig(path)])  # what moves is compiled here, not while the graph waits
    return str(path)


def test_joints_come_with_every_sample_and_start_over_with_a_reset(graph, tmp_path):
    rig = moving(tmp_path, start=0.02)
    node = simulator(graph, rig=rig, pace="lock_step", publish_clock=True, command_timeout_s=0.0,
                     line_state_rate_hz=50.0)  # fmt: skip
    joints = graph.listen(JointState, "joint_states", common.FAST_QOS)
    taps = graph.listen(TapPressures, "taps/pressures", common.FAST_QOS)
    publisher = graph.probe.create_publisher(ValveCommand, "valve/command", common.COMMAND_QOS)
    wait_for(lambda: publisher.get_subscription_count() == 1)
    for heard in ("joint_states", "taps/pressures"):
        wait_for(lambda heard=heard: node.count_subscribers(heard) == 1)
    for name in ("head_line", "rod_line"):  # and no gas of a cylinder
        assert node.count_publishers(f"lines/{name}/state") == 1
    topics = [name for name, _ in node.get_topic_names_and_types()]
    assert len([name for name in topics if name.startswith("/lines/")]) == 2
    publisher.publish(command(10.0))
    time.sleep(0.2)
    assert graph.call(StepSimulator, "simulator/step", step(0.02)).success
    wait_for(lambda: len(joints) == 5 and len(taps) == 5)
    assert [m.header.stamp for m in joints] == [m.header.stamp for m in taps]
    assert all(list(m.name) == ["load_slide"] for m in joints)
    assert all(len(m.position) == len(m.velocity) == 1 for m in joints)
    assert joints[0].header.frame_id == "cylinder"
    assert common.from_stamp(joints[-1].header.stamp) == 20_000_000
    assert graph.call(StepSimulator, "simulator/step", step(0.1)).success
    wait_for(lambda: len(joints) == 30)
    assert joints[-1].position[0] > 0.09
    pairs = list(itertools.pairwise(joints[:9]))  # before it meets its end
    moved = [b.position[0] - a.position[0] for a, b in pairs]
    mean = [0.5 * (a.velocity[0] + b.velocity[0]) / RATE_HZ for a, b in pairs]
    assert moved == pytest.approx(mean, abs=0.1 * max(moved))
    assert graph.call(ResetSimulator, "simulator/reset", ResetSimulator.Request()).success
    assert graph.call(StepSimulator, "simulator/step", step(0.004)).success  # valves shut again
    wait_for(lambda: len(joints) == 31)
    assert joints[-1].position[0] == pytest.approx(0.02, abs=1e-6)
    assert joints[-1].velocity[0] == pytest.approx(0.0, abs=1e-6)


def test_a_rig_without_taps_and_commands_has_joints_alone(graph, tmp_path):
    side = {"node": "closed", "dead_volume_m3": 1e-6}
    rig = {
        "pneu_rig": 1, "name": "spring",
        "cylinders": {"c": {"bore_m": 0.02, "stroke_m": 0.1, "head": side, "rod": side}},
        "bodies": {"b": {"kind": "rail", "cylinder": "c", "mass_kg": 0.5, "incline_rad": 1.57,
                         "slide": {"start": 0.06}}},
    }  # fmt: skip
    path = tmp_path / "rig.yaml"
    YAML(typ="safe").dump(rig, path)
    node = simulator(graph, rig=str(path))
    joints = graph.listen(JointState, "joint_states")
    wait_for(lambda: len(joints) > 20)
    assert min(m.position[0] for m in joints) < 0.0599
    for name in ("taps/pressures", "valve/applied"):
        assert node.count_publishers(name) == 0
    status = graph.status("commands")
    assert (status.level, status.message) == (DiagnosticStatus.OK, "there are none")


def test_a_channel_on_the_topic_of_joints_is_refused(graph, tmp_path):
    path = Path(moving(tmp_path))
    path.write_text(path.read_text().replace("/taps/rod", "joint_states"))
    with pytest.raises(InputError, match="channel of 'rod': topic 'joint_states' is that of the"):
        simulator(graph, rig=str(path))


def test_joints_of_a_mechanism_are_published_too(graph):
    pytest.importorskip("mujoco", reason="MuJoCo is an extra of the package")
    rig = Path(__file__).resolve().parents[3] / "rigs" / "arm4.yaml"
    Plant([load_rig(rig)])  # what moves is compiled here, not while the graph waits
    simulator(graph, rig=str(rig), pace="lock_step", publish_clock=True, command_timeout_s=0.0)
    joints = graph.listen(JointState, "joint_states", common.FAST_QOS)
    assert graph.call(StepSimulator, "simulator/step", step(0.02)).success
    wait_for(lambda: len(joints) > 0)
    assert list(joints[-1].name) == ["yaw", "shoulder", "elbow"]
    assert all(math.isfinite(x) for x in (*joints[-1].position, *joints[-1].velocity))


def test_a_rig_with_encoders_publishes_what_they_read_with_noise_of_the_seed(graph, tmp_path):
    path = Path(moving(tmp_path, start=0.02))
    encoders = "encoders:\n  place: {joint: load_slide, noise: 4.0e-4, quantum: 5.0e-4}\n"
    path.write_text(path.read_text() + encoders)
    node = simulator(graph, rig=str(path), pace="lock_step", publish_clock=True)
    read = graph.listen(JointState, "joint_states", common.FAST_QOS)
    wait_for(lambda: node.count_subscribers("joint_states") == 1)
    for count in (20, 40):
        assert graph.call(StepSimulator, "simulator/step", step(0.08)).success
        wait_for(lambda n=count: len(read) == n)
        assert graph.call(ResetSimulator, "simulator/reset", ResetSimulator.Request()).success
    assert all(list(m.name) == ["place"] and not len(m.velocity) for m in read)
    first, again = ([m.position[0] for m in part] for part in (read[:20], read[20:]))
    assert first == again, "the same seed, the same noise"
    steps = [place / 5e-4 for place in first]
    assert steps == pytest.approx([round(s) for s in steps], abs=1e-9)
    assert min(first) < max(first) and abs(sum(first) / 20 - 0.02) < 5e-4
