# SPDX-License-Identifier: Apache-2.0
"""The page: open a recording, see where the model fails, see what is missing, add it.

What it shows is asked of the session again and again; nothing of the work lies in a page, so that
another tab, or the same one loaded anew, shows the same.
"""

import shutil
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from nicegui import events, run, ui

from pneu_common.errors import InputError
from pneu_common.progress import clock
from pneu_sim.rig.schema import Rig
from pneu_sysid.tasks.expect import expected_words
from pneu_sysid.tasks.regime_masks import Key
from pneu_workbench.cards import Cards, heading, refusing
from pneu_workbench.chart import Chart
from pneu_workbench.editor import Editor
from pneu_workbench.files import LARGEST, RECORDINGS, Folder, dropped_name
from pneu_workbench.live.card import LiveCard
from pneu_workbench.schematic import STYLE as SCHEMATIC
from pneu_workbench.view import Part, words_of
from pneu_workbench.work import Work

POLL_S = 0.25
"""Seconds between looks at the session."""
COLOURS = {"primary": "#1f5fa8", "secondary": "#44546a", "accent": "#6a3d9a", "positive": "#1b6e3c",
           "negative": "#b3261e", "info": "#1f5fa8", "warning": "#8a4b00"}  # fmt: skip
"""Dark enough for white words on them."""
STYLE = """
.body--dark .q-btn--flat, .body--dark .q-btn--outline { --q-primary: #8ab4f8; }
.body--dark .text-warning { --q-warning: #ffca6b; }
.body--dark .text-negative { --q-negative: #ff8a80; }
.pneu-chart:focus-visible { outline: 3px solid #1f5fa8; outline-offset: 2px; }
.pneu-chart .u-title { font: 12px sans-serif; text-align: left; padding-left: 58px; }
.body--dark .pneu-chart .u-title { color: #d0d0d0; }
.pneu-columns { display: grid; grid-template-columns: minmax(0, 1fr); gap: 1rem; width: 100%; }
@media (min-width: 1100px) {
  .pneu-columns { grid-template-columns: minmax(0, 3fr) minmax(20rem, 1fr); }
}
.pneu-card { width: 100%; overflow-wrap: anywhere; }
.pneu-table { width: 100%; border-collapse: collapse; font-variant-numeric: tabular-nums; }
.pneu-table th, .pneu-table td { text-align: right; padding: 0.15rem 0.5rem; }
.pneu-table th, .pneu-scroll td { white-space: nowrap; }
.pneu-fields {
  display: grid; gap: 0.25rem 1rem; width: 100%;
  grid-template-columns: repeat(auto-fill, minmax(15rem, 1fr));
}
.pneu-scroll { width: 100%; max-height: 24rem; overflow: auto; }
.pneu-schematic { min-width: 36rem; }
.pneu-chosen { background: #1f5fa833; }
.pneu-heat-1 { background: #f4c95d40; }
.pneu-heat-2 { background: #f08a3c60; }
.pneu-heat-3 { background: #d9534f70; }
.pneu-heat-4 { background: #b3261e90; }
.pneu-table th:first-child, .pneu-table td:first-child { text-align: left; }
"""


