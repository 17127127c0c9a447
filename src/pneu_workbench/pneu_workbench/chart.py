# SPDX-License-Identifier: Apache-2.0
"""The chart of signals as an element of the page, and the route that it reads them by."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from fastapi import FastAPI, Query, Response
from nicegui.element import Element

from pneu_workbench.traces import packed
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
    ) -> None:
        """Makes it.

        Args:
            sensors: Names, units and noise floors.
            commands: Their names.
            span_s: First and last time, s.
        """
        super().__init__()
        self._props["sensors"] = [
            {"name": name, "shown": SHOWN[unit][0], "scale": SHOWN[unit][1]}
            for name, unit, _ in sensors
        ]
        self._props |= {"commands": list(commands), "span": list(span_s)}
        self._props |= {"candidate": -1, "before": False, "trial": False, "token": ""}

    def look(self, candidate: int, before: bool, trial: bool, token: str) -> None:
        """Shows another candidate, or what has changed.

        Args:
            candidate: Whose predicted residual is drawn; -1 is none's.
            before: Whether the version before is drawn as well.
            trial: Whether the model at the strength that is tried is.
            token: Says which state is shown; another one reads the signals again.
        """
        told = {"candidate": candidate, "before": before, "trial": trial, "token": token}
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
        before: bool = False,
        trial: bool = False,
    ) -> Response:
        parts: list[Any] = []
        try:
            for name, _, _ in work.sensors():
                others = [*(["before"] if before else []), *(["trial"] if trial else [])]
                kinds = ["measured", "model", *others, "residual"]
                parts += [work.pyramid(k, name).shown(begin, end, columns) for k in kinds]  # type: ignore[arg-type]
                if candidate >= 0:
                    one = work.pyramid("candidate", name, candidate)
                    parts.append(one.shown(begin, end, columns))
            for name in work.commands():
                parts.append(work.pyramid("command", name).shown(begin, end, columns))
        except KeyError as error:
            return Response(f"no such signal: {error}", status_code=404)
        # compressing takes longer than the loopback does
        headers = {"content-encoding": "identity", "cache-control": "no-store"}
        body = packed(parts, begin)
        return Response(body, media_type="application/octet-stream", headers=headers)

    app.get("/signals")(signals)
