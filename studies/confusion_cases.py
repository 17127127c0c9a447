# SPDX-License-Identifier: Apache-2.0
"""Recordings of rigs drawn at random, each with an effect that the calibrated rig lacks, or none.

The plant has a finer grid, another limiter and another flux than the model, valves with curves,
delays and limits that no datasheet tells, and each rig is calibrated from its datasheet first. What
is injected has a place, a position and a strength of its own, none of them the catalogue's typical
one. An effect that changes no sensor by a few times its noise is made stronger until it does. A
joint is steered in a loop of its own, by which an effect changes the commands too: what it changes
is told by a healthy joint beside it that gets the same commands and is put to where the other is
several times a second.
"""

import json
import math
import pickle
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pneu_common.files import whole
from pneu_sim.effects import registry
from pneu_sim.effects.base import POSITION, Effect
from pneu_sim.rig import load_rig, save_rig
from pneu_sim.rig.schema import AttachedEffect, Rig
from pneu_sysid.fit import fit_rig
from pneu_sysid.records import Recording
from studies.calibration_rigs import draw_asked, draw_case, noises, run_plant, sampled
from studies.joint_runs import Excitation, Floats, Run

RIGS = (("line", 11), ("tee", 12), ("two_valves", 13), ("joint", 14))
"""Shape and seed of each rig; other seeds than the calibration's study has."""
SECONDS = 14.0
HEALTHY = 10
FELT = 3.0
"""An injected effect changes its most affected sensor by so many times the noise, root mean square.
"""
MOST_DOUBLINGS = 5
COMMANDS = 3
"""Command sequences that the faulty recordings of a rig share."""


@dataclass(frozen=True)
class Injection:
    """What is hidden in a recording.

    Attributes:
        rig: Name of the rig.
        key: Name of the recording.
        effect: Name of the effect; empty where there is none.
        place: Its place.
        values: Its parameters.
        felt: By how many times the noise it changes the sensor that feels it most.
    """

    rig: str
    key: str
    effect: str = ""
    place: str = ""
    values: dict[str, float] = field(default_factory=dict)
    felt: float = 0.0

    @property
    def strength(self) -> float:
        """How strong it is."""
        return self.values[registry()[self.effect].strength.name]


def strengths(effect: Effect, rig: Rig, place: str, rng: np.random.Generator) -> Iterator[float]:
    """Strengths to try, each twice the one before, within the effect's bounds.

    Args:
        effect: The effect.
        rig: The rig.
        place: Its place.
        rng: Source of the first, half to twice the typical one, and of its sign.
    """
    p = effect.strength
    low, high = effect.limits(p, rig, place)
    by = math.exp(rng.uniform(math.log(0.5), math.log(2.0)))
    if 0.9 < by < 1.1:
        by = 1.25
    if low < p.absent - 0.25 * abs(p.typical - p.absent) and rng.random() < 0.5:
        by = -by
    last = math.nan
    for k in range(MOST_DOUBLINGS + 1):
        # not on the bound itself
        at = p.absent + by * 2.0**k * (p.typical - p.absent)
        value = float(np.clip(at, low + 0.02 * (p.absent - low), high - 0.02 * (high - p.absent)))
        if value != last:
            yield value
        last = value


def place_of(effect: Effect, rig: Rig, rng: np.random.Generator) -> str | None:
    """One of the places of an effect; None where it has none.

    Args:
        effect: The effect.
        rig: The rig.
        rng: Source of the choice.
    """
    places = effect.places(rig)
    return str(rng.choice(places)) if places else None


def shape_of(effect: Effect, rig: Rig, place: str, rng: np.random.Generator) -> dict[str, float]:
    """Every parameter but the strength: a position anywhere, and what is fitted not typical.

    Where the rig bounds a parameter (a relief valve's set pressure lies between those that there
    are) it is drawn from the middle half of what the rig allows.

    Args:
        effect: The effect.
        rig: The rig.
        place: Its place.
        rng: Source of the draws.
    """
    values = {}
    for q in effect.parameters[1:]:
        low, high = effect.limits(q, rig, place)
        if q.name == POSITION:
            values[q.name] = float(rng.uniform(0.1, 0.9) * rig.pipes[place].length_m)
        elif q.fitted and (low, high) != (q.lower, q.upper):
            values[q.name] = float(low + rng.uniform(0.25, 0.75) * (high - low))
        elif q.name == "at":  # where a spring pulls to, typically zero
            values[q.name] = float(np.clip(q.step * rng.uniform(-20.0, 20.0), low, high))
        elif q.fitted:
            values[q.name] = float(np.clip(q.typical * rng.uniform(0.5, 2.0), low, high))
        else:
            values[q.name] = q.typical
    return values


