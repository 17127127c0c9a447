# SPDX-License-Identifier: Apache-2.0
"""Every effect of the catalogue injected into a synthetic recording and diagnosed, as a matrix.

The recordings come from the simulator on a finer grid than the diagnosis uses, with sensor noise
and quantisation, along seeded random valve commands. Results are appended to ``out/confusion.json``
as they come, so an interrupted run goes on; ``docs/confusion.md`` shows them.
"""

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from pneu_sim.effects import registry
from pneu_sim.effects.base import POSITION
from pneu_sim.rig import load_rig
from pneu_sim.rig.schema import AttachedEffect, Rig
from pneu_sim.run import add_noise, run_rig
from pneu_sysid.diagnose import diagnose
from pneu_sysid.records import Recording, even_recording
from studies.digest import sources_digest

ROOT = Path(__file__).resolve().parent.parent
RATE_HZ = 500.0
NOISE_PA = 250.0
STRENGTHS = (1.0, 2.0)
"""Injected strengths, as multiples of each effect's typical one."""
HEALTHY = 10
"""Recordings with nothing injected, per seed."""


def commands(seconds: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """Valve volts: held random steps, large ones at first, then small ones around null."""
    volts = np.empty(round(seconds * RATE_HZ))
    at = 0
    while at < volts.size:
        hold = int(rng.uniform(0.02, 0.2) * RATE_HZ)
        spread = 5.0 if at < 0.4 * volts.size else 1.2
        volts[at : at + hold] = np.clip(5.0 + rng.uniform(-spread, spread), 0.0, 10.0)
        at += hold
    return volts


def synthetic(rig: Rig, seconds: float, seed: int, name: str) -> Recording:
    """A recording of a rig on a grid of half the cell length, with noise."""
    rng = np.random.default_rng(seed)
    finer = rig.model_copy(
        update={"grid": rig.grid.model_copy(update={"dx_m": 0.5 * rig.grid.dx_m})}
    )
    volts = commands(seconds, rng)
    taps = add_noise(rig, run_rig(finer, {"voltage": volts}, 1.0 / RATE_HZ), rng, NOISE_PA)
    size = len(next(iter(taps.values())))
    return even_recording(name, np.arange(size) / RATE_HZ, {"voltage": volts[:size]}, taps)


def cases(rig: Rig, seeds: int) -> list[tuple[str, str, dict[str, float], float, int]]:
    """(effect, place, values, multiple, seed) of every injection, healthy ones first."""
    out: list[tuple[str, str, dict[str, float], float, int]] = [
        ("none", "", {}, 0.0, 100 + s) for s in range(HEALTHY * seeds)
    ]
    for effect in registry().values():
        places = effect.places(rig)
        if not places:
            continue
        # the part on which the effect is felt most: the longest pipe, the tap at its end
        longest = max(rig.pipes, key=lambda n: rig.pipes[n].length_m)
        place = longest if longest in places else "end" if "end" in places else places[0]
        for multiple in STRENGTHS:
            p = effect.strength
            low, high = effect.limits(p, rig, place)
            strength = float(np.clip(p.absent + multiple * (p.typical - p.absent), low, high))
            values = {q.name: q.typical for q in effect.parameters[1:]}
            values[p.name] = strength
            if effect.has_position:
                values[POSITION] = 0.6 * rig.pipes[place].length_m
            for s in range(seeds):
                out.append((effect.name, place, values, multiple, 1000 + s))
    return out


def main(arguments: list[str] | None = None) -> int:
    """Runs the study; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=6.0)
    parser.add_argument("--budget-s", type=float, default=float("inf"))
    options = parser.parse_args(arguments)
    console = Console(width=140)
    rig = load_rig(ROOT / "rigs" / "rig_a_fitted.yaml")
    # The recordings below come from this very model: its calibration is exact there.
    rig = rig.model_copy(
        update={
            "calibration": rig.calibration.model_copy(
                update={"rmse_pa": dict.fromkeys(rig.taps, NOISE_PA)}
            )
            if rig.calibration
            else None
        }
    )
    store = ROOT / "out" / "confusion.json"
    store.parent.mkdir(exist_ok=True)
    made_from = sources_digest()
    kept = json.loads(store.read_text()) if store.exists() else {}
    # What other sources found does not belong on the same page.
    done = kept["cases"] if kept.get("sources") == made_from else {}
    planned = cases(rig, options.seeds)
    total = len(planned)
    started = time.monotonic()
    for name, place, values, multiple, seed in planned:
        key = f"{name}@{place} x{multiple:g} #{seed}"
        if key in done:
            continue
        if time.monotonic() - started > options.budget_s:
            console.print("time is up; run again to go on")
            break
        faulty = rig
        if name != "none":
            attached = AttachedEffect(effect=name, place=place, parameters=values)
            faulty = rig.model_copy(update={"effects": [*rig.effects, attached]})
        found = diagnose(rig, synthetic(faulty, options.seconds, seed, key), refine=False)
        top = found.finalists[0] if found.finalists else None
        named = found.verdict in ("effect", "ambiguous") and top is not None
        done[key] = {
            "injected": name,
            "place": place,
            "multiple": multiple,
            "verdict": found.verdict,
            "named": top.site.effect.name if named and top else None,
            "named_place": top.site.place if named and top else None,
            "alike": [a.split("@")[0] for a in found.alike(0)] if named else [],
            "strength": top.strength if named and top else None,
            "true_strength": values.get(registry()[name].strength.name) if name != "none" else None,
            "excess": found.excess,
        }
        part = store.with_suffix(".part")
        part.write_text(json.dumps({"sources": made_from, "cases": done}, indent=1))
        part.replace(store)
        console.print(key, "->", done[key]["verdict"], done[key]["named"], done[key]["alike"])
    (ROOT / "docs" / "confusion.md").write_text(page(done, total), encoding="utf-8")
    console.print(page(done, total))
    return 0


def page(done: dict[str, dict], total: int) -> str:  # type: ignore[type-arg]
    """The results as a page: matrix by effect, recall, precision, false alarms."""
    healthy = [r for r in done.values() if r["injected"] == "none"]
    faulty = [r for r in done.values() if r["injected"] != "none"]
    # An effect too weak to leave a mark in the recording is not one that could be found.
    felt = [r for r in faulty if r["excess"] > 1.1]
    exact = [r for r in felt if r["named"] == r["injected"]]
    tied = [r for r in felt if r["named"] == r["injected"] or r["injected"] in r["alike"]]
    named = [r for r in faulty if r["named"]]
    right = [r for r in named if r["named"] == r["injected"] or r["injected"] in r["alike"]]
    alarms = [r for r in healthy if r["verdict"] != "nothing_missing"]

    def share(a: list, b: list) -> str:  # type: ignore[type-arg]
        return f"{len(a)} of {len(b)}" + (f" ({100 * len(a) / len(b):.0f} %)" if b else "")

    lines = [
        "# Confusion matrix",
        "",
        "Made by `make confusion`: every effect of the catalogue injected into a synthetic"
        " recording of rig A, at its typical strength and at twice that, and diagnosed. A recording"
        " whose residual stays within 10 % of the noise does not show its effect and is not counted"
        " in the recall.",
        f"Made from the sources {sources_digest()}.",
        "",
        f"* injections and healthy recordings run: {len(done)} of {total}"
        + ("" if len(done) == total else " (run again to go on)"),
        f"* recall, first name: {share(exact, felt)}",
        f"* recall, named or declared inseparable from the name: {share(tied, felt)}",
        f"* precision of the names given: {share(right, named)}",
        f"* false alarms on healthy recordings: {share(alarms, healthy)}",
        "",
        "| injected | times typical | residual over floor | verdict | named | alike |"
        " strength error |",
        "|---|---|---|---|---|---|---|",
    ]
    for r in done.values():
        error = ""
        if r["named"] == r["injected"] and r["true_strength"]:
            error = f"{100 * (r['strength'] / r['true_strength'] - 1):+.0f} %"
        lines.append(
            f"| {r['injected']} {r['place']} | {r['multiple']:g} | {r['excess']:.2f} |"
            f" {r['verdict']} | {r['named'] or ''}"
            f" {('@' + r['named_place']) if r['named_place'] else ''}"
            f" | {', '.join(r['alike'])} | {error} |"
        )
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
