# SPDX-License-Identifier: Apache-2.0
"""Calibrations moved on purpose by one and two of their own standard errors: do verdicts hold?

The rigs and recordings are those of the confusion study. All parameters of a calibration are moved
together, drawn from the covariance of its estimate: what the recordings tell of a product of two
parameters stays told. Writes ``docs/moved.md``.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np
from rich.console import Console

from pneu_sim.rig import load_rig, save_rig
from pneu_sim.rig.schema import Rig
from pneu_sysid.fit import FitOutcome, fit_rig
from pneu_sysid.learn import learn
from pneu_sysid.parameters import rig_at
from studies.calibration_rigs import draw_case
from studies.confusion import (
    STORE,
    Found,
    Store,
    found_of,
    key_of_sources,
    line_of,
    mark_of,
    recordings_folder,
    share,
    table,
)
from studies.confusion_cases import RIGS, load_recording, recordings_of
from studies.digest import sources_digest

ROOT = Path(__file__).resolve().parent.parent
SCALES = (1.0, 2.0)
"""Standard errors."""
EVERY = 8
"""One in so many faulty recordings of each rig is looked at ..."""
HEALTHY = 2
"""... and so many healthy ones, each with a calibration moved anew."""


def moved(outcome: FitOutcome, scale: float, rng: np.random.Generator) -> Rig:
    """A calibrated rig, all that was fitted moved together, within its bounds.

    Args:
        outcome: The calibration.
        scale: Standard errors.
        rng: Source of the draw.
    """
    estimate = outcome.estimate
    values, axes = np.linalg.eigh(estimate.covariance)
    step = axes @ (np.sqrt(np.clip(values, 0.0, None)) * rng.standard_normal(values.size))
    low, high = np.array([[p.lower, p.upper] for p in outcome.fitted]).T
    log = np.array([p.log for p in outcome.fitted])
    low, high = (np.where(log, np.log(np.where(log, b, 1.0)), b) for b in (low, high))
    return rig_at(outcome.rig, outcome.fitted, np.clip(estimate.values + scale * step, low, high))


def moved_rigs(shape: str, seed: int, count: int, folder: Path) -> dict[float, list[Rig]]:
    """Calibrations of a rig of the study, moved; they are drawn once and kept.

    Args:
        shape: Its shape.
        seed: Its seed.
        count: How many by each scale.
        folder: Where they are kept.
    """
    files = {s: [folder / f"{shape}_{seed}_{s:g}_{k}.yaml" for k in range(count)] for s in SCALES}
    if not all(f.exists() for of in files.values() for f in of):
        folder.mkdir(parents=True, exist_ok=True)
        case = draw_case(shape, seed)
        outcome = fit_rig(case.datasheet, case.recordings[0])
        for scale, of in files.items():
            for k, file in enumerate(of):
                rng = np.random.default_rng([seed, 4, k])
                save_rig(moved(outcome, scale, rng), file)
    return {s: [load_rig(f) for f in of] for s, of in files.items()}


def main(arguments: list[str] | None = None) -> int:
    """Runs the study; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--every", type=int, default=EVERY)
    options = parser.parse_args(arguments)
    console = Console(width=170)
    key = key_of_sources()
    store = Store(f"moved_{key}")
    for shape, seed in RIGS:
        every = recordings_of(shape, seed, recordings_folder())
        faulty = [c for c in every if c[0].effect and c[0].felt > 0.0][:: options.every]
        healthy = [c for c in every if not c[0].effect][:HEALTHY]
        chosen = healthy + faulty
        rigs = moved_rigs(shape, seed, len(chosen), STORE / f"moved_{key}")
        for scale, of in rigs.items():
            for rig, (injection, path) in zip(of, chosen, strict=True):
                name = f"{injection.key}, {scale:g} s.e."
                if name in store.cases:
                    continue
                started = time.monotonic()
                learned = learn(rig, load_recording(path))
                found = found_of(injection, rig, learned, time.monotonic() - started)
                store.add(name, found)
                console.print(line_of(name, found), soft_wrap=True)
    (ROOT / "docs" / "moved.md").write_text(page(store.cases), encoding="utf-8")
    return 0


def page(cases: dict[str, Found]) -> str:
    """The results as a page.

    Args:
        cases: What was found, by name.
    """
    lines = [
        "# Calibrations moved on purpose",
        "",
        "Made by `make moved`: calibrations of the confusion study's rigs, all that was fitted"
        " moved together by one and by two of their own standard errors, and what is learned with"
        " them from recordings of that study.",
        f"Made from the sources {sources_digest()}.",
        "",
    ]
    for scale in SCALES:
        mine = {k: f for k, f in cases.items() if k.endswith(f", {scale:g} s.e.")}
        felt = {k: f for k, f in mine.items() if not f.healthy and f.felt}
        healthy = {k: f for k, f in mine.items() if f.healthy}
        right = [k for k, f in felt.items() if not mark_of(k, f)]
        clean = [k for k, f in healthy.items() if not mark_of(k, f)]
        tied = sum(f.tied for f in felt.values())
        lines.append(
            f"* {scale:g} standard errors: first or tied {share(tied, len(felt))}, with place,"
            f" strength and nothing besides {share(len(right), len(felt))}; healthy and clean"
            f" {share(len(clean), len(healthy))}"
        )
    lines += ["", *table(cases)]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
