# SPDX-License-Identifier: Apache-2.0
"""``pneu observe``: an observer led along a recording."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer
from rich.console import Console

from pneu_common.errors import InputError
from pneu_common.files import write_whole
from pneu_common.options import Force
from pneu_common.outputs import check_output
from pneu_common.progress import progress
from pneu_common.tables import Column, NamedTable

if TYPE_CHECKING:
    from pneu_sysid.observed.follow import Followed
    from pneu_sysid.results.observe import ObserveResult, Said


def observe(
    bag: Annotated[
        Path, typer.Argument(metavar="BAG", help="rosbag2 folder, .mcap file, or text recording.")
    ],
    rig: Annotated[Path, typer.Option("--rig", help="Rig file, calibrated.", show_default=False)],
    used: Annotated[
        list[str] | None,
        typer.Option(
            "--used",
            help="Tap or encoder whose readings are taken; the others are only compared. May be"
            " given several times; all by default.",
            show_default=False,
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", help="Table of what was said (.csv), SI.", show_default=False
        ),
    ] = None,
    figure: Annotated[
        Path | None, typer.Option("--figure", help="Draw it (.png, .svg).", show_default=False)
    ] = None,
    json_path: Annotated[
        Path | None, typer.Option("--json", help="Write the result as JSON.", show_default=False)
    ] = None,
    members: Annotated[int, typer.Option(help="Rigs side by side.", min=4, max=64)] = 16,
    dx: Annotated[
        float | None,
        typer.Option(help="Cell length, m; the rig's own by default.", show_default=False),
    ] = None,
    rate: Annotated[float, typer.Option(help="Steps per second.", min=20.0, max=5000.0)] = 500.0,
    smooth: Annotated[
        float,
        typer.Option(
            help="What is read up to so much later counts too, s: 0.02 tells more of a tap that"
            " nobody reads than 0, which is all that is known while it runs.",
            min=0.0,
            max=1.0,
        ),
    ] = 0.0,
    leak: Annotated[
        float,
        typer.Option(
            "--leak",
            help="Lines may come to leak to the room by about so much, effective area, m^2; of a"
            " smaller number nulls of valves are made.",
            min=0.0,
            max=1e-4,
        ),
    ] = 0.0,
    load: Annotated[
        float,
        typer.Option(
            "--load", help="Joints may come to carry about so much, kg.", min=0.0, max=1e3
        ),
    ] = 0.0,
    seed: Annotated[int, typer.Option(help="Of what is drawn.", min=0)] = 0,
    effects: Annotated[
        Path | None,
        typer.Option(help="Python file with effects of your own.", show_default=False),
    ] = None,
    force: Force = False,
) -> None:
    """Follow the state of a rig along a recording: taps that are missing, lost or wrong."""
    from pneu_sim.effects import load_effect_file
    from pneu_sim.observe.settings import LEAK_S, LOAD_S, Drift, ObserverSettings
    from pneu_sim.rig import load_rig
    from pneu_sysid.observed.figures import draw_observed
    from pneu_sysid.observed.follow import follow
    from pneu_sysid.observed.noise import noise_of, with_noise
    from pneu_sysid.observed.summary import summary_of
    from pneu_sysid.pictures import check_figure
    from pneu_sysid.problem import record_for
    from pneu_sysid.results.files import write_json

    for path in (output, figure, json_path):
        check_output(path, force)
    check_figure(figure)
    if dx is not None and not 0.0 < dx < 100.0:
        raise InputError(f"--dx: found {dx:g} m, it must be positive and below 100")
    if effects is not None:
        load_effect_file(effects)
    loaded = load_rig(rig)
    names = [*loaded.taps, *loaded.encoders]
    for name in used or []:
        if name not in names:
            raise InputError(f"--used: found {name!r}, rig {loaded.name!r} has {', '.join(names)}")
    taken = list(dict.fromkeys(used)) if used else names
    recording = record_for(loaded, str(bag))
    console = Console(markup=False, emoji=False)
    console = console if console.is_terminal else Console(width=140, markup=False, emoji=False)
    findings = [str(finding) for finding in recording.report]
    for finding in findings:
        console.print(finding, style="yellow")
    steps_back = round(smooth * rate)
    settings = ObserverSettings(
        members=members,
        dx_m=dx,
        seed=seed,
        leak=Drift(std=leak, time_s=LEAK_S),
        load=Drift(std=load, time_s=LOAD_S),
    )
    noise = noise_of(loaded, settings)
    with progress("observing") as tell:
        found = follow(
            with_noise(loaded, noise), recording, taken, settings, 1.0 / rate,
            steps_back=steps_back, progress=lambda f: tell(recording.name, f),
        )  # fmt: skip
    smooth_s = steps_back / rate
    result = summary_of(loaded, str(rig), recording.name, found, taken, noise, findings, smooth_s)
    for table in tables(result):
        console.print(table)
    if not result.said:
        console.print("Nothing was said to be wrong, with the model or with a sensor.")
    if output is not None:
        write_whole(output, rows_of(found))
        console.print(f"wrote {output}")
    if figure is not None:
        draw_observed(found, result, figure)
        console.print(f"wrote {figure}")
    if json_path is not None:
        write_json(json_path, result)
        console.print(f"wrote {json_path}")


def tables(result: "ObserveResult") -> list[NamedTable]:
    """What is printed of a result.

    Args:
        result: The result.
    """
    from pneu_sysid.sensor_units import unit_of

    errors = NamedTable(
        f"{result.recording}: what the observer says, from {result.begin_s:g} s on"
        + (f", {result.smooth_s:g} s later" if result.smooth_s else ""),
        [
            Column("sensor"),
            Column("readings"),
            Column("error", "number"),
            Column("unit"),
            Column("times noise", "number"),
            Column("within 90 %", "number"),
            Column("its own std.", "number"),
        ],
    )
    for s in result.observed:
        unit = unit_of(s.name, result.encoders)
        errors.add_row(
            s.name,
            "taken" if s.used else "only compared",
            unit.figure(s.rmse),
            unit.told,
            "-" if s.times_noise is None else f"{s.times_noise:.2f}",
            "-" if s.within_90 is None else f"{100 * s.within_90:.0f} %",
            unit.figure(s.std),
        )
    out = [errors]
    if result.said:
        said = NamedTable(
            "Said to be wrong",
            [
                Column("first [s]", "number"),
                Column("last [s]", "number"),
                Column("for [s]", "number"),
                Column("at last", "words"),
            ],
        )
        together: dict[tuple[str, str], list[Said]] = {}
        for one in result.said:
            together.setdefault((one.kind, one.subject), []).append(one)
        for (kind, subject), every in together.items():
            words = every[-1].words if kind == "model" else f"{subject}: {every[-1].words}"
            whole = sum(one.end_s - one.start_s for one in every)
            times = f"{every[0].start_s:.2f}", f"{every[-1].end_s:.2f}", f"{whole:.2f}"
            said.add_row(*times, words)
        out.append(said)
    if result.drifting:
        drifting = NamedTable(
            "Drifts slowly, at the end",
            [
                Column("what"),
                Column("off by", "number"),
                Column("its std.", "number"),
                Column("unit"),
                Column("of what is allowed", "number"),
            ],
        )
        for d in result.drifting:
            figures = f"{d.value:.3g}", f"{d.std:.2g}"
            drifting.add_row(d.name, *figures, d.unit, f"{d.times:.1f}")
        out.append(drifting)
    return out


def rows_of(found: "Followed") -> str:
    """A table of what was said at every time, as CSV.

    Args:
        found: What an observer said.
    """
    names = list(found.mean)
    head = ["time_s", *(f"{name}{part}" for name in names for part in ("", ".std", ".read"))]
    nothing = np.full(found.time_s.size, np.nan)
    columns = [found.time_s]
    for name in names:
        columns += [found.mean[name], found.std[name], found.read.get(name, nothing)]
    rows = [
        ",".join("" if np.isnan(x) else f"{x:.9g}" for x in row)
        for row in np.stack(columns, axis=1)
    ]
    return "\n".join([",".join(head), *rows]) + "\n"
