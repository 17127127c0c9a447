# SPDX-License-Identifier: Apache-2.0
"""Nodes of controllers and targets on a graph: tracking, life cycle, what is missing or wrong."""

import math
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from tests.graph_fixtures import domain, graph  # isort: skip
from tests.live_graph import wait_for  # isort: skip

from diagnostic_msgs.msg import DiagnosticStatus
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from pneu_msgs.msg import PressureTarget, ValveCommand
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import FluidPressure

from pneu_common.errors import InputError
from pneu_graph.launch.plan import Plan
from pneu_graph.nodes import common
from pneu_policy.control.controllers import PidController, save_pid
from pneu_policy.control.identity import rig_identity
from pneu_policy.control.observations import Recipe
from pneu_policy.control.pid import Gains
from pneu_policy.control.policy_file import PolicyFile
from pneu_policy.control.predictive_file import save_predictive
from pneu_policy.nodes.pid import PidNode
from pneu_policy.nodes.policy import PolicyNode
from pneu_policy.nodes.target import TargetNode
from pneu_policy.task.targets import Target
from pneu_sim.rig import load_rig

pytestmark = [pytest.mark.realtime, pytest.mark.takes(55)]

__all__ = ["domain", "graph"]  # fixtures

ROOT = Path(__file__).parents[3]
GAINS = {"kp_v_per_pa": 1e-5, "ki_v_per_pa_s": 0.0}


class Plant:
    """Readings and targets that the test sets, published until it stops."""

    def __init__(self, graph, others=()):
        self.pressure_pa, self.target_pa = 200e3, 250e3
        self.readings = self.targets = True
        self.noise_pa, self.frozen = 0.0, False
        self.off_s = 0.0
        self.stalled = None  # a stamp that readings at the end keep
        self.ahead_pa = []  # what a target tells beyond the present
        self.others = dict.fromkeys(others, 300e3)
        probe = self.probe = graph.probe
        self.pressure = probe.create_publisher(FluidPressure, "taps/end/pressure", 10)
        self.publishers = {
            tap: probe.create_publisher(FluidPressure, f"taps/{tap}/pressure", 10) for tap in others
        }
        self.target = probe.create_publisher(PressureTarget, "target", common.COMMAND_QOS)
        self.commands = graph.listen(ValveCommand, "valve/command", common.COMMAND_QOS)
        probe.create_timer(0.01, self.tick, clock=common.steady_clock())
        wait_for(lambda: self.pressure.get_subscription_count() == 1)

    def tick(self):
        now = self.probe.get_clock().now().to_msg()
        self.noise_pa = 0.0 if self.frozen else 1e-3 - self.noise_pa
        if self.readings:
            message = FluidPressure(fluid_pressure=self.pressure_pa + self.noise_pa)
            behind = common.from_stamp(now) + round(1e9 * self.off_s)
            message.header.stamp = self.stalled or common.to_stamp(behind)
            self.pressure.publish(message)
        for tap, pressure_pa in list(self.others.items()):
            message = FluidPressure(fluid_pressure=pressure_pa + self.noise_pa)
            message.header.stamp = now
            self.publishers[tap].publish(message)
        if self.targets:
            values = [self.target_pa, *self.ahead_pa]
            message = PressureTarget(tap="end", step_s=0.1, pressure_pa=values)
            message.header.stamp = now
            self.target.publish(message)

    def volts(self):
        return self.commands[-1].voltage_v[0] if self.commands else math.nan

    def period_s(self):
        """Return the median time between commands: a busy machine drops some, but not most."""
        first = len(self.commands)
        wait_for(lambda: len(self.commands) > first + 100)
        stamps = [common.from_stamp(command.header.stamp) for command in self.commands[first:]]
        return 1e-9 * np.median(np.diff(stamps))

    def settles_at(self, volts):
        wait_for(lambda: self.volts() == pytest.approx(volts, abs=1e-6))


