# SPDX-License-Identifier: Apache-2.0
"""A device's clock in terms of ours, and its records: against clocks and registers made up."""

import random
from itertools import pairwise

import pytest

from pneu_hw_bridge.device_clock import JUMP_S, MOST_DRIFT, DeviceClock
from pneu_hw_bridge.modbus.records import Reader
from pneu_hw_bridge.registers.clock import Records

pytestmark = pytest.mark.realtime

PERIOD_NS = 2_000_000
QUICKEST_NS = 400_000
ZERO_NS = 1_700_000_000_123_456_789
"""Our time at which the device's clock was at zero."""


class Poll:
    """Reads of a device, late as on a busy machine; true time is the steady clock's."""

    def __init__(self, seed=5, drift=0.0):
        self.clock = DeviceClock()
        self.rng = random.Random(seed)
        self.drift = drift
        self.now_ns = 0
        self.stood_ns = 0
        self.set_ns = 0
        self.lost_ns = 0

    def run(self, seconds):
        """Per new sample its device time, its stamp, and when it was really taken."""
        taken = []
        end_ns = self.now_ns + round(1e9 * seconds)
        while self.now_ns < end_ns:
            self.now_ns += PERIOD_NS
            device_ns = self.device_ns(self.now_ns)
            late_ns = QUICKEST_NS + (
                round(self.rng.expovariate(1 / 8e6)) if self.rng.random() < 0.8 else 0
            )
            received_ns = ZERO_NS + self.now_ns + late_ns + self.set_ns
            self.clock.observe(device_ns, received_ns, 1e-9 * (self.now_ns + late_ns))
            stamp_ns = self.clock.stamp(device_ns)
            taken.append((device_ns, stamp_ns, ZERO_NS + self.now_ns + self.set_ns))
        return taken

    def device_ns(self, at_ns):
        return round((at_ns - self.stood_ns) * (1 - self.drift)) - self.lost_ns


def stamped(taken):
    return [one for one in taken if one[1] is not None]


def test_lateness_does_not_show():
    """Four of five readings are late by 8 ms on average; stamps are the device's to the ns."""
    taken = stamped(Poll().run(10.0))
    assert len(taken) > 4800
    steps = {(b[0] - a[0], b[1] - a[1]) for a, b in pairwise(taken)}
    assert steps == {(PERIOD_NS, PERIOD_NS)}
    assert all(stamp - true == QUICKEST_NS for _, stamp, true in taken)


@pytest.mark.parametrize("drift", [100e-6, -100e-6])
def test_drift_is_followed_without_jumps(drift):
    taken = stamped(Poll(drift=drift).run(300.0))
    steps = [(b[1] - a[1]) / (b[0] - a[0]) for a, b in pairwise(taken)]
    assert max(abs(step - 1.0) for step in steps) <= MOST_DRIFT + 1e-6
    apart_s = [1e-9 * (stamp - QUICKEST_NS - true) for _, stamp, true in taken]
    assert abs(300.0 * drift) > 0.025, "so far apart without being followed"
    assert max(map(abs, apart_s)) < 0.006
    assert max(map(abs, apart_s[-1000:])) < 0.004


def test_a_device_that_stands_still_is_told_of_and_its_stamps_stay_its_own():
    poll = Poll()
    before = stamped(poll.run(3.0))
    poll.now_ns += 700_000_000
    poll.stood_ns += 700_000_000
    after = poll.run(30.0)
    taken = before + after
    assert {(b[0] - a[0], b[1] - a[1]) for a, b in pairwise(taken)} == {(PERIOD_NS, PERIOD_NS)}
    assert poll.clock.behind_s == pytest.approx(0.7, abs=1e-3)
    assert (poll.clock.restarts, list(poll.clock.told)) == (0, [])


def test_a_clock_that_leaps_ahead_is_mapped_anew():
    poll = Poll()
    poll.run(1.0)
    poll.lost_ns -= 500_000_000
    after = poll.run(1.0)
    assert "leapt ahead by 0.5" in poll.clock.told.popleft()
    assert after[0][1] is None
    assert all(stamp - true == QUICKEST_NS for _, stamp, true in stamped(after))
    assert len(stamped(after)) > 350


