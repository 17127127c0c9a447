# SPDX-License-Identifier: Apache-2.0
"""Every condition of the safety supervisor, at its boundary and one step beyond.

All times and voltages are sums of powers of two, so that "exactly at the limit" is exact. Limits
differ from each other, and the output, sensor or encoder in question is never the first.
"""

import dataclasses
import math

import pytest

from pneu_hw_bridge.safety.limits import Limits, OutputLimits, SensorLimits
from pneu_hw_bridge.safety.motion import EncoderLimits, FrozenLimits
from pneu_hw_bridge.safety.supervisor import Counters, Latches, State, Supervisor

pytestmark = pytest.mark.kernel_free

TICK_S = 2.0**-20
WATCHDOG_S, SENSOR_TIMEOUT_S, FROZEN_S = 0.09375, 0.078125, 0.1875
DWELL_S, SAFE_WITHIN_S, STUCK_S = 0.75, 0.125, 0.0625
SLEW_V_S = 256.0
SAFE = {"head": 1.0, "rod": -2.0}
READINGS = {"supply": 400000.0, "middle": 262144.0, "end": 131072.0}
PLACES = {"hip": 0.5, "elbow": 0.25}
# Pushes the elbow with 12 + 2^-12 * middle - 2^-13 * end: 60 N at these readings.
FROZEN = FrozenLimits(
    {"middle": 2.0**-12, "end": -(2.0**-13)}, 60.0, 12.0, STUCK_S, 0.0078125, (-1.5, 1.5)
)
LIMITS = Limits(
    outputs={"head": OutputLimits(0.0, 8.0, 1.0), "rod": OutputLimits(-4.0, 4.0, -2.0)},
    sensors={
        "supply": SensorLimits(1e4, 1e6, hold_below_pa=3e5),
        "middle": SensorLimits(2e4, 8e5),
        "end": SensorLimits(1e4, 6e5, 5e5, frozen_after_s=FROZEN_S),
    },
    watchdog_s=WATCHDOG_S,
    sensor_timeout_s=SENSOR_TIMEOUT_S,
    slew_v_s=SLEW_V_S,
    clamp_margin_v=0.5,
    dwell_s=DWELL_S,
    safe_within_s=SAFE_WITHIN_S,
    encoders={
        "hip": EncoderLimits((-3.0, 3.0), -2.5, 2.5),
        "elbow": EncoderLimits((-2.0, 2.0), -1.0, 1.0, impossible=8.0, frozen=FROZEN),
    },
)
"""Limits of which no two are alike."""


def up(value):
    return math.nextafter(value, math.inf)


def down(value):
    return math.nextafter(value, -math.inf)


class Bench:
    """A supervisor of which everything is healthy, its time, and what differs from healthy."""

    def __init__(self, **changes):
        self.one = Supervisor(dataclasses.replace(LIMITS, **changes))
        self.now = 64.0
        self._noise = 0.0
        self.one.bus("")
        self.one.publishers(1)
        self.one.enable()
        self.sense()
        self.one.output(self.now)

    def sense(self, without=(), **values):
        """Takes a reading of each sensor and encoder, but for some."""
        self._noise = 1.0 - self._noise  # so that no pressure freezes
        for name, value in READINGS.items():
            if name not in without:
                self.one.reading(name, values.get(name, value + self._noise), self.now)
        for name, value in PLACES.items():
            if name not in without:
                # Each time by a little more than what counts as no movement.
                place = values.get(name, value + 0.015625 * self._noise)
                self.one.position(name, place, self.now, self.now)

    def step(self, dt, without=(), head=2.0, rod=3.0, **values):
        """Passes time, takes readings and a command, and returns the output."""
        self.now += dt
        self.sense(without, **values)
        given = {"head": head, "rod": rod}
        self.one.command({n: v for n, v in given.items() if n not in without}, self.now)
        return self.one.output(self.now)

    def follow(self):
        """Passes time until both outputs are what is commanded."""
        for _ in range(4):
            found = self.step(0.03125)
        assert found == {"head": 2.0, "rod": 3.0}
        return self

    @property
    def state(self):
        return self.one.state(self.now)

    def reasons(self):
        return self.one.reasons(self.now)


# What it begins with


