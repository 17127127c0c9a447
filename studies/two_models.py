# SPDX-License-Identifier: Apache-2.0
"""Robots that learn in the full or in the simple model, and are judged on the full one.

A case is a robot and what it is to do (thesis 7.4 to 7.7): the simple model is matched to the full
one, policies are trained in either with several seeds, one is kept every few iterations, and all of
them are judged. What is there already is not made again, so that a study goes on where it ended.
"""

import json
from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import joblib
import numpy as np

from pneu_common.errors import InputError
from pneu_common.files import write_whole
from pneu_common.progress import progress
from pneu_policy.control.robot_policy import RobotPolicy
from pneu_policy.learn.networks import mean_action
from pneu_policy.learn.rollout import roll_out
from pneu_policy.learn.sweep import Run, Workers, expand
from pneu_policy.task.robots import Robots, RobotSettings
from pneu_sim.lumped.match import Matched, match_thin_plate
from pneu_sim.rig.load import load_rig, save_rig
from pneu_sim.rig.schema import Rig
from studies.digest import digest_of
from studies.training import train_runs

KINDS = ("pde", "plate")
TITLES = {"pde": "the full model", "plate": "the simple model"}
SEED = 31_000
"""Of the episodes that policies are judged by."""
MODEL_ONLY: dict[str, Any] = {"line": []}
"""What of a recipe the simple model cannot tell: it has no lines (thesis 7.5)."""


@dataclass(frozen=True)
class Case:
    """A robot, and what it is to do.

    Attributes:
        name: Of the case, as files have it.
        folder: Where its trainings and what is judged are kept.
        rig: File of the full model.
        plate: File of the simple model, which `match` writes.
        document: Fields of `TrainSettings` for the full model, without ``sweep``.
        seeds: Seeds of trainings by kind of model.
        settled: Share of an episode, from its beginning, that is not judged.
    """

    name: str
    folder: Path
    rig: Path
    plate: Path
    document: dict[str, Any]
    seeds: dict[str, tuple[int, ...]]
    settled: float = 0.25

    def trained(self, kind: str) -> dict[str, Any]:
        """Fields of `TrainSettings` for a kind of model.

        Args:
            kind: ``pde`` or ``plate``.
        """
        document = deepcopy(self.document)
        document["env"]["rig"] = str(self.rig if kind == "pde" else self.plate)
        if kind == "plate":
            document["env"]["recipe"] |= MODEL_ONLY
        return document

    def runs(self, kind: str) -> list[Run]:
        """Trainings in a kind of model.

        Args:
            kind: ``pde`` or ``plate``.
        """
        document = self.trained(kind) | {"sweep": {"seed": list(self.seeds[kind])}}
        return expand(document, self.folder / "training" / kind)

    @property
    def matched(self) -> dict[str, Any]:
        """What the match found."""
        return dict(json.loads((self.folder / "match.json").read_text(encoding="utf-8")))

    @property
    def rows(self) -> list[dict[str, Any]]:
        """What was judged."""
        path = self.folder / "judge.json"
        if not path.exists():
            raise InputError(f"{path}: is missing; the stage judge makes it")
        return list(json.loads(path.read_text(encoding="utf-8"))["rows"])