def test_this_machines_clock_may_be_set():
    poll = Poll()
    poll.run(1.0)
    poll.set_ns = -3_600_000_000_000
    after = poll.run(1.0)
    assert poll.clock.told.popleft() == "this machine's clock was set by -3600.000 s"
    assert all(stamp - true == QUICKEST_NS for _, stamp, true in stamped(after))


@pytest.mark.parametrize(("lost_s", "anew"), [(0.0, 0), (JUMP_S / 2, 0), (0.3, 1)])
def test_after_a_lost_connection_the_clocks_are_compared_again(lost_s, anew):
    poll = Poll()
    before = stamped(poll.run(1.0))
    poll.now_ns += 5_000_000_000
    poll.lost_ns = round(1e9 * lost_s)
    poll.clock.doubt()
    after = stamped(poll.run(1.0))
    assert poll.clock.restarts == anew
    between = (after[0][0] - before[-1][0], after[0][1] - before[-1][1])
    assert (between[0] == between[1]) == (not anew)
    if anew:
        assert "was set by -0.300 s meanwhile" in poll.clock.told[0]


class Told:
    """Samples whose lateness is chosen, at even intervals of device time."""

    def __init__(self, period_ns=100_000_000):
        self.clock = DeviceClock()
        self.period_ns = period_ns
        self.device_ns = 7_000_000_000
        self.offset_ns = ZERO_NS
        self.set_ns = 0

    def observe(self, late_ns=0):
        """The next sample, so late by what the clock stamps it with, or by the offset before."""
        self.device_ns += self.period_ns
        ours_ns = self.clock.stamp(self.device_ns)
        ours_ns = self.device_ns + self.offset_ns if ours_ns is None else ours_ns - self.set_ns
        received_ns = ours_ns + late_ns
        steady_s = 1e-9 * (received_ns - ZERO_NS)
        was_ns = self.clock.stamp(self.device_ns)
        self.clock.observe(self.device_ns, received_ns + self.set_ns, steady_s)
        if was_ns is not None and self.clock.settled:
            assert self.clock.stamp(self.device_ns) == was_ns, "no stamp jumps"

    def settle(self):
        while not self.clock.settled:
            self.observe()
        return self

    def window(self, late_ns):
        """Samples until the next comparison of drifts; the smallest lateness is not the first."""
        begun_s = self.clock._window_s
        for extra_ns in (3_000_000, 0, 5_000_000):
            self.observe(late_ns + extra_ns)
        while self.clock._window_s == begun_s:
            self.observe(late_ns + 8_000_000)


@pytest.mark.parametrize(
    ("period_ms", "reads"), [(5, 41), (10, 21), (10.0000001, 21), (9.9, 22), (20, 20), (100, 20)]
)
def test_clocks_are_compared_for_a_time_and_for_some_reads(period_ms, reads):
    told = Told(round(1e6 * period_ms))
    for count in range(1, reads + 1):
        assert not told.clock.settled and told.clock.stamp(told.device_ns) is None
        told.observe(1000 - count)  # the quickest way is the last
    assert told.clock.settled
    assert told.clock.stamp(told.device_ns) == told.device_ns + ZERO_NS + 1000 - reads
    assert told.clock.stamp(told.device_ns + 77) == told.device_ns + ZERO_NS + 1077 - reads


def test_the_quickest_way_counts_wherever_it_was():
    for quickest in (0, 7, 19):
        told = Told(20_000_000)
        for count in range(20):
            told.observe(-300 if count == quickest else 5_000_000 + count)
        assert told.clock.stamp(told.device_ns) == told.device_ns + ZERO_NS - 300


@pytest.mark.parametrize(("gap_ms", "reads"), [(190, 10), (210, 20)])
def test_a_device_that_stands_still_meanwhile_is_compared_from_when_it_goes_on(gap_ms, reads):
    told = Told(20_000_000)
    for _ in range(10):
        told.observe()
    told.offset_ns += 1_000_000 * (gap_ms - 20)  # no device time passes, ours does
    for count in range(reads):
        assert not told.clock.settled, count
        told.observe()
    assert told.clock.settled