def test_a_new_supervisor_lacks_everything_and_says_so():
    one = Supervisor(LIMITS)
    assert set(dataclasses.asdict(one.counters).values()) == {0}
    assert one.output(64.0) == SAFE
    assert (one.state(64.0), one.explain(64.0)) == (State.DISABLED, "not active")
    assert one.command({"rod": 3.0}, 64.0) == "nobody is known to publish commands"
    one.publishers(1)
    assert one.command({"rod": 3.0}, 64.0) == "not active"
    one.enable()
    lacks = [
        "bus: not connected yet",
        "sensor supply: never read",
        "sensor middle: never read",
        "sensor end: never read",
        "encoder hip: never read",
        "encoder elbow: never read",
        "command head: none yet",
        "command rod: none yet",
    ]
    assert one.reasons(64.0) == lacks
    assert (one.state(64.0), one.explain(64.0)) == (State.HOLDING, "; ".join(lacks))
    assert one.output(64.0) == SAFE
    assert one.counters == Counters(competing=1)


def test_a_healthy_one_follows_and_has_no_reason_not_to():
    bench = Bench().follow()
    assert (bench.state, bench.reasons(), bench.one.explain(bench.now)) == (
        State.FOLLOWING,
        [],
        "",
    )
    assert bench.one.counters.accepted == 4


# Reasons to hold


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("middle", "sensor middle: stale for 0.08 s"),
        ("end", "sensor end: stale for 0.08 s"),
        ("elbow", "encoder elbow: stale for 0.08 s"),
    ],
)
def test_a_reading_may_be_as_old_as_the_sensor_timeout_and_no_older(name, says):
    bench = Bench().follow()
    bench.step(SENSOR_TIMEOUT_S, without=(name,))
    assert bench.state is State.FOLLOWING
    assert bench.step(TICK_S, without=(name,)) == SAFE
    assert bench.reasons()[0] == says
    assert bench.state is State.HOLDING


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("supply", 1e6, ""),
        ("supply", up(1e6), "sensor supply: 1e+06 Pa is out of its range"),
        ("supply", 3e5, ""),
        ("supply", down(3e5), "sensor supply: 300000 Pa is below 300000 Pa"),
        ("supply", 2e4, "sensor supply: 20000 Pa is below 300000 Pa"),
        ("middle", 2e4, ""),
        ("middle", down(2e4), "sensor middle: 20000 Pa is out of its range"),
        ("middle", 8e5, ""),
        ("middle", up(8e5), "sensor middle: 800000 Pa is out of its range"),
        ("end", math.nan, "sensor end: nan Pa is out of its range"),
        ("end", -math.inf, "sensor end: -inf Pa is out of its range"),
        ("elbow", math.nan, "encoder elbow: nan is out of its range"),
        ("elbow", math.inf, "encoder elbow: inf is out of its range"),
    ],
)
def test_a_reading_may_be_at_either_end_of_its_range_and_not_beyond(name, value, says):
    bench = Bench().follow()
    found = bench.step(2.0**-9, **{name: value})
    assert bench.one.latches == Latches()
    assert bench.reasons()[:1] == ([says] if says else [])
    assert (found == SAFE) is bool(says)
    assert bench.one.counters.bad_readings == (1 if "range" in says else 0)


def test_a_pressure_may_stay_the_same_for_its_time_and_no_longer():
    bench = Bench().follow()
    for _ in range(7):  # it stays the same from the first of these on
        bench.step(0.03125, end=200000.0)
    assert bench.reasons() == []
    assert bench.step(TICK_S, end=200000.0) == SAFE
    assert bench.reasons()[0] == "sensor end: frozen at 200000 Pa"
    bench.step(TICK_S, end=200001.0)
    assert bench.reasons() == ["waits 0.7 s after: sensor end: frozen at 200000 Pa"]
    for _ in range(8):  # of the others none is watched for that
        bench.step(0.03125, supply=350000.0, middle=200000.0)
    assert [reason[:5] for reason in bench.reasons()] == ["waits"]


def test_each_output_needs_a_command_no_older_than_the_watchdog():
    bench = Bench().follow()
    bench.step(WATCHDOG_S, without=("rod",))
    assert bench.state is State.FOLLOWING
    assert bench.one.counters.watchdog == 0
    assert bench.step(TICK_S, without=("rod",)) == SAFE
    assert bench.reasons()[0] == "command rod: none for 0.09 s"
    assert bench.one.counters.watchdog == 1
    bench.step(TICK_S, without=("rod",))
    assert bench.one.counters.watchdog == 1, "counted once each time"


def test_the_watchdog_counts_from_when_a_command_was_sent():
    bench = Bench().follow()
    bench.now += 0.0625
    bench.sense()
    assert bench.one.command({"head": 2.0}, bench.now) == ""
    assert bench.one.command({"rod": 3.0}, bench.now - 0.03125) == ""
    bench.now += WATCHDOG_S - 0.03125
    bench.sense()
    assert bench.reasons() == []
    bench.now += TICK_S
    assert bench.reasons() == ["command rod: none for 0.09 s"]


