# SPDX-License-Identifier: Apache-2.0
"""The stages of ``make experiments``.

`pairs`, each of two effects that a random recording of ten seconds leaves open, then a designed one
of the same length; `calibrations`, errors of a fit to designed and to random recordings by their
length, and how right the expected standard errors were; `page`. What is found goes at once to
``docs/experiments.json``; what is there already of the present sources is not run again.

    python -m studies.experiments pairs calibrations page
    python -m studies.experiments --only pair_2 calibration_rig_j_0
"""

import argparse
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rich.console import Console

from pneu_common.files import write_whole
from pneu_common.progress import progress
from studies.digest import sources_digest
from studies.experiments.calibrations import CALIBRATED, calibration_figures, key_of
from studies.experiments.page import page
from studies.experiments.pairs import PAIRS, pair_figures
from studies.experiments.plants import ROOT
from studies.stages import add_stages


def kept_in(path: Path) -> dict[str, dict[str, Any]]:
    """Figures and sources of what was run, by its name."""
    if not path.is_file():
        return {}
    kept: dict[str, dict[str, Any]] = json.loads(path.read_text(encoding="utf-8"))
    return kept


def jobs_of(stages: list[str], console: Console) -> dict[str, Callable[[], dict[str, Any]]]:
    """What there is to run, by its name."""
    jobs: dict[str, Callable[[], dict[str, Any]]] = {}
    if "pairs" in stages:
        for k, pair in enumerate(PAIRS):
            jobs[f"pair_{k}"] = lambda pair=pair: pair_figures(pair, console)
    if "calibrations" in stages:
        for file, sheets in CALIBRATED.items():
            for seed in range(sheets):
                jobs[key_of(file, seed)] = lambda file=file, seed=seed: calibration_figures(
                    file, seed, console
                )
    return jobs


def main() -> int:
    """Runs the stages."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    add_stages(parser, ("pairs", "calibrations", "page"))
    parser.add_argument("--kept", type=Path, default=ROOT / "docs" / "experiments.json")
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "experiments.md")
    parser.add_argument("--only", nargs="*", metavar="NAME", help="what to run of the stages")
    asked = parser.parse_args()
    console, sources = Console(width=140), sources_digest()
    jobs = jobs_of(asked.stages, console)
    names = list(jobs) if asked.only is None else asked.only
    for name in names:
        if name not in jobs:
            parser.error(f"--only: found {name!r}, allowed are {', '.join(jobs)}")
    for name in names:
        if kept_in(asked.kept).get(name, {}).get("sources") == sources:
            continue
        with progress(name):
            figures = jobs[name]()
        # read anew: others may have been run meanwhile
        kept = {**kept_in(asked.kept), name: {"sources": sources, "figures": figures}}
        write_whole(asked.kept, json.dumps(dict(sorted(kept.items())), indent=1) + "\n")
        console.print(f"{name}: {json.dumps(figures)[:1500]}")
    if "page" in asked.stages:
        page(asked.page, kept_in(asked.kept))
        console.print(f"{asked.page} is written")
    return 0


if __name__ == "__main__":
    sys.exit(main())
