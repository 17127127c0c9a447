# SPDX-License-Identifier: Apache-2.0
"""Pairs of effects that a random recording leaves open: does a designed one name the right one?"""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from pneu_sim.rig import load_rig, save_rig
from pneu_sim.rig.schema import AttachedEffect, Rig
from pneu_sysid.design.design import Asked, design
from pneu_sysid.design.hypotheses import hypotheses_of
from pneu_sysid.design.judge import judged
from pneu_sysid.design.limits import Limits, limits_of
from pneu_sysid.design.waves import STEP_S
from pneu_sysid.diagnose import Diagnosis, diagnose, result_of_diagnosis
from pneu_sysid.fit import fit_rig
from pneu_sysid.records import Recording
from studies.digest import sources_digest
from studies.experiments.plants import RATE_HZ, ROOT, plant_of, random_volts, record

OUT = ROOT / "out" / "experiments"
SECONDS = 10.0
SEEDS = 4
"""Random recordings that are tried at each strength until one leaves it open."""


@dataclass(frozen=True)
class Pair:
    """Two effects that look alike.

    Attributes:
        name: In words.
        rig: Rig file.
        taps: Of it that are there; all where it names none.
        hidden: What the plant has.
        strengths: Multiples of the strength that are tried, one after the other.
        voltages: Range of the random recording, V; None is the rig's.
    """

    name: str
    rig: str
    taps: tuple[str, ...]
    hidden: AttachedEffect
    strengths: tuple[float, ...] = (1.0, 0.5, 0.25, 0.12)
    voltages: tuple[float, float] | None = None


def _effect(effect: str, place: str, **parameters: float) -> AttachedEffect:
    return AttachedEffect(effect=effect, place=place, parameters=parameters)


PAIRS = (
    Pair(
        "leak at the closed end or spool leakage", "rigs/lab.yaml", ("end",),
        _effect("leak", "tube", area_m2=3e-9, position_m=1.45),
        voltages=(4.6, 5.6),
    ),
    Pair(
        "delay or sensor lag", "rigs/lab.yaml", ("end",),
        _effect("sensor_lag", "end", lag_s=4e-3),
        strengths=(0.12, 0.06, 0.03), voltages=(4.0, 6.0),
    ),
    Pair(
        "dead volume or compliance", "rigs/lab.yaml", ("end",),
        _effect("dead_volume", "tube", volume_m3=4e-7, position_m=1.45),
        voltages=(4.0, 6.0),
    ),
    Pair(
        "compliance or dead volume", "rigs/lab.yaml", ("end",),
        _effect("wall_compliance", "tube", compliance_per_pa=5e-8), voltages=(4.0, 6.0),
    ),
    Pair(
        "blockage or local loss", "rigs/lab.yaml", ("valve_out", "end"),
        _effect("blockage", "tube", fraction=0.4, position_m=0.8),
        voltages=(4.0, 6.0),
    ),
    Pair(
        "gain or bias", "rigs/lab.yaml", ("end",),
        _effect("sensor_gain", "end", error=0.01), voltages=(5.2, 5.8),
    ),
    Pair(
        "friction or damping of a joint", "rigs/rig_j.yaml", (),
        _effect("joint_friction", "elbow", torque=0.05),
    ),
)  # fmt: skip


def calibrated(file: str) -> Rig:
    """A rig fitted to its plant without a fault, kept for all pairs of the same sources."""
    OUT.mkdir(parents=True, exist_ok=True)
    kept = OUT / f"{Path(file).stem}_fitted_{sources_digest()}.yaml"
    if not kept.exists():
        rig = load_rig(ROOT / file)
        rig = rig.model_copy(update={"fit": rig.fit.model_copy(update={"parameters": []})})
        limits = limits_of(rig)
        healthy = record(plant_of(rig), random_volts(rig, limits, 12.5, 1), "healthy", 1)
        save_rig(fit_rig(rig, [healthy]).rig, kept)
    return load_rig(kept)


def with_taps(rig: Rig, taps: tuple[str, ...]) -> Rig:
    """A rig with some of its taps."""
    if not taps:
        return rig
    return rig.model_copy(update={"taps": {n: rig.taps[n] for n in taps}})


def named(found: Diagnosis) -> list[str]:
    """What is believed, and what it is not told from."""
    if not found.believed:
        return []
    return [found.finalists[0].site.label, *found.alike(0)]


def pair_figures(pair: Pair, console: Console) -> dict[str, Any]:
    """One pair: the random recording that leaves it open, and what the designed one makes of it."""
    model = with_taps(calibrated(pair.rig), pair.taps)
    whole = limits_of(model)
    low, high = pair.voltages or (None, None)
    narrow = limits_of(model, low, high)
    strength = next(iter(pair.hidden.parameters))
    for factor in pair.strengths:
        values = {**pair.hidden.parameters, strength: factor * pair.hidden.parameters[strength]}
        hidden = pair.hidden.model_copy(update={"parameters": values})
        plant = plant_of(with_taps(load_rig(ROOT / pair.rig), pair.taps), hidden)
        for seed in range(SEEDS):
            first = record(plant, random_volts(model, narrow, SECONDS, seed), "random", seed)
            found = diagnose(model, [first], refine=False)
            console.print(f"{pair.name}: {factor:g}, seed {seed}: {found.verdict} {named(found)}")
            if found.verdict == "nothing_missing":
                break
            labels = [label.split("@")[0] for label in named(found)]
            if len(labels) > 1 and pair.hidden.effect in labels:
                return _designed(pair, model, plant, whole, first, found, values, seed)
    return {"open": False}


def _designed(
    pair: Pair,
    model: Rig,
    plant: Rig,
    limits: Limits,
    first: Recording,
    found: Diagnosis,
    values: Mapping[str, float],
    seed: int,
) -> dict[str, Any]:
    told = result_of_diagnosis(model.name, found, [])
    hypotheses = hypotheses_of(model, told, "diagnosis")
    unseen = [p for p in model.fit.parameters if p.std_error is None]
    begun = time.monotonic()
    plan = design(model, Asked(SECONDS, limits, hypotheses, unseen, rate_hz=RATE_HZ, seed=seed))
    took_s = time.monotonic() - begun
    second = record(plant, plan.volts(STEP_S), "designed", seed + 100)
    both = diagnose(model, [first, second], refine=False)
    alone = diagnose(model, [second], refine=False)
    other = record(plant, random_volts(model, limits, SECONDS, seed + 50), "another", seed + 50)
    again = diagnose(model, [first, other], refine=False)
    return {
        "open": True,
        "hidden": f"{pair.hidden.effect}@{pair.hidden.place}",
        "values": dict(values),
        "seed": seed,
        "first": named(found),
        "expected": [s.as_dict() for s in plan.expected.separations],
        "words": plan.expected.words,
        "both": [both.verdict, *named(both)],
        "alone": [alone.verdict, *named(alone)],
        "found": [one.as_dict() for one in judged("designed", plan, alone).told_apart],
        "random_again": [again.verdict, *named(again)],
        "design_s": took_s,
    }
