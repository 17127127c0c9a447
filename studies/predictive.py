# SPDX-License-Identifier: Apache-2.0
"""Table 9.1 with predictive control: on the plants of the emulated lab, in lock step.

The plants are those of ``make study-pressure``, with what they hide; targets, noise and delays are
the same. Nothing runs against the clock, so that the figures are the same on any machine: what a
controller commands in one period acts in the next, whatever time it took. Runs that are there
already in ``out/predictive`` are not run again; with ``--only`` those of other controllers are
shown as they were made last, and the page says of which sources each column is.
"""

import argparse
import json
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import joblib
import numpy as np
from rich.console import Console

from pneu_common.files import write_whole
from pneu_common.progress import progress
from pneu_policy.control.controllers import load_controller
from pneu_policy.control.late import with_delay
from pneu_policy.control.predictive import PredictiveController
from pneu_policy.judge.evaluate import check_fits, file_for, simulated_tracks
from pneu_policy.judge.metrics import ATM_PA
from pneu_policy.judge.tasks import Conditions
from pneu_policy.task.plants import ControlPlant
from pneu_sim.rig.load import load_rig
from pneu_sysid.observed.follow import Spoil
from studies.digest import digest_of
from studies.pressure import POLICIES, TASKS, TUBES, policies, revealed
from studies.tap_faults import FAULTS, Fault

ROOT = Path(__file__).resolve().parent.parent
OUT = ROOT / "out" / "predictive"
BROKEN: dict[str, Callable[[str, float], Spoil]] = {"lost": Fault, **FAULTS}
PREDICTIVE = {
    "predictive": "all taps, plans by Gauss-Newton steps",
    "predictive_virtual": "the same without the controlled tap: its virtual one instead",
    "predictive_one_tap": "the same with the controlled tap alone",
    "predictive_light": "the same on cells of 0.5 m, a plan every 20 ms: what two cores that also"
    " emulate the laboratory have time for",
    "predictive_mppi": "all taps, plans by path integrals, 64 draws",
    "predictive_adaptive": "the same, the spread of the draws learnt",
}
LEARNED = ("pde", "pde_fine", "one_tap")
VIRTUAL = {
    "pde_fine_virtual": "`pde_fine` with the controlled tap alone, the others virtual",
    "pde_fine_observed_virtual": "the same, trained by what an observer tells by that tap",
    "line_virtual": "a policy that sees the gas at five points of the tube, which no sensor tells"
    " (thesis 7.3): what an observer makes of it by the controlled tap",
}
"""Policies of a variant, ``<variant>_virtual``."""
CLASSICAL = ("feed_forward", "pid")
FAULTY_SEED = 101
FAULTY_S, FAULTY_FOR_S = 3.0, 6.0
LIMITS = ROOT / "docs" / "pressure.json"
LIVE = ROOT / "docs" / "predictive_live.json"
"""What ``make predictive-live`` found."""
LIVE_PLANNED = ("predictive_light", "predictive", "predictive_one_tap")
LIVE_NAMES = (*LIVE_PLANNED, "pde_fine", *VIRTUAL, "feed_forward")


def files_of(tube: str, name: str) -> list[Path]:
    """Files of a controller of a tube; none where it was not made for that.

    Args:
        tube: Name of the tube.
        name: Of the controller.
    """
    if name in LEARNED:
        return policies(tube, name)
    if name in VIRTUAL:
        return sorted(POLICIES.glob(f"{tube}_{name}_*.yaml"))
    path = POLICIES / f"{tube}_{name}.yaml"
    return [path] if path.exists() else []


def policies_of(tube: str, name: str) -> list[Path]:
    """Policies inside the files of a controller that runs them with virtual taps.

    Args:
        tube: Name of the tube.
        name: Of the controller.
    """
    return policies(tube, name.removesuffix("_virtual")) if name in VIRTUAL else []


