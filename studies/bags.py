# SPDX-License-Identifier: Apache-2.0
"""Every bag of folders against its rig: calibrate on healthy ones, name what the others hide.

Bags are named ``<rig>_<what>``: ``a_healthy_1`` calibrates rig A, ``a_healthy_2`` validates it,
every other ``a_*`` hides something. A rig is the one in the folder (``rig_a.yaml``), or else the
project's (``rigs/rig_a.yaml``), whose shipped calibration is used if there is one. What a bag hides
is in the folder's ``labels.json``, or in ``KNOWN``. Writes ``docs/bags.md``, or the page that is
named, and ``out/bags/``.
"""

import argparse
import json
import sys
import time
from pathlib import Path
from typing import NamedTuple

from rich.console import Console

from pneu_common.errors import InputError
from pneu_sim.effects import registry
from pneu_sim.effects.base import POSITION
from pneu_sim.rig import load_rig, save_rig
from pneu_sim.rig.schema import Rig
from pneu_sysid.compare import compare
from pneu_sysid.fit import fit_rig
from pneu_sysid.learn import learn
from pneu_sysid.parameters import default_parameters
from pneu_sysid.problem import record_for
from pneu_sysid.sensor_units import unit_of
from studies.confusion import (
    STRENGTH_WITHIN,
    Found,
    found_of,
    line_of,
    mark_of,
    places_line,
    share,
    table,
)
from studies.confusion_cases import Injection
from studies.digest import digest_of, sources_digest

ROOT = Path(__file__).resolve().parent.parent
OUT = ROOT / "out" / "bags"
AFTER_WITHIN = 1.2
"""Error kept aside after adding, as a multiple of the healthy recording's."""


class Label(NamedTuple):
    """What a bag hides: effect, place, strength, and position along a pipe."""

    effect: str
    place: str
    strength: float
    position_m: float | None = None


KNOWN: dict[str, Label] = {
    "a_leak": Label("leak", "tube", 0.8 * 0.02e-6, 2.5),
    "a_dead_band": Label("dead_band", "valve", 0.25, None),
    "a_delay": Label("valve_delay", "valve", 2.5e-3, None),
    "a_blockage": Label("blockage", "tube", 0.45, 1.5),
    "a_tap_lag": Label("sensor_lag", "end", 6e-3, None),
    "b_droop": Label("regulator_droop", "supply", 12e3 / 1e-3, None),
    "b_dead_volume": Label("dead_volume", "tube", 1.5e-6, 5.0),
    "b_hysteresis": Label("hysteresis", "valve", 0.2, None),
    "j_seal": Label("seal_friction", "forearm", 25e-6),
    "j_stiction": Label("piston_stiction", "forearm", 14.0),
    "j_piston_leak": Label("piston_leak", "forearm", 0.06e-6),
    "j_payload": Label("payload", "elbow", 0.25),
    "j_backlash": Label("backlash", "elbow", 0.02),
    "j_dead_volume": Label("cylinder_volume", "forearm.head", 8e-6),
    "j_cable": Label("external_spring", "elbow", 1.2),
    "j_overlap": Label("dead_band", "head", 0.25),
}


def labels_of(folder: Path) -> dict[str, Label]:
    """What the bags of a folder hide, one effect each at most.

    Args:
        folder: The folder.
    """
    file = folder / "labels.json"
    if not file.exists():
        return KNOWN
    told = json.loads(file.read_text(encoding="utf-8"))
    return {
        name: Label(e["effect"], e["place"], e["strength"], e.get("position_m"))
        for name, effects in told.items()
        for e in effects[:1]
    }


def rig_file(letter: str) -> Path:
    """The project's rig file of a letter.

    Args:
        letter: What the names of its bags begin with.
    """
    return ROOT / "rigs" / f"rig_{letter}.yaml"


def calibrated(letter: str, folder: Path, refit: bool, console: Console) -> Rig:
    """The rig of a letter, calibrated on its first healthy bag.

    Args:
        letter: What the names of its bags begin with.
        folder: Folder of the bags.
        refit: Whether a shipped calibration is made anew.
        console: Where progress goes.
    """
    own, ours = folder / f"rig_{letter}.yaml", rig_file(letter)
    shipped = ours.with_name(f"{ours.stem}_fitted.yaml")
    if shipped.exists() and not own.exists() and not refit:
        return load_rig(shipped)
    nominal = load_rig(own if own.exists() else ours)
    bag = folder / f"{letter}_healthy_1"
    console.print(f"fitting {nominal.name} to {bag.name}")
    outcome = fit_rig(nominal, record_for(nominal, str(bag)))
    OUT.mkdir(parents=True, exist_ok=True)
    save_rig(outcome.rig, OUT / f"rig_{letter}_fitted.yaml")
    return outcome.rig


def thin_plate(rig: Rig, bag: Path) -> Rig:
    """The thin-plate baseline of a rig, fitted to the same recording.

    Args:
        rig: The rig.
        bag: The recording.
    """
    plain = rig.model_copy(update={"model": "thin_plate", "calibration": None})
    plain = plain.model_copy(update={"fit": plain.fit.model_copy(update={"parameters": []})})
    return fit_rig(plain, record_for(plain, str(bag)), default_parameters(plain)).rig


