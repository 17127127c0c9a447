# SPDX-License-Identifier: Apache-2.0
"""The simulation's thread without ROS: commands, time, pace, steps and resets."""

import time
from pathlib import Path

import numpy as np
import pytest
from tests.live_graph import wait_for

from pneu_common.errors import InputError
from pneu_sim.nodes.stepper import Inputs, Pacing, Stepper
from pneu_sim.rig import load_rig
from pneu_sim.simulator import Simulator
from pneu_sim.valve import voltage_limits

ROOT = Path(__file__).parents[3]
RIG = load_rig(ROOT / "rigs/lab.yaml")
QUIET = RIG.model_copy(deep=True)
for tap in QUIET.taps.values():
    tap.noise_pa = tap.quantum_pa = 0.0
PERIOD_S = 0.004


class At:
    def __init__(self, nanoseconds):
        self.nanoseconds = nanoseconds


class Monotonic:
    def now(self):
        return At(time.monotonic_ns())


class SetClock:
    """A clock that the test sets."""

    nanoseconds = 0

    def now(self):
        return At(self.nanoseconds)


def make(pace="lock_step", factor=1.0, rig=QUIET, clock=None, **options):
    samples = []
    inputs = Inputs(rig, options.pop("timeout_s", 0.1), None)
    pacing = Pacing(pace, factor, clock or Monotonic(), clock is not None)
    stepper = Stepper(
        rig, inputs, pacing, PERIOD_S, options.pop("dx_m", None), 0,
        origin_ns=options.pop("origin_ns", None), publish=samples.append, running=lambda: True,
    )  # fmt: skip
    return stepper, inputs, samples


def ask(call, *arguments):
    """Asks the stepper's thread and waits for the answer."""
    box = []
    call(*arguments, box.append)
    wait_for(lambda: box or not call.__self__._thread.is_alive())
    return box[0]


@pytest.mark.parametrize("model", ["pde", "thin_plate", "delay_line"])
def test_steps_are_those_of_the_simulator_itself(model):
    rig = QUIET.model_copy(update={"model": model})
    stepper, inputs, samples = make(timeout_s=0.0, rig=rig)
    stepper.start()
    try:
        inputs.take({"voltage": 6.0})
        assert ask(stepper.ask_step, 0.2) == ("", 200_000_000)
        assert stepper.time_s == pytest.approx(0.2)
    finally:
        stepper.stop()
    whole = Simulator(rig).run(0.2, {"voltage": 6.0}, PERIOD_S)
    assert samples[0].taps is None
    for name, series in whole.taps.items():
        live = np.array([s.taps[name] for s in samples[1:]])
        assert np.array_equal(live, series[1:])


def test_a_command_gives_way_to_the_closed_valve_when_it_is_too_old():
    stepper, inputs, _ = make(timeout_s=0.1)
    stepper.start()
    try:
        assert inputs.report(0.0).waiting
        inputs.take({"voltage": 8.0})
        ask(stepper.ask_step, 0.1)
        assert inputs.now(0.096) == {"voltage": 8.0}
        assert inputs.now(0.100) == {"voltage": 5.0}
        assert inputs.report(0.2).stale == ["voltage"]
        inputs.take({"voltage": 7.0})
        assert inputs.now(0.2) == {"voltage": 7.0}
    finally:
        stepper.stop()


def test_what_is_not_finite_is_ignored_and_what_is_too_much_is_clamped():
    inputs = Inputs(RIG, 0.0, None)
    inputs.take({"voltage": 6.0})
    for volts in (float("nan"), float("inf"), float("-inf")):
        inputs.take({"voltage": volts})
    assert inputs.now(0.0) == {"voltage": 6.0}
    inputs.take({"voltage": 1e300})
    assert inputs.now(0.0) == {"voltage": voltage_limits(RIG)["voltage"][1]} == {"voltage": 10.0}
    inputs.take({"voltage": -1e300})
    assert inputs.now(0.0) == {"voltage": 0.0}
    report = inputs.report(0.0)
    assert (report.taken, report.ignored, report.clamped) == (3, 3, 2)


