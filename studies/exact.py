# SPDX-License-Identifier: Apache-2.0
"""Exact models of rigs drawn at random: what `compare` leaves, whom `diagnose` accuses, where `fit`
goes. Writes ``docs/exact.md``.

The recordings are the simulator's own, of one run from rest with other steps than the comparison's,
with noise; half begin in the middle of motion. Whatever stands above 1 in the table is the fault of
how a recording is brought to a residual, not of a model.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track

from pneu_sim.rig.schema import Rig
from pneu_sysid.diagnose import diagnose
from pneu_sysid.fit import fit_rig
from pneu_sysid.problem import make_problem
from pneu_sysid.records import Recording
from studies.digest import sources_digest
from studies.exact_rigs import COMMAND_HZ, NOISE_PA, RATES, SHAPES, draw_rig, record

ROOT = Path(__file__).resolve().parent.parent
SECONDS = 8.0
FITTED = {500.0: False, 125.0: True, 50.0: False, "uneven": False}
"""Rates whose recordings are diagnosed and fitted too; that takes a minute or two each."""


def errors(rig: Rig, recording: Recording) -> tuple[list[float], list[float]]:
    """Error over noise per tap, and how far noise alone would scatter it."""
    problem = make_problem(rig, recording)
    residual = problem.residual(problem.predict([rig])[0])
    count = np.isfinite(problem.measured).sum(axis=(0, 1))
    found = np.sqrt(np.sum(residual**2, axis=(0, 1)) / count)
    return found.tolist(), (1.0 / np.sqrt(2.0 * count)).tolist()


def strayed(rig: Rig, recording: Recording) -> tuple[float, int, int]:
    """How far a fit that starts at the truth leaves it: rms and number of parameters over 3 s.e."""
    outcome = fit_rig(rig, recording, approach=False, iterations=2)
    estimate = outcome.estimate
    truth = np.array(
        [np.log(s) if p.log else s for s, p in zip(outcome.start, outcome.parameters, strict=True)]
    )
    seen = np.isfinite(estimate.std_errors)
    apart = np.abs(estimate.values - truth)[seen] / estimate.std_errors[seen]
    return float(np.sqrt(np.mean(apart**2))), int((apart > 3.0).sum()), int(seen.sum())


def main(arguments: list[str] | None = None) -> int:
    """Runs the study; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--no-fit", action="store_true", help="compare alone")
    options = parser.parse_args(arguments)
    console = Console(width=140)
    rows: list[str] = []
    worst = 0.0
    beyond = accused = judged = 0
    cases = [(shape, rate) for shape in SHAPES for rate in RATES]
    for k, (shape, rate) in enumerate(track(cases, console=Console(stderr=True))):
        rng = np.random.default_rng([options.seed, k])
        rig = draw_rig(shape, rng)
        moving = bool(rng.integers(2))
        recording = record(rig, rng, rate, SECONDS, moving)
        found, scatter = errors(rig, recording)
        worst = max(worst, *found)
        beyond += sum(f > 1.1 + 2.0 * s for f, s in zip(found, scatter, strict=True))
        verdict = stray = ""
        if FITTED[rate] and not options.no_fit:
            own = rig.model_copy(update={"calibration": None})
            answer = diagnose(own, recording, finalists=3, refine=False)
            judged += 1
            accused += answer.verdict != "nothing_missing"
            verdict = answer.verdict.replace("_", " ")
            rms, far, count = strayed(rig, recording)
            stray = f"{rms:.2f} ({far} of {count})"
        figures = " ".join(f"{f:.2f}" for f in found)
        pressure = rig.reservoirs["supply"].pressure_pa / 1e5
        begins = "in motion" if moving else "at rest"
        taps = rate if rate == "uneven" else f"{rate:g} Hz"
        row = f"| {shape} | {pressure:.1f} | {taps} | {begins} | {figures} | {max(scatter):.2f} |"
        rows.append(row + f" {verdict} | {stray} |")
        console.print(rows[-1])
    page = [
        "# Exact models",
        "",
        "Made by `make exact`: " + " ".join(str(__doc__).split(". Writes")[0].split()) + ".",
        f"Noise {NOISE_PA:g} Pa, commands at {COMMAND_HZ:g} Hz, {SECONDS:g} s each, seed"
        f" {options.seed}; taps that are uneven are read one by one, 20 to 50 ms apart.",
        f"Made from the sources {sources_digest()}.",
        "",
        f"Largest figure {worst:.2f}; {beyond} above 1.10 and what noise alone may add (two"
        f" standard deviations, of few readings). {accused} of {judged} exact models accused.",
        "",
        "| shape | supply, bar | taps | begins | error over noise, per tap | ± by noise alone |"
        " diagnosed | fit from the truth: rms in s.e. (beyond 3) |",
        "|" + "---|" * 8,
        *rows,
    ]
    console.print(page[6])
    (ROOT / "docs" / "exact.md").write_text("\n".join(page) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