@pytest.mark.parametrize(
    ("set_ms", "says"),
    [
        (19, None),
        (-19, None),
        (21, "this machine's clock was set by 0.021 s"),
        (-21, "this machine's clock was set by -0.021 s"),
    ],
)
def test_how_far_this_machines_clock_may_be_set(set_ms, says):
    told = Told().settle()
    told.set_ns = 1_000_000 * set_ms
    told.observe()
    assert list(told.clock.told) == ([] if says is None else [says])
    assert (told.clock.restarts, told.clock.settled) == ((0, True) if says is None else (1, False))
    told.settle()
    for _ in range(3):
        told.observe()
    assert told.clock.restarts == (says is not None), "told once"


@pytest.mark.parametrize(
    ("late_ms", "says"), [(-19, None), (-21, "the device's clock leapt ahead by 0.021 s")]
)
def test_how_far_ahead_a_sample_may_be(late_ms, says):
    told = Told().settle()
    told.observe(1_000_000 * late_ms)
    assert list(told.clock.told) == ([] if says is None else [says])
    assert (told.clock.restarts, told.clock.settled) == ((0, True) if says is None else (1, False))
    if says is not None:
        assert told.clock._reads == 1, "the sample itself is compared already"


@pytest.mark.parametrize(
    ("apart_ms", "says"),
    [
        (19, None),
        (-19, None),
        (21, "the device's clock was set by -0.021 s meanwhile"),
        (-21, "the device's clock was set by 0.021 s meanwhile"),
    ],
)
def test_how_far_clocks_may_be_apart_after_a_connection_was_lost(apart_ms, says):
    told = Told().settle()
    told.clock.doubt()
    told.offset_ns += 1_000_000 * apart_ms
    told.settle()
    assert list(told.clock.told) == ([] if says is None else [says])
    assert told.clock.restarts == (says is not None)
    moved_ns = 0 if says is None else 1_000_000 * apart_ms
    assert told.clock.stamp(told.device_ns) == told.device_ns + ZERO_NS + moved_ns


@pytest.mark.parametrize(
    ("late_us", "behind_us", "drift"),
    [
        ([900], 0, 0.0),
        ([1100], 0, 1100e-6 / 30.0),
        ([2900], 0, 2900e-6 / 30.0),
        ([3200], 3200, 0.0),
        ([-900], 0, 0.0),
        ([-1100], 0, -1100e-6 / 30.0),
        ([-2900], 0, -2900e-6 / 30.0),
        ([-5000], 0, -5000e-6 / 30.0),
        ([-7000], 0, -MOST_DRIFT),
        ([700_000], 700_000, 0.0),
        ([2900, 5800], 0, 2900e-6 / 30.0),  # the quickest of two windows counts
        ([2900, 5800, 5800], 0, 5800e-6 / 30.0),
        ([2900, 5800, 5800, 8700, 8700], 0, MOST_DRIFT),
        ([700_000, 701_500, 701_500], 700_000, 1500e-6 / 30.0),
        ([700_000, 500_000], 500_000, 0.0),
        ([700_000, 100_000, -3500], 0, -3500e-6 / 30.0),
    ],
)  # fmt: skip
def test_what_is_made_of_the_quickest_way_of_a_window(late_us, behind_us, drift):
    told = Told().settle()
    for one in late_us:
        told.window(1000 * one)
    clock = told.clock
    assert clock.behind_s == pytest.approx(1e-6 * behind_us, abs=1e-7)
    assert clock.drift == pytest.approx(drift, abs=1e-10)
    assert (clock.restarts, list(clock.told)) == (0, [])
    at_ns = told.device_ns
    later_ns = clock.stamp(at_ns + 10**10) - clock.stamp(at_ns)
    assert later_ns - 10**10 == pytest.approx(1e10 * drift, abs=2.0)


def test_windows_are_as_long_as_they_are():
    told = Told().settle()
    assert told.clock._window_s == pytest.approx(1e-9 * told.device_ns)
    for count in range(99):
        told.observe(2_000_000)
        assert told.clock.drift == 0.0, count
    told.observe(2_000_000)
    told.observe(2_000_000)
    assert told.clock.drift == pytest.approx(2e-3 / 30.0)


