# SPDX-License-Identifier: Apache-2.0
"""How late commands are: clocks that differ, drift and are set, a hang, and a queue that stands."""

import math
import random

import pytest

from pneu_hw_bridge.safety.lateness import Lateness

pytestmark = pytest.mark.realtime

SKEW_S = 1.7e9
PERIOD_S = 0.01
WATCHDOG_S = 0.1


def run(lateness, begin_s, seconds, skew_s=SKEW_S, delay_s=0.001):
    """Commands at 100 Hz; returns how late each is said to be."""
    times = [begin_s + PERIOD_S * k for k in range(round(seconds / PERIOD_S))]
    return [lateness.of(t + skew_s, t + delay_s) for t in times]


def test_clocks_may_differ_by_any_amount():
    for skew_s in (0.0, SKEW_S, -SKEW_S):
        assert max(run(Lateness(), 10.0, 5.0, skew_s)) < 1e-5


def test_a_command_that_waited_is_late_however_long_it_was():
    for hang_s in (0.2, 1.5, 60.0):
        lateness = Lateness()
        run(lateness, 10.0, 3.0)
        late_s = lateness.of(13.0 + SKEW_S, 13.0 + hang_s)
        assert late_s == pytest.approx(hang_s, abs=0.01 + 5e-4 * hang_s)  # (clocks may drift)
        assert max(run(lateness, 13.1 + hang_s, 3.0)) < 1e-2


@pytest.mark.parametrize("delay_s", [0.15, 3.0])
def test_a_queue_that_stands_is_late_as_long_as_it_stands(delay_s):
    """For an hour; it was once believed after a second."""
    lateness = Lateness()
    run(lateness, 10.0, 3.0)
    late_s = run(lateness, 13.0, 3600.0, delay_s=delay_s)
    assert min(late_s) == pytest.approx(delay_s - 0.001, abs=0.01)
    assert max(run(lateness, 3620.0, 3.0)[1:]) < 1e-2


@pytest.mark.parametrize("step_s", [-3600.0, -30.0, -0.2, -0.05, 0.05, 0.2, 30.0, 3600.0])
def test_a_clock_that_is_set_stops_nothing(step_s):
    lateness = Lateness()
    run(lateness, 10.0, 3.0)
    late_s = run(lateness, 13.0, 30.0, SKEW_S + step_s)
    assert max(late_s) <= PERIOD_S + 1e-3
    assert max(late_s[-100:]) < 2e-3


@pytest.mark.parametrize("step_s", [-3600.0, -1.0, 3600.0])
def test_a_queue_that_stands_is_not_forgotten_with_a_clock_that_is_set(step_s):
    lateness = Lateness()
    run(lateness, 10.0, 3.0)
    run(lateness, 13.0, 3.0, delay_s=3.0)
    assert min(run(lateness, 16.0, 3.0, SKEW_S + step_s, delay_s=3.0)) > 2.9


@pytest.mark.parametrize("rate", [-4e-4, -1e-4, 1e-4, 4e-4])
def test_clocks_may_drift(rate):
    lateness = Lateness()
    times = [PERIOD_S * k for k in range(100_000)]
    late_s = [lateness.of(t * (1.0 + rate) + SKEW_S, t + 0.001) for t in times]
    assert max(late_s) < 1e-3


@pytest.mark.parametrize("seed", range(20))
def test_none_is_said_to_be_much_newer_than_it_is(seed):
    """Queues that fill and empty in order, a clock that is set, from a known delay on."""
    rng = random.Random(seed)
    lateness = Lateness()
    skew_s, arrived_s, delay_s, sent_s = SKEW_S, 0.0, 0.001, 0.0
    for k in range(20_000):
        sent_s += PERIOD_S
        if rng.random() < 0.002:
            delay_s = rng.choice([0.001, 0.001, 0.05, 0.3, 2.0])
        quiet = k > 100 and delay_s == 0.001 and arrived_s < sent_s
        if quiet and rng.random() < 0.002:  # (set while something waits, it is told too late alone)
            skew_s += rng.choice([-3600.0, -1.0, -0.05, 0.05, 1.0, 3600.0])
        arrived_s = max(arrived_s + 1e-6, sent_s + delay_s)
        said_s = lateness.of(sent_s + skew_s, arrived_s)
        assert said_s >= arrived_s - sent_s - 0.001 - 2e-3