def apart(faulty: dict[str, Floats], healthy: dict[str, Floats], noise: dict[str, float]) -> float:
    """How much two runs differ at the sensor where they differ most, in noise deviations.

    Args:
        faulty: What sensors read on one run.
        healthy: The same on the other.
        noise: Noise of each, Pa, rad or m.
    """
    return max(
        float(np.sqrt(np.mean((faulty[sensor] - healthy[sensor]) ** 2))) / noise[sensor]
        for sensor in healthy
    )


def calibrated(shape: str, seed: int, folder: Path) -> Rig:
    """The calibration of a rig of the study, which is made once.

    Args:
        shape: Its shape.
        seed: Its seed.
        folder: Where calibrations are kept.
    """
    file = folder / f"{shape}_{seed}.yaml"
    if not file.exists():
        case = draw_case(shape, seed)
        folder.mkdir(parents=True, exist_ok=True)
        save_rig(fit_rig(case.datasheet, case.recordings[0]).rig, file)
    return load_rig(file)


def recordings_of(shape: str, seed: int, folder: Path) -> list[tuple[Injection, Path]]:
    """Makes the recordings of a rig that are not there yet.

    Args:
        shape: Its shape.
        seed: Its seed.
        folder: Where recordings are kept.

    Returns:
        What each hides, and where it is; `load_recording` reads it.
    """
    folder.mkdir(parents=True, exist_ok=True)
    case = draw_case(shape, seed, count=0)
    plant, rate, noise = case.truth, case.rate_hz, case.noise_pa
    out = []
    for k in range(HEALTHY):
        rng = np.random.default_rng([seed, 1, k])
        key = f"{shape}_{seed}_healthy_{k}"
        injection = Injection(case.name, key)
        if not (folder / f"{key}.pkl").exists():
            run = run_plant(plant, draw_asked(plant, SECONDS, rng), noise)
            recording = sampled(plant, run, rng, rate, noise, key)
            _keep(folder, injection, recording)
        out.append((injection, folder / f"{key}.pkl"))
    shared: dict[int, tuple[dict[str, Floats] | Excitation, Run | None]] = {}
    for number, effect in enumerate(registry().values()):
        rng = np.random.default_rng([seed, 2, *effect.name.encode()])
        place = place_of(effect, plant, rng)
        if place is None:
            continue
        key = f"{shape}_{seed}_{effect.name}"
        told = folder / f"{key}.json"
        if not told.exists():
            along = number % COMMANDS
            if along not in shared:
                own = np.random.default_rng([seed, 3, along])
                asked = draw_asked(plant, SECONDS, own)
                shared[along] = asked, None if plant.bodies else run_plant(plant, asked)
            asked, alone = shared[along]
            values = shape_of(effect, plant, place, rng)
            for strength in strengths(effect, plant, place, rng):
                values[effect.strength.name] = strength
                attached = AttachedEffect(effect=effect.name, place=place, parameters=values)
                hiding = plant.model_copy(update={"effects": [attached]})
                faulty = run_plant(hiding, asked, noise, plant if alone is None else None)
                healthy = faulty.beside if alone is None else alone.readings
                felt = apart(faulty.readings, healthy, noises(plant, noise))
                if felt >= FELT:
                    break
            injection = Injection(case.name, key, effect.name, place, dict(values), felt)
            _keep(folder, injection, sampled(plant, faulty, rng, rate, noise, key))
        out.append((Injection(**json.loads(told.read_text())), folder / f"{key}.pkl"))
    return out


def load_recording(path: Path) -> Recording:
    """A recording that this study has kept.

    Args:
        path: Its file.
    """
    with path.open("rb") as file:
        recording = pickle.load(file)
    assert isinstance(recording, Recording)
    return recording


def _keep(folder: Path, injection: Injection, recording: Recording) -> None:
    with whole(folder / f"{injection.key}.pkl") as aside, aside.open("wb") as file:
        pickle.dump(recording, file)
    (folder / f"{injection.key}.json").write_text(json.dumps(vars(injection), indent=1))
