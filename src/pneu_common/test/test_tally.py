# SPDX-License-Identifier: Apache-2.0
"""How much is done: weighted by the parts' amounts, never back, whoever tells it."""

from concurrent.futures import ThreadPoolExecutor

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pneu_common.tally import Tally

pytestmark = pytest.mark.kernel_free


def test_parts_weigh_as_much_as_they_are_work() -> None:
    told: list[float] = []
    tally = Tally([1.0, 3.0], told.append)
    tally.reached(1, 1.0 / 3.0)
    tally.of(0)(1.0)
    tally.reached(1, 0.1)  # later than it should have come: nothing is undone
    tally.reached(1, 1.0)
    assert told == [0.25, 0.5, 0.5, 1.0]
    Tally([1.0, 3.0]).reached(1, 0.5)  # nobody is told


def test_a_part_counts_no_more_than_its_amount() -> None:
    """The last step of a roll-out may end a little beyond the end of its part."""
    told: list[float] = []
    tally = Tally([1, 4, 3], told.append)
    tally.reached(1, 1.5)
    tally.reached(0, 7.0)
    tally.reached(2, 1.0 + 1e-9)
    assert told == [0.5, 0.625, 1.0]


AMOUNTS = st.lists(st.floats(1e-6, 1e6), min_size=1, max_size=8)
FRACTIONS = st.lists(st.tuples(st.integers(0, 7), st.floats(0.0, 1.001)), max_size=20)


@given(AMOUNTS, FRACTIONS)
def test_fractions_never_fall_and_end_at_one(
    amounts: list[float], steps: list[tuple[int, float]]
) -> None:
    told: list[float] = [0.0]
    tally = Tally(amounts, told.append)
    for part, fraction in steps:
        tally.reached(part % len(amounts), fraction)
    for part in range(len(amounts)):
        tally.reached(part, 1.0)
    assert told == sorted(told)
    assert told[-1] == 1.0


def test_threads_tell_one_at_a_time() -> None:
    told: list[float] = []
    tally = Tally([1.0] * 8, told.append)

    def work(part: int) -> None:
        for step in range(1, 201):
            tally.reached(part, step / 200)

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(work, range(8)))
    assert told == sorted(told)
    assert len(told) == 1600
    assert told[-1] == 1.0
