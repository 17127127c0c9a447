# SPDX-License-Identifier: Apache-2.0
"""What tasks do: results are written to a folder aside and moved to their place in one go."""

import json
import math
import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pneu_common.files import write_whole
from pneu_sim.rig import load_rig, save_rig
from pneu_sim.rig.schema import Rig
from pneu_sysid.command.fit_result import fit_result
from pneu_sysid.command.given import read_findings
from pneu_sysid.compare import compare
from pneu_sysid.diagnose import diagnose_apart, result_of_diagnosis
from pneu_sysid.fit import fit_rig
from pneu_sysid.gross import refuse_gross_errors
from pneu_sysid.learn import learn, refit_added, result_of_learning
from pneu_sysid.problem import Problem, make_problem, record_for
from pneu_sysid.records import Recording
from pneu_sysid.regimes import operation
from pneu_sysid.report import write_report
from pneu_sysid.results.files import write_json
from pneu_sysid.tasks.expect import EXPECTED, RUNS, RunClock, expected_s
from pneu_sysid.tasks.regime_masks import REGIMES, regime_masks, save_regimes
from pneu_sysid.tasks.request import Outcome, Request, Tell, check
from pneu_sysid.tasks.signals import SIGNALS, save_signals, signals_of
from pneu_sysid.visited import visited

FIT_ITERATIONS = 8

Errors = Callable[[dict[str, float]], object]
"""Told the error of each sensor in noise units, as it falls."""
Early = Callable[[Path], object]
"""Told the folder in which what was measured lies, before anything is known of the model."""


@dataclass(frozen=True)
class _Job:
    """A request with what it is about.

    Attributes:
        request: It.
        rig: The rig.
        recordings: The recordings.
        findings: What was found while they were read.
        written: Where the output goes for now.
        beside: Where a result beside it goes for now.
        tell: Called with a stage and the fraction done, NaN where it is not known.
        errors: Called with the error of each sensor, in noise units.
        early: Called with the folder in which what was measured lies.
    """

    request: Request
    rig: Rig
    recordings: list[Recording]
    findings: list[str]
    written: Path
    beside: Path
    tell: Tell
    errors: Errors
    early: Early

    @property
    def title(self) -> str:
        """Names of the recordings."""
        return ", ".join(recording.name for recording in self.recordings)

    @property
    def workers(self) -> int | None:
        """Threads; None is all cores."""
        return self.request.workers or None

    def problem(self) -> Problem:
        """The rig and the recordings, some of it kept aside."""
        aside = self.request.kept_aside
        return make_problem(self.rig, self.recordings, workers=self.workers, aside=aside)


def perform(
    request: Request, tell: Tell, errors: Errors | None = None, early: Early | None = None
) -> Outcome:
    """Does what is asked, and puts all of its results in place at the end.

    Args:
        request: The request.
        tell: Called with a stage and the fraction done, NaN where it is not known.
        errors: Called with the error of each sensor, in noise units, as it falls (add).
        early: Called with the folder in which what was measured lies, as signals of a model that
            says nothing, before anything is known of it (look).

    Raises:
        InputError: The recording, the rig file or the output is wrong.
    """
    check(request)
    aside, output = Path(request.aside), Path(request.output)
    work, inside = TASKS[request.task]
    result_file = output / inside if inside else output.with_suffix(".json")
    aside.mkdir()
    try:
        rig = load_rig(request.rig)
        tell("reading the recording", math.nan)
        recordings = [record_for(rig, bag) for bag in (request.bag, *request.more_bags)]
        job = _Job(
            request, rig, recordings, read_findings(recordings), aside / output.name,
            aside / result_file.name, tell, errors or (lambda told: None),
            early or (lambda folder: None),
        )  # fmt: skip
        if inside:
            job.written.mkdir()
        verdict = work(job)
        if not inside:
            os.replace(job.beside, result_file)
        os.replace(job.written, output)
    finally:
        shutil.rmtree(aside, ignore_errors=True)
    return Outcome(True, verdict=verdict, result_file=str(result_file))


def _fit(job: _Job) -> str:
    job.tell("looking for gross errors", math.nan)
    refuse_gross_errors(job.rig, job.recordings, job.workers)
    fitted = fit_rig(
        job.rig,
        job.recordings,
        iterations=FIT_ITERATIONS,
        workers=job.workers,
        progress=lambda stage, fraction=None, note="": job.tell(
            f"{stage} ({note})", math.nan if fraction is None else fraction
        ),
    )
    save_rig(fitted.rig, job.written)
    asked = job.request
    write_json(job.beside, fit_result(asked.rig, asked.output, job.recordings, fitted))
    return ""


