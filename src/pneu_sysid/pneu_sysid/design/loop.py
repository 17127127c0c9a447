# SPDX-License-Identifier: Apache-2.0
"""Experiment after experiment on a running rig, until the verdict is no longer in doubt."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Literal

from pneu_sim.rig.schema import Rig
from pneu_sysid.design.design import Asked, design
from pneu_sysid.design.hypotheses import hypotheses_of, part_of
from pneu_sysid.design.judge import judged
from pneu_sysid.design.limits import Limits
from pneu_sysid.design.live import LiveRig, play
from pneu_sysid.design.parameters import open_parameters, parameters_to_learn
from pneu_sysid.design.plan import Plan
from pneu_sysid.design.played import UntimelyError
from pneu_sysid.diagnose import Diagnosis, diagnose_apart, result_of_diagnosis
from pneu_sysid.problem import record_for
from pneu_sysid.records import Recording
from pneu_sysid.results.base import Verdict
from pneu_sysid.results.files import write_json
from pneu_sysid.results.learn import Experiment

Progress = Callable[[str, float], None]
Ended = Literal["name", "nothing_missing", "unknown", "inseparable", "budget"]

ENDED: dict[Verdict, Ended] = {
    "effect": "name",
    "ambiguous": "name",
    "unknown": "unknown",
    "nothing_missing": "nothing_missing",
}
"""Why no more is run where nothing is tied with the best candidate."""
PLAYS = 4
"""So often a plan is played at most that is broken off for nothing but time, on a busy machine."""


@dataclass(frozen=True)
class Budget:
    """How much may be tried.

    Attributes:
        experiments: How many at most.
        seconds: Length of each, s.
        limits: What they keep to.
        rate_hz: Readings of each sensor per second.
        seed: Of what is drawn.
        workers: Threads; None is all cores.
    """

    experiments: int
    seconds: float
    limits: Limits
    rate_hz: float = 500.0
    seed: int = 0
    workers: int | None = None


@dataclass
class Loop:
    """What came of it.

    Attributes:
        recordings: All that there are, those that were given first.
        bags: Their files.
        experiments: Those that were run, judged.
        found: The last diagnosis; None before.
        ended: Why no more was run.
        words: What is to be said of that.
        played_again: Why plans were broken off that were played again.
    """

    recordings: list[Recording]
    bags: list[Path]
    experiments: list[Experiment] = field(default_factory=list)
    found: Diagnosis | None = None
    ended: Ended = "budget"
    words: str = ""
    played_again: list[str] = field(default_factory=list)


def run(
    rig: Rig,
    rig_file: Path,
    bags: Sequence[Path],
    out: Path,
    budget: Budget,
    where: LiveRig,
    progress: Progress | None = None,
    player: Callable[..., None] = play,
) -> Loop:
    """Diagnoses, and has a designed experiment run as long as candidates cannot be told apart.

    Without a recording to begin with, random steps are run first.

    Args:
        rig: The rig, calibrated.
        rig_file: Its file.
        bags: Recordings that there are.
        out: Folder that receives ``experiment_<n>.json`` and the bags ``experiment_<n>``; that of a
            plan that is played again has another name.
        budget: How much may be tried.
        where: Where the rig runs.
        progress: Called with a stage's name and the fraction done.
        player: Plays and records a plan.

    Raises:
        InputError: The rig has no calibration, nothing keeps to the limits, or a plan was not
            played to its end.
    """
    tell = progress or (lambda stage, done: None)
    unseen = open_parameters(rig, rig_file)
    asked = Asked(
        budget.seconds, budget.limits, [], parameters_to_learn(rig), None, budget.rate_hz,
        budget.seed, budget.workers,
    )  # fmt: skip
    state = Loop([record_for(rig, str(bag)) for bag in bags], list(bags))
    plans: list[tuple[Path, Plan]] = []
    for number in range(budget.experiments + 1):
        if state.recordings:
            state.found = diagnose_apart(
                rig, state.recordings, workers=budget.workers, progress=tell
            )
            state.experiments = [judged(str(file), plan, state.found) for file, plan in plans]
            tied = set(state.found.alike(0)) if state.found.believed else set()
            if not tied:
                state.ended = ENDED[state.found.verdict]
                return state
            result = result_of_diagnosis(rig.name, state.found, [])
            hypotheses = hypotheses_of(rig, result, "diagnosis")
            plan = design(
                rig, replace(asked, hypotheses=hypotheses, parameters=unseen, seed=number), tell
            )
            top, others = hypotheses[0].part, {part_of(label) for label in tied}
            doubts = [
                s
                for s in plan.expected.separations
                if top in (part_of(s.one), part_of(s.other))
                and others & {part_of(s.one), part_of(s.other)}
            ]
            if all(s.inseparable for s in doubts):
                state.ended = "inseparable"
                state.words = " ".join(w for w in plan.expected.words if top in w)
                return state
        else:
            plan = design(rig, replace(asked, kind="steps"), tell)
        if number == budget.experiments:
            break
        file = out / f"experiment_{number + 1}.json"
        write_json(file, plan)
        bag = _played(partial(player, plan, file, rig_file), file, where, tell, state.played_again)
        plans.append((file, plan))
        state.bags.append(bag)
        state.recordings.append(record_for(rig, str(bag)))
    state.words = f"{budget.experiments} experiments were allowed, and candidates are left alike."
    return state


def _played(
    player: Callable[..., None], file: Path, where: LiveRig, tell: Progress, broken_off: list[str]
) -> Path:
    """Plays a plan, again where only time broke it off; the bag, and why there are others."""
    for play_number in range(1, PLAYS + 1):
        bag = file.with_name(file.stem + (f"_play_{play_number}" if play_number > 1 else ""))
        try:
            player(bag, where, tell)
            break
        except UntimelyError as error:
            if play_number == PLAYS:
                raise
            broken_off.append(str(error))
    return bag
