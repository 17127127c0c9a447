# SPDX-License-Identifier: Apache-2.0
"""How long tasks are expected to take: from a run of the model without what goes before it."""

import math

import pytest

from pneu_sysid.tasks.expect import MOVING_RUNS, RUNS, RunClock, expected_s, expected_words


def test_what_goes_before_the_first_part_does_not_count():
    clock = RunClock([(100.0, 0.0)])
    for now_s, done in ((160.0, 0.1), (161.0, 0.35), (163.6, 1.0)):
        clock.tell(done, now_s)
    assert clock.run_s == pytest.approx(4.0)


def test_a_run_in_one_part_counts_from_its_beginning():
    clock = RunClock([(100.0, 0.0)])
    assert math.isnan(clock.run_s)
    assert expected_s("suspect", clock.run_s, False) is None
    clock.tell(1.0, 102.5)
    assert clock.run_s == pytest.approx(2.5)


@pytest.mark.parametrize("moves", [False, True])
def test_expected_times_are_so_many_runs(moves):
    assert RUNS.keys() == MOVING_RUNS.keys()
    for task, (least, most) in (MOVING_RUNS if moves else RUNS).items():
        assert expected_s(task, 2.0, moves) == (2.0 * least, 2.0 * most)
    assert expected_s("look", 2.0, moves) is None


def test_no_more_digits_are_told_than_are_known():
    assert expected_words((17.0, 74.0)) == "0:15 to 1:00"
    assert expected_words((0.2, 0.4)) == "0:01"
    assert expected_words((312.0, 4100.0)) == "5:00 to 1:10:00"
