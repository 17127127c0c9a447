# SPDX-License-Identifier: Apache-2.0
"""One command of the identification as a process of its own, so that it can be ended at any time.

The process reads one request from its standard input (JSON, the fields of `Request`) and writes
one JSON object per line to its standard output: ``{"stage": …, "progress": …}`` while it works,
then ``{"success": …, "message": …, "verdict": …, "result_file": …}``. Results are written to a
folder aside and moved to their place at the end, in one go. When its standard input closes, the
process that asked is gone: it clears up and ends.
"""

import json
import math
import os
import shutil
import sys
import threading
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TextIO

from pneu_common.errors import InputError
from pneu_common.log import hand_on
from pneu_sim.rig import load_rig, save_rig
from pneu_sysid.commands import fit_result, read_findings
from pneu_sysid.compare import compare
from pneu_sysid.diagnose import diagnose_apart, result_of_diagnosis
from pneu_sysid.fit import fit_rig
from pneu_sysid.gross import refuse_gross_errors
from pneu_sysid.learn import learn, result_of_learning
from pneu_sysid.problem import make_problem, record_for
from pneu_sysid.report import write_report
from pneu_sysid.results import write_json

FIT_ITERATIONS = 8
TASKS = ("fit", "compare", "diagnose", "learn")

Tell = Callable[[str, float], None]


@dataclass(frozen=True)
class Request:
    """What is asked for.

    Attributes:
        task: One of ``TASKS``.
        bag: Recording.
        rig: Rig file.
        output: What is written: a rig file (fit), a report (compare, diagnose), a folder (learn).
        aside: Folder for work in progress, on the same disk as the output; made and removed.
        workers: Threads; 0 is all cores.
        more_bags: Further recordings of the same rig.
    """

    task: str
    bag: str
    rig: str
    output: str
    aside: str
    workers: int = 0
    more_bags: tuple[str, ...] = ()


@dataclass(frozen=True)
class Outcome:
    """What came of it.

    Attributes:
        success: Whether the output is there.
        message: Why not.
        verdict: Of ``diagnose`` and ``learn``.
        result_file: JSON of the result.
    """

    success: bool
    message: str = ""
    verdict: str = ""
    result_file: str = ""


def check(request: Request) -> None:
    """Raises InputError where it can be told beforehand that a request will fail.

    Args:
        request: The request.
    """
    if request.task not in TASKS:
        raise InputError(f"task: found {request.task!r}, allowed are {', '.join(TASKS)}")
    for name in ("bag", "rig"):
        if not Path(getattr(request, name)).exists():
            raise InputError(f"{name}: found {getattr(request, name)!r}, there is no such file")
    for bag in request.more_bags:
        if not Path(bag).exists():
            raise InputError(f"more_bags: found {bag!r}, there is no such file")
    if not request.output:
        raise InputError("output: found nothing, a path is needed")
    output = Path(request.output)
    if not output.absolute().parent.is_dir():
        raise InputError(f"output: folder {output.absolute().parent} does not exist")
    if request.task == "learn" and output.exists():
        raise InputError(f"output: {output} exists already; learning writes to a new folder")
    if request.task != "learn" and output.is_dir():
        raise InputError(f"output: {output} is a folder, a file is needed")


def perform(request: Request, tell: Tell) -> Outcome:
    """Does what is asked, and puts all of its results in place at the end.

    Args:
        request: The request.
        tell: Called with a stage and the fraction done, NaN where it is not known.

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
        if request.task != "learn":
            os.replace(result, result_file)
        os.replace(written, output)
    finally:
        shutil.rmtree(aside, ignore_errors=True)
    return Outcome(True, verdict=verdict, result_file=str(result_file))


def main() -> None:
    """Serves the one request that this process was started for."""
    request = Request(**json.loads(sys.stdin.readline()))
    answers = sys.stdout
    sys.stdout = sys.stderr  # what a library prints must not come between the answers
    threading.Thread(target=_end_with_asker, args=(request,), daemon=True).start()

    def tell(stage: str, done: float) -> None:
        _say(answers, stage=stage, progress=done)

    hand_on(lambda text: tell(text, 0.0))
    try:
        outcome = perform(request, tell)
    except InputError as error:
        outcome = Outcome(False, str(error))
    except OSError as error:
        outcome = Outcome(False, f"{error.filename}: {error.strerror}")
    _say(answers, **asdict(outcome))


def _say(stream: TextIO, **values: Any) -> None:
    print(json.dumps(values), file=stream, flush=True)


def _end_with_asker(request: Request) -> None:
    sys.stdin.read()
    shutil.rmtree(request.aside, ignore_errors=True)
    os._exit(1)


if __name__ == "__main__":
    main()
