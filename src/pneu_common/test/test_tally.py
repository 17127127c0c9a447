# SPDX-License-Identifier: Apache-2.0
"""How much is done: weighted by the parts' amounts, never back, whoever tells it."""

from concurrent.futures import ThreadPoolExecutor

import pytest

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
