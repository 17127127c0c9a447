# SPDX-License-Identifier: Apache-2.0
"""Every effect beside its reference, and what holds of all of them: `docs/effects_proven.md`."""

import argparse
import dataclasses
from pathlib import Path

from rich.progress import track
from tests.effect_benches import BENCHES, felt_on
from tests.references.effects import COMPARISONS

from pneu_common.files import whole
from pneu_sim.effects import Comparison, load_effect_file, proof, registry
from pneu_sim.effects.proof import Finding
from studies.digest import ROOT, digest_of

SOURCES = (
    "src/pneu_sim/pneu_sim",
    "tests/references",
    "tests/effect_benches.py",
    "studies/effects.py",
)
COLUMNS = {
    "vanishes": "none of it",
    "slope": "slope",
    "cells half as long": "cells / 2",
    "steps half as long": "steps / 2",
    "other cells half as long": "other cells / 2",
    "pipe written from its other end": "pipe turned",
    "order of attachment": "order",
    "keeps its mass": "mass",
    "keeps its energy": "energy",
}


@dataclasses.dataclass(frozen=True)
class Row:
    """What was found of one effect.

    Attributes:
        name: The effect.
        bench: The rig on which it was held to what holds of all.
        general: What holds of all.
        experiment: What it is compared with, where there is something.
        reference: One finding of that per strength.
        refused: Models that refuse it.
    """

    name: str
    bench: str
    general: list[Finding]
    experiment: Comparison | None
    reference: list[Finding]
    refused: list[str]


def main() -> None:
    """Measure, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "effects_proven.md")
    options = parser.parse_args()
    load_effect_file(ROOT / "examples" / "my_effect.py")
    benches = {name: bench() for name, bench in BENCHES.items()}
    felt = {}
    for name, effect in registry().items():
        order = [benches["short_arm"]] if name == "end_cushion" else list(benches.values())
        at = felt_on(effect, order)
        if at is None:
            raise SystemExit(f"{name}: felt on none of the rigs")
        felt[name] = at
    rows = []
    for name, at in track(felt.items(), description="effects", total=len(felt)):
        others = [one for one in felt.values() if one.bench is at.bench]
        general = proof.prove(at, others)
        one = next(iter(at.effect.comparisons()), COMPARISONS.get(name))
        rows.append(
            Row(
                name,
                next(key for key, bench in benches.items() if bench is at.bench),
                general,
                one,
                [] if one is None else proof.compare(at.effect, one),
                [f.check.rpartition(" ")[2] for f in general if f.check.startswith("refused")],
            )
        )
    found = {name: proof.twins(bench) for name, bench in benches.items()}
    page(rows, found, options.page)


def _number(finding: Finding) -> str:
    text = f"{finding.deviation:.2g}"
    return text if finding.holds else f"**{text}**"


def page(rows: list[Row], twins: dict[str, set[tuple[str, str]]], path: Path) -> None:
    """Write the page.

    Args:
        rows: What was found.
        twins: Per rig the pairs that nothing tells apart.
        path: The page.
    """
    failed = [(row.name, f) for row in rows for f in row.general + row.reference if not f.holds]
    without = [row.name for row in rows if not row.reference]
    compared = [f for row in rows for f in row.reference]
    within = sum(f.deviation <= 0.01 for f in compared)
    lines = [
        "# Effects beside their references",
        "",
        f"Made by `make effects` from the sources {digest_of(ROOT / p for p in SOURCES)}. A"
        " deviation that is not allowed is bold and counts as a failure.",
        "",
        f"{len(rows)} effects, {len(rows) - len(without)} of them with a reference, at"
        f" {len(compared)} strengths: {within} deviate by at most 1 %, the others by at most"
        f" {100 * max(f.deviation for f in compared):.1f} %. Failures, of all checks:"
        f" {len(failed)}. No closed form: {', '.join(without)}.",
        "",
        "## References",
        "",
        "A deviation is the largest difference of what the effect changes from what it should"
        " change, as a share of the largest change, on an experiment that one law decides"
        " (`tests/references/effects.py`).",
        "",
        "| effect | reference | strengths: deviation |",
        "|---|---|---|",
    ]
    for row in rows:
        if row.experiment is not None:
            told = "; ".join(
                f"{s:g}: {_number(f)}"
                for s, f in zip(row.experiment.strengths, row.reference, strict=True)
            )
            lines.append(f"| {row.name} | {row.experiment.what} | {told} |")
    lines += [
        "",
        "## What holds of every effect",
        "",
        "By `pneu_sim.effects.proof`, where the effect is felt most on the first of the rigs of"
        " `tests/effect_benches.py` on which it is felt; as shares of what a typical strength"
        f" changes. Allowed: none of it {proof.ROUND_OFF:g}, slope {proof.SLOPE:g} (half a small"
        f" strength against a whole one; {proof.FINITE:g} where it is declared curved, c), cells"
        f" and steps {proof.GRID:g}, pipe turned {proof.TURNED:g}, order of attachment"
        f" {proof.ROUND_OFF:g}, mass and energy of a closed rig {proof.KEPT:g}. Models that refuse"
        " the effect are named; in all others it acts.",
        "",
        "| effect | rig | " + " | ".join(COLUMNS.values()) + " | refused by |",
        "|---|---|" + "---|" * len(COLUMNS) + "---|",
    ]
    for row in rows:
        cells = []
        for check in COLUMNS:
            matching = [f for f in row.general if f.check.startswith(check)]
            worst = max(matching, key=lambda f: f.deviation, default=None)
            curved = worst is not None and "curved" in worst.check
            cells.append("" if worst is None else _number(worst) + (" c" if curved else ""))
        refused = ", ".join(row.refused)
        lines.append(f"| {row.name} | {row.bench} | " + " | ".join(cells) + f" | {refused} |")
    pairs = sorted({pair for found in twins.values() for pair in found})
    lines += [
        "",
        "Pairs that change the same at the same strength, so that no recording tells them apart: "
        + (
            "; ".join(
                f"{a} and {b} ({', '.join(n for n, found in twins.items() if (a, b) in found)})"
                for a, b in pairs
            )
            or "none"
        )
        + ".",
    ]
    with whole(path) as aside:
        aside.write_text("\n".join(lines) + "\n", encoding="utf-8")
    print(f"{path}: {len(failed)} failures")
    for name, finding in failed:
        print(f"  {name}: {finding.check} {finding.deviation:.2g} ({finding.about})")


if __name__ == "__main__":
    main()