# The same by hand: times are sums of powers of two, clocks drift by at most 2^-11 of what passes

DRIFT, UNSURE_S, JITTER_S = 5e-4, 0.02, 5e-3


def said(*commands):
    """How late each command is said to be: pairs of when it was sent and taken."""
    lateness = Lateness()
    return [lateness.of(sent_s, received_s) for sent_s, received_s in commands]


def test_the_first_command_is_late_by_nothing():
    assert said((SKEW_S, 64.0)) == [0.0]
    assert said((64.0, SKEW_S)) == [0.0]


def test_a_command_that_took_longer_is_late_by_the_difference_less_the_drift():
    (_, late_s) = said((8.0, 64.0), (9.0, 65.0625))
    assert late_s == pytest.approx(0.0625 - DRIFT * 1.0625, abs=1e-12)


def test_a_quicker_command_becomes_the_measure():
    found = said((8.0, 64.0625), (8.0625, 64.0625), (8.125, 64.1875))
    assert found[1] == 0.0
    assert found[2] == pytest.approx(0.0625 - DRIFT * 0.125, abs=1e-12)


@pytest.mark.parametrize(("late_s", "drifts"), [(0.015625, True), (0.03125, False)])
def test_only_a_little_lateness_may_be_drift(late_s, drifts):
    """What is later than 20 ms waits in a queue, and is not forgotten."""
    found = said((8.0, 64.0), (8.015625, 64.015625 + late_s), (9.015625, 65.015625 + late_s))
    begun_s = late_s - DRIFT * (0.015625 + late_s)
    assert found[1] == pytest.approx(begun_s, abs=1e-12)
    assert found[2] == pytest.approx(begun_s - (DRIFT if drifts else 0.0), abs=1e-12)


def test_lateness_of_exactly_20_ms_is_kept():
    lateness = Lateness()
    lateness.of(0.0, 0.0)
    lateness._late_s = UNSURE_S  # which no arithmetic of times gives exactly
    lateness._shortest_s = -UNSURE_S
    assert lateness.of(1.0, 1.0) == UNSURE_S


@pytest.mark.parametrize("passed_s", [0.0078125, 0.5])
def test_a_clock_that_is_set_back_may_hide_a_queue_of_all_the_time_that_passed(passed_s):
    found = said((8.0, 64.0), (8.0 - 2.0**-9, 64.0 + passed_s))
    assert found[1] == pytest.approx(passed_s, abs=1e-9)
    found = said((8.0, 64.0), (8.5, 64.75), (8.5 - 2.0**-9, 64.75 + passed_s))
    assert found[2] == pytest.approx(found[1] + passed_s, abs=1e-9), "and what waited before"


def test_a_command_of_the_same_moment_is_no_clock_set_back():
    assert said((8.0, 64.0), (8.0, 64.0625))[1] == pytest.approx(0.0625 - DRIFT / 16, abs=1e-12)
    assert said((8.0, 64.0), (8.0, 64.0))[1] == 0.0


@pytest.mark.parametrize("excess_s", [-1e-6, 1e-6])
def test_a_clock_that_is_set_forward_is_no_queue_that_empties(excess_s):
    """A sender cannot have spent more time than passed and what it makes up for."""
    first = said((8.0, 64.0), (8.25, 64.5))[1]
    passed_s = 0.125
    # spent = late + passed + jitter + 2 drift spent
    most_s = (first + passed_s + JITTER_S) / (1.0 - 2.0 * DRIFT)
    found = said((8.0, 64.0), (8.25, 64.5), (8.25 + most_s + excess_s, 64.5 + passed_s))
    if excess_s > 0.0:
        assert found[2] == pytest.approx(first, abs=1e-9), "as late as before, for all we know"
    else:
        assert found[2] == 0.0, "the queue is empty, and this the quickest of all"


def test_what_is_late_is_told_no_less_after_a_clock_was_set_forward():
    lateness = Lateness()
    for sent_s, received_s in ((8.0, 64.0), (8.25, 64.75), (3600.0, 64.875)):
        late_s = lateness.of(sent_s, received_s)
    assert late_s == pytest.approx(0.5 - DRIFT * 0.75, abs=1e-9)
    # From here on the new clock is the measure.
    assert lateness.of(3600.5, 64.875) == pytest.approx(0.0, abs=1e-9)
    assert math.isfinite(lateness.of(3600.625, 65.0))
