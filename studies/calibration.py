# SPDX-License-Identifier: Apache-2.0
"""Rigs drawn at random, calibrated from their datasheets: how long it takes, what is left on a
recording kept aside, and how far the parameters are from the truth. Writes ``docs/calibration.md``.

A folder of bags may be given besides: of each `X_healthy_1` and `X_healthy_2` in it, with
`rig_X.yaml` there or in `rigs/`, the first is fitted and the second is kept aside.
"""

import argparse
import multiprocessing
import resource
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np
from rich.console import Console

from pneu_common.progress import progress
from pneu_sim.rig import load_rig
from pneu_sim.rig.opening import opening_at
from pneu_sim.rig.parameters import get_parameter
from pneu_sim.rig.schema import Rig
from pneu_sysid.fit import FitOutcome, fit_rig, sensor_times_noise
from pneu_sysid.problem import make_problem, record_for
from pneu_sysid.records import Recording
from studies.bags import rig_file
from studies.calibration_rigs import JOINT_DX_M, PLANT_DX_M, SHAPES, draw_case
from studies.digest import digest_of, sources_digest

ROOT = Path(__file__).resolve().parent.parent
SEEDS = (1, 2)
MOST_TIMES_NOISE = 2.0
MOST_SECONDS = 120.0
NINETY = 1.645
"""Half the width of a 90 % interval, in standard errors."""
GROUPS = {
    "conductances and critical ratios": ("*conductance*", "*critical_ratio"),
    "opening curves": ("*.opening.fraction.*",),
    "spools": ("*.spool.*",),
    "other numbers of ports": ("valves.*",),
    "bores": ("*.area_m2",),
    "walls of lines": ("pipes.*.wall.*",),
    "chambers": ("chambers.*",),
    "friction and stops": ("*.friction.*", "*.viscous", "*.dry_friction", "*.stop_*"),
    "linkages": ("bodies.*.slider.*",),
    "masses and inertias": ("bodies.*",),
    "cylinders": ("cylinders.*",),
    "encoders": ("encoders.*",),
    "volumes and losses at ends": ("pipes.*",),
    "supply": ("reservoirs.*",),
    "places of taps": ("taps.*",),
    "restrictors": ("orifices.*",),
}
"""Kinds of parameters by the patterns of their paths; the first that meets one counts."""
SHOWN = (
    *("conductances and critical ratios", "spools", "chambers", "restrictors", "bores"),
    *("friction and stops", "linkages", "masses and inertias", "cylinders", "encoders"),
)
"""Kinds whose parameters are listed one by one."""


@dataclass(frozen=True)
class Calibrated:
    """A calibration and what it took.

    Attributes:
        outcome: The outcome.
        seconds: How long it took, s.
        cpu_seconds: Processor time, s.
        memory_mb: Most memory that the process had, MB.
        aside: Times the noise per tap on the recording kept aside.
        mended: The same, what the rig's cells get wrong made good: what the parameters leave.
    """

    outcome: FitOutcome
    seconds: float
    cpu_seconds: float
    memory_mb: float
    aside: list[float]
    mended: list[float]


@dataclass(frozen=True)
class Estimated:
    """A parameter that was fitted, and what it is."""

    path: str
    group: str
    value: float
    std_error: float
    truth: float
    at_bound: bool

    @property
    def inside(self) -> bool:
        """Whether the 90 % interval holds the truth."""
        return abs(self.value - self.truth) <= NINETY * self.std_error


def calibrated(rig: Rig, recordings: list[Recording]) -> Calibrated:
    """Calibrates a rig on the first of two recordings; looks at the other.

    Args:
        rig: Its datasheet.
        recordings: The recordings.
    """
    begun, cpu = time.monotonic(), time.process_time()
    outcome = fit_rig(rig, recordings[0])
    seconds, cpu_seconds = time.monotonic() - begun, time.process_time() - cpu
    memory_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    problem = make_problem(outcome.rig, recordings[1])
    every = np.ones(problem.stretches, dtype=bool)
    aside, mended = (
        list(sensor_times_noise(one, one.predict([outcome.rig])[0], every).values())
        for one in (problem, problem.mended(outcome.rig))
    )
    return Calibrated(outcome, seconds, cpu_seconds, memory_mb, aside, mended)


