# SPDX-License-Identifier: Apache-2.0
"""Several estimations at once whose models run side by side, in one batch.

A refit asks for two or three models at a time; the simulator is fastest with eight. Each estimation
has a thread, which waits until all others have asked too or are done.
"""

import copy
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

from pneu_sim.rig.schema import Rig
from pneu_sysid.problem import Problem, Rollouts

Item = TypeVar("Item")
Outcome = TypeVar("Outcome")


class _Gathering:
    """Requests of all threads that are still at work, run when the last of them has asked."""

    def __init__(self, problem: Problem, members: int) -> None:
        self._problem = problem
        self._members = members
        self._turn = threading.Condition()
        self._waiting: dict[int, Sequence[Rig]] = {}
        self._found: dict[int, Rollouts | Exception] = {}

    def simulate(
        self,
        rigs: Sequence[Rig],
        progress: Callable[[float], None] | None = None,
        strict: bool = True,
        flows: bool = False,
    ) -> Rollouts:
        """As `Problem.simulate`, of which it takes the place; unstable models are not finite."""
        me = threading.get_ident()
        with self._turn:
            self._waiting[me] = rigs
            self._run_if_all_have_asked()
            while me not in self._found:
                self._turn.wait()
            found = self._found.pop(me)
        if isinstance(found, Exception):
            raise found
        return found

    def leave(self) -> None:
        """One thread has come to its end."""
        with self._turn:
            self._members -= 1
            self._run_if_all_have_asked()

    def _run_if_all_have_asked(self) -> None:
        if not self._waiting or len(self._waiting) < self._members:
            return
        asked, self._waiting = self._waiting, {}
        together = [rig for rigs in asked.values() for rig in rigs]
        try:
            out = self._problem.simulate(together, strict=False)
        except Exception as error:
            self._found = dict.fromkeys(asked, error)
        else:
            first = 0
            for who, rigs in asked.items():
                part = slice(first, first + len(rigs))
                self._found[who] = Rollouts(out.readings[part], [])
                first += len(rigs)
        self._turn.notify_all()


def each_of(
    items: Sequence[Item], problem: Problem, estimate: Callable[[Problem, Item], Outcome]
) -> list[Outcome]:
    """Estimates for several items at once; what all of them ask of a problem runs side by side.

    Args:
        items: What to estimate for.
        problem: The problem; rigs of one structure.
        estimate: Called with a stand-in for the problem and an item, in a thread for each.

    Returns:
        The outcomes, in order.
    """
    if len(items) < 2:
        return [estimate(problem, item) for item in items]
    gathering = _Gathering(problem, len(items))
    shared: Any = copy.copy(problem)
    shared.simulate = gathering.simulate

    def one(item: Item) -> Outcome:
        try:
            return estimate(shared, item)
        finally:
            gathering.leave()

    with ThreadPoolExecutor(len(items)) as pool:
        return list(pool.map(one, items))