def test_a_device_that_stood_still_may_be_doubted():
    """What it stood still for is no setting of its clock; that it caught up would be one."""
    told = Told().settle()
    told.window(500_000_000)
    assert told.clock.behind_s == pytest.approx(0.5)
    told.clock.doubt()
    told.offset_ns += 500_000_000
    told.settle()
    assert (told.clock.restarts, told.clock.behind_s) == (0, pytest.approx(0.5))
    told.clock.doubt()
    told.offset_ns -= 500_000_000
    told.settle()
    assert list(told.clock.told) == ["the device's clock was set by 0.500 s meanwhile"]
    assert (told.clock.restarts, told.clock.behind_s, told.clock.drift) == (1, 0.0, 0.0)
    told.window(4_000_000)  # and what was before is forgotten
    assert (told.clock.behind_s, told.clock.drift) == (pytest.approx(4e-3), 0.0)


def test_the_newest_of_what_happened_is_kept():
    clock = DeviceClock()
    for k in range(9):
        clock.restart(f"reason {k}")
    assert list(clock.told) == [f"reason {k}" for k in range(1, 9)]
    assert clock.restarts == 9


# Records


def layout(records=3, counter="uint16", ticks="uint32"):
    return Records.model_validate(
        {
            "counter": {"address": 40, "type": counter},
            "time": {"address": 41, "type": ticks, "tick_s": 1e-6},
            "records": records,
            "stride": 4 if records > 1 else 0,
        }
    )


def shown(plan, number, first=0, period_us=2000, begun_us=0):
    """The registers of a device whose newest sample has a number, and whose oldest is the first."""
    raw = [0] * (4 * plan.records)
    for place in range(plan.records):
        one = max(number - place, first)
        raw[4 * place : 4 * place + 1] = plan.counter.encode(one)
        raw[4 * place + 1 : 4 * place + 3] = plan.time.encode(begun_us + one * period_us)
    return raw


def test_a_late_reader_takes_all_and_an_early_one_none():
    plan = layout()
    reader = Reader(plan, 40, apart=True)
    taken, skipped = [], 0
    for number in (0, 0, 1, 3, 3, 6, 7, 11, 12):
        found, lost, anew = reader.take(shown(plan, number))
        taken += [ns // PERIOD_NS for _, ns in found]
        skipped += lost
        assert anew == ""
    assert taken == [0, 1, 2, 3, 4, 5, 6, 7, 9, 10, 11, 12]
    assert skipped == 1


def test_numbers_and_times_that_begin_again_at_zero_go_on():
    plan = layout()
    reader = Reader(plan, 40, apart=True)
    times = []
    begin = 2**16 - 5
    for number in range(begin, begin + 12, 2):
        found, lost, anew = reader.take(shown(plan, number, begun_us=2**32 - begin * 2000 - 9000))
        times += [ns for _, ns in found]
        assert (lost, anew) == (0, "")
    assert {b - a for a, b in pairwise(times)} == {PERIOD_NS}
    assert len(times) == 11


@pytest.mark.parametrize(
    ("number", "period_us", "begun_us", "says"),
    [
        (3, 2000, 0, "counter went back"),
        (101, 1000, 0, "clock went back"),
        (101, 2000, -2000, "stands still while its counter runs"),
        (100, 2000, 77, "clock was set"),
    ],
)
def test_a_device_that_begins_anew_is_noticed(number, period_us, begun_us, says):
    plan = layout()
    reader = Reader(plan, 40, apart=True)
    reader.take(shown(plan, 100))
    found, _, anew = reader.take(shown(plan, number, 0, period_us, begun_us))
    assert says in anew
    assert [place for place, _ in found] == [0], "only the newest belongs to the new life"
    found, _, anew = reader.take(shown(plan, number + 2, 0, 2000, begun_us + 10**6))
    assert (len(found), anew) == (2, "")


def test_long_times_keep_their_nanoseconds():
    plan = Records.model_validate(
        {
            "counter": {"address": 0},
            "time": {"address": 2, "type": "uint64", "tick_s": 1e-9},
        }
    )
    reader = Reader(plan, 0, apart=True)
    ns = 1_700_000_000_123_456_789
    assert reader.take([*plan.counter.encode(7), *plan.time.encode(ns)])[0] == [(0, ns)]
