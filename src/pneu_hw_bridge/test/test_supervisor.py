# SPDX-License-Identifier: Apache-2.0
"""The safety state machine: each rule by itself, and what must hold under any stream of events."""

import math
import random
from itertools import pairwise

import pytest

from pneu_common.errors import InputError
from pneu_hw_bridge.registers.load import load_register_map
from pneu_hw_bridge.safety.limits import Limits, OutputLimits, SensorLimits, limits_of
from pneu_hw_bridge.safety.supervisor import State, Supervisor

pytestmark = pytest.mark.realtime

SAFE_V = 1.0


def make(**changes):
    sensor = SensorLimits(1e4, 1.6e6, trip_above_pa=9e5, hold_below_pa=5e4, frozen_after_s=0.2)
    limits = {
        "outputs": {"voltage": OutputLimits(0.0, 10.0, SAFE_V)},
        "sensors": {"end": sensor},
        "watchdog_s": 0.1,
        "sensor_timeout_s": 0.1,
        "slew_v_s": 1e6,
        "clamp_margin_v": 1.0,
        **changes,
    }
    return Supervisor(Limits(**limits))


class Bench:
    """A supervisor with a healthy bus and sensor, and its time."""

    def __init__(self, **changes):
        self.supervisor = make(**changes)
        self.now = 100.0
        self.pressure = 3e5
        self.supervisor.bus("")
        self.supervisor.publishers(1)
        self.supervisor.enable()
        self.step()

    def step(self, dt=0.01, command=None, sense=True):
        self.now += dt
        if sense:
            self.pressure += 1.0  # noise, so that it is not frozen
            self.supervisor.reading("end", self.pressure, self.now)
        refused = "" if command is None else self.supervisor.command({"voltage": command}, self.now)
        return self.supervisor.output(self.now)["voltage"], refused

    def follows_after_a_second(self, command):
        """Whether a stream of commands is not followed before, and then."""
        outputs = [self.step(command=command)[0] for _ in range(102)]
        return set(outputs[:96]) == {SAFE_V} and outputs[-1] == command

    @property
    def state(self):
        return self.supervisor.state(self.now)


def test_follows_a_healthy_stream():
    bench = Bench()
    assert bench.step(command=7.0) == (7.0, "")
    assert bench.state is State.FOLLOWING


def test_watchdog_vents_after_its_time_and_recovers_with_new_commands():
    bench = Bench()
    bench.step(command=7.0)
    assert bench.step(0.09)[0] == 7.0
    assert bench.step(0.02)[0] == SAFE_V
    assert bench.state is State.HOLDING
    assert "none for" in bench.supervisor.explain(bench.now)
    assert bench.supervisor.counters.watchdog == 1
    assert bench.follows_after_a_second(6.0)


@pytest.mark.parametrize("watchdog_s", [0.0, -0.1, 0.11, math.nan, math.inf])
def test_hardware_refuses_to_run_without_a_short_watchdog(watchdog_s):
    with pytest.raises(InputError, match="watchdog_s"):
        limits_of(load_register_map("generic_plc"), watchdog_s=watchdog_s)


@pytest.mark.parametrize("value", [math.inf, -math.inf, 11.5, -1.5, 1e30, math.nan])
def test_absurd_commands_are_refused_and_do_not_feed_the_watchdog(value):
    bench = Bench()
    bench.step(command=7.0)
    for _ in range(9):
        _, refused = bench.step(command=value)
        assert refused
    assert bench.step(0.02, command=value)[0] == SAFE_V


def test_small_excess_is_clamped_and_counted():
    bench = Bench()
    assert bench.step(command=10.4) == (10.0, "")
    assert bench.supervisor.counters.clamped == 1


def test_slew_limit_holds_back_commands_but_never_the_safe_state():
    bench = Bench(slew_v_s=10.0)
    bench.step(0.0)
    volts = [bench.step(0.01, command=9.0)[0] for _ in range(20)]
    steps = [b - a for a, b in zip([SAFE_V, *volts], volts, strict=False)]
    assert max(steps) == pytest.approx(0.1)
    bench.supervisor.e_stop("test")
    assert bench.step(1e-6)[0] == SAFE_V


