# SPDX-License-Identifier: Apache-2.0
"""The page: open a recording, see where the model fails, see what is missing, add it.

What it shows is asked of the session again and again; nothing of the work lies in a page, so that
another tab, or the same one loaded anew, shows the same.
"""

import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from nicegui import events, run, ui

from pneu_common.errors import InputError
from pneu_workbench.chart import SHOWN, Chart
from pneu_workbench.files import LARGEST, RECORDINGS, Folder, dropped_name
from pneu_workbench.schematic import STYLE as SCHEMATIC
from pneu_workbench.schematic import schematic
from pneu_workbench.work import Work

POLL_S = 0.25
"""Seconds between looks at the session."""
WORST = 8
REGIMES = 8
CARDS = 6
NOTCHES = 200
"""Of the slider of a strength."""
VERDICTS = {
    "effect": ("Missing", "positive"),
    "ambiguous": ("Not to be told apart", "warning"),
    "unknown": ("Unknown", "warning"),
    "nothing_missing": ("Nothing is missing", "info"),
}
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
.pneu-table th:first-child, .pneu-table td:first-child { text-align: left; }
"""


def told(times: float | None) -> str:
    """An error over the noise, in words.

    Args:
        times: The ratio.
    """
    return (
        "-" if times is None else f"{times:.1f} x noise" if times < 100 else f"{times:.0f} x noise"
    )


def place_of(candidate: dict[str, Any]) -> str:
    """Where a candidate is, in words.

    Args:
        candidate: As `pneu diagnose --json` has it.
    """
    at = candidate.get("position_m")
    return candidate["place"] if at is None else f"{candidate['place']}, {1e3 * at:.0f} mm along"


def strength_of(candidate: dict[str, Any]) -> str:
    """How strong a candidate is, with its error.

    Args:
        candidate: As `pneu diagnose --json` has it.
    """
    strength, error, unit = (candidate[k] for k in ("strength", "std_error", "unit"))
    if strength is None:
        return ""
    doubt = "" if error is None else f" ± {error:.1g}"
    return f"{strength:.3g}{doubt} {unit if unit != '1' else ''}".strip()


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
        self._tries: ui.label | None = None
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
                    self._drawing = ui.card().classes("pneu-card")
                    self._signals = ui.card().classes("pneu-card")
                with ui.column().classes("w-full min-w-0"):
                    self._check = ui.card().classes("pneu-card")
                    self._errors = ui.card().classes("pneu-card")
                    self._missing = ui.card().classes("pneu-card")
                    self._strength = ui.card().classes("pneu-card")
                    self._history = ui.card().classes("pneu-card")
                    self._keep = ui.card().classes("pneu-card")
        self._look()
        ui.timer(POLL_S, self._look)

    # ---- parts that stay ------------------------------------------------------------------

    def _head(self) -> None:
        with ui.header(fixed=False).classes("items-center"):
            ui.label("Pneu workbench").props("role=heading aria-level=1").classes("text-lg")
            ui.space()
            self._undo = ui.button(icon="undo", on_click=self._tried(self._work.undo))
            self._undo.props('flat color=white aria-label="Undo"')
            self._redo = ui.button(icon="redo", on_click=self._tried(self._work.redo))
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
            ui.label("Recording and model").props("role=heading aria-level=2").classes("text-base")
            ui.label(f"of {self._folder.root}").classes("text-sm")
            with ui.row().classes("w-full items-end"):
                self._bags = ui.select(names, label="Recordings", multiple=True, with_input=True)
                self._bags.classes("grow min-w-[16rem]").props("use-chips").mark("bags")
                self._rig = ui.select(rigs, label="Rig file", with_input=True)
                self._rig.classes("grow min-w-[16rem]").mark("rig")
                ui.button("Open", on_click=self._tried(self._open)).mark("open")
            self._opened = ui.label().classes("text-sm")
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
            ui.button("Cancel", on_click=self._work.cancel, color="negative").mark("cancel")
        self._falling = ui.label().classes("text-sm").props("aria-live=polite")
        self._fault = ui.label().classes("text-negative").props("role=alert")

    # ---- what is done ---------------------------------------------------------------------

    def _tried(self, what: Callable[[], None]) -> Callable[[], None]:
        def do() -> None:
            try:
                what()
            except InputError as error:
                self._say(str(error))
            self._look()

        return do

    def _say(self, text: str) -> None:
        ui.notify(text, type="negative", multi_line=True, close_button="Close", timeout=15000)

    def _open(self) -> None:
        if not self._rig.value:
            raise InputError("rig file: none was chosen")
        bags = [str(self._whole(name)) for name in self._bags.value or []]
        self._candidate = -1
        self._work.open(bags, str(self._folder.path(str(self._rig.value))))

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

    # ---- what there is to see -------------------------------------------------------------

    def _look(self) -> None:
        """Shows what has changed."""
        work = self._work
        task = work.task
        running = task is not None and task.running
        if work.changes != self._changes:
            self._changes = work.changes
            self._busy.set_visibility(running)
            self._stage.set_text(f"{task.title}: {task.stage}" if task and running else "")
            self._bar.props(f"{'indeterminate' if task and task.done is None else ''}")
            self._bar.value = 0.0 if task is None or task.done is None else task.done
            self._fault.set_text(task.fault if task is not None else "")
            self._falling.set_text(self._fallen())
            names = ", ".join(Path(bag).name for bag in work.bags)
            self._opened.set_text(f"Open: {names}" if names else "")
            if self._tries is not None and work.trial is not None:
                self._tries.set_text(self._tried_words())
                self._kept.set_enabled(bool(work.trial.errors) and not running)
                self._show_signals()
        now = work.versions.now
        found = work.diagnosis["folder"] if work.diagnosis is not None else ""
        tried = None if work.trial is None else (work.trial.ready, work.trial.fault)
        shown = None if now is None else now.folder
        seen = (shown, found, running, self._candidate, len(work.versions.all), tried)
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
        if not work.candidates():
            self._candidate = -1
        self._show_signals()
        told = work.comparison()
        for card, show in (
            (self._drawing, self._show_drawing),
            (self._check, self._show_check),
            (self._errors, self._show_errors),
            (self._missing, self._show_missing),
            (self._strength, self._show_strength),
            (self._history, self._show_history),
            (self._keep, self._show_keep),
        ):
            card.clear()
            card.set_visibility(told is not None)
            if told is not None:
                with card:
                    show(told, running)

    def _heading(self, text: str) -> None:
        ui.label(text).props("role=heading aria-level=2").classes("text-base")

    def _show_signals(self) -> None:
        now = self._work.versions.now
        self._signals.set_visibility(now is not None)
        if now is None:
            self._signals.clear()
            self._chart, self._shape = None, ()
            return
        shape = (self._work.sensors(), self._work.commands(), self._work.span_s())
        if shape != self._shape:
            self._signals.clear()
            self._shape = shape
            with self._signals:
                with ui.row().classes("w-full items-center"):
                    self._heading("Measured and model")
                    ui.space()
                    for icon, word, what, by in (
                        ("zoom_in", "Zoom in", "zoom", 0.5),
                        ("zoom_out", "Zoom out", "zoom", 2.0),
                        ("fit_screen", "Show all", "whole", None),
                    ):
                        self._zoomer(icon, word, what, by)
                ui.label(
                    "Black or white: measured. Red: model; grey and dashed: that of the version"
                    " before. Blue: what is left; amber: what a candidate would explain of it."
                    " Drag to zoom."
                ).classes("text-sm")
                self._chart = Chart(*shape).classes("w-full")
        assert self._chart is not None
        before, trial = self._work.versions.before is not None, self._work.trial
        tried = trial is not None and bool(trial.errors)
        token = f"{now.folder} {trial.strength if trial is not None and tried else ''}"
        self._chart.look(self._candidate, before, tried, token)

    def _zoomer(self, icon: str, word: str, what: str, by: float | None) -> None:
        def turn() -> None:
            if self._chart is not None:
                self._chart.run_method(what, *([] if by is None else [by]))

        ui.button(icon=icon, on_click=turn).props(f'flat dense aria-label="{word}"')

    def _to(self, begin: float, end: float) -> Callable[[], None]:
        def go() -> None:
            if self._chart is not None:
                edge = 0.1 * (end - begin)
                self._chart.run_method("show", begin - edge, end + edge)

        return go

    def _show_drawing(self, told_of: dict[str, Any], running: bool) -> None:
        rig = self._work.rig()
        self._heading("Rig")
        if rig is None:
            ui.label("Its file is gone.")
            return
        tried = self._work.candidates()
        one = tried[self._candidate] if 0 <= self._candidate < len(tried) else None
        place, at = (None, None) if one is None else (one["place"], one.get("position_m"))
        if one is None and rig.effects:  # what was added last
            last = rig.effects[-1]
            place, at = last.place, last.parameters.get("position_m")
        ui.html(schematic(rig, place, at), sanitize=False).classes("w-full")

    def _show_check(self, told_of: dict[str, Any], running: bool) -> None:
        self._heading("What these recordings tell")
        found = self._work.visited() or {}
        aside = f"{found['kept_aside']} of {found['stretches']} stretches are kept for judging"
        ui.label(f"{found['seconds']:.1f} s; {aside}.")
        if found["words"]:
            ui.label(f"They {found['words']}.").classes("text-sm text-warning")
        units = {name: unit for name, unit, _ in self._work.sensors()}
        with ui.expansion("Where they have been").classes("w-full"):
            self._table(
                ["sensor", "least", "most"],
                [
                    [
                        name,
                        *(f"{SHOWN[units[name]][1] * x:.3g} {SHOWN[units[name]][0]}" for x in of),
                    ]
                    for name, of in found["ranges"].items()
                ],
            )
            self._table(
                ["port", "opened to"],
                [[name, f"{100 * part:.0f} %"] for name, part in found["openings"].items()],
            )

    def _show_errors(self, told_of: dict[str, Any], running: bool) -> None:
        now, before = self._work.versions.now, self._work.versions.before
        assert now is not None
        self._heading("Where the model fails")
        ui.label(f"{now.title}: {told(now.overall)}").classes("text-lg").mark("overall")
        if before is not None:
            ui.label(f"before: {told(before.overall)}").mark("overall-before")
        self._table(
            ["sensor", "error", *(["before"] if before else [])],
            [
                [name, told(times), *([told(before.times_noise.get(name))] if before else [])]
                for name, times in now.times_noise.items()
            ],
        )
        model = told_of["models"][0]
        each = {**model["taps"], **model.get("encoders", {})}
        begins = dict(zip(told_of["recordings"], told_of["series"]["begins_s"], strict=False))
        worst = sorted(
            ((s["rmse"] if "rmse" in s else s["rmse_pa"], name, s, one["noise_floor_pa"] if
              "noise_floor_pa" in one else one["noise_floor"])
             for name, one in each.items() for s in one["worst"]),
            key=lambda entry: -entry[0] / (entry[3] or 1.0),
        )  # fmt: skip
        ui.label("Worst stretches").classes("font-medium")
        for error, name, s, noise in worst[:WORST]:
            since = begins.get(s.get("recording") or told_of["recordings"][0], 0.0)
            times = told(error / noise if noise else None)
            word = f"{name}, {s['start_s']:.2f} to {s['end_s']:.2f} s: {times}"
            link = ui.button(word, on_click=self._to(since + s["start_s"], since + s["end_s"]))
            link.props("flat dense no-caps align=left").classes("w-full")
            if s.get("doing"):
                link.tooltip(s["doing"])
        regimes = sorted(
            [*model["regimes"], *model.get("encoder_regimes", [])], key=lambda r: -r["share"]
        )
        with ui.expansion("By regime").classes("w-full"):
            self._table(
                ["when", "sensor", "error", "share"],
                [
                    [
                        " ".join(
                            x for x in (r["kind"].replace("_", " "), r["of"], r["label"]) if x
                        ),
                        r.get("tap") or r.get("encoder"),
                        told(r["times_noise"]),
                        f"{100 * r['share']:.0f} %",
                    ]
                    for r in regimes[:REGIMES]
                ],
            )
        for finding in told_of["findings"]:
            ui.label(finding).classes("text-sm text-warning")

    def _table(self, heads: list[str], rows: list[list[Any]]) -> None:
        with ui.element("table").classes("pneu-table"):
            with ui.element("thead"), ui.element("tr"):
                for head in heads:
                    with ui.element("th").props("scope=col"):
                        ui.label(head)
            with ui.element("tbody"):
                for row in rows:
                    with ui.element("tr"):
                        for cell in row:
                            with ui.element("td"):
                                ui.label(str(cell))

    def _show_missing(self, told_of: dict[str, Any], running: bool) -> None:
        work = self._work
        now, found = work.versions.now, work.diagnosis
        self._heading("What is missing")
        own = found is not None and now is not None and found["of"] == now.number
        if not own:
            ask = ui.button("Find what is missing", on_click=self._tried(work.suspect))
            ask.set_enabled(not running)
            ask.mark("suspect")
            return
        assert found is not None
        result = found["result"]
        word, colour = VERDICTS[result["verdict"]]
        ui.badge(word, color=colour).classes("text-base p-2").mark("verdict")
        ui.label(result["sentence"])
        for statement in result["statements"]:
            ui.label(statement).classes("text-sm")
        for number, one in enumerate(work.candidates()[:CARDS]):
            self._card(number, one, running)

    def _card(self, number: int, one: dict[str, Any], running: bool) -> None:
        shown = self._candidate == number
        with ui.card().classes("pneu-card").props("flat bordered"):
            ui.label(one["title"]).classes("font-medium")
            ui.label(f"{place_of(one)}: {strength_of(one)}")
            gain = one["held_out_gain"]
            if gain is not None:
                ui.label(f"takes away {100 * gain:.0f} % of the squared error kept aside")
            if one["indistinguishable_from"]:
                ui.label(f"looks like {', '.join(one['indistinguishable_from'])}").classes(
                    "text-sm"
                )
                if one["next_experiment"]:
                    ui.label(one["next_experiment"]).classes("text-sm")
            with ui.row():
                draw = ui.button(
                    "Hide" if shown else "Draw", on_click=partial(self._choose, number)
                )
                draw.props(f'outline dense aria-label="{"Hide" if shown else "Draw"} {number + 1}"')
                add = ui.button("Add", on_click=self._tried(partial(self._work.add, number)))
                add.props(f'dense aria-label="Add {number + 1}"').mark(f"add-{number}")
                add.set_enabled(not running)

    def _show_strength(self, told_of: dict[str, Any], running: bool) -> None:
        """A slider for the strength of what was added last."""
        work, self._tries = self._work, None
        now, trial = work.versions.now, work.trial
        if now is None or not now.added:
            self._strength.set_visibility(False)
            return
        self._heading("How strong")
        if trial is None:
            ask = ui.button("Try other strengths", on_click=self._tried(work.begin_trial))
            ask.set_enabled(not running)
            return
        if not trial.ready:
            ui.label(trial.fault or "The model is being made ready.").props("role=status")
            return
        ui.label(f"{trial.title}, {trial.unit}" if trial.unit not in ("", "1") else trial.title)
        wide = trial.upper - trial.lower
        now_at = round(NOTCHES * ((trial.strength or 0.0) - trial.lower) / wide)
        # in whole notches: the slider of the page's library rounds what is as small as an area
        slider = ui.slider(min=0, max=NOTCHES, step=1, value=now_at)
        slider.props('aria-label="Strength"').mark("strength")
        slider.on(
            "update:model-value",
            lambda event: work.try_strength(trial.lower + wide * float(event.args) / NOTCHES),
            throttle=0.2,
        )
        self._tries = ui.label(self._tried_words()).props("aria-live=polite")
        with ui.row():
            self._kept = ui.button("Keep this strength", on_click=self._tried(work.keep_trial))
            self._kept.set_enabled(bool(trial.errors) and not running)
            ui.button("Leave it", on_click=self._tried(work.end_trial)).props("outline")

    def _tried_words(self) -> str:
        trial = self._work.trial
        if trial is None or trial.strength is None:
            return ""
        parts = [f"{name} {value:.1f}" for name, value in trial.errors.items()]
        return f"{trial.strength:.3g}: {', '.join(parts) + ' x noise' if parts else 'as it is'}"

    def _show_history(self, told_of: dict[str, Any], running: bool) -> None:
        self._heading("Versions")
        for depth, version in self._work.versions.tree():
            here = version.number == self._work.versions.at
            word = f"{version.title}: {told(version.overall)}"
            link = ui.button(word, on_click=self._tried(partial(self._work.go, version.number)))
            link.props(f"{'unelevated' if here else 'flat'} dense no-caps align=left")
            link.classes("w-full").style(f"margin-left: {depth}rem")
            link.set_enabled(not running)

    def _show_keep(self, told_of: dict[str, Any], running: bool) -> None:
        self._heading("Keep")
        with ui.row():
            ui.button("Rig file", on_click=self._tried(self._rig_file)).mark("keep-rig")
            ui.button("Report", on_click=self._tried(self._report)).mark("keep-report")
        ui.label(f"Session: {self._work.folder}").classes("text-sm")
        ui.label("The same by commands").classes("font-medium")
        for words in self._work.words():
            ui.label(words).classes("text-sm font-mono")

    def _rig_file(self) -> None:
        ui.download.content(self._work.rig_text(), "rig.yaml")

    def _report(self) -> None:
        ui.download.file(self._work.report(), "report.html")
