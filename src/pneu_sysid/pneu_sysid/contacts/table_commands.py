# SPDX-License-Identifier: Apache-2.0
"""The subcommand `pneu contacts`: how far an estimate of a scene is to be trusted."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer
from rich.console import Console

from pneu_common.errors import InputError
from pneu_common.progress import progress
from pneu_common.tables import Column, NamedTable

if TYPE_CHECKING:
    from pneu_sysid.contacts.tables import Cross, LeftOut, Spread


def contacts(
    table: Annotated[
        str,
        typer.Argument(
            metavar="TABLE",
            help="cross: parameters of each recording on every one; leave-out: a sensor foretold by"
            " the others; starts: where many starts end; remote: the same with contacts that begin"
            " at a distance, and without.",
        ),
    ],
    bag: Annotated[
        list[Path],
        typer.Argument(metavar="BAG...", help="Recordings: bags, CSV files, folders of them."),
    ],
    rig: Annotated[Path, typer.Option("--rig", help="Scene file (YAML).")],
    count: Annotated[int, typer.Option(help="Starts.", min=2)] = 33,
    seed: Annotated[int, typer.Option(help="Of the starts.", min=0)] = 0,
    workers: Annotated[int | None, typer.Option("--workers", help="Threads.", min=1)] = None,
) -> None:
    """Show how far an estimate of a scene is to be trusted."""
    from pneu_sysid.contacts.physics import Physics
    from pneu_sysid.contacts.read import read_tracks
    from pneu_sysid.contacts.scene import load_scene
    from pneu_sysid.contacts.tables import cross, leave_out, spread

    kinds = ("cross", "leave-out", "starts", "remote")
    if table not in kinds:
        raise InputError(f"table: found {table!r}, allowed are {', '.join(kinds)}")
    console = Console(markup=False, emoji=False)
    if not console.is_terminal:
        console = Console(width=140, markup=False, emoji=False)
    loaded = load_scene(rig)
    tracks = read_tracks(bag, loaded)
    physics = Physics(workers)
    with progress(table) as tell:

        def told(note: str, done: float) -> None:
            tell(table, done, note)

        if table == "cross":
            crossed = cross(loaded, tracks, physics, told)
        elif table == "leave-out":
            left = leave_out(loaded, tracks, physics, tell=told)
        elif table == "starts":
            spreads = {"as the scene says": spread(loaded, tracks, physics, count, seed, (), told)}
        else:
            spreads = {
                "without a distance": spread(loaded, tracks, physics, count, seed, (), told),
                "from 2 mm to 0.1 mm": spread(
                    loaded, tracks, physics, count, seed, (2e-3, 1e-3, 5e-4, 2e-4, 1e-4), told
                ),
            }
    if table == "cross":
        for part in cross_tables(crossed):
            console.print(part)
        console.print(
            f"At worst {crossed.worst:.2f} times a recording's own cost; with the scene's own"
            f" parameters at least {crossed.gain:.2f} times."
        )
        return
    if table == "leave-out":
        console.print(left_out_table(left))
        return
    for title, one_spread in spreads.items():
        console.print(spread_table(title, one_spread))
        console.print(f"{100 * one_spread.same:.0f} % end within 2 % of the least cost.")


def cross_tables(crossed: "Cross") -> list[NamedTable]:
    """Return the parameters of each recording, and the cost of every one with those of each.

    Args:
        crossed: Parameters of each recording on every one.
    """
    names = [Column(name, "number") for name in crossed.labels]
    found = NamedTable("parameters", [Column("recording"), *names])
    for name, values in zip(crossed.names, crossed.values, strict=True):
        found.add_row(name, *(f"{v:.4g}" for v in values))
    ids = [Column(f"of {name}", "number") for name in crossed.names]
    costs = NamedTable(
        "cost with parameters", [Column("recording"), Column("the scene's", "number"), *ids]
    )
    for k, name in enumerate(crossed.names):
        row = [crossed.manual[k], *crossed.costs[k]]
        costs.add_row(name, *(f"{v:.4g}" for v in row))
    return [found, costs]


def left_out_table(left: "Sequence[LeftOut]") -> NamedTable:
    """Return the errors of sensors that are predicted by the others.

    Args:
        left: The sensors.
    """
    heads = ("error without it", "error with it", "its range", "error of its range")
    out = NamedTable("foretold", [Column("sensor"), *(Column(h, "number") for h in heads)])
    for one in left:
        share = f"{100 * one.rmse / one.span:.1f} %" if one.span else "-"
        figures = [f"{x:.4g}" for x in (one.rmse, one.with_it, one.span)]
        out.add_row(one.sensor, *figures, share)
    return out


def spread_table(title: str, found: "Spread") -> NamedTable:
    """Return mean and standard deviation of costs and parameters over many starts.

    Args:
        title: How contacts began.
        found: Where the starts end.
    """
    ends = NamedTable(
        f"{len(found.costs)} starts, {title}",
        [Column(""), Column("mean", "number"), Column("std. deviation", "number")],
    )
    ends.add_row("cost", f"{found.costs.mean():.5g}", f"{found.costs.std():.2g}")
    for k, label in enumerate(found.labels):
        values = found.values[:, k]
        ends.add_row(label, f"{values.mean():.5g}", f"{np.std(values):.2g}")
    return ends
