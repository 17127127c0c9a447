# SPDX-License-Identifier: Apache-2.0
"""`pneu workbench`: opens the page on recordings and a rig file."""

import importlib.util
import time
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from pneu_common.errors import InputError


def register(app: typer.Typer) -> None:
    """Adds `pneu workbench` to the application.

    Args:
        app: The application.
    """
    app.command("workbench")(workbench)


def workbench(
    bag: Annotated[
        list[Path] | None, typer.Argument(metavar="[BAG...]", help="Recordings to begin with.")
    ] = None,
    rig: Annotated[Path | None, typer.Option("--rig", help="Rig file to begin with.")] = None,
    folder: Annotated[
        Path, typer.Option("--folder", help="Folder that recordings and rig files are chosen from.")
    ] = Path(),
    session: Annotated[
        Path | None,
        typer.Option(
            "--session",
            help="Folder of the session, or a file that was kept of one; what is there is gone on"
            " with.",
        ),
    ] = None,
    port: Annotated[
        int | None, typer.Option("--port", help="Any that is free unless given.", min=1, max=65535)
    ] = None,
    workers: Annotated[
        int, typer.Option("--workers", help="Threads of a task; 0 is all cores.", min=0)
    ] = 0,
) -> None:
    """Compare, find what is missing and add it, on a local page."""
    if importlib.util.find_spec("nicegui") is None:
        raise InputError(
            "the workbench needs NiceGUI, which is not installed: `pip install '.[workbench]'` in a"
            " checkout of pneu, or 'FILE.whl[workbench]' for a wheel of it"
        )
    from pneu_workbench.packed import SUFFIX, unpack
    from pneu_workbench.server import serve
    from pneu_workbench.work import Work

    if bool(bag) != (rig is not None):
        raise InputError("--rig: a recording and a rig file are opened together, found one of them")
    for path in (*(bag or ()), *((rig,) if rig else ())):
        if not path.exists():
            raise InputError(f"{path}: there is no such file")
    if session is not None and session.suffix == SUFFIX:
        unpack(session, session.with_suffix(""))
        session = session.with_suffix("")
    where = session or Path("out") / "workbench" / time.strftime("%Y-%m-%d_%H-%M-%S")
    work = Work(where, workers)
    if bag and rig:
        work.open([str(path.resolve()) for path in bag], str(rig.resolve()))
    serve(work, folder, port, Console())
