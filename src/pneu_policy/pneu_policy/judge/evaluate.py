# SPDX-License-Identifier: Apache-2.0
"""Controllers tried in simulation on the same targets: runs, with noise and delay as on a rig.

A run begins with gas at rest at the room's pressure and a closed valve, as one on a rig does that
was vented. Its first second is not judged.
"""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_policy.control.controllers import Controller, load_controller
from pneu_policy.control.late import with_delay
from pneu_policy.control.learned import PolicyController
from pneu_policy.control.predictive import PredictiveController
from pneu_policy.control.virtual import VirtualTaps
from pneu_policy.judge.metrics import EARLY_S, Track
from pneu_policy.judge.results import LIMIT, Evaluation, Run
from pneu_policy.judge.tasks import Conditions, Tasks
from pneu_policy.task.plants import ControlPlant
from pneu_policy.task.targets import Target
from pneu_sim import sensors
from pneu_sim.rig.schema import Rig

Floats = NDArray[np.float64]
Controllers = Mapping[str, Sequence[Path]]
TARGET_STEP_S = 0.002


def check_fits(controller: Controller, spec: Path, rig: Rig) -> None:
    """Refuses a controller that is not for a rig.

    Args:
        controller: The controller.
        spec: Where it was read from.
        rig: The rig.

    Raises:
        InputError: It was trained for another, or needs a tap that is not there.
    """
    if isinstance(controller, PolicyController):
        controller.policy.check_rig(rig)
    if isinstance(controller, PredictiveController | VirtualTaps):
        controller.check_rig(rig, str(spec))
    missing = [tap for tap in controller.taps if tap not in rig.taps]
    if missing:
        raise InputError(
            f"{spec}: needs tap {missing[0]!r}, rig {rig.name!r} has {', '.join(rig.taps)}"
        )
    if len(rig.commands) != 1:
        raise InputError(f"rig {rig.name!r}: found {len(rig.commands)} valves, needed is one")


def provenance(files: Sequence[Path]) -> dict[str, Any]:
    """Where a controller comes from.

    Args:
        files: Its files.
    """
    digests = [hashlib.sha256(file.read_bytes()).hexdigest() for file in files]
    return {
        "files": [file.name for file in files],
        "sha256": digests[0] if len(digests) == 1 else hashlib.sha256(
            "".join(digests).encode()
        ).hexdigest(),
    }  # fmt: skip


def names_of(specs: Sequence[Path]) -> dict[str, Path]:
    """A name for each controller: its file's, with the folder's where two are alike.

    Args:
        specs: Files.

    Raises:
        InputError: Two have the same name all the same.
    """
    stems = [spec.stem for spec in specs]
    out: dict[str, Path] = {}
    for spec in specs:
        name = spec.stem
        if stems.count(name) > 1 or name == LIMIT:
            name = f"{spec.parent.name}-{name}"
        if name in out:
            raise InputError(f"{spec}: two controllers are called {name!r}; rename one")
        out[name] = spec
    return out


def file_for(files: Sequence[Path], seed: int) -> Path:
    """The file that a run takes: trained several times, a controller runs each in turn.

    Args:
        files: Files of one controller, such as those of several seeds of its training.
        seed: Seed of the run's target.
    """
    return files[seed % len(files)]


def target_series(target: Target, duration_s: float) -> tuple[Floats, Floats]:
    """A target over a run and a little beyond, finely.

    Args:
        target: The target.
        duration_s: Length of the run, s.

    Returns:
        Times and pressures.
    """
    count = round((duration_s + 2.0 * EARLY_S) / TARGET_STEP_S) + 1
    times = np.arange(count, dtype=np.float64) * TARGET_STEP_S
    return times, target.at(times)