@pytest.mark.parametrize(
    ("mostly_s", "usually_s", "watchdog_s"),
    [
        (0.0, 0.0, WATCHDOG_S),
        (0.03125, 0.0078125, WATCHDOG_S),  # exactly as much is left
        (0.046875, 0.015625, 0.078125),
        (0.0625, 0.015625, 0.0625),
        (0.1171875, 0.015625, 0.02),  # never less than 20 ms
        (math.nan, 0.0625, WATCHDOG_S),
        (0.0625, math.nan, 0.0625),
        (0.0078125, 0.0625, WATCHDOG_S),  # only the first argument shortens it
    ],
)
def test_a_slow_device_shortens_the_watchdog_by_what_it_mostly_takes(
    mostly_s, usually_s, watchdog_s
):
    bench = Bench().follow()
    bench.one.takes(mostly_s, usually_s)
    assert bench.one.watchdog_s == watchdog_s
    sent_s = bench.now
    for age_s in (0.75 * watchdog_s, watchdog_s):
        bench.now = sent_s + age_s
        bench.sense()
    if watchdog_s != 0.02:  # which is no sum of powers of two
        assert bench.reasons() == []
    bench.now += 2.0 * TICK_S
    short = f", allowed {watchdog_s:.3f} s as the device is slow"
    slow = short if watchdog_s < WATCHDOG_S else ""
    assert bench.reasons() == [
        f"command {name}: none for {watchdog_s:.2f} s{slow}" for name in ("head", "rod")
    ]


def test_a_device_that_usually_is_too_slow_is_not_driven():
    bench = Bench(safe_within_s=0.02 + 0.125).follow()
    bench.one.takes(0.25, 0.125)
    bench.step(TICK_S)
    assert bench.state is State.FOLLOWING
    bench.one.takes(0.0, up(0.125))
    assert bench.step(TICK_S) == SAFE
    assert bench.reasons()[0] == (
        "the device is too slow: valves would be safe after 0.15 s at best, allowed is 0.145 s"
        " (safe_within_s)"
    )
    bench.one.takes(math.nan, math.nan)
    assert [reason[:5] for reason in bench.reasons()] == ["comma", "comma", "waits"]


def test_all_reasons_are_told_in_order():
    bench = Bench().follow()
    bench.one.bus("no answer")
    bench.one.publishers(3)
    bench.step(0.125, without=("head", "rod", "middle", "hip"), end=math.nan)
    found = bench.reasons()
    assert found[:6] == [
        "bus: no answer",
        "3 publishers on the command topic, one is allowed",
        "sensor middle: stale for 0.12 s",
        "sensor end: nan Pa is out of its range",
        "encoder hip: stale for 0.12 s",
        "command head: none yet",
    ]
    assert bench.one.explain(bench.now) == "; ".join(found)


# Commands


@pytest.mark.parametrize(
    ("voltages", "refused", "counted"),
    [
        ({"rod": 3.5, "arm": 1.0}, "command 'arm': this bridge has head, rod", "unknown"),
        ({"head": 4.0, "rod": math.inf}, "command 'rod': found inf", "not_finite"),
        ({"head": 4.0, "rod": -math.inf}, "command 'rod': found -inf", "not_finite"),
        (
            {"head": 4.0, "rod": up(4.5)},
            "command 'rod': found 4.5 V, allowed are -4 to 4 V",
            "out_of_range",
        ),
        (
            {"head": 4.0, "rod": down(-4.5)},
            "command 'rod': found -4.5 V, allowed are -4 to 4 V",
            "out_of_range",
        ),
        (
            {"rod": 3.5, "head": 9.0},
            "command 'head': found 9 V, allowed are 0 to 8 V",
            "out_of_range",
        ),
        (
            {"rod": math.nan, "head": math.nan},
            "the command has no voltage but NaN",
            "not_finite",
        ),
        ({}, "the command has no voltage but NaN", "not_finite"),
    ],
)
def test_a_command_is_refused_as_a_whole_and_keeps_no_watchdog_quiet(voltages, refused, counted):
    bench = Bench().follow()
    before = dataclasses.asdict(bench.one.counters)
    bench.now += WATCHDOG_S
    bench.sense()
    assert bench.one.command(voltages, bench.now) == refused
    assert bench.one.output(bench.now) == {"head": 2.0, "rod": 3.0}
    after = dataclasses.asdict(bench.one.counters)
    assert {n: after[n] - before[n] for n in after if after[n] != before[n]} == {counted: 1}
    bench.now += TICK_S
    assert bench.one.output(bench.now) == SAFE
    bench.one.publishers(0)  # what the command is comes before who sent it
    assert bench.one.command(voltages, bench.now) == refused