def test_over_pressure_latches_until_reset_and_the_pressure_has_fallen():
    bench = Bench()
    bench.step(command=7.0)
    bench.pressure = 9.5e5
    assert bench.step(command=7.0)[0] == SAFE_V
    assert bench.state is State.TRIPPED
    assert "still at" in bench.supervisor.reset(bench.now)
    bench.pressure = 3e5
    assert bench.step(command=7.0)[0] == SAFE_V, "a lower pressure alone releases nothing"
    assert bench.supervisor.reset(bench.now) == ""
    assert bench.step()[0] == SAFE_V, "no command from before the reset is followed"
    assert bench.step(command=7.0)[0] == SAFE_V, "nor one that goes on"
    bench.step(command=SAFE_V)
    assert bench.step(command=7.0)[0] == 7.0


def test_a_sensor_at_the_end_of_its_range_trips_where_that_is_above_the_limit():
    bench = Bench()
    bench.step(command=7.0)
    bench.pressure = 1.7e6  # the sensor ends at 1.6e6
    assert bench.step(command=7.0)[0] == SAFE_V
    assert bench.state is State.TRIPPED
    bench.pressure = 3e5
    assert bench.step(command=7.0)[0] == SAFE_V
    assert bench.supervisor.reset(bench.now) == ""
    bench.step(command=SAFE_V)
    assert bench.step(command=7.0)[0] == 7.0


@pytest.mark.parametrize("period_s", [0.02, 0.1, 0.3, 0.7])
def test_valves_do_not_flutter_with_a_sensor(period_s):
    """It is safe at once, and stays so until nothing was wrong for a second."""
    bench = Bench()
    bench.step(command=7.0)
    healthy, outputs = bench.pressure, []
    for k in range(4000):
        bad = k == 3999 or (k * 0.002) % period_s < 0.5 * period_s
        bench.pressure = math.nan if bad else healthy + k
        outputs.append(bench.step(0.002, command=7.0)[0])
    assert set(outputs) == {SAFE_V}
    bench.pressure = healthy
    assert bench.follows_after_a_second(7.0)


@pytest.mark.parametrize("pause_s", [0.15, 0.5])
def test_valves_do_not_flutter_with_a_controller_that_is_too_slow(pause_s):
    bench = Bench()
    outputs = []
    for k in range(1000):
        due = k % round(pause_s / 0.01) == 0
        outputs.append(bench.step(0.01, command=7.0 if due else None)[0])
    changes = sum(a != b for a, b in pairwise(outputs))
    assert changes == 1
    assert outputs[-1] == SAFE_V


def test_e_stop_is_latched_and_wins():
    bench = Bench()
    bench.step(command=7.0)
    bench.supervisor.e_stop("test")
    assert bench.step(command=7.0) == (SAFE_V, "test")
    bench.supervisor.disable()
    bench.supervisor.enable()
    assert bench.step(command=7.0)[0] == SAFE_V
    assert bench.state is State.E_STOP
    assert bench.supervisor.reset(bench.now) == ""
    assert bench.step(command=7.0)[0] == SAFE_V
    bench.supervisor.disable()
    bench.supervisor.enable()
    assert bench.step(command=7.0)[0] == 7.0


@pytest.mark.parametrize("stop", ["stopped", "tripped"])
@pytest.mark.parametrize("first_v", [7.0, SAFE_V + 0.011, SAFE_V + 0.009, SAFE_V])
def test_a_reset_restarts_no_motion(stop, first_v):
    """ISO 13850: whoever went on commanding first commands the safe voltage, or is let in anew."""
    bench = Bench()
    bench.step(command=7.0)
    if stop == "stopped":
        bench.supervisor.e_stop("test")
    else:
        healthy, bench.pressure = bench.pressure, 9.5e5
        bench.step(command=7.0)
        bench.pressure = healthy
    bench.step(command=7.0)
    assert bench.supervisor.reset(bench.now) == ""
    assert {bench.step(0.01, command=7.0)[0] for _ in range(300)} == {SAFE_V}
    told = "waits after a reset for the safe voltage (voltage 1 V), or for activation"
    assert bench.step(command=7.0) == (SAFE_V, told) and told in bench.supervisor.explain(bench.now)
    assert bench.supervisor.reset(bench.now) == "", "a second reset changes nothing"
    bench.step(0.01, command=first_v)
    released = first_v <= SAFE_V + 0.01
    assert bench.step(0.01, command=7.0)[0] == (7.0 if released else SAFE_V)


