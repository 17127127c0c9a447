# SPDX-License-Identifier: Apache-2.0
"""The order of refits in a diagnosis: which candidates, from which starts, on which cells.

The outcome of each refit is prescribed; everything that decides on it is the product's own.
"""

import copy
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from tests.verdict_cases import Case, rig

from pneu_sim.effects import find_effect
from pneu_sim.rig.schema import Rig
from pneu_sysid import diagnose as diagnose_module
from pneu_sysid.bench import Bench
from pneu_sysid.candidates import Score
from pneu_sysid.diagnose import NEARLY, Diagnosis, look
from pneu_sysid.problem import Problem
from pneu_sysid.refits import Refit
from pneu_sysid.sites import Site

__all__ = ["rig"]  # a fixture

LEAK, LAG, GAIN = ("leak", "tube"), ("sensor_lag", "end"), ("sensor_gain", "end")
Part = tuple[str, str]


@dataclass
class Search:
    """A diagnosis with prescribed scores and refits, and a record of what it asked for.

    Attributes:
        case: The case.
        asked: Refits: effect, whether with multi-start, whether on coarse cells.
        settled: Effects that were refitted on the fine cells.
        placed: Effects whose position was refined there.
    """

    case: Case
    asked: list[tuple[str, bool, bool]] = field(default_factory=list)
    settled: list[str] = field(default_factory=list)
    placed: list[str] = field(default_factory=list)

    def run(
        self,
        monkeypatch: pytest.MonkeyPatch,
        scores: list[Score],
        made: Callable[[Part, bool], Refit],
        coarse: bool = True,
    ) -> Diagnosis:
        problem = self.case.bench.problem
        longer = copy.copy(problem) if coarse else problem

        def work(shared: Any, rig: Any, base: Any, candidate: Score, *more: Any) -> Refit:
            self.asked.append((candidate.site.part[0], more[-1], shared.recordings is not fine))
            return made(candidate.site.part, more[-1])

        def settle(shared: Any, base: Any, found: Refit, project: Any = None) -> Refit:
            assert shared.recordings is fine
            self.settled.append(found.site.part[0])
            return found

        def place(shared: Any, found: Refit, blocks: Any, project: Any = None) -> Refit:
            self.placed.append(found.site.part[0])
            return found

        fine = problem.recordings  # marks the problem on the fine cells
        if coarse:
            longer.recordings = list(fine)
        monkeypatch.setattr(Bench, "coarser", lambda bench, rig, readings: longer)
        monkeypatch.setattr(Problem, "mended", lambda problem, rig: problem)
        monkeypatch.setattr(diagnose_module, "best_per_place", lambda every: scores)
        monkeypatch.setattr(diagnose_module, "settled", settle)
        monkeypatch.setattr(diagnose_module, "well_placed", place)
        bench = self.case.bench
        return look(bench, self.case.rig, bench.readings, lambda stage, part: None, work=work)


def way_of(case: Case, k: int, cosine: float = 0.0) -> np.ndarray:
    """A sensitivity of its own, or one with a given cosine to that of candidate 0."""
    way = np.zeros(case.base.shape)
    way.ravel()[k] = np.sqrt(1.0 - cosine**2)
    way.ravel()[0] += cosine
    return way


def score(part: Part, explained: float, way: np.ndarray) -> Score:
    return Score(Site(find_effect(part[0]), part[1], {}), 1e-8, explained, 9.0, way, way)


def test_a_sufficient_first_candidate_ends_the_search(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    search = Search(Case(rig, 6.0))
    scores = [score(LEAK, 0.9, way_of(search.case, 0)), score(LAG, 0.01, way_of(search.case, 1))]
    answer = search.case.refit(*LEAK, held=0.96)
    found = search.run(monkeypatch, scores, lambda part, ladder: answer)
    assert search.asked == [("leak", False, True)]
    assert search.settled == search.placed == []
    assert found.verdict == "effect" and found.finalists == [answer]


def test_low_scores_are_refitted_with_multi_start(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    search = Search(Case(rig, 6.0))
    scores = [score(LEAK, 0.5, way_of(search.case, 0)), score(LAG, 0.01, way_of(search.case, 1))]
    made = {LEAK: search.case.refit(*LEAK, held=0.5), LAG: search.case.refit(*LAG, held=0.96)}
    found = search.run(monkeypatch, scores, lambda part, ladder: made[part])
    assert search.asked == [("leak", False, True), ("sensor_lag", True, True)]
    assert found.finalists[0] is made[LAG]


@pytest.mark.parametrize("better", [False, True])
def test_the_first_is_refitted_with_multi_start_last_and_the_better_fit_kept(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, better: bool
) -> None:
    search = Search(Case(rig, 6.0))
    scores = [score(LEAK, 0.5, way_of(search.case, 0)), score(LAG, 0.01, way_of(search.case, 1))]
    first = search.case.refit(*LEAK, held=0.5)
    again = search.case.refit(*LEAK, held=0.6 if better else 0.4)
    poor = search.case.refit(*LAG, held=0.02)
    found = search.run(
        monkeypatch,
        scores,
        lambda part, ladder: (again if ladder else first) if part == LEAK else poor,
    )
    assert [one[:2] for one in search.asked] == [
        ("leak", False), ("sensor_lag", True), ("leak", True)
    ]  # fmt: skip
    assert [r for r in found.finalists if r.site.part == LEAK] == [again if better else first]


def test_confounded_candidates_are_refitted_before_one_is_named(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    search = Search(Case(rig, 6.0))
    limits = search.case.bench.thresholds
    taps = list(search.case.rig.taps)
    kinds = ("sensor_lag", "sensor_gain", "sensor_offset")
    mates = [(kind, tap) for kind in kinds for tap in taps][: limits.finalists + 1]
    scores = [score(LEAK, 0.9, way_of(search.case, 0))]
    scores += [
        score(part, 0.8, way_of(search.case, k, cosine=0.97)) for k, part in enumerate(mates, 1)
    ]
    made = {part: search.case.refit(*part, held=0.7) for part in mates}
    made[LEAK] = search.case.refit(*LEAK, held=0.96)
    search.run(monkeypatch, scores, lambda part, ladder: made[part])
    assert [one[0] for one in search.asked[:1]] == ["leak"]
    assert len(search.asked) == len(scores) > limits.finalists
    assert not any(ladder for _, ladder, _ in search.asked)


@pytest.mark.parametrize("coarse", [True, False])
def test_runners_up_are_refitted_on_the_fine_cells(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, coarse: bool
) -> None:
    """Unless the first refits were on the fine cells already."""
    search = Search(Case(rig, 6.0))
    scores = [
        score(part, 0.9 - 0.1 * k, way_of(search.case, k))
        for k, part in enumerate((LAG, LEAK, GAIN))
    ]
    top = search.case.refit(*LAG, held=0.96)
    near = search.case.refit(*LEAK, residual=top.residual * np.sqrt(NEARLY - 1e-6))
    far = search.case.refit(*GAIN, residual=top.residual * np.sqrt(NEARLY + 1e-6))
    made = {LAG: top, LEAK: near, GAIN: far}
    search.run(monkeypatch, scores, lambda part, ladder: made[part], coarse)
    assert sorted(one[0] for one in search.asked) == ["leak", "sensor_gain", "sensor_lag"]
    assert sorted(search.settled) == (["leak", "leak", "sensor_lag"] if coarse else [])
    assert search.placed == (["leak"] if coarse else [])