def test_it_commands_the_voltage_of_its_law_at_its_rate(graph):
    graph.add(PidNode, autostart=True, rate_hz=100.0, **GAINS)
    plant = Plant(graph)
    plant.settles_at(5.5)
    plant.pressure_pa = 300e3
    plant.settles_at(4.5)
    assert plant.period_s() == pytest.approx(0.01, rel=0.1)
    assert list(plant.commands[-1].name) == ["voltage"]
    assert "tracking" in graph.status("control").message


def test_gains_may_be_changed_within_their_ranges(graph):
    node = graph.add(PidNode, autostart=True, **GAINS)
    plant = Plant(graph)
    plant.settles_at(5.5)
    assert node.set_parameters([Parameter("kp_v_per_pa", value=2e-5)])[0].successful
    plant.settles_at(6.0)
    assert not node.set_parameters([Parameter("kp_v_per_pa", value=-1.0)])[0].successful
    (refused,) = node.set_parameters([Parameter("null_v", value=11.0)])
    assert not refused.successful and "null_v" in refused.reason
    assert not node.set_parameters([Parameter("tap", value="middle")])[0].successful
    assert plant.volts() == pytest.approx(6.0)


def test_stale_readings_and_targets_lead_to_the_safe_voltage_and_back(graph):
    graph.add(PidNode, autostart=True, sensor_timeout_s=0.1, safe_voltage_v=4.25, **GAINS)
    plant = Plant(graph)
    plant.settles_at(5.5)
    plant.readings = False
    plant.settles_at(4.25)
    status = graph.status("control")
    assert status.level == DiagnosticStatus.WARN and "no pressure reading" in status.message
    plant.readings = True
    plant.settles_at(5.5)
    plant.targets = False
    plant.settles_at(4.25)
    assert "no target" in graph.status("control").message
    plant.targets = True
    plant.settles_at(5.5)


def test_readings_that_are_no_numbers_are_as_good_as_none(graph):
    graph.add(PidNode, autostart=True, **GAINS)
    plant = Plant(graph)
    plant.settles_at(5.5)
    plant.pressure_pa = math.nan
    plant.settles_at(5.0)
    plant.pressure_pa, plant.target_pa = 200e3, math.inf
    plant.settles_at(5.0)
    plant.target_pa = 250e3
    plant.settles_at(5.5)


def test_life_cycle(graph):
    graph.add(PidNode, safe_voltage_v=4.0, **GAINS)

    def change(transition):
        request = ChangeState.Request()
        request.transition.id = transition
        return graph.call(ChangeState, "pid/change_state", request).success

    def state():
        return graph.call(GetState, "pid/get_state", GetState.Request()).current_state.id

    assert state() == State.PRIMARY_STATE_UNCONFIGURED
    assert change(Transition.TRANSITION_CONFIGURE)
    plant = Plant(graph)
    time.sleep(0.2)
    assert not plant.commands  # inactive: no command
    assert change(Transition.TRANSITION_ACTIVATE)
    plant.settles_at(5.5)
    assert change(Transition.TRANSITION_DEACTIVATE)
    plant.settles_at(4.0)
    time.sleep(0.1)
    count = len(plant.commands)
    time.sleep(0.2)
    assert len(plant.commands) == count  # and silence
    assert change(Transition.TRANSITION_ACTIVATE)
    plant.settles_at(5.5)
    assert change(Transition.TRANSITION_DEACTIVATE)
    assert change(Transition.TRANSITION_CLEANUP)
    assert state() == State.PRIMARY_STATE_UNCONFIGURED
    assert change(Transition.TRANSITION_CONFIGURE)


