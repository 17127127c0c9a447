# SPDX-License-Identifier: Apache-2.0
"""The chart of signals as an element of the page, and the route that it reads them by."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from fastapi import FastAPI, Query, Response
from nicegui.element import Element

from pneu_common.errors import InputError
from pneu_sysid.tasks.regime_masks import Key
from pneu_workbench.traces import packed
from pneu_workbench.view import Kind
from pneu_workbench.work import Work

STATIC = Path(__file__).parent / "static"
SHOWN = {"Pa": ("bar", 1e-5), "rad": ("degrees", 57.29577951308232), "m": ("mm", 1e3)}
"""Units that are shown, and how many of them one of the SI is."""
COLUMNS = 4000


class Chart(Element, component="static/chart.js", esm={"uplot": "static/uplot"}):
    """Measured and model of all sensors, what is left, and the commands, over one range of time."""

    def __init__(
        self,
        sensors: Sequence[tuple[str, str, float]],
        commands: Sequence[str],
        span_s: tuple[float, float],
        looked: Callable[[float, float], None] | None = None,
        route: str = "signals",
    ) -> None:
        """Makes it.

        Args:
            sensors: Names, units and noise floors.
            commands: Their names.
            span_s: First and last time, s.
            looked: Called with the range that is shown, s, when it has changed.
            route: Where the signals are read from.
        """
        super().__init__()
        self._props["sensors"] = [
            {"name": name, "shown": SHOWN[unit][0], "scale": SHOWN[unit][1]}
            for name, unit, _ in sensors
        ]
        self._props |= {"commands": list(commands), "span": list(span_s)}
        self._props |= dict(candidate=-1, beside=False, trial=False, token="", regime=[])
        self._props |= dict(marks=[], aside=[], route=route)
        if looked is not None:
            self.on("range", lambda e: looked(e.args["begin"], e.args["end"]), throttle=0.3)

    def follow(self, span_s: tuple[float, float]) -> None:
        """Shows what has come in since.

        Args:
            span_s: First and last time, s.
        """
        if self._props["span"] != list(span_s):
            self._props["span"] = list(span_s)
            self.update()

    def look(
        self,
        candidate: int,
        beside: bool,
        trial: bool,
        token: str,
        regime: Key | None,
        marks: Sequence[tuple[float, float, str, str]],
        aside: Sequence[tuple[float, float]],
    ) -> None:
        """Shows another candidate, or what has changed.

        Args:
            candidate: Whose predicted residual is drawn; -1 is none's.
            beside: Whether another version is drawn as well.
            trial: Whether the model at the strength that is tried is.
            token: Says which state is shown; another one reads the signals again.
            regime: Whose readings are shown alone; None is none's.
            marks: What was found while the recordings were read: begin and end, s, channel, what.
            aside: What is kept aside for judging, s.
        """
        told: dict[str, Any] = dict(candidate=candidate, beside=beside, trial=trial, token=token)
        told |= dict(regime=list(regime or ()), marks=[list(m) for m in marks])
        told |= dict(aside=[list(part) for part in aside])
        if any(self._props[name] != value for name, value in told.items()):
            self._props |= told
            self.update()


def serve_signals(app: FastAPI, work: Work) -> None:
    """Adds the route by which charts read signals.

    Args:
        app: The server.
        work: The session.
    """

    def signals(
        begin: float,
        end: float,
        columns: int = Query(ge=1, le=COLUMNS),
        candidate: int = -1,
        beside: bool = False,
        trial: bool = False,
        regime: list[str] = Query(default=[]),  # noqa: B008 (FastAPI reads it so)
    ) -> Response:
        parts: list[Any] = []
        view = work.view
        kinds: list[Kind] = ["measured", "model"]
        kinds += ["beside"] if beside else []
        kinds += ["trial", "residual"] if trial else ["residual"]
        kinds += ["residual_beside"] if beside else []
        kinds += ["candidate"] if candidate >= 0 else []
        only = (regime[0], regime[1], regime[2]) if len(regime) == 3 else None
        try:
            for name, _, _ in view.sensors():
                for kind in kinds:
                    one = view.pyramid(kind, name, candidate, only)
                    parts.append(one.shown(begin, end, columns))
            for name in view.commands():
                parts.append(view.pyramid("command", name).shown(begin, end, columns))
        except (KeyError, InputError):
            # a page asks for what it saw a moment ago: a strength that is no longer tried, say
            return Response(status_code=204)
        # compressing takes longer than the loopback does
        headers = {"content-encoding": "identity", "cache-control": "no-store"}
        body = packed(parts, begin)
        return Response(body, media_type="application/octet-stream", headers=headers)

    app.get("/signals")(signals)
