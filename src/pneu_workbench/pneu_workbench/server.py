# SPDX-License-Identifier: Apache-2.0
"""The server of the page: on the loopback alone, behind a token."""

import secrets
import socket
from pathlib import Path

from nicegui import app, run, ui
from rich.console import Console

from pneu_common.errors import InputError
from pneu_workbench.chart import STATIC, serve_signals
from pneu_workbench.files import Folder
from pneu_workbench.gate import Gate
from pneu_workbench.live.card import serve_live
from pneu_workbench.page import Page
from pneu_workbench.work import Work

HOST = "127.0.0.1"


def free_port(asked: int | None) -> int:
    """A port that nothing listens at.

    Args:
        asked: Which; None takes any.

    Raises:
        InputError: Something listens at the one that was asked for.
    """
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, asked or 0))
        except OSError as error:
            raise InputError(f"--port: {asked} cannot be taken ({error.strerror})") from None
        return int(probe.getsockname()[1])


def serve(work: Work, root: Path, port: int | None, console: Console) -> None:
    """Serves the page until it is interrupted.

    Args:
        work: The session.
        root: Folder of recordings and rig files.
        port: Where; None takes any that is free.
        console: Where the address is told.

    Raises:
        InputError: The folder is none, or the port is taken.
    """
    folder, at = Folder(root), free_port(port)
    token = secrets.token_urlsafe(24)
    app.add_middleware(Gate, token=token, port=at)
    app.add_static_file(url_path="/uplot.css", local_file=STATIC / "uplot" / "uPlot.min.css")
    serve_signals(app, work)
    serve_live(app, work.live)
    app.on_startup(
        lambda: console.print(f"http://{HOST}:{at}/?token={token}", soft_wrap=True, highlight=False)
    )
    app.on_shutdown(work.close)

    @ui.page("/", title="Pneu workbench", response_timeout=30.0)
    def page() -> None:
        Page(work, folder)

    # a fork of a process with threads may hang
    run.process_pool_start_method = "spawn"
    try:
        ui.run(
            host=HOST, port=at, show=False, reload=False, show_welcome_message=False,
            reconnect_timeout=10.0, gzip_middleware_factory=None, language="en-US",
        )  # fmt: skip
    except KeyboardInterrupt:
        work.close()