def test_a_voltage_within_the_margin_is_clamped_to_either_end_and_counted():
    bench = Bench(slew_v_s=1e6).follow()
    assert bench.step(0.0078125, head=8.5, rod=-4.5) == {"head": 8.0, "rod": -4.0}
    assert bench.one.counters.clamped == 2
    assert bench.step(0.0078125, head=-0.5, rod=4.5) == {"head": 0.0, "rod": 4.0}
    assert bench.one.counters.clamped == 4
    assert bench.step(0.0078125, head=0.0, rod=4.0) == {"head": 0.0, "rod": 4.0}
    assert bench.step(0.0078125, head=8.0, rod=-4.0) == {"head": 8.0, "rod": -4.0}
    assert bench.one.counters.clamped == 4


def test_a_voltage_that_is_nan_commands_nothing_of_that_output_alone():
    bench = Bench(slew_v_s=1e6).follow()
    bench.now += 0.0625
    bench.sense()
    assert bench.one.command({"head": math.nan, "rod": -1.0}, bench.now) == ""
    assert bench.one.output(bench.now) == {"head": 2.0, "rod": -1.0}
    bench.now += 0.0625
    bench.sense()
    assert bench.reasons() == ["command head: none for 0.12 s"]


@pytest.mark.parametrize(
    ("count", "wrong", "refused"),
    [
        (0, "", "nobody is known to publish commands"),
        (1, "", ""),
        (1, "it has no name", "it has no name"),
        (2, "", "2 publishers on the command topic, one is allowed"),
        (3, "it has no name", "3 publishers on the command topic, one is allowed"),
    ],
)
def test_only_a_single_publisher_that_is_known_is_followed(count, wrong, refused):
    bench = Bench().follow()
    bench.one.publishers(count, wrong)
    forgotten = bool(refused)
    assert (bench.one.output(bench.now) == SAFE) is forgotten, "nor what it sent before"
    held = [] if not count or not refused else [refused]
    assert bench.reasons()[: len(held)] == held
    assert bench.one.command({"rod": 3.0, "head": 2.0}, bench.now) == refused
    assert bench.one.counters.competing == forgotten
    bench.one.e_stop("somebody")  # who sent it comes before the state
    assert bench.one.command({"rod": 3.0}, bench.now) == (refused or "somebody")


def test_why_a_command_is_refused_the_emergency_stop_first():
    bench = Bench().follow()
    bench.one.latches.trip = "too high"
    assert bench.one.command({"rod": 3.0}, bench.now) == "too high"
    bench.one.latches.e_stop = "somebody"
    assert bench.one.command({"rod": 3.0}, bench.now) == "somebody"
    bench.one.disable()
    assert bench.one.command({"rod": 3.0}, bench.now) == "somebody"
    bench.one.latches.e_stop = bench.one.latches.trip = ""
    assert bench.one.command({"rod": 3.0}, bench.now) == "not active"
    assert bench.one.counters.accepted == 4, "those before alone"


# States


def test_states_by_precedence():
    bench = Bench().follow()
    bench.one.bus("no answer")
    held = bench.one.explain(bench.now)
    assert bench.state is State.HOLDING and held.startswith("bus: no answer")
    bench.one.disable()
    assert (bench.state, bench.one.explain(bench.now)) == (State.DISABLED, "not active")
    bench.one.latches.trip = "too high"
    assert (bench.state, bench.one.explain(bench.now)) == (State.TRIPPED, "too high")
    bench.one.e_stop("somebody")
    assert (bench.state, bench.one.explain(bench.now)) == (State.E_STOP, "e-stop: somebody")


def test_the_first_reason_of_a_stop_and_of_a_trip_is_kept_and_counted_once():
    bench = Bench().follow()
    bench.one.e_stop("somebody")
    bench.one.e_stop("somebody else")
    bench.step(TICK_S, end=550000.0)
    bench.step(TICK_S, end=560000.0)
    assert bench.one.latches == Latches(
        "somebody", "over-pressure: end rose to 550000 Pa, above 500000 Pa"
    )
    assert (bench.one.counters.e_stops, bench.one.counters.trips) == (1, 1)