def test_vent_is_the_voltage_asked_for():
    assert Inputs(RIG, 0.1, 0.0).now(0.0) == {"voltage": 0.0}


@pytest.mark.realtime
@pytest.mark.parametrize("factor", [1.0, 2.0])
def test_real_time_is_kept_at_the_factor_asked_for(factor):
    stepper, _, samples = make("real_time", factor)
    stepper.start()
    try:
        # Kernels are loaded, and that time was made up for.
        wait_for(lambda: len(samples) > 100 or not stepper._thread.is_alive())
        assert stepper._thread.is_alive()
        stepper.pace_report()
        began, first = time.monotonic(), stepper.time_s
        time.sleep(1.5)
        gone = (stepper.time_s - first) / (time.monotonic() - began)
        report = stepper.pace_report()
    finally:
        stepper.stop()
    assert gone == pytest.approx(factor, rel=0.1)
    assert report.reached == pytest.approx(factor, rel=0.1)
    steps = np.diff([s.stamp_ns for s in samples])
    assert set(steps) == {round(PERIOD_S * 1e9)}


@pytest.mark.realtime
def test_what_cannot_keep_time_says_so_and_lets_time_slip():
    stepper, _, _ = make("real_time", 50.0, dx_m=0.02)
    stepper.start()
    try:
        time.sleep(0.3)
        stepper.pace_report()
        time.sleep(0.5)
        report = stepper.pace_report()
    finally:
        stepper.stop()
    assert report.behind and report.reached < 45.0 and report.slipped_s > 0.0


@pytest.mark.realtime
def test_a_clock_that_others_set_is_followed_through_pause_and_jump_back():
    clock = SetClock()
    clock.nanoseconds = 5 * 10**9
    stepper, _, _ = make("real_time", clock=clock)
    stepper.start()
    try:
        time.sleep(0.1)
        held = stepper.time_s
        time.sleep(0.1)
        assert stepper.time_s == held <= PERIOD_S
        for _ in range(20):
            clock.nanoseconds += 10_000_000
            time.sleep(0.005)
        assert stepper.time_s == pytest.approx(0.2, abs=0.02)
        clock.nanoseconds = 10**9  # back: no catching up, no standstill
        time.sleep(0.05)
        before = stepper.time_s
        for _ in range(10):
            clock.nanoseconds += 10_000_000
            time.sleep(0.005)
        assert stepper.time_s - before == pytest.approx(0.1, abs=0.02)
    finally:
        stepper.stop()


def test_a_reset_starts_over_and_refuses_what_the_rig_does_not_have():
    stepper, inputs, samples = make(timeout_s=0.0)
    stepper.start()
    try:
        inputs.take({"voltage": 9.0})
        ask(stepper.ask_step, 0.1)
        assert "no such part" in ask(stepper.ask_reset, {"nothing": 1e5})[0]
        assert ask(stepper.ask_reset, {"tube": 3e5}) == ("", 0)
        assert stepper.time_s == 0.0
        ask(stepper.ask_step, PERIOD_S)
        assert samples[-1].taps["end"] == pytest.approx(3e5, rel=1e-3)
        assert inputs.report(0.0).waiting  # the old command is not in force any more
    finally:
        stepper.stop()


@pytest.mark.parametrize("duration_s", [0.0, -1.0, 0.0061])
def test_a_step_is_a_whole_number_of_periods(duration_s):
    stepper, _, _ = make()
    with pytest.raises(InputError, match="whole number of control periods"):
        stepper.ask_step(duration_s, print)


def test_steps_are_for_lock_step_alone():
    stepper, _, _ = make("real_time")
    with pytest.raises(InputError, match="lock_step only"):
        stepper.ask_step(PERIOD_S, print)