class Page:
    """One page that looks at the session."""

    def __init__(self, work: Work, folder: Folder) -> None:
        """Builds it.

        Args:
            work: The session.
            folder: Where recordings and rig files are chosen from.
        """
        self._work, self._folder = work, folder
        self._dark = ui.dark_mode(None)
        self._candidate = -1
        self._do = refusing(self._say, self._look)
        self._edited: dict[str, Path] = {}
        self._part = Part()
        self._cards = Cards(work, self._do, self._choose, self._to, self._only)
        self._seen: tuple[Any, ...] = ()
        self._changes = -1
        self._chart: Chart | None = None
        self._shape: tuple[Any, ...] = ()
        ui.colors(**COLOURS)
        ui.add_css(STYLE + SCHEMATIC)
        ui.add_head_html('<link rel="stylesheet" href="uplot.css">')
        self._head()
        with ui.column().classes("w-full"):
            self._opening()
            self._progress()
            with ui.element("div").classes("pneu-columns"):
                with ui.column().classes("w-full min-w-0"):
                    drawing, self._signals, regimes = (
                        ui.card().classes("pneu-card") for _ in range(3)
                    )
                with ui.column().classes("w-full min-w-0"):
                    others = [ui.card().classes("pneu-card") for _ in self._cards.beside]
            self._shown = dict(
                zip(
                    [drawing, *others, regimes],
                    [self._cards.drawing, *self._cards.beside, self._cards.regimes],
                    strict=True,
                )
            )
        self._look()
        ui.timer(POLL_S, self._look)

    # ---- parts that stay ------------------------------------------------------------------

    def _head(self) -> None:
        with ui.header(fixed=False).classes("items-center"):
            ui.label("Pneu workbench").props("role=heading aria-level=1").classes("text-lg")
            ui.space()
            self._undo = ui.button(icon="undo", on_click=self._do(self._work.undo))
            self._undo.props('flat color=white aria-label="Undo"')
            self._redo = ui.button(icon="redo", on_click=self._do(self._work.redo))
            self._redo.props('flat color=white aria-label="Redo"')
            shade = ui.button(icon="contrast", on_click=self._shade)
            shade.props('flat color=white aria-label="Light or dark"')

    async def _shade(self) -> None:
        # as long as nobody chose, it is the browser's word
        dark = await ui.run_javascript("document.body.classList.contains('body--dark')")
        self._dark.value = not dark

    def _opening(self) -> None:
        names, rigs = self._folder.recordings(), self._folder.rigs()
        with ui.card().classes("pneu-card"):
            heading("Recording and model")
            root = self._folder.root
            ui.label(f"of the folder {root.name}").classes("text-sm").tooltip(str(root))
            with ui.row().classes("w-full items-end"):
                self._bags = ui.select(names, label="Recordings", multiple=True, with_input=True)
                self._bags.classes("grow min-w-[16rem]").props("use-chips")
                self._rig = ui.select(rigs, label="Rig file", with_input=True)
                self._rig.classes("grow min-w-[16rem]")
                ui.button("Open", on_click=self._do(self._open))
            self._opened = ui.label().classes("text-sm")
            with ui.expansion("Edit the rig, begin one, match channels").classes("w-full"):
                Editor(self._present_rig, self._chosen_recording, self._use, self._say)
            with ui.expansion("Live: a running graph").classes("w-full"):
                self._live = LiveCard(self._work, self._present_rig, self._do)
            with ui.expansion("A recording from elsewhere").classes("w-full"):
                ui.upload(
                    label=f"Drop {' or '.join(RECORDINGS)} here",
                    auto_upload=True, max_file_size=LARGEST, on_upload=self._dropped,
                    on_rejected=lambda: self._say("file: larger than 4 GiB, or no recording"),
                ).props(f'accept="{",".join(RECORDINGS)}"').classes("w-full")  # fmt: skip

    def _progress(self) -> None:
        with ui.row().classes("w-full items-center no-wrap") as self._busy:
            self._stage = ui.label().classes("min-w-0").props("role=status aria-live=polite")
            self._bar = ui.linear_progress(show_value=False).props('aria-label="Progress"')
            self._took = ui.label().classes("text-sm whitespace-nowrap")
            ui.button("Cancel", on_click=self._work.cancel, color="negative")
        self._falling = ui.label().classes("text-sm").props("aria-live=polite")
        self._fault = ui.label().classes("text-negative").props("role=alert")

    # ---- what is done ---------------------------------------------------------------------

    def _say(self, text: str) -> None:
        ui.notify(text, type="negative", multi_line=True, close_button="Close", timeout=15000)

    def _open(self) -> None:
        rig = self._chosen_rig()
        if rig is None:
            raise InputError("rig file: none was chosen")
        bags = [str(self._whole(name)) for name in self._bags.value or []]
        self._candidate = -1
        self._work.open(bags, str(rig))

    def _chosen_rig(self) -> Path | None:
        """The rig file that is chosen: one of the folder, or one that was edited here."""
        name = str(self._rig.value or "")
        if not name:
            return None
        return self._edited.get(name) or self._folder.path(name)

    def _present_rig(self) -> Path | None:
        now = self._work.versions.now
        return self._chosen_rig() if now is None else Path(now.rig)

    def _chosen_recording(self) -> Path | None:
        names = list(self._bags.value or [])
        if names:
            return self._whole(names[0])
        return Path(self._work.bags[0]) if self._work.bags else None

    def _use(self, rig: Rig, words: str) -> None:
        """Takes a rig from the form: another version of what is open, or what is opened next."""
        try:
            if self._work.versions.now is not None:
                self._work.edit(rig, words)
                return
            path = self._work.keep_rig(rig)
        except InputError as error:
            self._say(str(error))
            return
        name = f"edited: {path.stem}"
        self._edited[name] = path
        self._rig.set_options([*self._folder.rigs(), *self._edited], value=name)

    def _whole(self, name: str) -> Path:
        kept = self._work.folder / "dropped" / name
        own = name in {p.name for p in (self._work.folder / "dropped").glob("*")}
        return kept if own else self._folder.path(name)

    async def _dropped(self, event: events.UploadEventArguments) -> None:
        try:
            name = dropped_name(event.file.name, event.file.size())
            into = self._work.folder / "dropped"
            into.mkdir(exist_ok=True)
            aside = into / f".{name}.part"
            await event.file.save(aside)
            await run.io_bound(shutil.move, str(aside), str(into / name))
        except InputError as error:
            self._say(str(error))
            return
        options = [*self._folder.recordings(), *sorted(p.name for p in into.glob("[!.]*"))]
        self._bags.set_options(options, value=[*(self._bags.value or []), name])

    def _choose(self, number: int) -> None:
        self._candidate = -1 if self._candidate == number else number
        self._seen = ()
        self._look()

    def _only(self, regime: Key | None) -> None:
        """Shows the readings of one regime alone; of none, or of it again, all."""
        if regime == self._part.regime:
            regime = None
        self._narrow(replace(self._part, regime=regime))

    def _ranged(self, begin_s: float, end_s: float) -> None:
        """What is shown of all time has changed."""
        first, last = self._work.view.span_s()
        whole = begin_s <= first and end_s >= last
        part = replace(self._part, begin_s=None, end_s=None)
        self._narrow(part if whole else replace(part, begin_s=begin_s, end_s=end_s))

    def _narrow(self, part: Part) -> None:
        if part != self._part:
            self._part = part
            self._cards.narrow(part)
            self._show_signals()

    # ---- what there is to see -------------------------------------------------------------

    def _look(self) -> None:
        """Shows what has changed."""
        work = self._work
        task = work.task
        running = task is not None and task.running
        self._live.look()
        if task is not None and running:
            took = clock(time.monotonic() - task.begun_s)
            hoped = "" if task.expected is None else f" of about {expected_words(task.expected)}"
            self._took.set_text(f"{took}{hoped}")
        if work.changes != self._changes:
            self._changes = work.changes
            self._busy.set_visibility(running)
            self._stage.set_text(f"{task.title}: {task.stage}" if task and running else "")
            unknown = task is not None and task.done is None
            self._bar.props(**{"add" if unknown else "remove": "indeterminate"})
            self._bar.value = 0.0 if task is None or task.done is None else task.done
            self._fault.set_text(task.fault if task is not None else "")
            self._falling.set_text(self._fallen())
            names = ", ".join(Path(bag).name for bag in work.bags)
            self._opened.set_text(f"Open: {names}" if names else "")
            if work.trial is not None:
                self._cards.tried_anew()
                self._show_signals()
        tried = None if work.trial is None else (work.trial.ready, work.trial.fault)
        beside = work.view.beside
        seen = (
            work.view.state(), work.view.asked, running, self._candidate,
            len(work.versions.all), tried, None if beside is None else beside.number,
        )  # fmt: skip
        if seen != self._seen:
            self._seen = seen
            self._show(running)

    def _fallen(self) -> str:
        task = self._work.task
        if task is None or not task.errors:
            return ""
        first, last = task.errors[0], task.errors[-1]
        parts = [f"{name} {first[name]:.1f} to {value:.1f}" for name, value in last.items()]
        return f"error over noise: {'; '.join(parts)}"

    def _show(self, running: bool) -> None:
        work = self._work
        self._undo.set_enabled(work.versions.before is not None and not running)
        self._redo.set_enabled(bool(work.versions.undone) and not running)
        if not work.view.candidates():
            self._candidate = -1
        self._show_signals()
        left = work.view.comparison()
        self._cards.candidate, self._cards.running = self._candidate, running
        for card, show in self._shown.items():
            card.clear()
            card.set_visibility(left is not None)
            if left is not None:
                with card:
                    card.set_visibility(show(left))

    def _show_signals(self) -> None:
        view = self._work.view
        shape = (view.sensors(), view.commands(), view.span_s())
        self._signals.set_visibility(bool(shape[0]))
        if not shape[0]:
            self._signals.clear()
            self._chart, self._shape = None, ()
            return
        if shape != self._shape:
            self._signals.clear()
            self._shape = shape
            with self._signals:
                with ui.row().classes("w-full items-center"):
                    heading("Measured and model")
                    ui.space()
                    for icon, word, what, by in (
                        ("zoom_in", "Zoom in", "zoom", 0.5),
                        ("zoom_out", "Zoom out", "zoom", 2.0),
                        ("fit_screen", "Show all", "whole", None),
                    ):
                        self._zoomer(icon, word, what, by)
                ui.label(
                    "Black or white: measured. Red: model; grey and dashed: the version beside."
                    " Blue: what is left; amber: what a candidate would explain of it. Behind the"
                    " lines, pale: kept aside for judging; orange: found amiss in the recording."
                    " Drag to zoom."
                ).classes("text-sm")
                with ui.row().classes("w-full items-center") as self._narrowed:
                    self._only_label = ui.label().props("role=status")
                    every = ui.button("Show all readings", on_click=lambda: self._only(None))
                    every.props("outline dense")
                self._part = Part()
                self._chart = Chart(*shape, self._ranged).classes("w-full")
        assert self._chart is not None
        regime, trial = self._part.regime, self._work.trial
        self._narrowed.set_visibility(regime is not None)
        self._only_label.set_text(f"Only: {words_of(regime)}" if regime else "")
        tried = trial is not None and bool(trial.errors)
        token = f"{view.state()} {trial.strength if trial is not None and tried else ''}"
        self._chart.look(
            self._candidate, view.beside is not None, tried, token, regime, view.marks(),
            view.kept_aside(),
        )  # fmt: skip

    def _zoomer(self, icon: str, word: str, what: str, by: float | None) -> None:
        def turn() -> None:
            if self._chart is not None:
                self._chart.run_method(what, *([] if by is None else [by]))

        ui.button(icon=icon, on_click=turn).props(f'flat dense aria-label="{word}"')

    def _to(self, begin_s: float, end_s: float) -> None:
        """Shows a stretch of time with a little on either side."""
        if self._chart is not None:
            edge = 0.1 * (end_s - begin_s)
            self._chart.run_method("show", begin_s - edge, end_s + edge)
