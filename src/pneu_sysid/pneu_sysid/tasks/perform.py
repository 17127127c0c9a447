# SPDX-License-Identifier: Apache-2.0
"""What tasks do: results are written to a folder aside and moved to their place in one go."""

import json
import math
import os
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pneu_common.files import write_whole
from pneu_sim.rig import load_rig, save_rig
from pneu_sim.rig.schema import Rig
from pneu_sysid.commands import fit_result, read_findings
from pneu_sysid.compare import compare
from pneu_sysid.diagnose import diagnose_apart, result_of_diagnosis
from pneu_sysid.fit import fit_rig, sensor_rmse
from pneu_sysid.gross import refuse_gross_errors
from pneu_sysid.learn import learn, result_of_learning
from pneu_sysid.problem import Problem, make_problem, record_for
from pneu_sysid.records import Recording
from pneu_sysid.refits import refit_effects
from pneu_sysid.report import write_report
from pneu_sysid.results import write_json
from pneu_sysid.tasks.request import Outcome, Request, Tell, check
from pneu_sysid.tasks.signals import save_signals, signals_of
from pneu_sysid.visited import opened_to, words_on_openings

FIT_ITERATIONS = 8
ADD_ITERATIONS = 4
ENOUGH = 5e-3
"""A share of the error that is not worth another iteration when an effect is added."""

Errors = Callable[[dict[str, float]], None]
"""Told the error of each sensor in noise units, as it falls."""


def perform(request: Request, tell: Tell, errors: Errors | None = None) -> Outcome:
    """Does what is asked, and puts all of its results in place at the end.

    Args:
        request: The request.
        tell: Called with a stage and the fraction done, NaN where it is not known.
        errors: Called with the error of each sensor, in noise units, as it falls (add).

    Raises:
        InputError: The recording, the rig file or the output is wrong.
    """
    check(request)
    aside = Path(request.aside)
    aside.mkdir()
    try:
        rig = load_rig(request.rig)
        tell("reading the recording", math.nan)
        recordings = [record_for(rig, bag) for bag in (request.bag, *request.more_bags)]
        title = ", ".join(recording.name for recording in recordings)
        findings = read_findings(recordings)
        output = Path(request.output)
        result_file = output.with_suffix(".json")
        workers = request.workers or None
        verdict = ""
        written, result = aside / output.name, aside / result_file.name
        if request.task == "fit":
            tell("looking for gross errors", math.nan)
            refuse_gross_errors(rig, recordings, workers)
            fitted = fit_rig(
                rig,
                recordings,
                iterations=FIT_ITERATIONS,
                workers=workers,
                progress=lambda stage, fraction=None, note="": tell(
                    f"{stage} ({note})", math.nan if fraction is None else fraction
                ),
            )
            save_rig(fitted.rig, written)
            write_json(result, fit_result(request.rig, request.output, recordings, fitted))
        elif request.task == "compare":
            models = [(Path(request.rig).stem, rig, request.rig)]
            compared = compare(recordings, models, progress=lambda done: tell("comparing", done))
            write_json(result, compared)
            write_report(written, title=title, compare=compared.as_dict())
        elif request.task == "diagnose":
            found = diagnose_apart(rig, recordings, workers=workers, progress=tell)
            diagnosed = result_of_diagnosis(rig.name, found, findings)
            verdict = found.verdict
            write_json(result, diagnosed)
            write_report(written, title=title, diagnose=diagnosed.as_dict())
        elif request.task == "look":
            written.mkdir()
            _look(written, rig, request.rig, recordings, workers, tell)
            result_file = output / "compare.json"
        elif request.task == "suspect":
            written.mkdir()
            verdict = _suspect(written, rig, recordings, findings, workers, tell)
            result_file = output / "diagnose.json"
        elif request.task == "add":
            written.mkdir()
            tell("adding", 0.0)
            problem = make_problem(rig, recordings, workers=workers)
            better = _refitted(problem, rig, request.added, tell, errors or (lambda told: None))
            save_rig(better, written / "rig.yaml")
            _look(written, better, str(output / "rig.yaml"), recordings, workers, tell)
            result_file = output / "compare.json"
        else:
            written.mkdir()
            learned = learn(rig, recordings, out=written, workers=workers, progress=tell)
            verdict = learned.verdict
            problem = make_problem(learned.rig, recordings)
            outcome = result_of_learning(rig.name, learned, problem, findings, request.output)
            save_rig(learned.rig, written / "rig.yaml")
            write_json(written / "learn.json", outcome)
            first = result_of_diagnosis(rig.name, learned.diagnoses[0], findings)
            write_report(
                written / "report.html",
                title=f"{rig.name}: {title}",
                diagnose=first.as_dict(),
                learn=outcome.as_dict(),
            )
            result_file = output / "learn.json"
        if result.exists():
            os.replace(result, result_file)
        os.replace(written, output)
    finally:
        shutil.rmtree(aside, ignore_errors=True)
    return Outcome(True, verdict=verdict, result_file=str(result_file))


