# SPDX-License-Identifier: Apache-2.0
"""Controllers tried on the emulated lab through the live graph, and judged by the recording alone.

A run during which the machine did not keep up is repeated, at most twice.
"""

import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from pneu_common.errors import InputError
from pneu_policy.judge.evaluate import Controllers, file_for, open_controllers
from pneu_policy.judge.metrics import Metrics, Track
from pneu_policy.judge.results import Evaluation, Run
from pneu_policy.judge.tasks import Tasks
from pneu_policy.live.bag import LateError, track_of
from pneu_policy.live.rig import LivePlant, LiveRig
from pneu_sim.rig import load_rig

TRIES = 3


def evaluate_live(
    evaluation: Evaluation,
    controllers: Controllers,
    plants: Sequence[LivePlant],
    tasks: Tasks,
    keep_bags: bool = False,
    progress: Callable[[str, float], None] | None = None,
) -> None:
    """Tries controllers on emulated labs; runs that are there already are not run again.

    The order is target by target, and controller by controller within one, so that what changes
    slowly on the machine meets all controllers alike.

    Args:
        evaluation: Where the runs go; its folder must be set.
        controllers: Files of each by name; where there are several, `file_for` says which runs.
        plants: The labs.
        tasks: The targets.
        keep_bags: Keep the recordings of valid runs in the folder.
        progress: Called with what is run and the fraction of all that is done.

    Raises:
        InputError: A controller is not for a rig, or a lab cannot be run here.
    """
    if evaluation.folder is None:
        raise InputError("a live evaluation needs a folder for its recordings")
    rigs = {plant.name: load_rig(plant.rig) for plant in plants}
    tap = open_controllers(evaluation, controllers, rigs)
    folder = evaluation.folder / "live"
    missing = {
        plant.name: [
            run
            for kind in tasks.kinds
            for seed in tasks.seeds
            for name in controllers
            if not evaluation.has((run := Run(name, plant.name, kind, seed, None)).key)
        ]
        for plant in plants
    }
    total = sum(map(len, missing.values()))
    done = 0
    for plant in plants:
        if not missing[plant.name]:
            continue
        with LiveRig(plant, tap, folder) as rig:
            for run in missing[plant.name]:
                if progress is not None:
                    progress(run.key, done / total)
                file = file_for(controllers[run.controller], run.seed)
                _run(evaluation, rig, file, run, tasks, keep_bags)
                done += 1


def _judged(tasks: Tasks, track: Track) -> Metrics:
    """The figures of a run; a recording with a gap is one of a machine that was too busy."""
    try:
        return tasks.judge(track)
    except ValueError as error:
        raise LateError(str(error)) from None


def _run(
    evaluation: Evaluation, rig: LiveRig, spec: Path, run: Run, tasks: Tasks, keep_bags: bool
) -> None:
    """One run, repeated where the machine did not keep up."""
    target = tasks.target(run.kind, run.seed)
    notes = [spec.stem]
    for attempt in range(1, TRIES + 1):
        bag = rig.folder / run.key
        shutil.rmtree(bag, ignore_errors=True)
        track: Track | None = None
        figures: Metrics | None = None
        try:
            rig.record(spec, tasks, target, bag)
            track = track_of(bag, rig.tap)
            figures = _judged(tasks, track)
        except LateError as error:
            notes.append(str(error))
        if not keep_bags:
            shutil.rmtree(bag, ignore_errors=True)
        if figures is not None or attempt == TRIES:
            note = "; ".join(notes)
            evaluation.add(replace(run, metrics=figures, attempts=attempt, note=note), track)
            return