def test_readings_and_targets_that_cannot_be_are_none(graph):
    """Not even those whose square is no number."""
    graph.add(PidNode, autostart=True, **GAINS)
    plant = Plant(graph)
    plant.settles_at(5.5)
    for value in (1e30, 0.0, -5e5, 1e155, 1e308, -1e308):
        since = graph.mark()
        plant.pressure_pa = value
        plant.settles_at(5.0)
        graph.wait_until_told("control", "reading cannot be true", since)
        plant.pressure_pa = 200e3
        plant.settles_at(5.5)
        since = graph.mark()
        plant.target_pa = value
        plant.settles_at(5.0)
        graph.wait_until_told("control", "no target", since)
        plant.target_pa = 250e3
        plant.settles_at(5.5)


def test_a_frozen_tap_is_dead(graph):
    """With new stamps, while the valve is driven: what is blown into changes."""
    graph.add(PidNode, autostart=True, **GAINS)
    plant = Plant(graph)
    plant.settles_at(5.5)
    plant.frozen = True
    plant.settles_at(5.0)
    assert "reading does not change" in graph.status("control").message
    time.sleep(0.5)
    assert {command.voltage_v[0] for command in plant.commands[-50:]} == {5.0}
    plant.frozen = False
    plant.settles_at(5.5)


@pytest.mark.parametrize("off_s", [-3600.0, 3600.0, -20.0])
def test_readings_of_another_time_are_none(graph, off_s):
    graph.add(PidNode, autostart=True, **GAINS)
    plant = Plant(graph)
    plant.settles_at(5.5)
    plant.off_s = off_s
    plant.settles_at(5.0)
    assert "reading is of another time" in graph.status("control").message
    plant.off_s = 0.0
    plant.settles_at(5.5)


@pytest.mark.parametrize(("factor", "every_s"), [(100.0, 0.004), (0.01, 0.004), (100.0, 0.02)])
def test_simulated_time_that_is_out_of_its_mind_is_not_followed(graph, factor, every_s):
    """Neither where it only runs fast, nor where every step of it is a leap."""
    clock = graph.probe.create_publisher(Clock, "/clock", 1)
    graph.add(PidNode, autostart=True, use_sim_time=True, kp_v_per_pa=1e-5, ki_v_per_pa_s=0.0)
    commands = graph.listen(ValveCommand, "valve/command", common.COMMAND_QOS)
    pressure = graph.probe.create_publisher(FluidPressure, "taps/end/pressure", 10)
    target = graph.probe.create_publisher(PressureTarget, "target", common.COMMAND_QOS)
    wait_for(lambda: clock.get_subscription_count() and pressure.get_subscription_count())
    at_s = 100.0
    for rate in (1.0, factor):
        begin_s = before_s = time.monotonic()
        count = 0
        while time.monotonic() < begin_s + 1.0:
            time.sleep(0.004 if rate == 1.0 else every_s)
            now_s = time.monotonic()
            at_s, before_s = at_s + rate * (now_s - before_s), now_s
            stamp = common.to_stamp(round(at_s * 1e9))
            count += 1
            clock.publish(Clock(clock=stamp))
            reading = FluidPressure(fluid_pressure=200e3 + count % 2 * 1e-3)
            wanted = PressureTarget(tap="end", step_s=0.1, pressure_pa=[250e3])
            reading.header.stamp = wanted.header.stamp = stamp
            pressure.publish(reading)
            target.publish(wanted)
            if rate != 1.0 and now_s < begin_s + 0.5:
                commands.clear()
        told = {round(command.voltage_v[0], 3) for command in commands[-20:]}
        if rate == 1.0:  # safe voltages between are those of a machine that stalls
            assert 5.5 in told <= {5.0, 5.5}
        else:
            assert told == {5.0} if rate > 1.0 else told <= {5.0}, rate


