# SPDX-License-Identifier: Apache-2.0
"""The cards beside the chart: what the present version is, leaves and lacks, and what to do."""

from collections.abc import Callable
from functools import partial
from typing import Any

from nicegui import ui

from pneu_common.errors import InputError
from pneu_sysid.report.quantities import number, percent, with_error
from pneu_sysid.results import Candidate, CompareResult
from pneu_workbench.chart import SHOWN
from pneu_workbench.schematic import schematic
from pneu_workbench.work import Work

WORST = 8
REGIMES = 8
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


def table(heads: list[str], rows: list[list[str]]) -> None:
    """A table whose cells are words, whatever markup they hold.

    Args:
        heads: Of the columns.
        rows: Its cells.
    """
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
                            ui.label(cell)


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
    ) -> None:
        """Knows what they may do.

        Args:
            work: The session.
            do: Wraps what a button does.
            choose: Draws a candidate, or no more.
            show: Shows a stretch of time, from and to, s.
        """
        self._work, self._do, self._choose, self._show = work, do, choose, show
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
        rig = self._work.rig()
        if rig is None:
            ui.label("Its file is gone.")
            return True
        tried = self._work.candidates()
        place, at = None, None
        if 0 <= self.candidate < len(tried):
            place, at = tried[self.candidate].place, tried[self.candidate].position_m
        elif rig.effects:  # what was added last
            place, at = rig.effects[-1].place, rig.effects[-1].parameters.get("position_m")
        ui.html(schematic(rig, place, at), sanitize=False).classes("w-full")
        return True

    def check(self, left: CompareResult) -> bool:
        """What the recordings can tell at all.

        Args:
            left: What the version leaves.
        """
        found = self._work.visited() or {}
        heading("What these recordings tell")
        aside = f"{found['kept_aside']} of {found['stretches']} stretches are kept for judging"
        ui.label(f"{found['seconds']:.1f} s; {aside}.")
        if found["words"]:
            ui.label(f"They {found['words']}.").classes("text-sm text-warning")
        with ui.expansion("Where they have been").classes("w-full"):
            rows = []
            for name, unit, _ in self._work.sensors():
                word, scale = SHOWN[unit]
                if name in found["ranges"]:
                    rows.append([name, *(f"{scale * x:.3g} {word}" for x in found["ranges"][name])])
            table(["sensor", "least", "most"], rows)
            opened = [[name, percent(part)] for name, part in found["openings"].items()]
            table(["port", "opened to"], opened)
        return True

    def errors(self, left: CompareResult) -> bool:
        """Where the model fails.

        Args:
            left: What the version leaves.
        """
        now, before = self._work.versions.now, self._work.versions.before
        assert now is not None
        heading("Where the model fails")
        ui.label(f"{now.title}: {over_noise(now.overall)}").classes("text-lg")
        if before is not None:
            ui.label(f"before: {over_noise(before.overall)}")
        former = {} if before is None else before.times_noise
        table(
            ["sensor", "error", *(["before"] if before else [])],
            [
                [name, over_noise(times), *([over_noise(former.get(name))] if before else [])]
                for name, times in now.times_noise.items()
            ],
        )
        ui.label("Worst stretches").classes("font-medium")
        self._worst(left)
        with ui.expansion("By regime").classes("w-full"):
            regimes = sorted(left.models[0].all_regimes, key=lambda r: -r.share)[:REGIMES]
            rows = []
            for r in regimes:
                when = " ".join(x for x in (r.kind.replace("_", " "), r.of, r.label) if x)
                rows.append([when, r.sensor, over_noise(r.times_noise), percent(r.share)])
            table(["when", "sensor", "error", "share"], rows)
        for finding in left.findings:
            ui.label(finding).classes("text-sm text-warning")
        return True

    def _worst(self, left: CompareResult) -> None:
        """Buttons that lead to where the model is furthest off, over the noise."""
        begins = dict(zip(left.recordings, left.series.begins_s, strict=True))
        stretches = [
            (stretch.rmse / (left.noise_of[name] or 1.0), name, stretch)
            for name, error in left.models[0].sensors.items()
            for stretch in error.worst
        ]
        for times, name, s in sorted(stretches, key=lambda entry: -entry[0])[:WORST]:
            since = begins[s.recording or left.recordings[0]]
            link = ui.button(
                f"{name}, {s.start_s:.2f} to {s.end_s:.2f} s: {over_noise(times)}",
                on_click=partial(self._show, since + s.start_s, since + s.end_s),
            )
            link.props("flat dense no-caps align=left").classes("w-full")
            if s.doing:
                link.tooltip(s.doing)

    def missing(self, left: CompareResult) -> bool:
        """What is missing: the verdict and its candidates, or that it may be asked.

        Args:
            left: What the version leaves.
        """
        heading("What is missing")
        found = self._work.found
        if found is None:
            ask = ui.button("Find what is missing", on_click=self._do(self._work.suspect))
            ask.set_enabled(not self.running)
            return True
        word, colour = VERDICTS[found.verdict]
        ui.badge(word, color=colour).classes("text-base p-2")
        ui.label(found.sentence)
        for statement in found.statements:
            ui.label(statement).classes("text-sm")
        for k, one in enumerate(self._work.candidates()[:MOST]):
            with ui.card().classes("pneu-card").props("flat bordered"):
                self._one(k, one)
        return True

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
        for depth, version in self._work.versions.tree():
            here = version.number == self._work.versions.at
            link = ui.button(
                f"{version.title}: {over_noise(version.overall)}",
                on_click=self._do(partial(self._work.go, version.number)),
            )
            link.props(f"{'unelevated' if here else 'flat'} dense no-caps align=left")
            link.classes("w-full").style(f"margin-left: {depth}rem")
            link.set_enabled(not self.running)
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