@pytest.mark.parametrize("how", ["disabled", "stopped", "tripped"])
def test_no_command_from_before_is_followed_afterwards_and_nothing_is_waited_for(how):
    bench = Bench().follow()
    if how == "disabled":
        bench.one.disable()
        assert bench.one.output(bench.now) == SAFE
        bench.one.enable()
    elif how == "stopped":
        bench.one.e_stop("somebody")
        assert bench.one.output(bench.now) == SAFE
        assert bench.one.reset(bench.now) == ""
        bench.one.enable()
    else:
        bench.one.reading("end", 550000.0, bench.now)
        assert bench.one.output(bench.now) == SAFE
        bench.sense()
        assert bench.one.reset(bench.now) == ""
        bench.one.enable()
    assert bench.one.output(bench.now) == SAFE
    assert bench.reasons() == ["command head: none yet", "command rod: none yet"]
    bench.step(2.0**-8)
    assert bench.state is State.FOLLOWING


# Readings that trip


@pytest.mark.parametrize(
    ("name", "value", "trips"),
    [
        ("end", 5e5, ""),
        ("end", up(5e5), "over-pressure: end rose to 500000 Pa, above 500000 Pa"),
        ("end", 7e5, "over-pressure: end rose to 700000 Pa, above 500000 Pa"),
        # A span beyond the end of its range is the last number that can be a pressure.
        ("end", 1.19e6, "over-pressure: end rose to 1190000 Pa, above 500000 Pa"),
        ("end", up(1.19e6), ""),
        ("end", math.inf, ""),
        ("middle", 7e5, ""),
        ("elbow", 1.0, ""),
        ("elbow", up(1.0), "encoder: elbow is at 1, above its limit 1"),
        ("elbow", -1.0, ""),
        ("elbow", down(-1.0), "encoder: elbow is at -1, below its limit -1"),
    ],
)
def test_a_reading_trips_above_its_limit_and_not_at_it(name, value, trips):
    bench = Bench().follow()
    found = bench.step(0.5, **{name: value})  # after a gap nothing is a jump
    assert bench.one.latches == Latches(trip=trips)
    assert bench.one.counters.trips == bool(trips)
    if trips:
        assert found == SAFE and bench.state is State.TRIPPED


# What the gas pushes an encoder's joint with


def pushed(bench, middle, end, seconds, without=(), dt=2.0**-9):
    """Keeps the elbow where it is under pressures; returns after how long it tripped, s."""
    begun_s, k = bench.now, 0
    while bench.now < begun_s + seconds:
        bench.now += dt
        k += 1
        for name, value in (("supply", 400000.0), ("middle", middle), ("end", end)):
            if name not in without:
                bench.one.reading(name, value, bench.now)
        bench.one.position("hip", 0.5, bench.now, bench.now)
        bench.one.position("elbow", 0.328125, bench.now, bench.now)
        if bench.one.latches.trip:
            return bench.now - begun_s
    return math.inf


@pytest.mark.parametrize(
    ("middle", "end", "force"),
    [
        (262144.0, 131072.0, 60.0),  # 12 + 64 - 16
        (262148.0, 131072.0, 60.001),
        (262144.0, 131064.0, 60.001),
        (20480.0, 624640.0, -59.25),  # 12 + 5 - 76.25: beyond the range of the end sensor
        (20480.0, 500000.0, -44.04),
    ],
)
def test_the_force_is_the_offset_and_each_tap_times_its_area(middle, end, force):
    bench = Bench(sensors={n: SensorLimits(1e4, 1e6) for n in READINGS})
    took_s = pushed(bench, middle, end, 0.25)
    if abs(force) <= 60.0:
        assert math.isinf(took_s)
        return
    assert took_s == STUCK_S + 2.0**-9
    assert bench.one.latches.trip == (
        "encoder: elbow is frozen at 0.3281: pushed by 60 for 62 ms it shows no movement; at rest"
        " 60 can be held"
    )


def test_a_negative_force_freezes_as_well():
    bench = Bench(sensors={n: SensorLimits(1e4, 2e6) for n in READINGS})
    # 12 + 5 - 80 is -63.
    assert pushed(bench, 20480.0, 655360.0, 0.25) == STUCK_S + 2.0**-9


def test_a_force_is_not_known_of_a_pressure_that_is_stale():
    bench = Bench()
    # Up to the sensor timeout the latest pressure holds, and the joint counts as pushed.
    assert pushed(bench, 400000.0, 131072.0, STUCK_S) == math.inf
    assert pushed(bench, 400000.0, 131072.0, 0.25) == 2.0**-9
    bench = Bench()
    bench.one.reading("middle", 400000.0, bench.now)
    took_s = pushed(bench, 0.0, 131072.0, 0.25, ("middle",))
    assert took_s == STUCK_S + 2.0**-9, "STUCK_S is less than the sensor timeout"
    bench = Bench()
    bench.one.reading("middle", 400000.0, bench.now - 0.03125)
    assert pushed(bench, 0.0, 131072.0, 0.25, ("middle",)) == math.inf