def test_a_controller_that_fails_goes_on_and_is_safe(graph):
    class Failing(PidNode):
        def _step(self, stamp_ns, pressures_pa):
            if pressures_pa["end"] > 400e3:
                raise OverflowError("too much")
            return super()._step(stamp_ns, pressures_pa)

    graph.add(Failing, autostart=True, **GAINS)
    plant = Plant(graph)
    plant.settles_at(5.5)
    plant.pressure_pa = 500e3
    plant.settles_at(5.0)
    wait_for(lambda: "the controller failed" in graph.status("control").message)
    plant.pressure_pa = 200e3
    plant.settles_at(5.5)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_its_last_word_is_the_safe_voltage(graph, number):
    program = (
        "from pneu_runtime import hook; hook.install();"
        "from pneu_policy.nodes.pid import main; import sys; main(sys.argv[1:])"
    )
    words = [f"{name}:={value}" for name, value in {**GAINS, "autostart": "true"}.items()]
    command = [sys.executable, "-c", program, "--ros-args"]
    process = subprocess.Popen([*command, *(w for word in words for w in ("-p", word))])
    try:
        plant = Plant(graph)
        wait_for(lambda: plant.volts() == pytest.approx(5.5), 20.0)
        process.send_signal(number)
        assert process.wait(10.0) == 0
    finally:
        process.kill()
    plant.settles_at(5.0)


def test_a_clock_that_jumps_back_is_survived(graph):
    clock = graph.probe.create_publisher(Clock, "/clock", 1)
    graph.add(PidNode, autostart=True, use_sim_time=True, ki_v_per_pa_s=1e-4, kp_v_per_pa=1e-5)
    commands = graph.listen(ValveCommand, "valve/command", common.COMMAND_QOS)
    pressure = graph.probe.create_publisher(FluidPressure, "taps/end/pressure", 10)
    target = graph.probe.create_publisher(PressureTarget, "target", common.COMMAND_QOS)
    wait_for(lambda: clock.get_subscription_count() and pressure.get_subscription_count())

    def run(begin_s, seconds):
        for k in range(round(seconds / 0.004)):
            stamp = common.to_stamp(round((begin_s + k * 0.004) * 1e9))
            clock.publish(Clock(clock=stamp))
            reading = FluidPressure(fluid_pressure=200e3 + k % 2 * 1e-3)
            wanted = PressureTarget(tap="end", step_s=0.1, pressure_pa=[250e3])
            reading.header.stamp = wanted.header.stamp = stamp
            pressure.publish(reading)
            target.publish(wanted)
            time.sleep(0.004)

    run(100.0, 1.0)
    assert commands[-1].voltage_v[0] == pytest.approx(
        6.5, abs=1e-6
    )  # the integral has grown to its limit
    count = len(commands)
    run(1.0, 0.5)
    assert len(commands) > count + 50  # it goes on
    volts = [m.voltage_v[0] for m in commands[count:]]
    assert all(math.isfinite(v) for v in volts)
    assert min(volts[2:20]) < 6.0  # and began anew
    assert common.from_stamp(commands[-1].header.stamp) < 2e9


def test_bad_gains_are_refused_at_the_start(graph):
    with pytest.raises(InputError, match="null_v"):
        graph.add(PidNode, null_v=12.0)


def test_targets_are_those_of_the_seed_with_their_preview(graph):
    heard = graph.listen(PressureTarget, "target", common.COMMAND_QOS)
    graph.add(TargetNode, seed=5, kind="jagged", rate_hz=50.0, preview_s=0.5, step_s=0.02)
    wait_for(lambda: len(heard) > 40)
    first, later = heard[0], heard[30]
    begin = common.from_stamp(first.header.stamp)
    target = Target("jagged", 150e3, 500e3, 0.6, 5)
    assert len(later.pressure_pa) == 26
    # The first message heard need not be the first one sent: its start is found by its values.
    offsets = np.arange(0.0, 2.0, 0.0005)
    misses = [
        np.abs(target.at(o + 0.02 * np.arange(26)) - first.pressure_pa).max() for o in offsets
    ]
    start = offsets[int(np.argmin(misses))]
    assert min(misses) < 2000.0
    at = start + (common.from_stamp(later.header.stamp) - begin) * 1e-9 + 0.02 * np.arange(26)
    assert np.abs(target.at(at) - later.pressure_pa).max() < 4000.0