def one(tube: str, name: str, kind: str, seed: int) -> dict[str, float]:
    """Figures of one run.

    Args:
        tube: Name of the tube.
        name: Of the controller.
        kind: Of the target.
        seed: Of the target.
    """
    files = files_of(tube, name)
    of = digest_of([*files, *policies_of(tube, name), *made_of(tube)])
    path = OUT / f"{tube}-{name}-{kind}-{seed}-{of}.json"
    if path.exists():
        path.touch()  # the newest counts
        return dict(json.loads(path.read_text(encoding="utf-8")))
    rig = load_rig(TUBES[tube].rig)
    conditions = Conditions(dx_m=0.5 * rig.grid.dx_m)
    track = simulated_tracks(
        file_for(files, seed),
        revealed(tube),
        [TASKS.target(kind, seed)],
        [seed],
        TASKS.duration_s,
        conditions,
    )[0]
    found = TASKS.judge(track).to_dict()
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, json.dumps(found))
    return found


def kept(tube: str, name: str) -> tuple[dict[str, list[dict[str, float]]], str]:
    """The runs of a controller that were made last, by kind of target, and of which sources.

    Those count of which none is missing; there may be no such.

    Args:
        tube: Name of the tube.
        name: Of the controller.
    """
    files = sorted(OUT.glob(f"{tube}-{name}-*-*-*.json"), key=lambda path: path.stat().st_mtime)
    for of in dict.fromkeys(path.stem.rsplit("-", 1)[1] for path in reversed(files)):
        paths = {
            kind: [OUT / f"{tube}-{name}-{kind}-{seed}-{of}.json" for seed in TASKS.seeds]
            for kind in TASKS.kinds
        }
        if all(path.exists() for those in paths.values() for path in those):
            return {
                kind: [json.loads(path.read_text(encoding="utf-8")) for path in those]
                for kind, those in paths.items()
            }, of
    return {}, ""


def with_a_fault(
    tube: str, words: str, make: Callable[[str, float], Spoil] | None, tap: str
) -> str:
    """A row of the page: a run during which a tap fails.

    Args:
        tube: Name of the tube.
        words: What fails.
        make: How; None does not.
        tap: The tap.
    """
    controller = load_controller(POLICIES / f"{tube}_predictive.yaml")
    assert isinstance(controller, PredictiveController)
    rig, conditions = revealed(tube), Conditions()
    rig = with_delay(rig, conditions.delay_s)
    plant = ControlPlant([rig], controller.period_s, 0.5 * load_rig(TUBES[tube].rig).grid.dx_m)
    clean, rng = plant.reset(rig.ambient.pressure_pa), np.random.default_rng([FAULTY_SEED, 7])
    target = TASKS.target("smooth", FAULTY_SEED)
    spoil = None if make is None else make(tap, FAULTY_S)
    at, errors, highest = plant.taps.index(controller.tap), [], 0.0
    named: list[tuple[float, str]] = []
    for n in range(round(FAULTY_FOR_S / controller.period_s)):
        now = n * controller.period_s
        seen = clean[0] + conditions.noise_pa * rng.standard_normal(clean.shape[1])
        read = dict(zip(plant.taps, seen.tolist(), strict=True))
        if spoil is not None:
            read = spoil(now, read)
        volts = controller.step(read, target.at(now + np.array(controller.preview_s)).tolist())
        if now >= FAULTY_S:
            errors.append(float(clean[0, at]) - float(target.at(now)))
            highest = max(highest, float(clean[0, at]))
            if matter := controller.observer.trust.matter(tap):
                named.append((now - FAULTY_S, matter))
        clean = plant.step(volts)
    found = np.array(errors) / ATM_PA
    when = f"{1e3 * named[0][0]:.0f} ms" if named else "-"
    return (
        f"| {tube} | {tap} {words} | {when} | {named[-1][1] if named else '-'} |"
        f" {math.sqrt(float(np.mean(found**2))):.4f} | {np.abs(found).max():.2f} |"
        f" {highest / 1e3:.0f} |"
    )


def made_of(tube: str) -> list[Path]:
    """What the runs on a tube depend on besides the controllers' files.

    Args:
        tube: Name of the tube.
    """
    sources = [ROOT / "src/pneu_sim/pneu_sim", ROOT / "src/pneu_policy/pneu_policy/control"]
    return [*sources, TUBES[tube].rig, TUBES[tube].sealed]