def test_latches_outlive_a_new_supervisor():
    first = make()
    first.e_stop("test")
    again = Supervisor(first.limits, first.latches)
    again.enable()
    assert again.state(0.0) is State.E_STOP


@pytest.mark.parametrize("write_s", [0.0, 0.03, 0.06, 0.1, 0.12])
def test_commands_are_followed_for_so_long_that_all_is_safe_in_time(write_s):
    bench = Bench()
    bench.supervisor.takes(write_s, write_s)
    assert bench.step(command=5.0)[0] == 5.0
    silent_s = 0.0
    while bench.step(0.001)[0] != SAFE_V:
        silent_s += 0.001
    assert silent_s + write_s < 0.151
    assert silent_s > min(0.1, 0.15 - write_s) - 0.002, "and for no less"


def test_a_device_that_is_too_slow_is_not_driven_and_this_is_said():
    bench = Bench()
    bench.supervisor.takes(0.2, 0.14)
    assert bench.step(command=5.0)[0] == SAFE_V
    assert "too slow: valves would be safe after 0.16 s at best" in bench.supervisor.explain(
        bench.now
    )
    bench.supervisor.takes(0.2, 0.1)  # now and then only
    assert bench.step(command=5.0)[0] == 5.0


def test_two_publishers_vent_until_one_is_gone():
    bench = Bench()
    bench.step(command=7.0)
    bench.supervisor.publishers(2)
    output, refused = bench.step(command=7.0)
    assert output == SAFE_V
    assert "2 publishers" in refused
    bench.supervisor.publishers(1)
    assert bench.follows_after_a_second(7.0)


@pytest.mark.parametrize(
    ("pressure", "says"),
    [
        (math.nan, "out of its range"),
        (-4e5, "out of its range"),
        (5e6, "out of its range"),
        (2e4, "below 50000 Pa"),
    ],
)
def test_a_sensor_that_cannot_be_believed_vents(pressure, says):
    bench = Bench()
    bench.step(command=7.0)
    healthy, bench.pressure = bench.pressure, pressure
    assert bench.step(command=7.0)[0] == SAFE_V
    assert says in bench.supervisor.explain(bench.now)
    bench.pressure = healthy
    assert bench.follows_after_a_second(7.0)


def test_a_stale_sensor_vents():
    bench = Bench()
    for _ in range(9):
        assert bench.step(0.01, command=7.0, sense=False)[0] == 7.0
    assert bench.step(0.02, command=7.0, sense=False)[0] == SAFE_V
    assert "stale" in bench.supervisor.explain(bench.now)


def test_a_frozen_sensor_vents():
    bench = Bench()
    outputs = []
    for _ in range(30):
        bench.pressure -= 1.0  # takes back the noise
        outputs.append(bench.step(0.01, command=7.0)[0])
    assert outputs[10] == 7.0
    assert outputs[-1] == SAFE_V
    assert "frozen" in bench.supervisor.explain(bench.now)


def test_a_lost_bus_vents_and_forgets_commands():
    bench = Bench()
    bench.step(command=7.0)
    bench.supervisor.bus("no connection")
    assert bench.step()[0] == SAFE_V
    bench.supervisor.bus("")
    assert bench.step()[0] == SAFE_V
    assert bench.follows_after_a_second(7.0)


