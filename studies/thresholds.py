# SPDX-License-Identifier: Apache-2.0
"""Every number that decides a verdict halved and doubled: which verdicts change.

On recordings of the confusion study's rigs, a part of the faulty ones and some healthy ones. What
is simulated once serves every number that only judges it. Writes ``docs/thresholds.md``.
"""

import argparse
import sys
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from rich.console import Console

from pneu_sim.rig.schema import Rig
from pneu_sysid.bench import Bench, bench_of
from pneu_sysid.candidates import residual_matrix, sensitivities
from pneu_sysid.diagnose import Diagnosis, look
from pneu_sysid.evidence import blocks_of
from pneu_sysid.refits import refit
from pneu_sysid.sites import all_sites
from pneu_sysid.standing import standing_of
from pneu_sysid.thresholds import Thresholds
from studies.confusion import STORE, key_of_sources, recordings_folder
from studies.confusion_cases import RIGS, calibrated, load_recording, recordings_of
from studies.digest import sources_digest

ROOT = Path(__file__).resolve().parent.parent
EVERY = 6
"""One in so many faulty recordings of each rig is looked at, and as many healthy ones."""
FACTORS = {"typical": (0.3, 3.0)}
"""Factors on numbers; half and double where it does not say."""


def variants() -> list[tuple[str, float, Thresholds]]:
    """Every number changed, by itself: its name, the factor, all numbers."""
    out = []
    usual = Thresholds()
    for one in fields(Thresholds):
        value = getattr(usual, one.name)
        for factor in FACTORS.get(one.name, (0.5, 2.0)):
            changed = type(value)(round(value * factor, 9))
            out.append((one.name, factor, replace(usual, **{one.name: changed})))
    return out


class Remembered:
    """A refit that is done once for each start.

    Args:
        work: The refit.
    """

    def __init__(self, work: Callable[..., Any]) -> None:
        self._work = work
        self._known: dict[tuple[Any, ...], Any] = {}

    def __call__(self, problem: Any, rig: Rig, base: Any, candidate: Any, *rest: Any) -> Any:
        """As the refit."""
        site = candidate.site
        key = (site.part, *sorted(site.shape.items()), candidate.strength, rest[0].typical)
        key += tuple(rest[2:])
        if key not in self._known:
            self._known[key] = self._work(problem, rig, base, candidate, *rest)
        return self._known[key]


def with_thresholds(bench: Bench, usual: Thresholds, limits: Thresholds) -> Bench:
    """A bench under other numbers; what they change of it is made anew.

    Args:
        bench: The bench.
        usual: Numbers that it was made with.
        limits: The other numbers.
    """
    out = replace(bench, thresholds=limits)
    residual = residual_matrix(bench.problem, bench.readings)
    out.standing = standing_of(bench.rig, bench.problem, residual, limits)
    if limits.block != usual.block:
        out.blocks = blocks_of(bench.problem, limits.block)
    if limits.typical != usual.typical:
        rough = bench.coarser(bench.rig, bench.readings)
        out.known = sensitivities(rough, bench.rig, all_sites(bench.rig), limits)
    return out


def quiet(stage: str, done: float) -> None:
    """Tells nobody how far the work is."""


def verdict_of(found: Diagnosis) -> str:
    """A verdict in a few words: what is named, and where."""
    if found.verdict == "nothing_missing" or not found.believed:
        return found.verdict
    top = found.finalists[0].site
    return f"{found.verdict} {top.effect.name}@{top.place}"


def main(arguments: list[str] | None = None) -> int:
    """Runs the study; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--every", type=int, default=EVERY)
    options = parser.parse_args(arguments)
    console = Console(width=150)
    usual = Thresholds()
    changes: dict[tuple[str, float], list[str]] = {(n, f): [] for n, f, _ in variants()}
    looked: list[str] = []
    for shape, seed in RIGS:
        rig = calibrated(shape, seed, STORE / f"rigs_{key_of_sources()}")
        every = recordings_of(shape, seed, recordings_folder())
        faulty = [(i, path) for i, path in every if i.effect][:: options.every]
        healthy = [(i, path) for i, path in every if not i.effect][: max(1, len(faulty) // 3)]
        for injection, path in faulty + healthy:
            bench = bench_of(rig, load_recording(path), False, None, quiet, usual, ())
            work = Remembered(refit)
            base = verdict_of(look(bench, rig, bench.readings, quiet, work=work))
            for name, factor, limits in variants():
                other = with_thresholds(bench, usual, limits)
                found = verdict_of(look(other, rig, bench.readings, quiet, work=work))
                if found != base:
                    changes[name, factor].append(f"{injection.key}: {base} -> {found}")
                    console.print(name, factor, changes[name, factor][-1])
            looked.append(injection.key)
            console.print(f"{len(looked)} {injection.key}: {base}")
    (ROOT / "docs" / "thresholds.md").write_text(page(looked, changes), encoding="utf-8")
    return 0


def page(looked: list[str], changes: dict[tuple[str, float], list[str]]) -> str:
    """The results as a page.

    Args:
        looked: Recordings that were looked at.
        changes: Per number and factor the verdicts that changed.
    """
    usual = Thresholds()
    lines = [
        "# What the thresholds are worth",
        "",
        "Made by `make thresholds`: every number of `pneu_sysid/thresholds.py` halved and doubled"
        " by itself (strengths at which effects are first tried: 0.3 and 3 times), and the verdicts"
        f" on {len(looked)} recordings of the confusion study that changed: another verdict,"
        " effect or part.",
        f"Made from the sources {sources_digest()}.",
        "",
        "| number | value | times | verdicts that change |",
        "|---" * 4 + "|",
    ]
    for (name, factor), found in changes.items():
        what = "; ".join(found) if found else ""
        lines.append(
            f"| {name} | {getattr(usual, name):g} | {factor:g} | {len(found)} of {len(looked)}"
            f"{': ' + what if what else ''} |"
        )
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