def of_drawn(shape: str, seed: int) -> tuple[str, Calibrated, list[Estimated]]:
    """Calibrates a rig drawn at random.

    Args:
        shape: Its shape.
        seed: Its seed.
    """
    case = draw_case(shape, seed)
    done = calibrated(case.datasheet, case.recordings)
    return case.name, done, compared(done.outcome, case.truth)


def of_bags(folder: Path, letter: str) -> tuple[str, Calibrated, list[Estimated]]:
    """Calibrates a rig on two bags of a folder.

    Args:
        folder: The folder.
        letter: What the names of its bags and its rig file begin with.
    """
    own = folder / f"rig_{letter}.yaml"
    rig = load_rig(own if own.exists() else rig_file(letter))
    bags = [folder / f"{letter}_healthy_{k}" for k in (1, 2)]
    done = calibrated(rig, [record_for(rig, str(bag)) for bag in bags])
    return f"{folder.name}/{letter}", done, []


def compared(outcome: FitOutcome, truth: Rig) -> list[Estimated]:
    """What was fitted against what it is; what the truth lacks, or nothing shows, is left out.

    Args:
        outcome: The outcome.
        truth: The truth.
    """
    out = []
    for p, value, at_bound in zip(
        outcome.parameters, outcome.values, outcome.known.at_bound, strict=True
    ):
        true = true_value(truth, outcome.rig, p.path)
        if true is None or p.std_error is None:
            continue
        group = next(g for g, like in GROUPS.items() if any(fnmatchcase(p.path, q) for q in like))
        out.append(Estimated(p.path, group, value, p.std_error, true, bool(at_bound)))
    return out


def true_value(truth: Rig, fitted: Rig, path: str) -> float | None:
    """What a fitted number should be; None where the truth has no such number.

    Args:
        truth: The truth.
        fitted: The fitted rig: its curves may have other points.
        path: Path of the number.
    """
    parts = path.split(".")
    if ".opening.fraction." in path:
        valve, port, point = parts[1], parts[3], int(parts[-1])
        null = truth.valves[valve].spool.null_v
        at = abs(fitted.valves[valve].ports[port].opening.voltage_v[point] - null)
        curve = truth.valves[valve].ports[port].opening
        side = 1.0 if curve.voltage_v[-1] > null else -1.0
        return float(opening_at(curve, null, np.array([null + side * at]))[0])
    if parts[-1] == "closing_delay_s":
        spool = truth.valves[parts[1]].spool
        return spool.delay_s if spool.closing_delay_s is None else spool.closing_delay_s
    if parts[-1] in ("max_speed_v_s", "max_acceleration_v_s2"):
        limit = getattr(truth.valves[parts[1]].spool, parts[-1])
        return None if limit is None else float(limit)
    return get_parameter(truth, path)


def row_of(name: str, done: Calibrated) -> str:
    """A line of the table."""
    noise = done.outcome.rig.calibration.noise  # type: ignore[union-attr]
    here = " ".join(f"{v / noise[t]:.2f}" for t, v in done.outcome.rmse.items())
    aside, mended = (" ".join(f"{v:.2f}" for v in of) for of in (done.aside, done.mended))
    short = "" if done.outcome.shortfall is None else ", ".join(done.outcome.shortfall.by_tap)
    met = max(done.mended) <= MOST_TIMES_NOISE or bool(short)
    seen = int(done.outcome.known.seen.sum())
    return (
        f"| {name} | {done.seconds:.0f} | {done.cpu_seconds:.0f} | {done.memory_mb:.0f} |"
        f" {seen} of {len(done.outcome.parameters)} | {here} | {aside} | {mended} |"
        f" {short or 'no'} |"
        f" {'yes' if met else 'NO'} |"
    )


