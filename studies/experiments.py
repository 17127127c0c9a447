# SPDX-License-Identifier: Apache-2.0
"""Does a designed recording tell what a random one left open? Pairs of effects, and calibrations.

Plants have finer cells and another numerical flux than the models, and no plant is the model of
anything else. Stages: `pairs`, each of two effects that a random recording of ten seconds leaves
open, then a designed one of the same length; `calibrations`, errors of a fit to designed and to
random recordings by their length, and how right the expected standard errors were; `page`.

    python -m studies.experiments pairs calibrations page
"""

import argparse
import json
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from pneu_common.files import write_whole
from pneu_common.progress import progress
from pneu_sim.rig import load_rig, save_rig
from pneu_sim.rig.opening import opening_at
from pneu_sim.rig.schema import AttachedEffect, Rig
from pneu_sim.run import add_encoder_noise, add_noise, run_from_rest
from pneu_sim.signals import Signal
from pneu_sysid.curves import curve_ties
from pneu_sysid.design.design import Asked, design
from pneu_sysid.design.hypotheses import hypotheses_of, part_of
from pneu_sysid.design.judge import judged
from pneu_sysid.design.limits import Limits, limits_of
from pneu_sysid.design.parameters import parameters_to_learn
from pneu_sysid.design.waves import STEP_S, draw_piece, joined
from pneu_sysid.diagnose import Diagnosis, diagnose, result_of_diagnosis
from pneu_sysid.fit import fit_rig
from pneu_sysid.observed.noise import with_noise
from pneu_sysid.parameters import estimated_parameters, rig_at, variables_of
from pneu_sysid.records import Recording, even_recording
from studies.digest import sources_digest
from studies.stages import add_stages

ROOT = Path(__file__).resolve().parents[1]
OUT = ROOT / "out" / "experiments"
PLANT_S = 2e-4
RATE_HZ = 500.0
SECONDS = 10.0
PIECE_S = 1.25
SEEDS = 4
"""Random recordings that are tried at each strength until one leaves it open."""
Volts = Mapping[str, np.ndarray]


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


def plant_of(rig: Rig, hidden: AttachedEffect | None = None) -> Rig:
    """A plant that is not the model: a quarter of its cells' length, another flux.

    Cells half as long still get two fifths as much wrong, the air of a rig nothing.
    """
    grid = rig.grid.model_copy(update={"dx_m": 0.25 * rig.grid.dx_m, "flux": "exact"})
    return rig.model_copy(
        update={"grid": grid, "effects": [] if hidden is None else [hidden], "calibration": None}
    )


def record(plant: Rig, volts: Volts, name: str, seed: int) -> Recording:
    """What its sensors read along commands, with noise."""
    rng = np.random.default_rng([seed, 41])
    size = len(next(iter(volts.values())))
    grid = np.arange(size) * STEP_S
    at = np.arange(round(size * STEP_S / PLANT_S)) * PLANT_S
    commands = {n: Signal(grid, np.asarray(v)) for n, v in volts.items()}
    out = run_from_rest(plant, {n: s.held(at) for n, s in commands.items()}, PLANT_S)
    every = round(1.0 / (RATE_HZ * PLANT_S))
    taps = add_noise(plant, {n: x[::every] for n, x in out.taps.items()}, rng)
    turns = add_encoder_noise(plant, {n: x[::every] for n, x in out.encoders.items()}, rng)
    recording = even_recording(name, at[::every], {}, taps, turns)
    recording.commands.update(commands)
    return recording


def random_volts(rig: Rig, limits: Limits, seconds: float, seed: int) -> dict[str, np.ndarray]:
    """Random steps."""
    rng = np.random.default_rng([seed, 43])
    count = round(seconds / PIECE_S)
    return joined([draw_piece(rig, limits, PIECE_S, "steps", rng) for _ in range(count)], limits)


def calibrated(file: str) -> Rig:
    """A rig fitted to its plant without a fault, kept for all pairs."""
    kept = OUT / f"{Path(file).stem}_fitted.yaml"
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


CALIBRATED = ("rigs/lab.yaml", "rigs/rig_b.yaml", "rigs/rig_j.yaml")
LONG_S, SHORT_S = 10.0, 5.0
SHEETS = 3
"""Datasheets that are drawn of each rig."""
OFF = 0.5
"""By this share of the standard deviation that is not known numbers of a datasheet are off."""
NOISE_PA = 250.0
"""Of taps whose rig file says nothing of it: no sensor is without."""
WAYS = (f"random {LONG_S:g} s", f"random {SHORT_S:g} s", f"designed {SHORT_S:g} s")