def limits() -> dict[str, float]:
    """The plants' limits by ``tube, kind``, mean error of their runs, atm."""
    told = json.loads(LIMITS.read_text(encoding="utf-8"))
    found: dict[str, list[float]] = {}
    for run in told["runs"]:
        if run["controller"] == "limit":
            found.setdefault(f"{run['plant']}, {run['kind']}", []).append(
                float(run["metrics"]["rmse_atm"])
            )
    return {key: float(np.mean(values)) for key, values in found.items()}


def cell(runs: Sequence[Mapping[str, float]]) -> str:
    """Mean and standard deviation of the runs' errors; a dash where there are none.

    Args:
        runs: Their figures.
    """
    if not runs:
        return "-"
    values = [run["rmse_atm"] for run in runs]
    if len(values) == 1:
        return f"{values[0]:.4f}"
    return f"{np.mean(values):.4f} ± {np.std(values, ddof=1):.4f}"


def main(arguments: list[str] | None = None) -> int:
    """Runs the study; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--workers", type=int, default=2, help="processes")
    parser.add_argument("--only", nargs="*", help="controllers to run; of none shows what there is")
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "predictive.md")
    asked = parser.parse_args(arguments)
    every = [*PREDICTIVE, *VIRTUAL, *LEARNED, *CLASSICAL]
    names = every if asked.only is None else asked.only
    jobs = [
        (tube, name, kind, seed)
        for name in names
        for tube in TUBES
        if files_of(tube, name)
        for kind in TASKS.kinds
        for seed in TASKS.seeds
    ]
    for tube, name, _, _ in jobs:
        file = files_of(tube, name)[0]
        check_fits(load_controller(file), file, load_rig(TUBES[tube].rig))
    runs = joblib.Parallel(n_jobs=asked.workers, return_as="generator")(
        joblib.delayed(one)(*job) for job in jobs
    )
    with progress("runs") as told:
        for n, ((tube, name, _, _), _) in enumerate(zip(jobs, runs, strict=True)):
            told(f"{tube} {name}", n / len(jobs))
    found: dict[tuple[str, str, str], list[dict[str, float]]] = {}
    sources: dict[str, list[str]] = {}
    for name in every:
        for tube in TUBES:
            rows, of = kept(tube, name)
            found |= {(tube, kind, name): figures for kind, figures in rows.items()}
            if of:
                sources.setdefault(name, []).append(f"{tube} {of}")
    kinds: list[tuple[str, Callable[[str, float], Spoil] | None, str]] = [
        ("as ever", None, "end"),
        *((words, make, tap) for tap in ("end", "valve_out") for words, make in BROKEN.items()),
    ]
    faults = joblib.Parallel(n_jobs=asked.workers)(
        joblib.delayed(with_a_fault)(tube, *kind) for tube in TUBES for kind in kinds
    )
    write_whole(asked.page, "\n".join([*page(found, sources), *of_live(), *of_faults(faults)]))
    Console().print(f"{asked.page} is written")
    return 0


def of_live() -> list[str]:
    """The part of the page about runs against the clock; none where there were none."""
    if not LIVE.exists():
        return []
    told = json.loads(LIVE.read_text(encoding="utf-8"))
    machine = told["machine"]
    names = [name for name in LIVE_NAMES if any(r["controller"] == name for r in told["runs"])]

    def made(name: str) -> list[str]:
        own = [r for r in told["runs"] if r["controller"] == name]
        return list(dict.fromkeys(f"{r['tube']} {r['of']}" for r in own))

    lines = [
        "## Against the clock",
        "",
        "The same on the emulated lab itself, over Modbus and the live graph, judged by recordings:"
        f" `make predictive-live`. Machine: processor {machine['processor']}, cores"
        f" {machine['cores']}, {told['labs']} labs at a time. Mean and standard deviation of the"
        " valid runs; in brackets how many of all are valid, where some are not: the bus, the lab"
        " or plans were late in each of three tries. Made from:",
        "",
        *(f"- `{name}`: {', '.join(made(name))}" for name in names),
        "",
    ]

    def of(tube: str, kind: str, name: str) -> str:
        key = (tube, kind, name)
        own = [r for r in told["runs"] if (r["tube"], r["kind"], r["controller"]) == key]
        valid = [r["figures"] for r in own if r["figures"] is not None]
        return cell(valid) + (f" ({len(valid)} of {len(own)})" if len(valid) < len(own) else "")

    return [*lines, *table(names, of), ""]


def table(names: Sequence[str], told: Callable[[str, str, str], str]) -> list[str]:
    """A table with a row for each tube and kind of target.

    Args:
        names: Controllers, its columns.
        told: What is in a cell, by tube, kind and controller.
    """
    return [
        f"| | {' | '.join(names)} |",
        f"|---|{'---|' * len(names)}",
        *(
            f"| {tube}, {kind} | {' | '.join(told(tube, kind, name) for name in names)} |"
            for tube in TUBES
            for kind in TASKS.kinds
        ),
    ]


def of_faults(rows: Sequence[str]) -> list[str]:
    """The part of the page about taps that fail.

    Args:
        rows: Rows of its table.
    """
    return [
        "## Taps that fail",
        "",
        f"Smooth target, all taps, one of which fails after {FAULTY_S:g} s: when the observer"
        " leaves it out, what it says, and the true pressure at `end` from then on: error against"
        " the target, atm, and highest, kPa; targets reach"
        f" {TASKS.high_pa / 1e3:g}.",
        "",
        "| plant | tap | left out after | named | RMSE | worst | highest |",
        "|---|---|---|---|---|---|---|",
        *rows,
        "",
    ]


def page(
    found: dict[tuple[str, str, str], list[dict[str, float]]], sources: Mapping[str, list[str]]
) -> list[str]:
    """The page.

    Args:
        found: Figures of runs by tube, kind of target and controller.
        sources: By controller, in order, digests of what its runs were made from.
    """
    names = list(sources)
    known, told = limits(), PREDICTIVE | VIRTUAL
    lines = [
        "# Predictive control of a pressure",
        "",
        "Made by `make predictive`. Each column names the model, controller and plant that it was"
        " made from, the short tube's and the long one's.",
        "",
        "Table 9.1 of the thesis on the plants of the emulated lab, whose hidden effects no model"
        " knows, in lock step: see `studies/predictive.py`. Predictive controllers plan on the"
        " calibrated rig and find out by what the plant differs while they control"
        " ([control.md](control.md)).",
        "",
        *(
            f"- `{name}`: {f'{told[name]}; ' if name in told else ''}{', '.join(of)}"
            for name, of in sources.items()
        ),
        *(f"- `{name}`: {words}; not run" for name, words in told.items() if name not in names),
        "",
        f"RMSE in atm, mean and standard deviation of {len(TASKS.seeds)} runs of"
        f" {TASKS.duration_s:g} s, the first {TASKS.skip_s:g} s not judged. The limit is that of"
        " [pressure.md](pressure.md); the mark is twice the limit and 0.01 atm.",
        "",
        f"| | {' | '.join(names)} | limit | mark |",
        f"|---|{'---|' * (len(names) + 2)}",
    ]
    for tube in TUBES:
        for kind in TASKS.kinds:
            cells = [cell(found.get((tube, kind, name), [])) for name in names]
            limit = known[f"{tube}, {kind}"]
            lines.append(
                f"| {tube}, {kind} | {' | '.join(cells)} | {limit:.4f} | {2.0 * limit + 0.01:.4f} |"
            )
    lines += [
        "",
        "Greatest error of all runs, atm, and RMS of the command's change, V/s:",
        "",
    ]

    def worst(tube: str, kind: str, name: str) -> str:
        runs = found.get((tube, kind, name))
        if not runs:
            return "-"
        rate = np.mean([f["effort_rate_v_s"] for f in runs])
        return f"{max(f['worst_atm'] for f in runs):.2f}, {rate:.0f}"

    return [*lines, *table(names, worst), ""]


if __name__ == "__main__":
    sys.exit(main())