def written(rig: Rig, path: Path) -> Path:
    """A rig as a file, left alone where it says the same already.

    Args:
        rig: The rig.
        path: Where.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.exists() or load_rig(path) != rig:
        save_rig(rig, path)
    return path


def match(cases: Sequence[Case], workers: int = 1, levels: int = 5) -> None:
    """Matches the simple model of each case to its full one.

    Args:
        cases: The cases.
        workers: At a time.
        levels: Openings to either side of a valve's null.
    """
    todo = [c for c in cases if not _stands(c)]
    jobs = joblib.Parallel(workers, return_as="generator_unordered")(
        joblib.delayed(_match)(case, levels) for case in todo
    )
    with progress("matching") as tell:
        for done, name in enumerate(jobs, 1):
            tell("cases", done / len(todo), name)


def _stands(case: Case) -> bool:
    """Whether the match is of the rig as it is."""
    try:
        return bool(case.matched["rig"] == digest_of([case.rig])) and case.plate.exists()
    except (OSError, KeyError, ValueError):
        return False


def _match(case: Case, levels: int) -> str:
    rig = load_rig(case.rig)
    found: Matched = match_thin_plate(rig, levels=levels)
    told = found.rig.model_copy(
        update={
            "name": f"{rig.name}_plate",
            "description": f"{rig.name} by the thin-plate model, its openings matched to the full"
            " model (thesis 7.4).",
        }
    )
    save_rig(told, case.plate)
    figures = {
        "rig": digest_of([case.rig]),
        "volts": found.volts.tolist(),
        "scales": {name: of.tolist() for name, of in found.scales.items()},
        "rmse_pa": {name: of.tolist() for name, of in found.rmse_pa.items()},
        "unmatched_pa": {name: of.tolist() for name, of in found.unmatched_pa.items()},
    }
    case.folder.mkdir(parents=True, exist_ok=True)
    write_whole(case.folder / "match.json", json.dumps(figures))
    return case.name


def train(cases: Sequence[Case], workers: Workers) -> None:
    """Trains what is not trained yet.

    Args:
        cases: The cases.
        workers: Where.

    Raises:
        InputError: A training failed.
    """
    train_runs([run for case in cases for kind in KINDS for run in case.runs(kind)], workers)


def judged_on(case: Case, kind: str, model: str) -> RobotSettings:
    """Episodes by which a policy is judged on a model.

    Args:
        case: The case.
        kind: In what it was trained; it sees what it saw there.
        model: ``pde`` or ``plate``.
    """
    env = case.trained(kind)["env"]
    return RobotSettings(**env | {"rig": str(case.rig if model == "pde" else case.plate)})


def judge(
    cases: Sequence[Case],
    workers: int,
    excerpt: Callable[[Robots, Any], dict[str, Any]] | None = None,
) -> None:
    """Judges every policy that was kept on the full model, and those of the simple one on that too.

    Args:
        cases: The cases.
        workers: At a time.
        excerpt: What else is told of the last policy of each training, from its environment and
            what acts.
    """
    todo = [case for case in cases if not _judged(case)]
    asked = [(case, kind, run) for case in todo for kind in KINDS for run in case.runs(kind)]
    found: dict[str, list[dict[str, Any]]] = {case.name: [] for case in todo}
    left = {case.name: sum(c is case for c, *_ in asked) for case in todo}
    jobs = joblib.Parallel(workers, return_as="generator", pre_dispatch="all")(
        joblib.delayed(_judge)(*one, excerpt) for one in asked
    )
    with progress("judging") as tell:
        for done, ((case, _, run), rows) in enumerate(zip(asked, jobs, strict=True), 1):
            found[case.name] += rows
            left[case.name] -= 1
            if not left[case.name]:
                told = {"of": _made_of(case), "rows": found[case.name]}
                write_whole(case.folder / "judge.json", json.dumps(told))
            tell("trainings", done / len(asked), f"{case.name} {run.folder.parent.name}")


def _made_of(case: Case) -> str:
    """Digest of the policies that are judged, and of the rigs."""
    folders = [run.folder for kind in KINDS for run in case.runs(kind)]
    files = [file for folder in folders for file in sorted(folder.glob("policy_*.npz"))]
    return digest_of([case.rig, case.plate, *files])


def _judged(case: Case) -> bool:
    path = case.folder / "judge.json"
    return path.exists() and json.loads(path.read_text(encoding="utf-8"))["of"] == _made_of(case)


def _judge(
    case: Case, kind: str, run: Run, excerpt: Callable[[Robots, Any], dict[str, Any]] | None
) -> list[dict[str, Any]]:
    files = sorted(run.folder.glob("policy_*.npz"))
    rows = []
    for model in KINDS if kind == "plate" else ("pde",):
        env = Robots(judged_on(case, kind, model))
        for file in files:
            weights = RobotPolicy.load(file).weights
            episodes = roll_out(env, partial(mean_action, weights), SEED)
            begin = round(case.settled * len(episodes.error))
            alive = np.ones_like(episodes.error, bool) if episodes.alive is None else episodes.alive
            error = np.abs(episodes.error[begin:][alive[begin:]])
            success = episodes.success
            row = {
                "kind": kind,
                "on": model,
                "seed": run.settings.seed,
                "iteration": int(file.stem.split("_")[1]),
                "mean": float(error.mean()) if error.size else None,
                "rms": float(np.sqrt((error**2).mean())) if error.size else None,
                "score": episodes.score,
                "success": None if success is None else float(success[begin:].mean()),
                "lasted": float(alive.mean()),
            }
            if file == files[-1] and excerpt is not None:
                row |= excerpt(env, weights)
            rows.append(row)
    return rows


def told(rows: Sequence[dict[str, Any]], kind: str, on: str, what: str = "mean") -> list[list[Any]]:
    """What was judged of every seed, iteration by iteration.

    Args:
        rows: All of it.
        kind: In what they were trained.
        on: On what they are judged.
        what: Which figure.

    Returns:
        Per seed the figures in the order of iterations; None where an episode never got that far.
    """
    own: dict[int, dict[int, Any]] = {}
    for row in rows:
        if row["kind"] == kind and row["on"] == on:
            own.setdefault(row["seed"], {})[row["iteration"]] = row[what]
    return [[of[k] for k in sorted(of)] for _, of in sorted(own.items())]


def last(rows: Sequence[dict[str, Any]], kind: str, on: str, what: str = "mean") -> list[float]:
    """The same at the end of each training; infinite where episodes never got that far.

    Args:
        rows: All that was judged.
        kind: In what they were trained.
        on: On what they are judged.
        what: Which figure.
    """
    return [np.inf if of[-1] is None else of[-1] for of in told(rows, kind, on, what)]


def best(rows: Sequence[dict[str, Any]], kind: str, on: str, what: str = "mean") -> list[float]:
    """The same at the iteration of each at which it is least.

    Args:
        rows: All that was judged.
        kind: In what they were trained.
        on: On what they are judged.
        what: Which figure.
    """
    return [min(np.inf if x is None else x for x in of) for of in told(rows, kind, on, what)]
