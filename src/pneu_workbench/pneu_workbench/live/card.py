# SPDX-License-Identifier: Apache-2.0
"""The part of the page that shows a running graph."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from fastapi import FastAPI, Query, Response
from nicegui import ui

from pneu_common.errors import InputError
from pneu_workbench.chart import COLUMNS, Chart
from pneu_workbench.live.link import SHOWN_S, Live
from pneu_workbench.traces import Pyramid, packed
from pneu_workbench.work import Work

LEVELS = {
    -1: ("not known yet", "secondary"),
    0: ("as expected", "positive"),
    1: ("worse than expected", "warning"),
    2: ("the model does not describe the rig", "negative"),
}
STATES = {0: ("well", "positive"), 1: ("warning", "warning"), 2: ("error", "negative")}
SILENT = ("silent", "secondary")
TAKEN_S = 10.0
"""Of what came in is diagnosed unless another number is typed."""
MOST_S = 120.0


def serve_live(app: FastAPI, live: Live) -> None:
    """Adds the route by which the chart reads what comes in.

    Args:
        app: The server.
        live: The graph.
    """

    def signals(begin: float, end: float, columns: int = Query(ge=1, le=COLUMNS)) -> Response:
        sensors, commands = live.shown()
        parts: list[Any] = []
        for time_s, measured, model, noise in sensors.values():
            scale = noise if noise > 0.0 else 1.0
            for values in (measured, model, (measured - model) / scale):
                parts.append(Pyramid(time_s, values).shown(begin, end, columns))
        for time_s, volts in commands.values():
            until = np.append(time_s[1:], max(end, time_s[-1])) if time_s.size else time_s
            parts.append((np.stack([time_s, until], axis=1).ravel(), np.repeat(volts, 2)))
        headers = {"content-encoding": "identity", "cache-control": "no-store"}
        body = packed(parts, begin)
        return Response(body, media_type="application/octet-stream", headers=headers)

    app.get("/live")(signals)


class LiveCard:
    """Filled where it is made."""

    def __init__(
        self,
        work: Work,
        rig: Callable[[], Path | None],
        do: Callable[[Callable[[], object]], Callable[[], None]],
    ) -> None:
        """Builds it.

        Args:
            work: The session.
            rig: Tells the rig file whose model runs alongside; None is none.
            do: Wraps what a button does.
        """
        self._work, self._live, self._rig, self._do = work, work.live, rig, do
        self._chart: Chart | None = None
        self._shape: tuple[Any, ...] = ()
        self._seen = -1
        with ui.row().classes("w-full items-center"):
            stop = ui.button("Emergency stop", on_click=self._live.e_stop, color="negative")
            stop.props('icon=report aria-label="Emergency stop"')
            self._listen = ui.button("Listen", on_click=do(self._begin))
            self._namespace = ui.input("Namespace", placeholder="found by itself")
            self._namespace.classes("w-[9rem]").props("dense")
            self._end = ui.button("Listen no longer", on_click=do(self._live.end)).props("outline")
            self._record = ui.button("Record", on_click=do(self._live.record)).props("outline")
            self._stop = ui.button("Stop recording", on_click=do(self._stop_recording))
            # what is out of range is refused in words, and not made another number silently
            self._seconds = ui.number("Last seconds", value=TAKEN_S)
            self._seconds.classes("w-[8rem]").props("dense")
            self._ask = ui.button("Diagnose them", on_click=do(self._diagnose)).props("outline")
        self._answer = ui.label().classes("text-sm").props("role=status")
        self._fault = ui.label().classes("text-negative").props("role=alert")
        with ui.row().classes("w-full items-center"):
            self._level = ui.badge("").classes("text-base p-2")
            self._words = ui.label().props("aria-live=polite")
        self._states = ui.column().classes("w-full")
        self._signals = ui.column().classes("w-full")
        self.look()

    def _begin(self) -> None:
        path = self._rig()
        if path is None:
            raise InputError("rig file: none was chosen whose model could run alongside")
        self._live.listen(path, str(self._namespace.value or "").strip())

    def _stop_recording(self) -> None:
        self._live.stop_recording(self._open)

    def _open(self, bag: str) -> None:
        try:
            self._work.open([bag], self._live.rig or str(self._rig() or ""))
        except InputError as error:
            self._live.fault = str(error)

    def _diagnose(self) -> None:
        seconds = float(self._seconds.value or TAKEN_S)
        if not 1.0 <= seconds <= MOST_S:
            raise InputError(f"last seconds: found {seconds:g}, allowed are 1 to {MOST_S:g}")
        rig = self._live.rig

        def taken(bag: str) -> None:
            try:
                self._work.open([bag], rig, ask=True)
            except InputError as error:
                self._live.fault = str(error)

        self._live.take(seconds, taken)

    def look(self) -> None:
        """Shows what has changed."""
        live = self._live
        if self._work.changes == self._seen:
            return
        self._seen = self._work.changes
        on = live.listening
        for part, there in (
            (self._listen, not on), (self._namespace, not on), (self._end, on),
            (self._stop, bool(live.recording)),
            (self._record, not live.recording), (self._ask, on), (self._seconds, on),
            (self._level, bool(live.rig)), (self._words, bool(live.rig)),
        ):  # fmt: skip
            part.set_visibility(there)
        said = [f"recording {Path(live.recording).name}"] if live.recording else []
        self._answer.set_text("; ".join([*said, *live.stopped]))
        self._fault.set_text(live.fault)
        word, colour = LEVELS[live.level]
        self._level.set_text(word)
        self._level.props(f"color={colour}")
        told = "too few samples yet"
        if live.times is not None:
            told = (
                f"{live.times:.{0 if live.times >= 10.0 else 1}f} times the error known from its"
                f" calibration, most at {live.worst}"
            )
        each = ", ".join(
            f"{name} {course.rms / course.noise:.1f}"
            for name, course in live.courses.items()
            if course.rms / course.noise > 0.0
        )
        over = f"; over noise: {each}" if each else ""
        where = f" in {live.namespace}" if live.namespace not in ("", "/") else ""
        self._words.set_text(f"{told}{over}; {live.samples} samples{where}")
        self._states.clear()
        with self._states:
            for name, level, message in live.state():
                with ui.row().classes("w-full items-center no-wrap"):
                    state, tone = STATES.get(level, SILENT)
                    ui.badge(state, color=tone)
                    ui.label(f"{name}: {message}").classes("text-sm min-w-0")
        self._draw()

    def _draw(self) -> None:
        sensors, commands = self._live.shown()
        ends = [float(time_s[-1]) for time_s, *_ in sensors.values() if time_s.size]
        if not ends:
            if not sensors:
                self._signals.clear()
                self._chart, self._shape = None, ()
            return
        span = max(ends) - SHOWN_S, max(ends)
        about = [(name, self._live.courses[name].unit, 1.0) for name in sensors]
        shape = (tuple(about), tuple(commands))
        if shape != self._shape:
            self._shape = shape
            self._signals.clear()
            with self._signals:
                self._chart = Chart(about, list(commands), span, route="live").classes("w-full")
        if self._chart is not None:
            self._chart.follow(span)
