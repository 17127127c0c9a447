# SPDX-License-Identifier: Apache-2.0
"""Verify every effect and write `docs/effects_proven.md`."""

import argparse
import dataclasses
from pathlib import Path

from rich.progress import track
from tests.effect_experiments import EXPERIMENTS, placement_on
from tests.references import scenes
from tests.references.effects import COMPARISONS

from pneu_common.files import whole
from pneu_sim.effects import Comparison, load_effect_file, proof, registry
from pneu_sim.effects.proof import Finding
from pneu_sysid.contacts.effects import scene_effects
from studies.digest import ROOT, digest_of

SOURCES = (
    "src/pneu_sim/pneu_sim",
    "src/pneu_sysid/pneu_sysid/contacts",
    "tests/references",
    "tests/effect_experiments.py",
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
    """Results of one effect.

    Attributes:
        name: Name of the effect.
        rig: Name of the rig of the property checks.
        properties: Results of the property checks.
        experiment: The experiment with a reference, if there is one.
        reference: One result of that experiment per strength.
        refused: Models that refuse the effect.
    """

    name: str
    rig: str
    properties: list[Finding]
    experiment: Comparison | None
    reference: list[Finding]
    refused: list[str]


def main() -> None:
    """Measure, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "effects_proven.md")
    options = parser.parse_args()
    load_effect_file(ROOT / "examples" / "my_effect.py")
    experiments = {name: experiment() for name, experiment in EXPERIMENTS.items()}
    placements = {}
    for name, effect in registry().items():
        order = [experiments["short_arm"]] if name == "end_cushion" else list(experiments.values())
        at = placement_on(effect, order)
        if at is None:
            raise SystemExit(f"{name}: no rig responds to it")
        placements[name] = at
    rows = []
    for name, at in track(placements.items(), description="effects", total=len(placements)):
        others = [one for one in placements.values() if one.experiment is at.experiment]
        properties = proof.prove(at, others)
        one = next(iter(at.effect.comparisons()), COMPARISONS.get(name))
        rows.append(
            Row(
                name,
                next(key for key, experiment in experiments.items() if experiment is at.experiment),
                properties,
                one,
                [] if one is None else proof.compare(at.effect, one),
                [f.check.rpartition(" ")[2] for f in properties if f.check.startswith("refused")],
            )
        )
    found = {
        name: proof.indistinguishable_pairs(experiment) for name, experiment in experiments.items()
    }
    of_scenes = {
        name: scenes.compare(name) if name in scenes.COMPARISONS else []
        for name in track(scene_effects(), description="effects of scenes")
    }
    page(rows, found, of_scenes, options.page)


def _number(finding: Finding) -> str:
    text = f"{finding.deviation:.2g}"
    return text if finding.holds else f"**{text}**"


def page(
    rows: list[Row],
    aliases: dict[str, set[tuple[str, str]]],
    of_scenes: dict[str, list[Finding]],
    path: Path,
) -> None:
    """Write the page.

    Args:
        rows: Results of all effects of rigs.
        aliases: Indistinguishable pairs of effects per rig.
        of_scenes: Reference results per effect of scenes.
        path: The page.
    """
    findings = [(row.name, f) for row in rows for f in row.properties + row.reference]
    findings += [(name, f) for name, found in of_scenes.items() for f in found]
    failed = [(name, f) for name, f in findings if not f.holds]
    # effects of rigs and of scenes may have the same name
    references = [(row.name, row.reference) for row in rows] + list(of_scenes.items())
    without = [name for name, found in references if not found]
    compared = [f for _, found in references for f in found]
    within = sum(f.deviation <= 0.01 for f in compared)
    lines = [
        "# Verification of the effects",
        "",
        f"Made by `make effects` from the sources {digest_of(ROOT / p for p in SOURCES)}. A"
        " deviation that is not allowed is bold and counts as a failure.",
        "",
        f"{len(references)} effects, {len(rows)} of rigs and {len(of_scenes)} of scenes,"
        f" {len(references) - len(without)} of them with a reference, at"
        f" {len(compared)} strengths: {within} deviate by at most 1 %, the others by at most"
        f" {100 * max(f.deviation for f in compared):.1f} %. Failures, of all checks:"
        f" {len(failed)}. No closed form: {', '.join(without) or 'none'}.",
        "",
        "## References",
        "",
        "Deviations are the largest error of the change that an effect makes, relative to the"
        " largest reference change (`tests/references/effects.py`).",
        "",
        "| effect | reference | strengths: deviation |",
        "|---|---|---|",
    ]
    for row in rows:
        if row.experiment is not None:
            deviations = "; ".join(
                f"{s:g}: {_number(f)}"
                for s, f in zip(row.experiment.strengths, row.reference, strict=True)
            )
            lines.append(f"| {row.name} | {row.experiment.what} | {deviations} |")
    lines += [
        "",
        "## Properties of every effect",
        "",
        "Checks of `pneu_sim.effects.proof`, at the placement with the largest response on the"
        " first rig of `tests/effect_experiments.py` that responds. Deviations are relative to the"
        f" response at the typical strength. Limits: vanishing {proof.ROUND_OFF:g}, linearity"
        f" {proof.SLOPE:g} ({proof.FINITE:g} for effects declared curved, marked c), grid and time"
        f" step {proof.GRID:g}, reversed pipe {proof.TURNED:g}, order of attachment"
        f" {proof.ROUND_OFF:g}, mass and energy of a closed rig {proof.KEPT:g}. All models that do"
        " not refuse an effect respond to it.",
        "",
        "| effect | rig | " + " | ".join(COLUMNS.values()) + " | refused by |",
        "|---|---|" + "---|" * len(COLUMNS) + "---|",
    ]
    for row in rows:
        cells = []
        for check in COLUMNS:
            matching = [f for f in row.properties if f.check.startswith(check)]
            worst = max(matching, key=lambda f: f.deviation, default=None)
            curved = worst is not None and "curved" in worst.check
            cells.append("" if worst is None else _number(worst) + (" c" if curved else ""))
        refused = ", ".join(row.refused)
        lines.append(f"| {row.name} | {row.rig} | " + " | ".join(cells) + f" | {refused} |")
    pairs = sorted({pair for found in aliases.values() for pair in found})
    lines += [
        "",
        "Indistinguishable pairs, with equal responses at equal strengths: "
        + (
            "; ".join(
                f"{a} and {b} on {', '.join(n for n in aliases if (a, b) in aliases[n])}"
                for a, b in pairs
            )
            or "none"
        )
        + ".",
        "",
        "## Effects of scenes",
        "",
        "Deviations as above, of predicted readings (`tests/references/scenes.py`).",
        "",
        "| effect | reference | values: deviation |",
        "|---|---|---|",
    ]
    for name, found in of_scenes.items():
        if found:
            one = scenes.COMPARISONS[name]
            cells = [f"{v:g}: {_number(f)}" for v, f in zip(one.values, found, strict=True)]
            lines.append(f"| {name} | {one.what} | {'; '.join(cells)} |")
    with whole(path) as aside:
        aside.write_text("\n".join(lines) + "\n", encoding="utf-8")
    print(f"{path}: {len(failed)} failures")
    for name, finding in failed:
        print(f"  {name}: {finding.check} {finding.deviation:.2g} ({finding.about})")


if __name__ == "__main__":
    main()
