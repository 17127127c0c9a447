# SPDX-License-Identifier: Apache-2.0
"""The page of what the experiments told, each row with the sources that it is of."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pneu_common.files import write_whole
from pneu_sysid.design.hypotheses import part_of
from studies.experiments.calibrations import CALIBRATED, LONG_S, OFF, SHORT_S, WAYS, key_of
from studies.experiments.pairs import PAIRS, SECONDS

RATIOS = ("errors_over_random", "error_ratios", "error_ratios_itself")


def page(path: Path, kept: Mapping[str, Mapping[str, Any]]) -> None:
    """Writes the page.

    Args:
        path: Of the page.
        kept: Figures and sources of what was run, by its name.
    """
    sources = sorted({one["sources"] for one in kept.values()})
    lines = [
        "# Experiments", "",
        f"Made by `make experiments`, from the sources {', '.join(sources)}; each row names its"
        " own.", "",
        "## Two effects that a random recording does not tell apart", "",
        "Plants with finer cells and another flux than the models. A random recording of"
        f" {SECONDS:g} s leaves the two open; then a designed one of the same length, and another"
        " random one for comparison, each diagnosed together with the first. Expected and found are"
        " the standard errors by which the designed one alone tells the first of the two from what"
        " comes nearest.", "",
        "| hidden | first, random | expected | found | with the designed one | with another random"
        " one | design [s] | sources |",
        "|---|---|---|---|---|---|---|---|",
    ]  # fmt: skip
    right = count = 0
    for k, pair in enumerate(PAIRS):
        one = kept.get(f"pair_{k}")
        if one is None:
            lines.append(f"| {pair.name} | not run | | | | | | |")
            continue
        f = one["figures"]
        if not f["open"]:
            told = "no random recording left it open"
            lines.append(f"| {pair.name} | {told} | | | | | | {one['sources']} |")
            continue
        count += 1
        named_right = f["both"][0] == "effect" and f["both"][1].startswith(f["hidden"])
        right += named_right
        top = part_of(f["first"][0])
        expected = min(s["standard_errors"] for s in f["expected"] if part_of(s["one"]) == top)
        found = _found(f)
        values = ", ".join(f"{n} {v:.3g}" for n, v in f["values"].items())
        lines.append(
            f"| {f['hidden']} ({values}) | {', '.join(f['first'])} | {expected:.1f} | {found}"
            f" | {'right' if named_right else 'NOT RIGHT'}: {', '.join(f['both'])}"
            f" | {', '.join(f['random_again'])}"
            f" | {f['design_s']:.0f} | {one['sources']} |"
        )
    told = f"Named rightly: {right} of {count} that were left open."
    lines += ["", told, "", "## Calibration", ""]
    lines += [
        "Errors of all parameters, in what was not known of each before: root mean square, in"
        f" brackets the median; numbers of datasheets are off by {OFF:g} of that, and what no"
        " recording shows stays so. After the stroke what the fit tells of its own errors but for"
        " opening curves: root mean square of the standard errors, and the share of 90 % intervals"
        " that hold the truth. Commands of all ways keep to the same limits of volts. Designed over"
        f" random: standard errors of the designed {SHORT_S:g} s over those of the random"
        f" {LONG_S:g} s, parameter by parameter, median and the middle 80 %. Found over expected:"
        " standard errors after the fit over what the plan foresaw of rigs as they may be by the"
        " datasheet, likewise; then over what is foreseen of the very rig, which is not known"
        " before.", "",
        f"| rig | datasheet | parameters | {' | '.join(WAYS)} | designed over random | found over"
        " expected | of the very rig | design [s] | sources |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]  # fmt: skip
    for file, sheets in CALIBRATED.items():
        every: list[list[list[float]]] = []
        all_ratios: list[list[list[float]]] = []
        for seed in range(sheets):
            one = kept.get(key_of(file, seed))
            if one is None:
                lines.append(f"| {file} | {seed} | not run | | | | | | | | |")
                continue
            f = one["figures"]
            told = " | ".join(_errors(*f[way]) for way in WAYS)
            ratios = " | ".join(_spread(*f[name]) for name in RATIOS)
            lines.append(
                f"| {file} | {seed} | {f['parameters']} | {told} | {ratios}"
                f" | {f['design_s']:.0f} | {one['sources']} |"
            )
            every.append([f[way] for way in WAYS])
            all_ratios.append([f[name] for name in RATIOS])
        if every:
            told = " | ".join(_errors(*of) for of in np.mean(every, axis=0).tolist())
            ratios = " | ".join(_spread(*of) for of in np.mean(all_ratios, axis=0).tolist())
            lines.append(f"| {file} | mean | | {told} | {ratios} | | |")
    write_whole(path, "\n".join(lines) + "\n")


def _errors(whole: float, middle: float, told: float, held: float) -> str:
    """Errors of a fit, and what it tells of them."""
    return f"{whole:.2f} ({middle:.3f}) / {told:.2f} {held:.0%}"


def _spread(low: float, middle: float, high: float) -> str:
    """Ratios, their middle and the ends of the middle 80 %."""
    return f"{middle:.2f} ({low:.2f} to {high:.2f})"


def _found(figures: dict[str, Any]) -> str:
    """By how much the designed recording alone told what the random one left open.

    Negative where what came nearest leads.
    """
    leads = [
        told["found"]
        for told in figures["found"]
        if told["found"] is not None and told["one"] == figures["first"][0]
    ]
    return f"{min(leads, key=abs):.1f}" if leads else "another was named"