def test_a_target_may_begin_at_a_time_of_its_own_with_moved_corners(graph):
    heard = graph.listen(PressureTarget, "target", common.COMMAND_QOS)
    graph.add(TargetNode, seed=5, kind="jagged", jitter=0.6, start_s=30.0, preview_s=2.0)
    wait_for(lambda: heard)
    target = Target("jagged", 150e3, 500e3, 0.6, 5, jitter=0.6)
    # The first message heard may be some tenths of a second after the start.
    ahead = 0.02 * np.arange(len(heard[0].pressure_pa))
    misses = [
        np.abs(target.at(30.0 + late + ahead) - heard[0].pressure_pa).max()
        for late in np.arange(0.0, 1.0, 0.0005)
    ]
    assert min(misses) < 2000.0


def test_an_unknown_kind_of_target_is_refused(graph):
    with pytest.raises(InputError, match="smooth, jagged, hold, mixed"):
        graph.add(TargetNode, kind="wavy")


def write_policy(path, weights, taps=("middle", "end"), rig="rig_a_fitted", **recipe):
    """A policy of one linear layer, made so that its voltages are known by heart."""
    made = Recipe(tap="end", taps=taps, levels=0, **{"preview_s": (0.0, 0.1), **recipe})
    layer = np.zeros((1, made.size), dtype=np.float32)
    for name, value in weights.items():
        layer[0, made.names().index(name)] = value
    identity = rig_identity(load_rig(ROOT / f"rigs/{rig}.yaml"))
    layers = [(layer, np.zeros(1, dtype=np.float32))]
    PolicyFile(layers, made, identity, {"algorithm": "by hand"}).save(path)
    return str(path)


@pytest.fixture
def policy(tmp_path):
    # 1 V for an error of 100 kPa now, 2 V for one in 0.1 s.
    return write_policy(tmp_path / "made.npz", {"error at 0 s": 0.2, "error at 0.1 s": 0.4})


def test_the_policy_commands_the_voltage_of_its_network_at_the_period_of_its_file(graph, policy):
    graph.add(PolicyNode, autostart=True, policy=policy)
    plant = Plant(graph, ["middle"])
    plant.ahead_pa = [300e3, 300e3]
    plant.settles_at(5.0 + 0.5 + 2.0)
    plant.pressure_pa = 300e3
    plant.settles_at(4.5)
    assert plant.period_s() == pytest.approx(0.01, rel=0.1)
    status = graph.status("policy: control")
    assert "tracking" in status.message
    rms = {pair.key: float(pair.value) for pair in status.values}["rms error (Pa)"]
    assert rms == pytest.approx(50e3, rel=1e-3)


def test_the_target_is_taken_at_the_time_of_the_reading(graph, tmp_path):
    path = write_policy(tmp_path / "made.npz", {"error at 0.1 s": 1.0}, taps=("end",))
    graph.add(PolicyNode, autostart=True, policy=path, sensor_timeout_s=1.0)
    commands = graph.listen(ValveCommand, "valve/command", common.COMMAND_QOS)
    pressure = graph.probe.create_publisher(FluidPressure, "taps/end/pressure", 10)
    target = graph.probe.create_publisher(PressureTarget, "target", common.COMMAND_QOS)
    wait_for(lambda: pressure.get_subscription_count() and target.get_subscription_count())
    now = graph.probe.get_clock().now().nanoseconds
    ramp = PressureTarget(tap="end", step_s=0.1, pressure_pa=[200e3 + 1e4 * k for k in range(6)])
    ramp.header.stamp = common.to_stamp(now)
    reading = FluidPressure(fluid_pressure=200e3)
    reading.header.stamp = common.to_stamp(now + 250_000_000)
    target.publish(ramp)
    pressure.publish(reading)
    # 0.25 s after the target's stamp and 0.1 s ahead of that: 35 kPa up the ramp, 5 V per 100 kPa.
    wait_for(lambda: commands and commands[-1].voltage_v[0] == pytest.approx(5.0 + 1.75, abs=1e-5))


