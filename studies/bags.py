# SPDX-License-Identifier: Apache-2.0
"""Every bag of a folder against its rig: calibrate on healthy ones, name what the others hide.

Bags are named ``<rig>_<what>``: ``a_healthy_1`` calibrates rig A (``rigs/rig_a.yaml``),
``a_healthy_2`` validates it, every other ``a_*`` hides something. Where the name of a bag is in
``KNOWN``, the answer is marked against it. Writes ``docs/bags.md`` and ``out/bags/``.
"""

import argparse
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

from pneu_sim.errors import InputError
from pneu_sim.rig import load_rig, save_rig
from pneu_sim.rig.schema import Rig
from pneu_sysid.compare import compare
from pneu_sysid.fit import fit_rig
from pneu_sysid.learn import learn
from pneu_sysid.parameters import default_parameters
from pneu_sysid.problem import record_for
from studies.digest import digest_of, sources_digest

ROOT = Path(__file__).resolve().parent.parent


@dataclass(frozen=True)
class Truth:
    """What a labelled bag hides: effect, part, strength, and position along a pipe of length L."""

    effect: str
    place: str
    strength: float
    position_m: float | None = None


KNOWN = {
    "a_leak": Truth("leak", "tube", 0.8 * 0.02e-6, 2.5),
    "a_dead_band": Truth("dead_band", "valve", 0.25),
    "a_delay": Truth("valve_delay", "valve", 2.5e-3),
    "a_blockage": Truth("blockage", "tube", 0.45, 1.5),
    "a_tap_lag": Truth("sensor_lag", "end", 6e-3),
    "b_droop": Truth("regulator_droop", "supply", 12e3 / 1e-3),
    "b_dead_volume": Truth("dead_volume", "tube", 1.5e-6, 5.0),
    "b_hysteresis": Truth("hysteresis", "valve", 0.2),
}


def calibrated(letter: str, folder: Path, refit: bool, console: Console) -> Rig:
    """The rig of a letter, calibrated on its first healthy bag."""
    shipped = ROOT / "rigs" / f"rig_{letter}_fitted.yaml"
    if shipped.exists() and not refit:
        return load_rig(shipped)
    nominal = load_rig(ROOT / "rigs" / f"rig_{letter}.yaml")
    bag = folder / f"{letter}_healthy_1"
    console.print(f"fitting {nominal.name} to {bag.name}")
    outcome = fit_rig(nominal, record_for(nominal, str(bag)))
    out = ROOT / "out" / "bags"
    out.mkdir(parents=True, exist_ok=True)
    save_rig(outcome.rig, out / f"rig_{letter}_fitted.yaml")
    return outcome.rig


def thin_plate(rig: Rig, bag: Path) -> Rig:
    """The thin-plate baseline of a rig, fitted to the same recording."""
    plain = rig.model_copy(update={"model": "thin_plate", "calibration": None})
    plain = plain.model_copy(update={"fit": plain.fit.model_copy(update={"parameters": []})})
    return fit_rig(plain, record_for(plain, str(bag)), default_parameters(plain)).rig


def main(arguments: list[str] | None = None) -> int:
    """Runs the study; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--refit", action="store_true", help="calibrate anew from the datasheet")
    parser.add_argument("--only", nargs="*", help="bags to run")
    options = parser.parse_args(arguments)
    console = Console(width=160)
    folder: Path = options.folder
    if not folder.is_dir():
        console.print(f"{folder}: no such folder")
        return 2
    bags = sorted(p for p in folder.iterdir() if p.is_dir() and p.name[1:2] == "_")
    lines = [
        "# The labelled recordings",
        "",
        "Made by `make bags BAGS=folder`.",
        f"Made from bags {digest_of(bags)} and sources {sources_digest()}.",
        "",
    ]
    letters = sorted({b.name[0] for b in bags})
    rigs = {}
    for letter in letters:
        rigs[letter] = calibrated(letter, folder, options.refit, console)
    lines += ["## Held-out healthy recording, RMSE per tap, Pa (times the sensor noise floor)", ""]
    for letter in letters:
        bag = folder / f"{letter}_healthy_2"
        if not bag.exists():
            continue
        baseline = thin_plate(rigs[letter], folder / f"{letter}_healthy_1")
        recording = record_for(rigs[letter], str(bag))
        result = compare(
            recording, [("pde", rigs[letter], None), ("thin plate", baseline, None)], refine=False
        )
        lines += [f"| {bag.name} | " + " | ".join(result.taps) + " |"]
        lines += ["|---" * (len(result.taps) + 1) + "|"]
        for model in result.models:
            cells = [
                f"{e.rmse_pa or 0.0:.0f} ({e.times_noise or 0.0:.2f})" for e in model.taps.values()
            ]
            lines += [f"| {model.name} | " + " | ".join(cells) + " |"]
        lines += [""]
        console.print("\n".join(lines[-5:]))
    table = Table(title="what the bags hide")
    heads = ("bag", "verdict", "found", "strength", "true", "error", "held-out x noise", "s", "ok")
    for column in heads:
        table.add_column(column)
    lines += ["## What is missing", "", "| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    for bag in bags:
        if bag.name.endswith("healthy_1") or (options.only and bag.name not in options.only):
            continue
        rig = rigs[bag.name[0]]
        started = time.monotonic()
        try:
            recording = record_for(rig, str(bag))
        except InputError as error:
            console.print(str(error))
            failed = (bag.name, f"could not be read: {error}", *[""] * 6, "NO")
            table.add_row(*failed)
            lines.append("| " + " | ".join(failed) + " |")
            continue
        out = ROOT / "out" / "bags" / bag.name
        out.mkdir(parents=True, exist_ok=True)
        learned = learn(rig, recording, out=out)
        seconds = time.monotonic() - started
        truth = KNOWN.get(bag.name)
        first = learned.steps[1] if len(learned.steps) > 1 else None
        found = " + ".join(f"{s.added}@{s.place}" for s in learned.steps[1:]) or "nothing"
        error, ok = "", ""
        if truth is not None:
            hit = first is not None and first.added == truth.effect
            hit = hit and str(first.place).split(":")[0] == truth.place  # type: ignore[union-attr]
            if hit and first is not None and first.strength is not None:
                error = f"{100.0 * (first.strength / truth.strength - 1.0):+.0f} %"
            ok = "yes" if hit else "NO"
        elif "healthy" in bag.name:
            ok = "yes" if first is None and learned.verdict == "nothing_missing" else "NO"
        row = (
            bag.name,
            learned.verdict,
            found,
            "" if first is None else f"{first.strength:.3g} {first.unit}",
            "" if truth is None else f"{truth.strength:.3g}",
            error,
            f"{learned.steps[0].held_out_times_noise:.2f} -> "
            f"{learned.steps[-1].held_out_times_noise:.2f}",
            f"{seconds:.0f}",
            ok,
        )
        table.add_row(*row)
        console.print(row, learned.sentence)
        lines.append("| " + " | ".join(row) + " |")
    console.print(table)
    if not options.only:
        (ROOT / "docs" / "bags.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
