# SPDX-License-Identifier: Apache-2.0
"""How late commands are: clocks that differ, a hang, and a clock that is set."""

import pytest

from pneu_hw_bridge.safety.lateness import Lateness

SKEW_S = 1.7e9


def run(lateness, begin_s, seconds, skew_s=SKEW_S, delay_s=0.001):
    """Commands at 100 Hz; returns how late each is."""
    times = [begin_s + 0.01 * k for k in range(round(100 * seconds))]
    return [lateness.of(t + skew_s, t + delay_s) for t in times]


def test_clocks_may_differ_by_any_amount():
    for skew_s in (0.0, SKEW_S, -SKEW_S):
        assert max(run(Lateness(), 10.0, 5.0, skew_s)) < 1e-5


def test_a_command_that_waited_is_late_however_long_it_was():
    for hang_s in (0.2, 1.5, 60.0):
        lateness = Lateness()
        run(lateness, 10.0, 3.0)
        late_s = lateness.of(13.0 + SKEW_S, 13.0 + hang_s)
        assert late_s == pytest.approx(hang_s, abs=0.01)
        assert max(run(lateness, 13.1 + hang_s, 3.0)) < 1e-5


def test_a_clock_that_is_set_is_believed_again():
    for step_s in (-30.0, 30.0):
        lateness = Lateness()
        run(lateness, 10.0, 3.0)
        late_s = run(lateness, 13.0, 3.0, SKEW_S + step_s)
        assert max(late_s[210:]) < 1e-5
        assert max(late_s) == pytest.approx(max(-step_s, 0.0), abs=0.01)
