# SPDX-License-Identifier: Apache-2.0
"""The cards beside the chart: what the present version is, leaves and lacks, and what to do."""

from collections.abc import Callable
from functools import partial
from typing import Any

from nicegui import ui

from pneu_common.errors import InputError
from pneu_sysid.report.quantities import number, percent, with_error
from pneu_sysid.results.compare import CompareResult
from pneu_sysid.results.diagnose import Candidate
from pneu_sysid.tasks.expect import expected_words
from pneu_sysid.tasks.regime_masks import Key
from pneu_workbench.chart import SHOWN
from pneu_workbench.schematic import schematic
from pneu_workbench.view import Part, words_of
from pneu_workbench.work import Work

WORST = 8
HEAT = (1.5, 3.0, 10.0, 30.0)
"""Times the noise from which on a cell is of the next colour."""
MOST = 6
"""Of candidates."""
NOTCHES = 200
"""Of the slider of a strength."""
VERDICTS = {
    "effect": ("Missing", "positive"),
    "ambiguous": ("Not to be told apart", "warning"),
    "unknown": ("Unknown", "warning"),
    "nothing_missing": ("Nothing is missing", "info"),
}

Do = Callable[[Callable[[], object]], Callable[[], None]]
"""Makes of what may be refused what says so on the page."""


def over_noise(times: float | None) -> str:
    """An error over the noise, in words.

    Args:
        times: The ratio.
    """
    if times is None:
        return "-"
    return f"{times:.{1 if times < 100.0 else 0}f} x noise"


def heading(text: str) -> None:
    """The heading of a card.

    Args:
        text: It.
    """
    ui.label(text).props("role=heading aria-level=2").classes("text-base")


def heat_of(times: float | None) -> str:
    """Class of a cell by how many times the noise an error is.

    Args:
        times: The ratio; None is no cell.
    """
    if times is None:
        return ""
    return f"pneu-heat-{sum(times >= edge for edge in HEAT)}"


def table(heads: list[str], rows: list[list[str]]) -> list[list[ui.label]]:
    """A table whose cells are words, whatever markup they hold; returns its labels.

    Args:
        heads: Of the columns.
        rows: Its cells.
    """
    labels: list[list[ui.label]] = []
    with ui.element("table").classes("pneu-table"):
        with ui.element("thead"), ui.element("tr"):
            for head in heads:
                with ui.element("th").props("scope=col"):
                    ui.label(head)
        with ui.element("tbody"):
            for row in rows:
                labels.append([])
                with ui.element("tr"):
                    for cell in row:
                        with ui.element("td"):
                            labels[-1].append(ui.label(cell))
    return labels