@pytest.mark.parametrize("age_s", [0.0, TICK_S])
def test_a_pressure_as_old_as_the_sensor_timeout_still_pushes(age_s):
    """The reading at which the joint has been pushed for its time comes at that age."""
    bench = Bench()
    bench.one.reading("middle", 400000.0, bench.now)
    bench.one.position("elbow", 0.125, bench.now + SENSOR_TIMEOUT_S - STUCK_S, bench.now)
    for dt in (SENSOR_TIMEOUT_S - 0.03125, SENSOR_TIMEOUT_S + age_s):
        bench.one.reading("end", 131072.0, bench.now + dt)
        bench.one.position("elbow", 0.125, bench.now + dt, bench.now + dt)
    assert bool(bench.one.latches.trip) is (age_s == 0.0)


@pytest.mark.parametrize("value", [math.nan, 9e5])
def test_a_force_is_not_known_of_a_pressure_that_cannot_be_true(value):
    assert pushed(Bench(), value, 131072.0, 0.25) == math.inf


def test_readings_of_an_encoder_are_told_apart_by_the_time_they_were_taken():
    bench = Bench().follow()
    for place, dt, taken_s in ((0.25, 0.5, 8.0), (0.75, 2.0**-9, 9.0), (0.25, 2.0**-9, 9.0625)):
        bench.now += dt
        bench.one.position("elbow", place, bench.now, taken_s)
        if taken_s < 9.03:
            assert bench.one.latches.trip == "", "half a radian in a second by the device's time"
    # 0.5 rad, but 8 rad/s for 62.5 + 10 ms are 0.58 rad.
    assert bench.one.latches.trip == ""
    bench.one.position("elbow", 0.875, bench.now + 0.0625, 9.065)
    assert bench.one.latches.trip == ("encoder: elbow jumped by 0.625 in 2.5 ms, faster than 8/s")


@pytest.mark.parametrize(("gap_s", "jumps"), [(SENSOR_TIMEOUT_S, True), (0.09375, False)])
def test_after_the_sensor_timeout_a_place_is_no_jump(gap_s, jumps):
    bench = Bench()
    bench.one.position("elbow", -0.75, bench.now + 0.25, 8.0)
    bench.one.position("elbow", 0.75, bench.now + 0.25 + gap_s, 8.0625)
    assert ("jumped by 1.5" in bench.one.latches.trip) is jumps


# Reset


RESETS = [
    # What is done after the trip by ``end``, how long before the reset, and what the reset answers.
    ("low and fresh", {}, 0.0, ""),
    ("low at the timeout", {}, SENSOR_TIMEOUT_S, ""),
    ("low and stale", {}, SENSOR_TIMEOUT_S + TICK_S, "the pressure at end is not known"),
    ("exactly at its limit", {"end": 5e5}, 0.0, ""),
    ("still high", {"end": up(5e5)}, 0.0, "end is still at 500000 Pa, above 500000 Pa"),
    ("high and stale", {"end": 5.5e5}, 0.125, "the pressure at end is not known"),
    ("no number", {"end": math.nan}, 0.0, "the pressure at end is not known"),
    ("below its range", {"end": 0.0}, 0.0, "the pressure at end is not known"),
    ("elbow at its limit", {"elbow": 1.0}, 0.0, ""),
    ("elbow beyond", {"elbow": up(1.0)}, 0.0, "still, elbow is at 1, above its limit 1"),
    ("elbow below", {"elbow": -1.5}, 0.0, "still, elbow is at -1.5, below its limit -1"),
    ("elbow no number", {"elbow": math.nan}, 0.0, "the position of elbow is not known"),
]


@pytest.mark.parametrize(("what", "values", "age_s", "refused"), RESETS, ids=[r[0] for r in RESETS])
def test_a_trip_is_released_only_by_what_is_known_to_be_safe_again(what, values, age_s, refused):
    bench = Bench().follow()
    bench.step(TICK_S, end=550000.0)
    assert bench.state is State.TRIPPED
    trip = bench.one.latches.trip
    bench.now += 0.5
    bench.sense(**values)
    bench.now += age_s
    # All others are read as well, and sensors without such a limit do not matter.
    bench.sense(without=("supply", "middle", "end", *(n for n in values if n in PLACES)))
    assert bench.one.reset(bench.now) == refused
    if refused:
        assert bench.one.latches.trip == trip and bench.state is State.TRIPPED
    else:
        assert bench.one.latches == Latches() and bench.state is State.HOLDING