def healthy_lines(letter: str, folder: Path, rig: Rig) -> list[str]:
    """Error on the second healthy bag of a rig, per sensor; beside a thin-plate model's on a line.

    Args:
        letter: What the names of its bags begin with.
        folder: Folder of the bags.
        rig: The calibrated rig.
    """
    bag = folder / f"{letter}_healthy_2"
    if not bag.exists():
        return []
    models: list[tuple[str, Rig, None]] = [("pde", rig, None)]
    if not rig.chambers and not rig.bodies:
        models.append(("thin plate", thin_plate(rig, folder / f"{letter}_healthy_1"), None))
    result = compare(record_for(rig, str(bag)), models, refine=False)
    units = {name: unit_of(name, result.encoders) for name in result.sensors}
    heads = [f"{n}, {units[n].told}" if n in result.encoders else n for n in result.sensors]
    lines = [f"| {bag.name} | " + " | ".join(heads) + " |"]
    lines += ["|---" * (len(heads) + 1) + "|"]
    for model in result.models:
        cells = [
            f"{units[n].figure(e.rmse or 0.0)} ({e.times_noise or 0.0:.2f})"
            for n, e in model.sensors.items()
        ]
        lines += [f"| {model.name} | " + " | ".join(cells) + " |"]
    return [*lines, ""]


def looked_at(bag: Path, rig: Rig, label: Label | None) -> Found:
    """What is learned from a bag.

    Args:
        bag: The bag.
        rig: Its calibrated rig.
        label: What it hides; None where it is healthy.

    Raises:
        InputError: It cannot be read.
    """
    injection = Injection(rig.name, bag.name)
    if label is not None:
        effect, place, strength, position_m = label
        values = {registry()[effect].strength.name: strength}
        if position_m is not None:
            values[POSITION] = position_m
        injection = Injection(rig.name, bag.name, effect, place, values, float("inf"))
    started = time.monotonic()
    recording = record_for(rig, str(bag))
    out = OUT / bag.name
    out.mkdir(parents=True, exist_ok=True)
    learned = learn(rig, recording, out=out)
    return found_of(injection, rig, learned, time.monotonic() - started)


def main(arguments: list[str] | None = None) -> int:
    """Runs the study; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--refit", action="store_true", help="calibrate anew from the datasheet")
    parser.add_argument("--only", nargs="*", help="bags to run")
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "bags.md", help="to write")
    options = parser.parse_args(arguments)
    console = Console(width=170)
    for folder in options.folders:
        if not folder.is_dir():
            console.print(f"{folder}: no such folder")
            return 2
    healthy: list[str] = []
    cases: dict[str, Found] = {}
    failed: list[str] = []
    digests = []
    for folder in options.folders:
        bags = sorted(p for p in folder.iterdir() if p.is_dir() and p.name[1:2] == "_")
        digests.append(f"{folder.name} {digest_of(bags)}")
        labels = labels_of(folder)
        rigs = {
            letter: calibrated(letter, folder, options.refit, console)
            for letter in sorted({b.name[0] for b in bags})
        }
        for letter, rig in rigs.items():
            healthy += [] if options.only else healthy_lines(letter, folder, rig)
        for bag in bags:
            if bag.name.endswith("healthy_1") or (options.only and bag.name not in options.only):
                continue
            try:
                cases[bag.name] = looked_at(bag, rigs[bag.name[0]], labels.get(bag.name))
            except InputError as error:
                failed.append(f"| {bag.name} | could not be read: {error} |")
                console.print(failed[-1])
                continue
            found = cases[bag.name]
            console.print(f"{line_of(bag.name, found)} {found.seconds:.0f} s", soft_wrap=True)
    text = page(digests, healthy, cases, failed)
    console.print(text)
    if not options.only:
        options.page.write_text(text, encoding="utf-8")
    return 0


def page(digests: list[str], healthy: list[str], cases: dict[str, Found], failed: list[str]) -> str:
    """The results as a page.

    Args:
        digests: Names and digests of the folders.
        healthy: Tables of the errors on healthy recordings.
        cases: What was found, by name.
        failed: Bags that could not be read.
    """
    left = {k[0]: f.before for k, f in cases.items() if k.endswith("healthy_2")}
    faulty = {k: f for k, f in cases.items() if not f.healthy}
    tied = [f for f in faulty.values() if f.tied]
    located = [f for f in tied if f.at is not None]
    right = [f for f in located if abs(f.strength_error or 0.0) <= STRENGTH_WITHIN]
    near = [f for k, f in faulty.items() if f.after <= AFTER_WITHIN * left.get(k[0], 0.0)]
    wrong = sum(bool(mark_of(k, f)) for k, f in cases.items() if f.healthy)
    beside = [f for f in tied if f.named and f.superfluous > 0]
    total = len(faulty) + len(failed)
    return "\n".join(
        [
            "# The labelled recordings",
            "",
            "Made by `make bags BAGS=folders`.",
            f"Made from the bags {', '.join(digests)} and the sources {sources_digest()}.",
            "",
            "## Held-out healthy recordings, RMSE per sensor, taps in Pa (times the noise floor)",
            "",
            *healthy,
            "## What is missing",
            "",
            f"* first, or said not to be told from what is first: {share(len(tied), total)}",
            places_line(located),
            f"* strength within {100 * STRENGTH_WITHIN:.0f} %: {share(len(right), len(located))}",
            f"* with something superfluous: {share(len(beside), total)}",
            f"* error kept aside after adding within {AFTER_WITHIN:g} times the healthy"
            f" recording's: {share(len(near), total)}",
            f"* healthy recordings accused: {share(wrong, len(cases) - len(faulty))}",
            "",
            *table(cases),
            *failed,
            "",
        ]
    )


if __name__ == "__main__":
    sys.exit(main())
