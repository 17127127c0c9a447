# SPDX-License-Identifier: Apache-2.0
"""Table 9.1 with predictive control against the clock: on the emulated lab, by the live graph.

The plants, targets and controllers of ``make predictive``, each lab with its bridge, a recorder,
the node of the controller and the process that plans for it: five processes, for which two cores
have time enough with ``predictive_light`` only. A run for which the machine is too slow is tried
three times and then counts as what it is, not valid. What was found goes to
``docs/predictive_live.json``, which the page of ``make predictive`` shows; runs that are there
already in ``out/predictive_live`` are not run again. With ``--only`` what was found of other
controllers stays as it was; each run names what it was made from.
"""

import argparse
import json
import os
import sys
from pathlib import Path
from typing import Any

import joblib
from benchmarks import timing
from rich.console import Console

from pneu_common.files import write_whole
from pneu_common.progress import progress
from pneu_policy.judge.results import Evaluation, load
from pneu_policy.live.evaluate import evaluate_live
from pneu_policy.live.rig import LivePlant
from studies.digest import digest_of
from studies.predictive import LIVE, LIVE_NAMES, files_of, made_of, policies_of
from studies.pressure import TASKS, TUBES

OUT = Path("out") / "predictive_live"
CORES = 4
"""What a lab and its controller have work for."""


def of_lab(tube: str, name: str) -> list[dict[str, Any]]:
    """The runs of a controller on a tube.

    Args:
        tube: Name of the tube.
        name: Of the controller.

    Returns:
        What was found of each, with how often it was tried and why it is not valid.
    """
    files = files_of(tube, name)
    of = digest_of([*files, *policies_of(tube, name), *made_of(tube)])
    folder = OUT / f"{tube}-{name}-{of}"
    path = folder / "evaluation.json"
    evaluation = load(path) if path.exists() else Evaluation({}, folder=folder)
    plant = LivePlant(tube, TUBES[tube].rig, TUBES[tube].sealed)
    evaluate_live(evaluation, {name: files}, [plant], TASKS)
    return [
        {
            "tube": tube,
            "controller": name,
            "of": of,
            "kind": run.kind,
            "seed": run.seed,
            "attempts": run.attempts,
            "note": run.note,
            "figures": None if run.metrics is None else run.metrics.to_dict(),
        }
        for run in evaluation.runs
    ]


def main(arguments: list[str] | None = None) -> int:
    """Runs the study; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument(
        "--labs",
        type=int,
        default=max(1, (os.cpu_count() or 1) // CORES),
        help=f"labs at a time, each of which wants {CORES} cores",
    )
    parser.add_argument("--only", nargs="+", choices=LIVE_NAMES, default=LIVE_NAMES)
    parser.add_argument("--kept", type=Path, default=LIVE, help="where what was found goes")
    asked = parser.parse_args(arguments)
    jobs = [(tube, name) for name in asked.only for tube in TUBES if files_of(tube, name)]
    found: list[dict[str, Any]] = []
    if asked.kept.exists():
        before = json.loads(asked.kept.read_text(encoding="utf-8"))["runs"]
        found = [run for run in before if run["controller"] not in asked.only]
    runs = joblib.Parallel(asked.labs, return_as="generator")(
        joblib.delayed(of_lab)(*job) for job in jobs
    )
    with progress("live") as told:
        for n, (job, rows) in enumerate(zip(jobs, runs, strict=True), 1):
            found += rows
            told("labs", n / len(jobs), " ".join(job))
    kept = {"machine": timing.machine(), "labs": asked.labs, "runs": found}
    write_whole(asked.kept, json.dumps(kept, indent=1) + "\n")
    Console().print(f"{asked.kept} is written")
    return 0


if __name__ == "__main__":
    sys.exit(main())