@pytest.mark.parametrize("age_s", [0.0, TICK_S])
def test_a_trip_is_released_only_where_each_encoder_was_read_lately(age_s):
    """Its latest reading lies within its limits, but may be older than the trip's cause."""
    bench = Bench().follow()
    bench.step(0.5, elbow=1.25)
    assert bench.one.latches.trip == "encoder: elbow is at 1.25, above its limit 1"
    bench.now += 0.5
    bench.sense(elbow=0.5)
    bench.now += SENSOR_TIMEOUT_S + age_s
    bench.sense(without=("elbow",))
    refused = "the position of elbow is not known" if age_s else ""
    assert bench.one.reset(bench.now) == refused
    assert bool(bench.one.latches.trip) is bool(refused)


def test_a_reset_forgets_how_a_joint_moved_before():
    bench = Bench().follow()
    bench.step(2.0**-9, elbow=0.9375)  # a jump of 0.67
    assert "elbow jumped" in bench.one.latches.trip
    bench.now += 2.0**-9
    bench.one.reading("end", 131072.0, bench.now)
    assert bench.one.reset(bench.now) == ""
    bench.step(2.0**-9)
    assert bench.one.latches.trip == "", "back where it was is no jump after a reset"


def test_an_emergency_stop_is_released_whatever_is_known_of_pressures():
    one = Supervisor(LIMITS)
    one.e_stop("somebody")
    assert one.reset(64.0) == ""
    assert one.latches == Latches()


def test_a_reset_of_nothing_does_not_shorten_the_wait_after_a_fault():
    bench = Bench().follow()
    bench.step(TICK_S, end=math.nan)
    bench.step(0.0625)
    assert bench.one.reset(bench.now) == ""
    bench.step(TICK_S)
    assert bench.reasons() == ["waits 0.7 s after: sensor end: nan Pa is out of its range"]
    bench.one.e_stop("somebody")
    assert bench.one.reset(bench.now) == ""
    bench.step(TICK_S)
    assert [reason.partition(" for")[0] for reason in bench.reasons()][:1] == [
        "waits after a reset"
    ]
    bench.one.enable()
    bench.step(TICK_S)
    assert bench.reasons() == []


# What is written


def test_a_voltage_changes_no_faster_than_the_slew_limit_either_way():
    bench = Bench()
    assert bench.step(2.0**-8) == {"head": 2.0, "rod": -1.0}, "from the safe voltages on"
    assert bench.one.counters.slew_limited == 1, "the head may change by its 1 V"
    assert bench.step(2.0**-8, head=4.0, rod=-4.0) == {"head": 3.0, "rod": -2.0}
    assert bench.step(2.0**-8, head=4.0, rod=-4.0) == {"head": 4.0, "rod": -3.0}
    assert bench.step(2.0**-8, head=4.0, rod=-4.0) == {"head": 4.0, "rod": -4.0}
    assert bench.one.counters.slew_limited == 4
    assert bench.step(2.0**-7, head=0.0, rod=4.0) == {"head": 2.0, "rod": -2.0}
    assert bench.one.output(bench.now) == {"head": 2.0, "rod": -2.0}, "no time has passed"
    bench.one.bus("no answer")
    assert bench.one.output(bench.now) == SAFE, "and the safe voltages at once"


def test_the_slew_limit_counts_from_the_safe_voltages_and_their_time():
    one = Bench(dwell_s=0.0)
    one.follow()
    one.step(2.0**-8, end=math.nan)
    one.step(2.0**-8)
    assert one.step(2.0**-9) == {"head": 1.5 + 0.5, "rod": -2.0 + 1.5}


def test_the_first_output_of_all_is_safe():
    one = Supervisor(LIMITS)
    bench = Bench.__new__(Bench)
    bench.one, bench.now, bench._noise = one, 64.0, 0.0
    one.bus("")
    one.publishers(1)
    one.enable()
    bench.sense()
    one.command({"head": 2.0, "rod": 3.0}, 64.0)
    assert one.state(64.0) is State.FOLLOWING
    assert one.output(64.0) == SAFE
    assert one.output(64.0 + 2.0**-8) == {"head": 2.0, "rod": -1.0}


def test_what_it_returns_is_the_callers_own():
    bench = Bench().follow()
    for output in (bench.one.output(bench.now), bench.one.safe()):
        output["rod"] = 99.0
    assert bench.one.output(bench.now) == {"head": 2.0, "rod": 3.0}
    bench.one.bus("no answer")
    bench.one.output(bench.now)["rod"] = 99.0
    assert bench.one.output(bench.now) == SAFE


# The wait after a fault