def test_a_tap_that_was_never_heard_or_falls_silent_is_named_and_the_valve_safe(graph, policy):
    graph.add(PolicyNode, autostart=True, policy=policy, safe_voltage_v=4.25)
    plant = Plant(graph, ["middle"])
    plant.ahead_pa = [250e3, 250e3]
    silent = plant.others.pop("middle")
    plant.settles_at(4.25)
    status = graph.status("policy: control")
    assert status.level == DiagnosticStatus.WARN
    assert "safe voltage (never heard 'middle' on /taps/middle/pressure)" in status.message
    plant.others["middle"] = silent
    plant.settles_at(6.5)
    del plant.others["middle"]
    plant.settles_at(4.25)
    assert "for 0.05 s nothing new of 'middle'" in graph.status("policy: control").message
    plant.others["middle"] = silent
    plant.settles_at(6.5)
    plant.targets = False
    plant.settles_at(4.25)
    assert "for 0.25 s none on /target" in graph.status("policy: control").message


def test_a_reading_that_is_no_number_makes_the_valve_safe_at_once(graph, policy):
    graph.add(PolicyNode, autostart=True, policy=policy, sensor_timeout_s=1.0)
    plant = Plant(graph, ["middle"])
    plant.ahead_pa = [250e3, 250e3]
    plant.settles_at(6.5)
    begin = time.monotonic()
    plant.others["middle"] = math.nan
    plant.settles_at(5.0)
    assert time.monotonic() - begin < 0.9  # well before the timeout
    told = graph.status("policy: control").message
    assert told.startswith("reading is no number: safe voltage (found nan as 'middle' on")
    plant.others["middle"] = 300e3
    plant.settles_at(6.5)


@pytest.mark.parametrize("make", [PidNode, PolicyNode])
def test_a_stalled_reading_that_is_repeated_grows_old(graph, policy, make):
    own = {"policy": policy} if make is PolicyNode else GAINS
    graph.add(make, autostart=True, **own)
    plant = Plant(graph, ["middle"])
    plant.ahead_pa = [250e3, 250e3]
    wait_for(lambda: plant.volts() > 5.4)
    plant.stalled = graph.probe.get_clock().now().to_msg()
    plant.settles_at(5.0)
    told = graph.status("control").message
    assert "no pressure reading: safe voltage (for 0.05 s nothing new of 'end'" in told
    plant.stalled = None
    wait_for(lambda: plant.volts() > 5.4)


def test_a_target_that_tells_too_little_of_the_future_is_not_followed(graph, policy):
    graph.add(PolicyNode, autostart=True, policy=policy)
    plant = Plant(graph, ["middle"])
    plant.settles_at(5.0)
    told = graph.status("policy: control").message
    assert told == "target too short: safe voltage (it tells 0 s ahead, needed are 0.1)"
    plant.ahead_pa = [250e3]
    plant.settles_at(6.5)


def test_a_tuned_pid_runs_in_the_place_of_a_policy(graph, tmp_path):
    path = tmp_path / "pid.yaml"
    save_pid(PidController(Gains(kp_v_per_pa=1e-5), period_s=0.02), {}, path)
    graph.add(PolicyNode, autostart=True, policy=str(path), rig=str(ROOT / "rigs/lab.yaml"))
    Plant(graph).settles_at(5.5)


