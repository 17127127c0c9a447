# SPDX-License-Identifier: Apache-2.0
"""Controllers tried in simulation on the same targets: runs, with noise and delay as on a rig.

A run begins with gas at rest at the room's pressure and a closed valve, as one on a rig does that
was vented. Its first second is not judged.
"""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from pneu_policy.controllers import Controller, PolicyController, load_controller
from pneu_policy.metrics import EARLY_S, LATE_S, Metrics, Track, measure
from pneu_policy.plants import make_plant
from pneu_policy.results import LIMIT, Evaluation, Run
from pneu_policy.targets import KINDS, Kind, Target
from pneu_sim import sensors
from pneu_sim.errors import InputError
from pneu_sim.rig.schema import AttachedEffect, Rig

Floats = NDArray[np.float64]
Controllers = Mapping[str, Sequence[Path]]
TARGET_STEP_S = 0.002
NOISE_PA = 250.0
"""Noise of the sensors, one sigma: what the calibrations of the rigs found as noise floor."""


@dataclass(frozen=True)
class Tasks:
    """What controllers are tried on.

    Attributes:
        kinds: Kinds of target.
        seeds: Seeds of the targets; each is a run.
        low_pa: Lowest target, Pa.
        high_pa: Highest target, Pa.
        period_s: Typical time between a target's extremes, s.
        jitter: Share of that by which corners of jagged targets are moved.
        duration_s: Length of a run, s.
        skip_s: Beginning that is not judged, s.
        null_v: Voltage at which the valve closes, V.
    """

    kinds: tuple[Kind, ...] = ("smooth", "jagged")
    seeds: tuple[int, ...] = (0, 1, 2, 3, 4)
    low_pa: float = 150e3
    high_pa: float = 550e3
    period_s: float = 0.3
    jitter: float = 0.6
    duration_s: float = 12.0
    skip_s: float = 1.0
    null_v: float = 5.0

    def __post_init__(self) -> None:
        """Raises InputError where the numbers make no runs."""
        for kind in self.kinds:
            if kind not in KINDS:
                raise InputError(f"targets: found {kind!r}, allowed are {', '.join(KINDS)}")
        if not self.kinds or not self.seeds:
            raise InputError("targets, seeds: found none, needed is at least one of each")
        if len(set(self.kinds)) < len(self.kinds) or len(set(self.seeds)) < len(self.seeds):
            raise InputError("targets, seeds: found one twice, each is run once")
        if not LATE_S <= self.skip_s < self.duration_s - 0.5:
            raise InputError(
                f"skip_s: found {self.skip_s:g}, allowed are {LATE_S:g} s to half a second before"
                f" the end at {self.duration_s:g} s"
            )
        self.target(self.kinds[0], self.seeds[0])

    @property
    def band_hz(self) -> float:
        """Upper end of the targets' band: twice the fastest sine of a smooth one."""
        return 3.0 / self.period_s

    def target(self, kind: str, seed: int) -> Target:
        """The target of a run.

        Args:
            kind: Its kind.
            seed: Its seed.
        """
        return Target(
            cast(Kind, kind), self.low_pa, self.high_pa, self.period_s, seed, jitter=self.jitter
        )  # fmt: skip

    def judge(self, track: Track) -> Metrics:
        """The figures of a run.

        Args:
            track: What it left; the target began at time zero.

        Raises:
            ValueError: The run cannot be judged.
        """
        return measure(track, self.skip_s, self.duration_s, self.null_v, self.band_hz)

    def to_dict(self) -> dict[str, Any]:
        """Returns the tasks as plain data."""
        data = asdict(self)
        return {k: list(v) if isinstance(v, tuple) else v for k, v in data.items()}


@dataclass(frozen=True)
class Conditions:
    """What lies between a simulated rig and its controller.

    Attributes:
        noise_pa: Noise of the readings, one sigma, Pa.
        delay_s: Delay of commands beyond the rig's own, s.
        dx_m: Cell length that replaces the rig's, m.
        start_pa: Pressure behind the valve at the start, Pa; None is the room's.
    """

    noise_pa: float = NOISE_PA
    delay_s: float = 0.004
    dx_m: float | None = None
    start_pa: float | None = None


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
    if c.delay_s > 0.0:
        late = AttachedEffect(
            effect="valve_delay",
            place=next(iter(rig.valves)),
            parameters={"delay_s": c.delay_s},
        )
        rig = rig.model_copy(update={"effects": [*rig.effects, late]})
    plant = make_plant([rig] * len(targets), first.period_s, c.dx_m)
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
