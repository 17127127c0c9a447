# SPDX-License-Identifier: Apache-2.0
"""``pneu diagnose``: what is missing in a model, ranked."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import typer

from pneu_common.errors import InputError
from pneu_common.options import Force
from pneu_common.outputs import check_output
from pneu_common.progress import progress
from pneu_common.tables import Column, NamedTable
from pneu_sysid.command.given import finish, is_scene_file, load, make_console, read, read_findings
from pneu_sysid.command.options import (
    BagPaths,
    EffectsPath,
    HtmlPath,
    JsonPath,
    KeptAside,
    RigPath,
    Workers,
)

if TYPE_CHECKING:
    from pneu_sysid.diagnose import Diagnosis


def diagnose(
    bag: BagPaths,
    rig: RigPath,
    refine: Annotated[bool, typer.Option(help="Check the grid first.")] = True,
    effects: EffectsPath = None,
    aside: KeptAside = None,
    json_path: JsonPath = None,
    report: HtmlPath = None,
    workers: Workers = None,
    force: Force = False,
) -> None:
    """Rank what is missing in a model, and say which effect it is."""
    from pneu_sysid.diagnose import diagnose_apart, result_of_diagnosis

    console = make_console()
    for path in (json_path, report):
        check_output(path, force)
    if is_scene_file(rig, effects):
        from pneu_sysid.contacts.commands import diagnose as diagnose_scene

        if aside:
            raise InputError("--aside: a scene keeps whole recordings aside, leave it out")
        return diagnose_scene(bag, rig, json_path, report, workers, console)
    loaded = load(rig, effects)
    kept = parts_of("--aside", aside or [])
    recordings = read(bag, loaded, console)
    with progress("diagnosing") as tell:
        found = diagnose_apart(
            loaded, recordings, refine=refine, workers=workers, progress=tell, aside=kept
        )
    console.print(diagnosis_table(found))
    console.print(found.sentence, style="bold")
    for statement in found.statements:
        console.print(statement)
    result = result_of_diagnosis(loaded.name, found, read_findings(recordings))
    if result.numerics.discretisation:
        console.print(result.numerics.sentence, style="yellow")
    finish(result, json_path, report, console, diagnose=result.as_dict())


def parts_of(option: str, told: Sequence[str]) -> list[tuple[float, float]]:
    """Parts of recordings as the command line tells them.

    Args:
        option: Its name.
        told: FROM:TO each, s.

    Raises:
        InputError: One is no such.
    """
    parts = []
    for text in told:
        begin, colon, end = text.partition(":")
        try:
            part = float(begin), float(end)
        except ValueError:
            part = math.nan, math.nan
        if not (colon and part[0] < part[1] < math.inf and part[0] > -math.inf):
            raise InputError(
                f"{option}: found {text!r}, allowed is FROM:TO in seconds, as in 10:20"
            )
        parts.append(part)
    return parts


def diagnosis_table(found: "Diagnosis") -> NamedTable:
    """The ranking as a table.

    Args:
        found: The diagnosis.
    """
    from pneu_sysid.parameter_units import strength_unit

    table = NamedTable(
        "candidates, best first",
        [
            Column("effect"),
            Column("place"),
            Column("strength", "words"),
            Column("score", "number", drop=2),
            Column("refit", "number", drop=1),
            Column("held out", "number"),
            Column("t", "number"),
            Column("not to be told from"),
        ],
    )
    for k, r in enumerate(found.finalists):
        unit = strength_unit(r.rig, r.site.effect, r.site.place)
        strength = f"{r.strength:.3g} ± {r.std_error:.1g} {unit}"
        table.add_row(
            r.site.effect.name,
            r.site.label.split("@", 1)[1],
            strength,
            f"{100 * r.score_explained:.0f} %",
            f"{100 * r.explained:.0f} %",
            f"{100 * r.held_out:.0f} %",
            f"{r.t:.1f}",
            ", ".join(found.alike(k)),
        )
    return table
