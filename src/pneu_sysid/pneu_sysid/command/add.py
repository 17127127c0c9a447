# SPDX-License-Identifier: Apache-2.0
"""``pneu add``: an effect added to a rig, and refitted."""

import math
from pathlib import Path
from typing import Annotated

import typer

from pneu_common.errors import InputError
from pneu_common.options import Force
from pneu_common.outputs import check_output
from pneu_sysid.command.given import is_scene_file, load, make_console, read, read_findings
from pneu_sysid.command.options import EffectsPath, JsonPath, RigPath, Workers
from pneu_sysid.command.tables import step_table


def add(
    effect: Annotated[
        str,
        typer.Argument(
            metavar="EFFECT[@PLACE[:POSITION]]",
            help="Effect of `pneu effects`, where, and how far along a pipe in m.",
        ),
    ],
    rig: RigPath,
    bag: Annotated[
        list[Path], typer.Option("--bag", help="Recording to refit on; repeat for several.")
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="Better rig file.")],
    effects: EffectsPath = None,
    json_path: JsonPath = None,
    workers: Workers = None,
    force: Force = False,
) -> None:
    """Add an effect to a rig and refit it."""
    from pneu_sim.rig import save_rig
    from pneu_sysid.heading import heading
    from pneu_sysid.learn import add_effect
    from pneu_sysid.problem import make_problem
    from pneu_sysid.results.files import write_json
    from pneu_sysid.results.learn import LearnResult
    from pneu_sysid.sensor_units import encoder_units

    console = make_console()
    for path in (output, json_path):
        check_output(path, force)
    name, _, where = effect.partition("@")
    if is_scene_file(rig, effects):
        from pneu_sysid.contacts.commands import add as add_to_scene

        return add_to_scene(name, where, bag, rig, output, workers, console)
    place, _, position = where.partition(":")
    try:
        at = float(position) if position else None
    except ValueError:
        at = math.nan
    if at is not None and not math.isfinite(at):
        raise InputError(f"effect {effect!r}: position {position!r} is no number of metres")
    loaded = load(rig, effects)
    recordings = read(bag, loaded, console)
    better, before, after = add_effect(loaded, recordings, name, place or None, at, workers)
    save_rig(better, output)
    console.print(step_table([before, after], encoder_units(better)))
    console.print(f"wrote {output}")
    if json_path is not None:
        problem = make_problem(better, recordings)
        write_json(
            json_path,
            LearnResult(
                **heading(problem, better, loaded.name, read_findings(recordings)),
                steps=[before, after],
                verdict="effect",
                sentence=f"{name} added at {after.place}.",
                output=str(output),
            ),
        )