def coverage(found: list[Estimated]) -> list[str]:
    """How often the 90 % intervals hold the truth, by kind."""
    heads = "| parameters | fitted | 90 % intervals that hold the truth | at a bound |"
    lines = [heads, "|---" * 4 + "|"]
    for group in (*GROUPS, "all"):
        mine = [e for e in found if group in (e.group, "all")]
        if mine:
            share = 100.0 * sum(e.inside for e in mine) / len(mine)
            bound = sum(e.at_bound for e in mine)
            lines.append(f"| {group} | {len(mine)} | {share:.0f} % | {bound} |")
    return lines


def main(arguments: list[str] | None = None) -> int:
    """Runs the study; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="*", type=Path, help="folders of bags")
    parser.add_argument("--seeds", type=int, nargs="*", default=list(SEEDS))
    parser.add_argument("--shapes", nargs="*", default=list(SHAPES), choices=SHAPES)
    options = parser.parse_args(arguments)
    console = Console(width=150)
    tasks: list[tuple[str, tuple[object, ...]]] = [
        ("drawn", (shape, seed)) for shape in options.shapes for seed in options.seeds
    ]
    for folder in options.folders:
        letters = sorted(b.name.split("_")[0] for b in folder.glob("*_healthy_1"))
        tasks += [("bags", (folder, letter)) for letter in letters]
    rows, every, lists = [], [], []
    slow = 0
    # one process each, so that its memory is its own
    with (
        ProcessPoolExecutor(
            1, mp_context=multiprocessing.get_context("spawn"), max_tasks_per_child=1
        ) as pool,
        progress("calibrating") as tell,
    ):
        for k, (kind, given) in enumerate(tasks):
            tell("calibrating", k / len(tasks), " ".join(str(g) for g in given))
            work = of_drawn if kind == "drawn" else of_bags
            name, done, found = pool.submit(work, *given).result()  # type: ignore[arg-type]
            rows.append(row_of(name, done))
            slow += done.seconds > MOST_SECONDS
            console.print(rows[-1])
            every += found
            lists += [
                f"| {name} | `{e.path}` | {e.truth:.4g} | {e.value:.4g} | {e.std_error:.2g} |"
                f" {(e.value - e.truth) / e.std_error:+.1f} |"
                for e in found
                if e.group in SHOWN
            ]
    table = coverage(every)
    for line in table:
        console.print(line)
    if set(options.shapes) == set(SHAPES):
        _write(rows, slow, table, lists, options.folders)
    return 0


def _write(
    rows: list[str], slow: int, table: list[str], lists: list[str], folders: list[Path]
) -> None:
    missed = sum(row.endswith("NO |") for row in rows)
    text = " ".join(str(__doc__).split(". Writes")[0].split())
    bags = [f"{folder.name} {digest_of([folder])}" for folder in folders]
    lines = [
        "# Calibration",
        "",
        f"Made by `make calibration`: {text}.",
        f"The plant has cells of {1000 * PLANT_DX_M:g} mm (of a joint {1000 * JOINT_DX_M:g} mm, and"
        " another flux), another limiter, and valves with limits,"
        " delays and curves of their own; datasheets are off by 10 to 40 %.",
        f"Made from the sources {sources_digest()}"
        + (f" and the bags {', '.join(bags)}." if bags else "."),
        "",
        f"Marks: at most {MOST_TIMES_NOISE:g} times the noise on every tap of the recording kept"
        " aside, what the rig's cells get wrong made good (no number is fitted to that), or the"
        f" calibration says that it stops short: missed by {missed} of {len(rows)} rigs."
        f" {MOST_SECONDS:g} s on two quiet cores: {slow} took longer.",
        "",
        "| rig | s | processor s | MB | parameters shown | times noise, fitted | kept aside |"
        " cells made good | stops short at | mark |",
        "|---" * 10 + "|",
        *rows,
        "",
        "## What the standard errors are worth",
        "",
        "Of all parameters that the recordings show and the truth has.",
        "",
        *table,
        "",
        "## Parameters against the truth",
        "",
        "| rig | parameter | truth | fitted | std. error | apart, in std. errors |",
        "|---" * 6 + "|",
        *lists,
    ]
    (ROOT / "docs" / "calibration.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