def _look(
    folder: Path,
    rig: Rig,
    file: str,
    recordings: Sequence[Recording],
    workers: int | None,
    tell: Tell,
) -> None:
    """Errors of a rig, and every reading beside what it predicts."""
    problem = make_problem(rig, recordings, workers=workers)
    tell("predicting", 0.0)
    readings = problem.predict([rig])[0]
    save_signals(signals_of(problem, rig, readings), folder / "signals.npz")
    compared = compare(
        problem,
        [(rig.name, rig, file)],
        refine=False,
        progress=lambda done: tell("comparing", done),
    )
    write_json(folder / "compare.json", compared)
    write_whole(folder / "visited.json", json.dumps(_visited(problem, rig)))
    tell("comparing", 1.0)


def _visited(problem: Problem, rig: Rig) -> dict[str, Any]:
    """Where recordings have been, and what is kept aside of them."""
    measured = problem.measured
    return {
        "seconds": sum(r.end_s - r.start_s for r in problem.recordings),
        "openings": opened_to(rig, problem.recordings),
        "ranges": {
            name: [float(np.nanmin(measured[:, :, k])), float(np.nanmax(measured[:, :, k]))]
            for k, name in enumerate(problem.taps)
            if np.isfinite(measured[:, :, k]).any()
        },
        "words": words_on_openings(rig, problem.recordings),
        "stretches": problem.stretches,
        "kept_aside": int(problem.held_out.sum()),
    }


def _suspect(
    folder: Path,
    rig: Rig,
    recordings: Sequence[Recording],
    findings: list[str],
    workers: int | None,
    tell: Tell,
) -> str:
    """What is missing: the verdict, the rig with each candidate, and what it would change."""
    found = diagnose_apart(rig, recordings, workers=workers, progress=tell)
    write_json(folder / "diagnose.json", result_of_diagnosis(rig.name, found, findings))
    problem = found.problem
    shape = problem.measured.shape
    changes = {}
    for k, one in enumerate(found.finalists):
        save_rig(one.rig, folder / f"candidate_{k}.yaml")
        changes[f"candidate_{k}"] = one.change.reshape(shape) * problem.noise_pa
    told = signals_of(problem, rig, found.bench.readings, changes)
    save_signals(told, folder / "signals.npz")
    return found.verdict


def _refitted(problem: Problem, rig: Rig, added: int, tell: Tell, errors: Errors) -> Rig:
    """A rig with its last effects fitted together, the errors told after every iteration."""
    noise = dict(zip(problem.taps, problem.noise_pa.tolist(), strict=True))
    used = ~problem.held_out

    def told(of: Rig) -> float:
        rmse = sensor_rmse(problem, problem.predict([of])[0], used)
        times = {name: value / noise[name] for name, value in rmse.items()}
        errors(times)
        return float(np.sqrt(np.mean(np.square(list(times.values())))))

    indices = list(range(len(rig.effects) - added, len(rig.effects)))
    told(rig.model_copy(update={"effects": rig.effects[:-1]}))
    before = told(rig)
    for k in range(ADD_ITERATIONS):
        tell("fitting what was added", k / ADD_ITERATIONS)
        better, _ = refit_effects(problem, rig, indices, 1)
        after = told(better)
        if not after < before:
            break
        rig, gone = better, 1.0 - after / before
        before = after
        if gone < ENOUGH:
            break
    return rig