def _compare(job: _Job) -> str:
    models = [(Path(job.request.rig).stem, job.rig, job.request.rig)]
    compared = compare(job.recordings, models, progress=lambda done: job.tell("comparing", done))
    write_json(job.beside, compared)
    write_report(job.written, title=job.title, compare=compared.as_dict())
    return ""


def _diagnose(job: _Job) -> str:
    found = diagnose_apart(job.rig, job.recordings, workers=job.workers, progress=job.tell)
    diagnosed = result_of_diagnosis(job.rig.name, found, job.findings)
    write_json(job.beside, diagnosed)
    write_report(job.written, title=job.title, diagnose=diagnosed.as_dict())
    return found.verdict


def _learn(job: _Job) -> str:
    learned = learn(
        job.rig, job.recordings, out=job.written, workers=job.workers, progress=job.tell
    )
    problem = make_problem(learned.rig, job.recordings)
    name, to = job.rig.name, job.request.output
    outcome = result_of_learning(name, learned, problem, job.findings, to)
    save_rig(learned.rig, job.written / "rig.yaml")
    write_json(job.written / "learn.json", outcome)
    first = result_of_diagnosis(name, learned.diagnoses[0], job.findings)
    write_report(
        job.written / "report.html",
        title=f"{name}: {job.title}",
        diagnose=first.as_dict(),
        learn=outcome.as_dict(),
    )
    return learned.verdict


def _look(job: _Job) -> str:
    """Errors of a rig, and every reading beside what it predicts."""
    problem = job.problem()
    nothing = np.full(problem.measured.shape, np.nan)
    save_signals(signals_of(problem, job.rig, nothing), job.written / SIGNALS)
    job.early(job.written)
    _looked(job, problem, job.rig)
    return ""


def _add(job: _Job) -> str:
    """The effects that were added last fitted together, and what that leaves."""
    job.tell("fitting what was added", 0.0)
    problem = job.problem()

    def told(done: float, errors: dict[str, float]) -> None:
        job.tell("fitting what was added", done)
        job.errors(errors)

    _looked(job, problem, refit_added(problem, job.rig, job.request.added, told))
    return ""


def _looked(job: _Job, problem: Problem, rig: Rig) -> None:
    job.tell("predicting", 0.0)
    save_rig(rig, job.written / "rig.yaml")
    file = str(Path(job.request.output) / "rig.yaml")
    timed = RunClock()

    def told(done: float) -> None:
        timed.tell(done)
        job.tell("predicting", done)

    out = problem.simulate([rig], progress=told, flows=True)
    job.tell("comparing", math.nan)
    save_signals(signals_of(problem, rig, out.readings[0]), job.written / SIGNALS)
    save_regimes(regime_masks(problem, operation(problem, rig, out)), job.written / REGIMES)
    compared = compare(problem, [(rig.name, rig, file)], refine=False, ran=[out])
    write_json(job.written / "compare.json", compared)
    write_whole(job.written / "visited.json", json.dumps(visited(rig, problem)))
    expected = {task: expected_s(task, timed.run_s, rig.moves) for task in RUNS}
    write_whole(job.written / EXPECTED, json.dumps(expected))


def _suspect(job: _Job) -> str:
    """What is missing: the verdict, the rig with each candidate, and what it would change."""
    found = diagnose_apart(
        job.rig, job.recordings, workers=job.workers, progress=job.tell,
        aside=job.request.kept_aside,
    )  # fmt: skip
    diagnosed = result_of_diagnosis(job.rig.name, found, job.findings)
    write_json(job.written / "diagnose.json", diagnosed)
    problem = found.problem
    shape = problem.measured.shape
    changes = {}
    for k, one in enumerate(found.finalists):
        save_rig(one.rig, job.written / f"candidate_{k}.yaml")
        changes[f"candidate_{k}"] = one.change.reshape(shape) * problem.noise_pa
    told = signals_of(problem, job.rig, found.bench.readings, changes)
    save_signals(told, job.written / SIGNALS)
    return found.verdict


TASKS: dict[str, tuple[Callable[[_Job], str], str]] = {
    "fit": (_fit, ""),
    "compare": (_compare, ""),
    "diagnose": (_diagnose, ""),
    "learn": (_learn, "learn.json"),
    "look": (_look, "compare.json"),
    "suspect": (_suspect, "diagnose.json"),
    "add": (_add, "compare.json"),
}
"""What does a task and returns the verdict, and the result in the folder that it writes; nothing
where its output is a file, beside which the result is put."""