def datasheet(rig: Rig, seed: int) -> Rig:
    """A rig as its datasheet might have it: every number off by about what is not known of it.

    Opening curves are off as a whole: they bend no more there than a fit expects curves to.
    """
    bare = rig.model_copy(
        update={"calibration": None, "fit": rig.fit.model_copy(update={"parameters": []})}
    )
    listed, _ = estimated_parameters(bare)
    rng = np.random.default_rng([seed, 47])
    variables = variables_of(bare, listed)
    std = np.array([min(v.std, v.upper - v.lower) for v in variables])
    ties = curve_ties(bare, listed).matrix * std
    root = np.linalg.cholesky(np.eye(std.size) + ties.T @ ties)
    off = OFF * std * np.linalg.solve(root.T, rng.normal(size=std.size))
    x = [float(np.clip(v.value + o, v.lower, v.upper)) for v, o in zip(variables, off, strict=True)]
    return rig_at(bare, listed, np.array(x))


def with_curves_of(rig: Rig, other: Rig) -> Rig:
    """A rig whose opening curves are told at the voltages of another's.

    A fit gives ports curves and points of their own, so that the same index is another voltage.
    """
    out = rig.model_copy(deep=True)
    for v, valve in out.valves.items():
        for p, port in valve.ports.items():
            known = other.valves[v].ports[p].opening
            if known.mirror is not None:
                port.opening = known
                continue
            volts = np.array(known.voltage_v)
            fraction = opening_at(port.opening, valve.spool.null_v, volts)
            port.opening = known.model_copy(update={"fraction": fraction.tolist()})
    return out


def calibration_figures(file: str, seed: int, console: Console) -> dict[str, Any]:
    """One datasheet: a fit to ten random seconds, to five, and to five that were designed."""
    true = load_rig(ROOT / file)
    true = with_noise(true, dict.fromkeys(true.taps, NOISE_PA))
    sheet = datasheet(true, seed)
    limits = limits_of(sheet)
    plant = plant_of(true)
    listed, _ = estimated_parameters(sheet)
    variables = variables_of(sheet, listed)
    scale = np.array([min(v.std, v.upper - v.lower) for v in variables])
    truth = np.array([v.value for v in variables_of(true, listed)])
    begun = time.monotonic()
    learnt = parameters_to_learn(sheet)
    plan = design(sheet, Asked(SHORT_S, limits, [], learnt, rate_hz=RATE_HZ, seed=seed))
    out: dict[str, Any] = {"design_s": time.monotonic() - begun, "parameters": len(listed)}
    volts: list[Volts] = [
        random_volts(sheet, limits, LONG_S, 10 * seed + 1),
        random_volts(sheet, limits, SHORT_S, 10 * seed + 2),
        plan.volts(STEP_S),
    ]
    for name, series in zip(WAYS, volts, strict=True):
        fitted = fit_rig(sheet, [record(plant, series, "recording", seed + 10)])
        found = variables_of(with_curves_of(fitted.rig, true), listed)
        off = np.abs(np.array([v.value for v in found]) - truth) / scale
        out[name] = [float(np.sqrt(np.mean(off**2))), float(np.median(off))]
        console.print(f"{file}, datasheet {seed}: {name}: {out[name][0]:.3f} of what was unknown")
    known = {p.path: p.std_error for p in fitted.rig.fit.parameters}
    ratios = [
        error / expected
        for path, expected in plan.expected.std_errors.items()
        if (error := known.get(path)) is not None and expected and ".opening." not in path
    ]
    out["error_ratios"] = [float(x) for x in np.quantile(ratios, [0.1, 0.5, 0.9])]
    return out


