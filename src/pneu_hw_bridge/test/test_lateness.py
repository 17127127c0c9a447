# SPDX-License-Identifier: Apache-2.0
"""How late commands are: clocks that differ, drift and are set, a hang, and a queue that stands."""

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
