# SPDX-License-Identifier: Apache-2.0
"""Labelled bags with fewer and fewer readings: does the diagnosis stay the same?

Every bag of a folder that is in ``studies.bags.KNOWN`` is diagnosed as it is, and with its taps
thinned to 100 and 50 Hz and to uneven instants 20 to 50 ms apart, commands left alone. Writes
``docs/thinned.md``.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console

from pneu_sim.effects.base import POSITION
from pneu_sim.rig import load_rig
from pneu_sim.signals import Signal
from pneu_sysid.diagnose import diagnose
from pneu_sysid.problem import record_for
from pneu_sysid.records import Recording
from studies.bags import KNOWN
from studies.digest import digest_of, sources_digest

ROOT = Path(__file__).resolve().parent.parent
RATES = ("500 Hz", "100 Hz", "50 Hz", "uneven")


def thinned(recording: Recording, rate: str, seed: int) -> Recording:
    """A recording with fewer readings, each tap at instants of its own.

    Args:
        recording: At 500 Hz.
        rate: One of ``RATES``.
        seed: Of the uneven instants.
    """
    if rate == "500 Hz":
        return recording
    rng = np.random.default_rng(seed)
    kept = {}
    for k, (tap, signal) in enumerate(recording.pressures.items()):
        if rate == "uneven":
            count = int(np.ptp(signal.time_s) / 0.02)
            at = signal.time_s[0] + np.cumsum(rng.uniform(0.02, 0.05, count))
            index = np.unique(np.searchsorted(signal.time_s, at[at < signal.time_s[-1]]))
        else:
            stride = 500 // int(rate.split()[0])
            index = np.arange(k % stride, len(signal), stride)
        kept[tap] = Signal(signal.time_s[index], signal.values[index])
    return replace(recording, pressures=kept)


def main(arguments: list[str] | None = None) -> int:
    """Runs the study; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", nargs="*", help="bags to run")
    options = parser.parse_args(arguments)
    console = Console(width=150)
    if not options.folder.is_dir():
        console.print(f"{options.folder}: no such folder")
        return 2
    rows: list[str] = []
    same = asked = 0
    for name, truth in KNOWN.items():
        if not (options.folder / name).exists() or (options.only and name not in options.only):
            continue
        rig = load_rig(ROOT / "rigs" / f"rig_{name[0]}_fitted.yaml")
        whole = record_for(rig, str(options.folder / name))
        reference = None
        for rate in RATES:
            found = diagnose(rig, thinned(whole, rate, seed=1), refine=False)
            top = found.finalists[0]
            label = f"{top.site.effect.name}@{top.site.place}"
            where = top.site.shape.get(POSITION)
            reference = reference or (label, top.strength, top.std_error, where)
            apart = (top.strength - reference[1]) / np.hypot(top.std_error, reference[2])
            if rate != RATES[0]:
                asked += 1
                same += label == reference[0]
            right = label == f"{truth.effect}@{truth.place}"
            place = "" if where is None else f" at {where:.2f} m"
            rows.append(
                f"| {name} | {rate} | {label}{place}{'' if right else ' (wrong)'} |"
                f" {top.strength:.4g} ± {top.std_error:.2g} | {truth.strength:.4g} |"
                f" {apart:+.1f} | {found.verdict.replace('_', ' ')} |"
            )
            console.print(rows[-1])
    used = [options.folder / name for name in KNOWN if (options.folder / name).exists()]
    page = [
        "# Thinned recordings",
        "",
        "Made by `make thinned BAGS=folder`: labelled bags with their taps as recorded, at 100 and"
        " 50 Hz, and at uneven instants 20 to 50 ms apart; commands at 500 Hz throughout.",
        f"Made from bags {digest_of(used)} and sources {sources_digest()}.",
        "",
        f"First effect and part as at 500 Hz in {same} of {asked} thinned recordings.",
        "",
        "| bag | taps | first | strength | true | apart from 500 Hz, s.e. | verdict |",
        "|" + "---|" * 7,
        *rows,
    ]
    if not options.only:
        (ROOT / "docs" / "thinned.md").write_text("\n".join(page) + "\n", encoding="utf-8")
    console.print(page[5])
    return 0


if __name__ == "__main__":
    sys.exit(main())
