# SPDX-License-Identifier: Apache-2.0
"""``pneu compare``: how far models are from recordings, and where."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pneu_common.options import Force
from pneu_common.outputs import check_output
from pneu_common.progress import progress
from pneu_sysid.command.given import finish, is_scene_file, load, make_console, read
from pneu_sysid.command.options import BagPaths, EffectsPath, HtmlPath, JsonPath

if TYPE_CHECKING:
    from pneu_sim.rig.schema import Rig


def compare(
    bag: BagPaths,
    rig: Annotated[list[Path], typer.Option("--rig", help="Rig file; repeat to compare several.")],
    refine: Annotated[bool, typer.Option(help="Run the first model on a finer grid too.")] = True,
    effects: EffectsPath = None,
    json_path: JsonPath = None,
    report: HtmlPath = None,
    force: Force = False,
) -> None:
    """Show how far models are from recordings, and where."""
    from pneu_sysid.compare import compare as run_compare
    from pneu_sysid.compare import compare_table

    console = make_console()
    for path in (json_path, report):
        check_output(path, force)
    if is_scene_file(rig[0], effects):
        from pneu_sysid.contacts.commands import compare as compare_scenes

        return compare_scenes(bag, rig, json_path, report, console)
    rigs = [load(path, effects if k == 0 else None) for k, path in enumerate(rig)]
    recordings = read(bag, rigs[0], console)
    with progress("comparing") as tell:
        result = run_compare(
            recordings,
            [(_model_name(r, path), r, str(path)) for r, path in zip(rigs, rig, strict=True)],
            refine=refine,
            progress=lambda done: tell("comparing", done),
        )
    console.print(compare_table(result))
    finish(result, json_path, report, console, compare=result.as_dict())


def _model_name(rig: "Rig", path: Path) -> str:
    from pneu_sim.models import kind_of

    return path.stem if kind_of(rig).along_lines else f"{path.stem} ({rig.model.replace('_', '-')})"