def simulated_tracks(
    spec: Path,
    rig: Rig,
    targets: Sequence[Target],
    seeds: Sequence[int],
    duration_s: float,
    conditions: Conditions | None = None,
    progress: Callable[[float], None] | None = None,
) -> list[Track]:
    """Runs one controller on several targets side by side.

    Args:
        spec: File of the controller.
        rig: The rig.
        targets: The targets.
        seeds: Seed of each run's noise.
        duration_s: Length of the runs, s.
        conditions: Noise and delay.
        progress: Called with the fraction done.

    Returns:
        What each run left.

    Raises:
        InputError: The controller is not for this rig, or the simulation became unstable.
    """
    c = conditions or Conditions()
    controllers = [load_controller(spec) for _ in targets]
    first = controllers[0]
    check_fits(first, spec, rig)
    rig = with_delay(rig, c.delay_s)
    plant = ControlPlant([rig] * len(targets), first.period_s, c.dx_m)
    room_pa = rig.ambient.pressure_pa
    clean = plant.reset(room_pa if c.start_pa is None else c.start_pa)
    taps = [rig.taps[tap] for tap in plant.taps]
    noise = np.full(len(taps), c.noise_pa)
    quantum = np.array([t.quantum_pa for t in taps])
    draws = [np.random.default_rng([seed, 7]) for seed in seeds]
    steps = round(duration_s / first.period_s)
    times = np.arange(steps + 1, dtype=np.float64) * first.period_s
    ahead = [target.at(times[:, None] + np.array(first.preview_s)) for target in targets]
    shown = np.empty((steps + 1, len(targets)))
    volts = np.empty((steps + 1, len(targets)))
    points = first.policy.recipe.line if isinstance(first, PolicyController) else ()
    at = plant.taps.index(first.tap)
    for step in range(steps + 1):
        line = plant.line(points) if points else None
        for j, controller in enumerate(controllers):
            seen = sensors.corrupt(clean[j : j + 1], noise, quantum, draws[j])[0]
            readings = dict(zip(plant.taps, seen.tolist(), strict=True))
            now = ahead[j][step].tolist()
            if line is not None and isinstance(controller, PolicyController):
                volts[step, j] = controller.step(readings, now, line[j : j + 1])
            else:
                volts[step, j] = controller.step(readings, now)
            shown[step, j] = seen[at]
        clean = plant.step(volts[step])
        if progress is not None and step % 50 == 0:
            progress(step / steps)
    series = [target_series(target, duration_s) for target in targets]
    return [Track(times, shown[:, j], *series[j], times, volts[:, j]) for j in range(len(targets))]


def open_controllers(
    evaluation: Evaluation, controllers: Controllers, plants: Mapping[str, Rig]
) -> str:
    """Checks controllers and tells an evaluation where they come from.

    Args:
        evaluation: The evaluation.
        controllers: Files of each by name.
        plants: Rigs that they shall all run on, by name.

    Returns:
        The tap that they control.

    Raises:
        InputError: One is not for a rig, or they control several taps.
    """
    tap = ""
    for name, files in controllers.items():
        for file in files:
            controller = load_controller(file)
            for rig in plants.values():
                check_fits(controller, file, rig)
            if tap not in ("", controller.tap):
                raise InputError(f"{file}: controls tap {controller.tap!r}, others {tap!r}")
            tap = controller.tap
        for plant in plants:
            evaluation.introduce(plant, name, provenance(files))
    if not tap:
        raise InputError("controllers: found none, needed is at least one")
    return tap


def evaluate_simulated(
    evaluation: Evaluation,
    controllers: Controllers,
    plants: Mapping[str, Rig],
    tasks: Tasks,
    conditions: Conditions | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> None:
    """Tries controllers on rigs in simulation; runs that are there already are not run again.

    Args:
        evaluation: Where the runs go.
        controllers: Files of each by name; where there are several, `file_for` says which runs.
        plants: The rigs by name.
        tasks: The targets.
        conditions: Noise and delay.
        progress: Called with what is run and the fraction of it that is done.

    Raises:
        InputError: A controller is not for a rig.
    """
    open_controllers(evaluation, controllers, plants)
    for plant, rig in plants.items():
        for name, files in controllers.items():
            for file in files:
                wanted = [
                    run
                    for kind in tasks.kinds
                    for seed in tasks.seeds
                    if file_for(files, seed) == file
                    and not evaluation.has((run := Run(name, plant, kind, seed, None)).key)
                ]
                if not wanted:
                    continue
                targets = [tasks.target(run.kind, run.seed) for run in wanted]

                def told(part: float, what: str = f"{file.stem} on {plant}") -> None:
                    if progress is not None:
                        progress(what, part)

                tracks = simulated_tracks(
                    file, rig, targets, [r.seed for r in wanted], tasks.duration_s, conditions,
                    told,
                )  # fmt: skip
                for run, track in zip(wanted, tracks, strict=True):
                    evaluation.add(replace(run, metrics=tasks.judge(track), note=file.stem), track)