def test_the_launch_file_puts_a_policy_in_the_place_of_the_pid(tmp_path):
    launch = ROOT / "ros_ws/src/pneu_bringup/launch/rig.launch.yaml"
    rig = ROOT / "rigs/rig_a_fitted.yaml"
    given = {"controller": "policy", "policy": "deft.npz", "rig": str(rig)}
    words = [" ".join(spec.command) for spec in Plan(launch, given, os.environ, tmp_path).processes]
    nodes = [re.search(r"__node:=(\w+)", line)[1] for line in words]
    assert nodes == ["simulator", "policy", "target"]
    files = [Path(word) for word in words[1].split() if word.endswith(".yaml")]
    parameters = "".join(path.read_text() for path in files)
    assert "policy: deft.npz" in parameters and f"rig: {rig}" in parameters


def refusals(tmp_path):
    """Per case the parameters and what is told."""
    good = write_policy(tmp_path / "good.npz", {"error at 0 s": 1.0})
    cut = tmp_path / "cut.npz"
    cut.write_bytes(Path(good).read_bytes()[:-200])
    inside = write_policy(tmp_path / "inside.npz", {}, line=(("tube", 3),))
    other = str(ROOT / "rigs/rig_b_fitted.yaml")
    return {
        "none": ({}, "parameter policy: found none"),
        "missing": ({"policy": str(tmp_path / "x.npz")}, "x.npz: no such policy file"),
        "cut": ({"policy": str(cut)}, "cut.npz: is no policy file, or a damaged one"),
        "another rig": (
            {"policy": good, "rig": other},
            "good.npz: trained for rig 'rig_a', found rig 'rig_b': pipe 'tube' is 5 m long",
        ),
        "another valve": ({"policy": good, "command": "left"}, "the policy commands voltage"),
        "gas": ({"policy": inside}, "sees the gas of lines, which no sensor tells"),
    }


def test_what_cannot_control_the_rig_is_refused_in_a_sentence(graph, tmp_path):
    for parameters, told in refusals(tmp_path).values():
        with pytest.raises(InputError) as error:
            graph.add(PolicyNode, autostart=True, **parameters)
        assert told in str(error.value)


def test_a_policy_for_another_rig_is_not_configured_until_it_is_the_right_one(graph, tmp_path):
    parameters, told = refusals(tmp_path)["another rig"]
    graph.add(PolicyNode, **parameters)

    def configure():
        request = ChangeState.Request()
        request.transition.id = Transition.TRANSITION_CONFIGURE
        return graph.call(ChangeState, "policy/change_state", request).success

    since = graph.mark()
    assert not configure()
    status = graph.wait_until_told("policy: control", told, since)
    assert status.level == DiagnosticStatus.ERROR
    state = graph.call(GetState, "policy/get_state", GetState.Request()).current_state.id
    assert state == State.PRIMARY_STATE_UNCONFIGURED
    write_policy(parameters["policy"], {"error at 0 s": 1.0}, rig="rig_b_fitted")
    assert configure()


def test_a_predictive_controller_goes_on_without_its_tap_for_a_while(graph, tmp_path):
    path, rig = tmp_path / "ahead.yaml", ROOT / "rigs/lab.yaml"
    settings = {"holds": [1, 1, 2], "period_s": 0.05, "sample_s": 0.01}
    save_predictive(path, str(rig), "end", ["valve_out", "end"], settings)
    node = graph.add(PolicyNode, autostart=True, policy=str(path), virtual_for_s=1.5)
    beside = node._plans.controller.planning
    plant = Plant(graph, others=("valve_out",))
    plant.others["valve_out"] = plant.pressure_pa
    plant.ahead_pa = [250e3, 250e3, 250e3]
    wait_for(lambda: plant.volts() > 5.01)  # there is not enough air
    plant.readings = False

    def figure(key):
        told = {value.key: value.value for value in graph.status("control").values}
        return told.get(key, "")

    wait_for(lambda: figure("tap end") == "no pressure reading")
    plant.settles_at(5.0)
    plant.readings = True
    wait_for(lambda: plant.volts() > 5.01)
    graph.run_in_executor(node.trigger_deactivate)
    node.destroy_node()
    assert not beside._process.is_alive()
