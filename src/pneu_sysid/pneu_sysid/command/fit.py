# SPDX-License-Identifier: Apache-2.0
"""``pneu fit``: a rig's base parameters fitted to recordings."""

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pneu_common.errors import InputError
from pneu_common.options import Force
from pneu_common.outputs import check_output
from pneu_common.progress import progress
from pneu_common.tables import Column, NamedTable
from pneu_sysid.command.fit_result import fit_result
from pneu_sysid.command.given import finish, is_scene_file, load, make_console, read, titled
from pneu_sysid.command.options import BagPaths, EffectsPath, HtmlPath, JsonPath, RigPath, Workers
from pneu_sysid.command.tables import error_table

if TYPE_CHECKING:
    from pneu_sim.rig.schema import FitParameter, Rig
    from pneu_sysid.results.fit import FitResult


def fit(
    bag: BagPaths,
    rig: RigPath,
    output: Annotated[Path, typer.Option("-o", "--output", help="Fitted rig file.")],
    robust: Annotated[bool, typer.Option(help="Huber loss, for recordings with outliers.")] = False,
    hold_out: Annotated[bool, typer.Option(help="Keep a third of the recording aside.")] = False,
    iterations: Annotated[
        int, typer.Option(help="Gauss-Newton iterations of a step, at most.", min=1)
    ] = 8,
    anyway: Annotated[
        bool, typer.Option("--anyway", help="Fit even a rig file that seems grossly wrong.")
    ] = False,
    show_list: Annotated[
        bool, typer.Option("--list", help="Show what would be fitted, and end.")
    ] = False,
    plan: Annotated[
        Path | None,
        typer.Option(
            help="Plan of `pneu excite` that the recording was made by: standard errors that it"
            " promised are set beside those that were found.",
            show_default=False,
        ),
    ] = None,
    effects: EffectsPath = None,
    json_path: JsonPath = None,
    report: HtmlPath = None,
    workers: Workers = None,
    force: Force = False,
) -> None:
    """Fit a rig's base parameters to recordings."""
    from pneu_sim.rig import save_rig
    from pneu_sysid.design.plan_file import check_plan, load_plan
    from pneu_sysid.fit import fit_rig, parameters_of
    from pneu_sysid.gross import refuse_gross_errors
    from pneu_sysid.shortfall import ENOUGH

    console = make_console()
    for path in (output, json_path, report):
        check_output(path, force)
    if is_scene_file(rig, effects):
        from pneu_sysid.contacts.commands import fit as fit_scene

        if plan is not None:
            raise InputError(f"{rig}: is a scene; --plan is of rigs")
        return fit_scene(bag, rig, output, json_path, report, workers, console)
    start = load(rig, effects)
    if show_list:
        console.print(parameter_list(start, parameters_of(start)))
        return
    played = None if plan is None else load_plan(plan)
    if played is not None:
        check_plan(played, start, plan or "plan")
    recordings = read(bag, start, console)
    begun = time.monotonic()
    with progress("fitting") as tell:
        if not anyway:
            tell("looking for gross errors")
            try:
                refuse_gross_errors(start, recordings, workers)
            except InputError as error:
                raise InputError(f"{rig}: {error}; --anyway fits it all the same") from None
        outcome = fit_rig(
            start,
            recordings,
            robust=robust,
            hold_out=hold_out,
            iterations=iterations,
            workers=workers,
            progress=tell,
        )
    save_rig(outcome.rig, output)
    took_s = time.monotonic() - begun
    result = fit_result(str(rig), str(output), recordings, outcome, took_s, played)
    console.print(fitted_table(f"{start.name} fitted to {titled(recordings)}", result))
    columns = {"noise": result.noise_of, "fitted": result.rmse_of}
    if result.held_out_rmse_of:
        columns["held out"] = result.held_out_rmse_of
    title = "error per sensor" if result.encoders else "error per tap"
    console.print(error_table(title, columns, result.encoders))
    for warning in outcome.warnings:
        console.print(warning, style="yellow")
    if outcome.shortfall is None:
        every = "sensor" if result.encoders else "tap"
        console.print(f"Every {every} is expected to be within {ENOUGH:g} times its noise.")
    else:
        for k, line in enumerate(outcome.shortfall.lines):
            console.print(line, style="bold red" if k == 0 else "yellow")
    console.print(f"condition number {outcome.known.condition:.2g}; wrote {output}")
    finish(result, json_path, report, console, fit=result.as_dict())


def parameter_list(rig: "Rig", parameters: "list[FitParameter]") -> NamedTable:
    """What would be fitted, as a table.

    Args:
        rig: The rig.
        parameters: They.
    """
    from pneu_sysid.parameter_units import unit_of_parameter

    numbers = [Column(name, "number") for name in ("lower", "upper", "uncertain by")]
    table = NamedTable(f"{len(parameters)} parameters", [Column("path"), *numbers, Column("unit")])
    for p in parameters:
        std = "all of it" if p.std is None else f"{p.std:.3g}"
        unit = unit_of_parameter(rig, p.path) or "-"
        table.add_row(p.path, f"{p.lower:.4g}", f"{p.upper:.4g}", std, unit)
    return table


def fitted_table(title: str, result: "FitResult") -> NamedTable:
    """Fitted parameters that the recordings show; the points of curves are in JSON and report.

    Args:
        title: Of the table.
        result: What the fit found.
    """
    promised = any(p.expected_error is not None for p in result.parameters)
    table = NamedTable(
        title,
        [
            Column("parameter"),
            Column("start", "number", drop=1),
            Column("value", "number"),
            Column("std. error", "number"),
            *([Column("expected", "number")] if promised else []),
            Column("unit"),
            Column("", "words"),
        ],
    )
    points: dict[str, int] = {}
    for p in result.parameters:
        curve, _, point = p.path.rpartition(".fraction.")
        if point.isdigit():
            points[curve] = points.get(curve, 0) + 1
            continue
        if not p.identified and not p.held:
            continue
        note = "held" if p.held else "at bound" if p.at_bound else ""
        error = "-" if p.std_error is None else f"{p.std_error:.2g}"
        name = p.path if p.recording is None else f"{p.path} in {p.recording}"
        cells = [f"{p.start:.5g}", f"{p.value:.5g}", error]
        if promised:
            among = " to ".join(f"{x:.2g}" for x in p.expected_range)
            error = "-" if p.expected_error is None else f"{p.expected_error:.2g}"
            cells.append(f"{error} ({among})" if among else error)
        table.add_row(name, *cells, p.unit or "-", note)
    for curve, count in points.items():
        blank = [""] * (4 if promised else 3)
        table.add_row(f"{curve}: {count} points", "", "in the file", *blank)
    return table