def test_a_command_of_nobody_who_is_known_is_not_followed():
    bench = Bench()
    bench.supervisor.publishers(0)
    assert bench.step(command=7.0) == (SAFE_V, "nobody is known to publish commands")
    bench.supervisor.publishers(1)
    assert bench.step()[0] == SAFE_V, "nor is it later"
    assert bench.step(command=7.0)[0] == 7.0
    bench.supervisor.publishers(1, "the publisher on the command topic belongs to no node")
    assert "belongs to no node" in bench.step(command=7.0)[1]
    assert bench.step()[0] == SAFE_V


def test_the_next_controller_has_not_to_wait_for_the_one_before():
    bench = Bench()
    bench.step(command=7.0)
    bench.supervisor.publishers(0)
    for _ in range(300):
        assert bench.step()[0] == SAFE_V
    bench.supervisor.publishers(1)
    assert bench.step(command=6.0)[0] == 6.0


def test_unknown_outputs_are_refused():
    bench = Bench()
    assert "this bridge has voltage" in bench.supervisor.command({"other": 1.0}, bench.now)


@pytest.mark.parametrize("seed", range(20))
def test_under_any_stream_only_fresh_valid_commands_reach_the_valves(seed):
    """Against a record of events that is kept apart from the state machine."""
    rng = random.Random(seed)
    supervisor = make(slew_v_s=500.0)
    now, last_output = 0.0, SAFE_V
    good_s = read_s = -math.inf
    reading, changed_s = math.nan, -math.inf
    enabled = e_stop = tripped = False
    bus, publishers = "down", 0
    followed, following, opened_s = 0, False, []
    for _ in range(20000):
        dt = rng.choice([1e-4, 0.002, 0.01]) if rng.random() < 0.99 else rng.uniform(0.05, 0.3)
        now += dt
        event = rng.random()
        if event < 0.45:
            reading = rng.uniform(2e5, 4e5)
            if rng.random() < 0.002:
                reading = rng.choice([math.nan, 2e6, 9.9e5, 1.0, 3e4])
            supervisor.reading("end", reading, now)
            read_s = changed_s = now
            tripped = tripped or reading > 9e5
            if tripped:
                good_s = -math.inf
        elif event < 0.9:
            value = rng.uniform(-0.9, 10.9)
            if rng.random() < 0.05:
                value = rng.choice([math.nan, math.inf, -math.inf, 50.0, -3.0])
            supervisor.command({"voltage": value}, now)
            valid = -1.0 <= value <= 11.0
            if valid and enabled and publishers == 1 and not e_stop and not tripped:
                good_s = now
        elif event < 0.92:
            enabled, opened_s = rng.random() < 0.8, []
            (supervisor.enable if enabled else supervisor.disable)()
            good_s = -math.inf
        elif event < 0.94:
            bus = "" if rng.random() < 0.8 else "down"
            supervisor.bus(bus)
        elif event < 0.96:
            publishers = rng.choice([0, 1, 1, 1, 2])
            supervisor.publishers(publishers)
            if publishers != 1:
                good_s = -math.inf
        elif event < 0.965:
            supervisor.e_stop("test")
            e_stop, good_s = True, -math.inf
        elif event < 0.99 and supervisor.reset(now) == "":
            opened_s = [] if e_stop or tripped else opened_s
            e_stop = tripped = False
            good_s = -math.inf
        output = supervisor.output(now)["voltage"]
        sensible = 5e4 <= reading <= 1.6e6 and now - read_s <= 0.1 and now - changed_s <= 0.2
        may_follow = (
            enabled
            and not e_stop
            and not tripped
            and not bus
            and publishers <= 1
            and sensible
            and now - good_s <= 0.1
        )
        assert math.isfinite(output) and 0.0 <= output <= 10.0
        if not may_follow:
            assert output == SAFE_V
        if output != SAFE_V:
            followed += 1
            assert abs(output - last_output) <= 500.0 * dt + 1e-9
        following, before = supervisor.state(now) is State.FOLLOWING, following
        if following and not before:
            assert not opened_s or now - opened_s[-1] > 1.0 - 1e-9
            opened_s.append(now)
        last_output = output
    assert followed > 100, "the stream must also follow, or nothing was shown"