def test_it_waits_for_the_dwell_after_the_last_moment_at_which_anything_was_wrong():
    bench = Bench().follow()
    bench.step(2.0**-8, end=math.nan)
    bench.step(2.0**-8, supply=math.nan)
    last_s = bench.now
    bench.step(2.0**-8)
    assert bench.reasons() == ["waits 0.7 s after: sensor supply: nan Pa is out of its range"]
    while bench.now < last_s + DWELL_S - 0.03125:
        assert bench.step(0.015625) == SAFE
    bench.step(last_s + DWELL_S - TICK_S - bench.now)
    assert bench.state is State.HOLDING
    bench.now += TICK_S
    bench.sense()
    assert bench.reasons() == [], "the command of just before is followed, no further one needed"


@pytest.mark.parametrize("early_s", [TICK_S, 0.0])
def test_a_fault_during_the_wait_begins_it_anew_and_one_at_its_end_does_not(early_s):
    bench = Bench().follow()
    bench.step(2.0**-8, end=math.nan)
    end_s = bench.now + DWELL_S
    while bench.now < end_s - 0.0625:
        bench.step(0.03125)
    bench.step(end_s - early_s - bench.now, end=math.nan)
    bench.step(2.0**-8)
    assert (bench.state is State.FOLLOWING) is (early_s == 0.0)


def test_that_no_command_has_come_yet_neither_begins_the_wait_nor_lengthens_it():
    bench = Bench()
    for _ in range(40):
        bench.step(0.03125, without=("head", "rod"))
    bench.step(0.03125)
    assert bench.state is State.FOLLOWING
    bench.step(2.0**-8, end=math.nan)
    for _ in range(25):
        bench.step(0.03125, without=("head", "rod"))
    bench.step(0.03125)
    assert bench.state is State.FOLLOWING


def test_a_command_that_comes_too_late_is_a_fault_after_which_it_waits():
    bench = Bench().follow()
    bench.step(0.125, without=("head", "rod"))
    bench.step(2.0**-8)
    assert bench.reasons() == [
        "waits 0.7 s after: command head: none for 0.12 s; command rod: none for 0.12 s"
    ]
    assert bench.one.counters.watchdog == 1


@pytest.mark.parametrize("how", ["reading", "bus"])
def test_a_fault_forgets_commands_even_where_nothing_is_waited_for(how):
    bench = Bench(dwell_s=0.0).follow()
    if how == "reading":
        bench.now += TICK_S
        bench.sense(end=math.nan)
        assert bench.one.output(bench.now) == SAFE
        bench.sense()
    else:  # come and gone between two cycles
        bench.one.bus("no answer")
        bench.one.bus("")
    bench.now += TICK_S
    assert bench.one.output(bench.now) == SAFE
    assert bench.reasons() == ["command head: none yet", "command rod: none yet"]
    assert bench.one.counters.watchdog == 0, "it was not the watchdog"
    bench.step(TICK_S)
    assert bench.state is State.FOLLOWING


def test_it_waits_as_well_where_the_controller_ends_and_nothing_is_wrong():
    bench = Bench().follow()
    bench.step(2.0**-8, end=math.nan)
    for _ in range(26):  # an earlier reason is not told again
        bench.step(0.03125)
    assert bench.state is State.FOLLOWING
    bench.one.publishers(0)
    assert bench.one.output(bench.now) == SAFE
    bench.one.publishers(1)
    bench.step(2.0**-8)
    assert bench.reasons() == ["waits 0.7 s after: the commands ended"]


def test_a_bus_that_works_forgets_nothing():
    bench = Bench().follow()
    bench.one.bus("")
    assert bench.reasons() == []


def test_one_output_that_is_not_commanded_leaves_the_command_of_the_other():
    bench = Bench(dwell_s=0.0).follow()
    bench.step(0.0625, without=("rod",))
    assert bench.step(0.0625, without=("rod", "head")) == SAFE
    assert bench.reasons() == ["command rod: none for 0.12 s"]
    bench.one.command({"rod": 3.0}, bench.now)
    assert bench.reasons() == []


def test_the_watchdog_is_counted_only_where_it_ended_following():
    bench = Bench().follow()
    bench.one.bus("no answer")  # commands are forgotten, not too old
    bench.step(0.125)
    assert bench.one.counters.watchdog == 0
    bench = Bench().follow()
    bench.one.disable()
    bench.one.enable()
    bench.one.output(bench.now)
    bench.one.command({"head": 2.0, "rod": 3.0}, bench.now - 0.125)  # sent too long ago
    bench.one.output(bench.now)
    assert bench.one.counters.watchdog == 0, "it was not followed"
    bench = Bench().follow()
    bench.step(WATCHDOG_S, without=("rod",), end=math.nan)
    assert bench.one.counters.watchdog == 0, "another fault, and no command was too old"
