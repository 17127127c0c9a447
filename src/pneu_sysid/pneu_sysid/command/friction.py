# SPDX-License-Identifier: Apache-2.0
"""``pneu friction``: the friction of a cylinder's seals, from drag tests."""

from pathlib import Path
from typing import Annotated

import typer

from pneu_common.errors import InputError
from pneu_common.options import Force
from pneu_common.outputs import check_output
from pneu_common.progress import progress
from pneu_sysid.command.given import load, make_console
from pneu_sysid.command.options import JsonPath, RigPath


def friction(
    files: Annotated[
        list[Path],
        typer.Argument(metavar="FILE...", help="Drag tests of one cylinder: text files or bags."),
    ],
    rig: RigPath,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Write a rig file with it.", show_default=False),
    ] = None,
    json_path: JsonPath = None,
    figure: Annotated[
        Path | None, typer.Option("--figure", help="Draw it (.png, .svg).", show_default=False)
    ] = None,
    force: Force = False,
) -> None:
    """Name the friction of a cylinder's seals, from force, position and pressure of drag tests."""
    from pneu_sim.rig import save_rig
    from pneu_sysid.pictures import check_figure
    from pneu_sysid.results.files import write_json
    from pneu_sysid.seals.figures import draw_friction
    from pneu_sysid.seals.identify import identify, with_friction
    from pneu_sysid.seals.reading import DragTest, read_drag
    from pneu_sysid.seals.words import result_of_friction, tables_of

    console = make_console()
    for path in (output, json_path, figure):
        check_output(path, force)
    check_figure(figure)
    loaded = load(rig, None)
    tests: list[DragTest] = []
    for path in files:
        if any(path.resolve() == other.resolve() for other in files[: len(tests)]):
            raise InputError(f"{path}: was given twice; each recording is needed once")
        tests.append(read_drag(loaded, path))
    with progress("finding friction"):
        found = identify(loaded, tests)
    result = result_of_friction(
        loaded, str(rig), None if output is None else str(output), tests, found
    )
    for finding in result.findings:
        console.print(finding, style="yellow")
    for table in tables_of(found):
        console.print(table)
    console.print(result.sentence, style="bold")
    for statement in result.statements:
        console.print(statement)
    if output is not None:
        save_rig(with_friction(loaded, found), output)
        console.print(f"wrote {output}")
    if figure is not None:
        draw_friction([(loaded.name, found)], figure)
        console.print(f"wrote {figure}")
    if json_path is not None:
        write_json(json_path, result)
        console.print(f"wrote {json_path}")