class Cards:
    """What fills them; each method fills the card that it is called in.

    Each takes what the present version leaves, and returns whether there is anything to be seen.

    Attributes:
        candidate: Number of the one that is drawn; -1 is none.
        running: Whether long work goes on.
    """

    def __init__(
        self,
        work: Work,
        do: Do,
        choose: Callable[[int], None],
        show: Callable[[float, float], None],
        only: Callable[[Key | None], None],
    ) -> None:
        """Knows what they may do.

        Args:
            work: The session.
            do: Wraps what a button does.
            choose: Draws a candidate, or no more.
            show: Shows a stretch of time, from and to, s.
            only: Shows the readings of a regime alone.
        """
        self._work, self._do, self._choose, self._show = work, do, choose, show
        self._only, self._part = only, Part()
        self._part_label: ui.label | None = None
        self._errors: dict[str, list[ui.label]] = {}
        self._stretches: list[tuple[str, float, float, ui.button]] = []
        self._map_cells: dict[tuple[Key, str], tuple[ui.element, ui.label]] = {}
        self._map_links: dict[Key, ui.button] = {}
        self.candidate, self.running = -1, False
        self._tried: ui.label | None = None
        self._keep_it: ui.button | None = None

    @property
    def beside(self) -> list[Callable[[CompareResult], bool]]:
        """Those in the column beside the chart, from the top."""
        return [self.check, self.errors, self.missing, self.strength, self.history, self.keep]

    def drawing(self, left: CompareResult) -> bool:
        """The rig, with what is missing marked.

        Args:
            left: What the version leaves.
        """
        heading("Rig")
        rig = self._work.view.rig()
        if rig is None:
            ui.label("Its file is gone.")
            return True
        tried = self._work.view.candidates()
        place, at = None, None
        if 0 <= self.candidate < len(tried):
            place, at = tried[self.candidate].place, tried[self.candidate].position_m
        elif rig.effects:  # what was added last
            place, at = rig.effects[-1].place, rig.effects[-1].parameters.get("position_m")
        with ui.element("div").classes("pneu-scroll") as moved:
            # what is moved sideways on a small screen can be moved by keys
            moved.props('tabindex=0 role=group aria-label="Schematic, can be moved sideways"')
            ui.html(schematic(rig, place, at), sanitize=False).classes("w-full")
        return True

    def check(self, left: CompareResult) -> bool:
        """What the recordings can tell at all.

        Args:
            left: What the version leaves.
        """
        found = self._work.view.visited() or {}
        heading("What these recordings tell")
        aside = f"{found['kept_aside']} of {found['stretches']} stretches are kept for judging"
        ui.label(f"{found['seconds']:.1f} s; {aside}.")
        with ui.row():
            hand = ui.button("Keep the shown part aside", on_click=self._do(self._keep_shown))
            hand.props("outline dense").set_enabled(not self.running)
            if self._work.kept_aside:
                again = self._do(lambda: self._work.keep_aside([]))
                own = ui.button("Choose by itself", on_click=again)
                own.props("outline dense").set_enabled(not self.running)
        if found["words"]:
            ui.label(f"They {found['words']}.").classes("text-sm text-warning")
        with ui.expansion("Where they have been").classes("w-full"):
            rows = []
            for name, unit, _ in self._work.view.sensors():
                word, scale = SHOWN[unit]
                if name in found["ranges"]:
                    rows.append([name, *(f"{scale * x:.3g} {word}" for x in found["ranges"][name])])
            table(["sensor", "least", "most"], rows)
            opened = [[name, percent(part)] for name, part in found["openings"].items()]
            table(["port", "opened to"], opened)
        return True

    def _keep_shown(self) -> None:
        part = self._part
        if part.begin_s is None or part.end_s is None:
            raise InputError("kept aside: all is shown; zoom to the part that is to be kept")
        self._work.keep_aside([*self._work.kept_aside, (part.begin_s, part.end_s)])

    def errors(self, left: CompareResult) -> bool:
        """Where the model fails: by sensor, by stretch, by regime.

        Args:
            left: What the version leaves.
        """
        work, view = self._work, self._work.view
        now, beside = work.versions.now, view.beside
        assert now is not None
        heading("Where the model fails")
        ui.label(f"{now.title}: {over_noise(now.overall)}").classes("text-lg")
        if beside is not None:
            word = "before" if beside is work.versions.before else f"beside, {beside.title}"
            ui.label(f"{word}: {over_noise(beside.overall)}")
        self._part_label = ui.label().classes("text-sm").props("aria-live=polite")
        names = list(now.times_noise)
        heads = ["sensor", "error", *(["beside"] if beside else [])]
        cells = table(heads, [[name] + [""] * (len(heads) - 1) for name in names])
        self._errors = {name: row[1:] for name, row in zip(names, cells, strict=True)}
        ui.label("Worst stretches").classes("font-medium")
        self._worst(left)
        for finding in left.findings:
            ui.label(finding).classes("text-sm text-warning")
        self._narrow_errors(self._part)
        return True

    def regimes(self, left: CompareResult) -> bool:
        """Errors by regime; a click leaves the readings of one.

        Args:
            left: What the version leaves.
        """
        names = list(left.models[0].sensors)
        heading("Errors by regime, over noise")
        ui.label("Choose one to see its readings alone.").classes("text-sm")
        self._map_cells, self._map_links = {}, {}
        with ui.element("div").classes("pneu-scroll"), ui.element("table").classes("pneu-table"):
            with ui.element("thead"), ui.element("tr"):
                for head in ("when", *names):
                    with ui.element("th").props("scope=col"):
                        ui.label(head)
            with ui.element("tbody"):
                for row in self._work.view.map(Part()):
                    with ui.element("tr"):
                        with ui.element("td"):
                            if row.chosen:
                                link = ui.button(row.words, on_click=partial(self._only, row.key))
                                link.props("flat dense no-caps align=left")
                                self._map_links[row.key] = link
                            else:
                                ui.label(row.words)
                        for name in names:
                            with ui.element("td") as cell:
                                self._map_cells[row.key, name] = cell, ui.label()
        self._narrow_map(self._part)
        return True

    def narrow(self, part: Part) -> None:
        """Tells errors of a part of the recordings alone.

        Args:
            part: The part.
        """
        self._part = part
        if self._work.versions.now is not None:
            self._narrow_errors(part)
            self._narrow_map(part)

    def _narrow_map(self, part: Part) -> None:
        told = {row.key: row.times_noise for row in self._work.view.map(part)}
        # the map may still be that of the version before
        for (key, name), (cell, label) in self._map_cells.items():
            times = told.get(key, {}).get(name)
            label.set_text("" if times is None else f"{times:.{1 if times < 100 else 0}f}")
            cell.classes(replace=heat_of(times))
        for key, link in self._map_links.items():
            link.props(f"aria-pressed={str(key == part.regime).lower()}")
            link.classes(**{"add" if key == part.regime else "remove": "pneu-chosen"})

    def _narrow_errors(self, part: Part) -> None:
        if self._part_label is None:
            return
        view = self._work.view
        told = [view.errors(part)]
        if view.beside is not None:
            told.append(view.errors(part, beside=True))
        for name, labels in self._errors.items():
            for label, errors in zip(labels, told, strict=False):
                label.set_text(over_noise(errors.get(name)))
        where = [] if part.begin_s is None else [f"{part.begin_s:.2f} to {part.end_s:.2f} s"]
        where += [words_of(part.regime)] if part.regime else []
        self._part_label.set_text(f"of {', '.join(where)}" if where else "of all readings")
        for sensor, begin, end, link in self._stretches:
            inside = part.begin_s is None or (begin < (part.end_s or 0.0) and end > part.begin_s)
            stretch = Part(begin, end, part.regime)
            link.set_visibility(inside and (not part.regime or view.touches(sensor, stretch)))

    def _worst(self, left: CompareResult) -> None:
        """Buttons that lead to where the model is furthest off, over the noise."""
        begins = dict(zip(left.recordings, left.series.begins_s, strict=True))
        stretches = [
            (stretch.rmse / (left.noise_of[name] or 1.0), name, stretch)
            for name, error in left.models[0].sensors.items()
            for stretch in error.worst
        ]
        self._stretches = []
        for times, name, s in sorted(stretches, key=lambda entry: -entry[0])[:WORST]:
            since = begins[s.recording or left.recordings[0]]
            link = ui.button(
                f"{name}, {s.start_s:.2f} to {s.end_s:.2f} s: {over_noise(times)}",
                on_click=partial(self._show, since + s.start_s, since + s.end_s),
            )
            link.props("flat dense no-caps align=left").classes("w-full")
            if s.doing:
                link.tooltip(s.doing)
            self._stretches.append((name, since + s.start_s, since + s.end_s, link))

    def missing(self, left: CompareResult) -> bool:
        """What is missing: the verdict and its candidates, or that it may be asked.

        Args:
            left: What the version leaves.
        """
        heading("What is missing")
        found = self._work.view.found
        if found is None:
            ask = ui.button("Find what is missing", on_click=self._do(self._work.suspect))
            ask.set_enabled(not self.running)
            self._expect("suspect", "That takes")
            return True
        word, colour = VERDICTS[found.verdict]
        ui.badge(word, color=colour).classes("text-base p-2")
        ui.label(found.sentence)
        for statement in found.statements:
            ui.label(statement).classes("text-sm")
        tried = self._work.view.candidates()[:MOST]
        if tried:
            self._expect("add", "Adding one and fitting it takes")
        for k, one in enumerate(tried):
            with ui.card().classes("pneu-card").props("flat bordered"):
                self._one(k, one)
        return True

    def _expect(self, task: str, words: str) -> None:
        expected = self._work.view.expected(task)
        if expected is not None:
            ui.label(f"{words} about {expected_words(expected)}").classes("text-sm")

    def _one(self, k: int, one: Candidate) -> None:
        """A candidate."""
        at = "" if one.position_m is None else f", {number(1e3 * one.position_m)} mm along"
        ui.label(one.title).classes("font-medium")
        ui.label(f"{one.place}{at}: {with_error(one.strength, one.std_error, one.unit)}")
        if one.held_out_gain is not None:
            ui.label(f"takes away {percent(one.held_out_gain)} of the squared error kept aside")
        if one.indistinguishable_from:
            ui.label(f"looks like {', '.join(one.indistinguishable_from)}").classes("text-sm")
            ui.label(one.next_experiment).classes("text-sm")
        word = "Hide" if self.candidate == k else "Draw"
        with ui.row():
            draw = ui.button(word, on_click=partial(self._choose, k))
            draw.props(f'outline dense aria-label="{word} {k + 1}"')
            add = ui.button("Add", on_click=self._do(partial(self._work.add, k)))
            add.props(f'dense aria-label="Add {k + 1}"').set_enabled(not self.running)

    def strength(self, left: CompareResult) -> bool:
        """A slider for the strength of what was added last.

        Args:
            left: What the version leaves.
        """
        work, self._tried = self._work, None
        now, trial = work.versions.now, work.trial
        if now is None or not now.added:
            return False
        heading("How strong")
        if trial is None:
            ask = ui.button("Try other strengths", on_click=self._do(work.begin_trial))
            ask.set_enabled(not self.running)
            return True
        if not trial.ready:
            ui.label(trial.fault or "The model is being made ready.").props("role=status")
            return True
        ui.label(", ".join(word for word in (trial.title, trial.unit) if word not in ("", "1")))
        lower, wide = trial.lower, trial.upper - trial.lower

        def run(event: Any) -> None:
            self._do(partial(work.try_strength, lower + wide * float(event.args) / NOTCHES))()

        # in whole notches: the slider of the page's library rounds what is as small as an area
        at = round(NOTCHES * ((trial.strength or 0.0) - lower) / wide)
        slider = ui.slider(min=0, max=NOTCHES, step=1, value=at).props('aria-label="Strength"')
        slider.on("update:model-value", run, throttle=0.2)
        self._tried = ui.label().props("aria-live=polite")
        with ui.row():
            self._keep_it = ui.button("Keep this strength", on_click=self._do(work.keep_trial))
            ui.button("Leave it", on_click=self._do(work.end_trial)).props("outline")
        self.tried_anew()
        return True

    def tried_anew(self) -> None:
        """Says what the strength that is tried leaves."""
        trial = self._work.trial
        if self._tried is None or self._keep_it is None or trial is None or trial.strength is None:
            return
        parts = [f"{name} {value:.1f}" for name, value in trial.errors.items()]
        left = f"{', '.join(parts)} x noise" if parts else "as it is"
        self._tried.set_text(f"{number(trial.strength)}: {left}")
        self._keep_it.set_enabled(bool(parts) and not self.running)

    def history(self, left: CompareResult) -> bool:
        """All versions, as a tree.

        Args:
            left: What the version leaves.
        """
        heading("Versions")
        work, beside = self._work, self._work.view.beside
        for depth, version in work.versions.tree():
            here = version.number == work.versions.at
            with ui.row().classes("w-full items-center no-wrap").style(f"padding-left: {depth}rem"):
                link = ui.button(
                    f"{version.title}: {over_noise(version.overall)}",
                    on_click=self._do(partial(work.go, version.number)),
                )
                link.props(f"{'unelevated' if here else 'flat'} dense no-caps align=left")
                link.classes("grow min-w-0").set_enabled(not self.running)
                if not here:
                    drawn = beside is not None and beside.number == version.number
                    to = None if drawn else version.number
                    compare = ui.button(
                        icon="compare", on_click=self._do(partial(work.look_beside, to))
                    )
                    words = f"Draw beside: {version.title}"
                    compare.props(
                        f"{'' if drawn else 'flat'} dense aria-pressed={str(drawn).lower()}"
                    )
                    compare.props["aria-label"] = words
                    compare.tooltip(words)
        return True

    def keep(self, left: CompareResult) -> bool:
        """What may be taken along.

        Args:
            left: What the version leaves.
        """
        work = self._work
        heading("Keep")
        with ui.row():
            ui.button(
                "Rig file",
                on_click=self._do(lambda: ui.download.content(work.rig_text(), "rig.yaml")),
            )
            ui.button(
                "Report", on_click=self._do(lambda: ui.download.file(work.report(), "report.html"))
            )
            ui.button(
                "Session",
                on_click=self._do(lambda: ui.download.file(work.packed(), "session.zip")),
            )
        ui.label(f"Session: {work.folder}").classes("text-sm")
        ui.label("The same by commands").classes("font-medium")
        for words in work.words():
            ui.label(words).classes("text-sm font-mono")
        return True


def refusing(say: Callable[[str], None], then: Callable[[], None]) -> Do:
    """What wraps the work of buttons: a refusal is said, and the page looks again.

    Args:
        say: Says it.
        then: Looks.
    """

    def do(what: Callable[[], object]) -> Callable[[], None]:
        def tried() -> None:
            try:
                what()
            except InputError as error:
                say(str(error))
            then()

        return tried

    return do