def page(path: Path) -> None:
    """Writes the page of what was found."""
    kept = {f.stem: json.loads(f.read_text(encoding="utf-8")) for f in sorted(OUT.glob("*.json"))}
    sources = sorted({one["sources"] for one in kept.values()})
    lines = [
        "# Experiments", "",
        f"Made by `make experiments`, from the sources {', '.join(sources)}; each row names its"
        " own.", "",
        "## Two effects that a random recording does not tell apart", "",
        "Plants with finer cells and another flux than the models. A random recording of"
        f" {SECONDS:g} s leaves the two open; then a designed one of the same length, and another"
        " random one for comparison, each diagnosed together with the first. Expected and found are"
        " the standard errors by which the designed one alone tells the first of the two from what"
        " comes nearest.", "",
        "| hidden | first, random | expected | found | with the designed one | with another random"
        " one | design [s] | sources |",
        "|---|---|---|---|---|---|---|---|",
    ]  # fmt: skip
    right = count = 0
    for k, pair in enumerate(PAIRS):
        one = kept.get(f"pair_{k}")
        if one is None:
            lines.append(f"| {pair.name} | not run | | | | | | |")
            continue
        f = one["figures"]
        if not f["open"]:
            told = "no random recording left it open"
            lines.append(f"| {pair.name} | {told} | | | | | | {one['sources']} |")
            continue
        count += 1
        named_right = f["both"][0] == "effect" and f["both"][1].startswith(f["hidden"])
        right += named_right
        top = part_of(f["first"][0])
        expected = min(s["standard_errors"] for s in f["expected"] if part_of(s["one"]) == top)
        found = _found(f)
        values = ", ".join(f"{n} {v:.3g}" for n, v in f["values"].items())
        lines.append(
            f"| {f['hidden']} ({values}) | {', '.join(f['first'])} | {expected:.1f} | {found}"
            f" | {'right' if named_right else 'NOT RIGHT'}: {', '.join(f['both'])}"
            f" | {', '.join(f['random_again'])}"
            f" | {f['design_s']:.0f} | {one['sources']} |"
        )
    told = f"Named rightly: {right} of {count} that were left open."
    lines += ["", told, "", "## Calibration", ""]
    lines += [
        "Errors of all parameters, in what was not known of each before: root mean square, in"
        f" brackets the median. {SHEETS} datasheets of each rig, whose numbers are off by"
        f" {OFF:g} of that. Commands of all ways keep to the same limits of volts. Found over"
        " expected: standard errors after the fit over what the plan foresaw, median and the middle"
        " 80 %.", "",
        f"| rig | datasheet | parameters | {' | '.join(WAYS)} | found over expected | design [s] |"
        " sources |",
        "|---|---|---|---|---|---|---|---|---|",
    ]  # fmt: skip
    for file in CALIBRATED:
        every: list[list[list[float]]] = []
        for seed in range(SHEETS):
            one = kept.get(_calibration_key(file, seed))
            if one is None:
                lines.append(f"| {file} | {seed} | not run | | | | | | |")
                continue
            f = one["figures"]
            low, middle, high = f["error_ratios"]
            told = " | ".join(f"{f[way][0]:.2f} ({f[way][1]:.3f})" for way in WAYS)
            lines.append(
                f"| {file} | {seed} | {f['parameters']} | {told}"
                f" | {middle:.2f} ({low:.2f} to {high:.2f}) | {f['design_s']:.0f}"
                f" | {one['sources']} |"
            )
            every.append([f[way] for way in WAYS])
        if every:
            told = " | ".join(f"{whole:.2f} ({middle:.3f})" for whole, middle in np.mean(every, 0))
            lines.append(f"| {file} | mean | | {told} | | | |")
    write_whole(path, "\n".join(lines) + "\n")


def _calibration_key(file: str, seed: int) -> str:
    return f"calibration_{Path(file).stem}_{seed}"


def _found(figures: dict[str, Any]) -> str:
    """By how much the designed recording alone told what the random one left open.

    Negative where what came nearest leads.
    """
    leads = [
        told["found"]
        for told in figures["found"]
        if told["found"] is not None and told["one"] == figures["first"][0]
    ]
    return f"{min(leads, key=abs):.1f}" if leads else "another was named"


def main() -> int:
    """Runs the stages."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    add_stages(parser, ("pairs", "calibrations", "page"))
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "experiments.md")
    parser.add_argument("--only", type=int, nargs="*", help="pairs by their number")
    asked = parser.parse_args()
    OUT.mkdir(parents=True, exist_ok=True)
    console, sources = Console(width=140), sources_digest()
    jobs: list[tuple[str, Callable[[], Any]]] = []
    if "pairs" in asked.stages:
        for k, pair in enumerate(PAIRS):
            if asked.only is None or k in asked.only:
                jobs.append((f"pair_{k}", lambda pair=pair: pair_figures(pair, console)))
    if "calibrations" in asked.stages:
        for rig in CALIBRATED:
            for seed in range(SHEETS):
                jobs.append(
                    (
                        _calibration_key(rig, seed),
                        lambda rig=rig, seed=seed: calibration_figures(rig, seed, console),
                    )
                )
    for name, job in jobs:
        file = OUT / f"{name}.json"
        if file.is_file():
            continue
        with progress(name):
            figures = job()
        write_whole(file, json.dumps({"sources": sources, "figures": figures}))
        console.print(f"{name}: {json.dumps(figures)[:1500]}")
    if "page" in asked.stages:
        page(asked.page)
        console.print(f"{asked.page} is written")
    return 0


if __name__ == "__main__":
    sys.exit(main())
