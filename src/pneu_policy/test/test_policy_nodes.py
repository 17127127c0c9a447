# SPDX-License-Identifier: Apache-2.0
"""The PID and target nodes on a graph: tracking, life cycle, stale inputs, a clock set back."""

import math
import time

import numpy as np
import pytest

from tests.live_graph import own_domain, running_graph, wait_for  # isort: skip

from diagnostic_msgs.msg import DiagnosticStatus
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from pneu_msgs.msg import PressureTarget, ValveCommand
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import FluidPressure

from pneu_policy.nodes.pid import PidNode
from pneu_policy.nodes.target import TargetNode
from pneu_policy.targets import Target
from pneu_sim.errors import InputError
from pneu_sim.nodes import common

GAINS = {"kp_v_per_pa": 1e-5, "ki_v_per_pa_s": 0.0}


@pytest.fixture(scope="module", autouse=True)
def domain():
    with own_domain():
        yield


@pytest.fixture
def graph():
    with running_graph() as graph:
        yield graph


class Plant:
    """Readings and targets that the test sets, published until it stops."""

    def __init__(self, graph):
        self.pressure_pa, self.target_pa = 200e3, 250e3
        self.readings = self.targets = True
        probe = self.probe = graph.probe
        self.pressure = probe.create_publisher(FluidPressure, "taps/end/pressure", 10)
        self.target = probe.create_publisher(PressureTarget, "target", common.COMMAND_QOS)
        self.commands = graph.listen(ValveCommand, "valve/command", common.COMMAND_QOS)
        probe.create_timer(0.01, self.tick, clock=common.steady_clock())
        wait_for(lambda: self.pressure.get_subscription_count() == 1)

    def tick(self):
        now = self.probe.get_clock().now().to_msg()
        if self.readings:
            message = FluidPressure(fluid_pressure=self.pressure_pa)
            message.header.stamp = now
            self.pressure.publish(message)
        if self.targets:
            message = PressureTarget(tap="end", step_s=0.1, pressure_pa=[self.target_pa])
            message.header.stamp = now
            self.target.publish(message)

    def volts(self):
        return self.commands[-1].voltage_v[0] if self.commands else math.nan

    def settles_at(self, volts):
        wait_for(lambda: self.volts() == pytest.approx(volts, abs=1e-6))


def test_it_commands_the_voltage_of_its_law_at_its_rate(graph):
    graph.add(PidNode, autostart=True, rate_hz=100.0, **GAINS)
    plant = Plant(graph)
    plant.settles_at(5.5)
    plant.pressure_pa = 300e3
    plant.settles_at(4.5)
    begin, count = time.monotonic(), len(plant.commands)
    time.sleep(1.0)
    rate = (len(plant.commands) - count) / (time.monotonic() - begin)
    assert rate == pytest.approx(100.0, rel=0.1)
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
            reading = FluidPressure(fluid_pressure=200e3)
            wanted = PressureTarget(tap="end", step_s=0.1, pressure_pa=[250e3])
            reading.header.stamp = wanted.header.stamp = stamp
            pressure.publish(reading)
            target.publish(wanted)
            time.sleep(0.004)

    run(100.0, 1.0)
    assert commands[-1].voltage_v[0] == pytest.approx(6.5)  # the integral has grown to its limit
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


def test_an_unknown_kind_of_target_is_refused(graph):
    with pytest.raises(InputError, match="smooth, jagged, hold, mixed"):
        graph.add(TargetNode, kind="wavy")
