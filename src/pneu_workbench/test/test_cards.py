# SPDX-License-Identifier: Apache-2.0
"""Cards of the page, built without a browser from results whose numbers all differ."""

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from tests.distinct_results import compare_result, diagnose_result

pytest.importorskip("nicegui")

from nicegui import Client, ui
from nicegui.page import page

from pneu_common.errors import InputError
from pneu_sim.rig import load_rig
from pneu_sysid.report.quantities import number, percent
from pneu_sysid.results.compare import CompareResult
from pneu_workbench.cards import MOST, NOTCHES, WORST, Cards, heat_of, over_noise, refusing
from pneu_workbench.versions import Version, Versions
from pneu_workbench.view import MapRow, Part, View
from pneu_workbench.work import Work

RIG = load_rig(Path(__file__).parents[3] / "rigs" / "rig_a_fitted.yaml")
KEYS = [("pressure", "supply", "1-2 bar"), ("flow_direction", "", "filling")]


class Session:
    """Stand-in for `Work` with fixed results; records the calls of its other methods."""

    def __init__(self) -> None:
        self.asked: list[tuple[Any, ...]] = []
        self.said: list[str] = []
        self.versions = Versions()
        errors = {"supply": 1.1, "valve_out": 22.2, "end": None}
        for k, title in enumerate(("rig", "leak", "lag")):
            own = {name: None if x is None else x + k for name, x in errors.items()}
            self.versions.add(Version(0, None, title, title, f"{title}.yaml", k, own, 3.3 + k))
        self.kept_aside: list[tuple[float, float]] = []
        self.trial: Any = None
        self.folder = Path("session")
        self.view = SimpleNamespace(
            rig=lambda: RIG,
            candidates=lambda: diagnose_result(False).candidates,
            found=diagnose_result(False),
            beside=self.versions.all[1],
            expected=lambda task: {"suspect": (61.0, 125.0), "add": (5.0, 9.0)}[task],
            errors=self.errors,
            map=self.map,
            touches=lambda sensor, part: sensor == "end",
            sensors=lambda: [("supply", "Pa", 1.0), ("elbow", "rad", 1.0)],
            visited=lambda: {
                "kept_aside": 3, "stretches": 11, "seconds": 12.34, "words": "were quiet",
                "ranges": {"supply": (1.2e5, 3.4e5), "elbow": (-0.5, 0.25)},
                "openings": {"valve.fill": 0.625},
            },
        )  # fmt: skip

        assert all(hasattr(View, name) for name in vars(self.view))

    def errors(self, part: Part, beside: bool = False) -> dict[str, float]:
        if part.regime is None and part.begin_s is None:
            return {"supply": 1.25, "valve_out": 222.2} if not beside else {"supply": 7.75}
        return {"supply": 4.5, "end": 5.25}

    def map(self, part: Part) -> list[MapRow]:
        more = 0.0 if part.begin_s is None else 100.0
        rows = [{"supply": more or 1.0, "end": 40.0}, {"valve_out": 2.0 + more}]
        words = ("at 1-2 bar", "as it fills")
        every = zip(KEYS, words, rows, (True, False), strict=True)
        return [MapRow(key, told, times, chosen) for key, told, times, chosen in every]

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or not callable(getattr(Work, name, None)):
            raise AttributeError(name)
        return lambda *given: self.asked.append((name, *given))


@pytest.fixture
def session() -> Session:
    return Session()


@pytest.fixture
def client() -> Iterator[Client]:
    with Client(page("/cards")) as one:
        yield one


@pytest.fixture
def cards(session: Session, client: Client) -> Cards:
    def choose(k: int) -> None:
        session.asked.append(("choose", k))

    def show(begin_s: float, end_s: float) -> None:
        session.asked.append(("show", begin_s, end_s))

    def only(key: Any) -> None:
        session.asked.append(("only", key))

    work: Any = session
    do = refusing(session.said.append, lambda: None)
    return Cards(work, do, choose, show, only)


def both_begin(second_s: float) -> CompareResult:
    """A comparison of two recordings, by when the second begins."""
    left = compare_result(False)
    left.series.begins_s = [0.0, second_s]
    return left


def words(client: Client) -> list[str]:
    """All labels that are shown, in their order."""
    return [e.text for e in client.elements.values() if isinstance(e, ui.label) and e.text]


def buttons(client: Client) -> dict[str, ui.button]:
    """Buttons by what a screen reader says of them."""
    every = [e for e in client.elements.values() if isinstance(e, ui.button)]
    return {e.props.get("aria-label") or e.text: e for e in every}


def press(button: ui.button) -> None:
    for listener in button._event_listeners.values():
        if listener.type == "click":
            listener.handler(None)  # type: ignore[misc]


def rows(client: Client, heads: int) -> list[list[str]]:
    """Cells of a table with so many columns."""
    told = words(client)
    return [told[k : k + heads] for k in range(0, len(told), heads)]


@pytest.mark.parametrize(
    ("times", "told"), [(None, "-"), (1.26, "1.3"), (99.94, "99.9"), (100.0, "100")]
)
def test_an_error_over_the_noise(times: float | None, told: str) -> None:
    assert over_noise(times) == (told if times is None else f"{told} x noise")


def test_colours_begin_at_their_limits() -> None:
    told = {1.49: 0, 1.5: 1, 2.9: 1, 3.0: 2, 10.0: 3, 29.0: 3, 30.0: 4}
    assert {times: heat_of(times) for times in told} == {
        times: f"pneu-heat-{k}" for times, k in told.items()
    }
    assert heat_of(None) == ""


def test_the_rig_is_drawn_with_the_candidate_that_is_looked_at(
    session: Session, cards: Cards, client: Client
) -> None:
    candidates = diagnose_result(False).candidates
    candidates[1].place, candidates[1].position_m = "tube", 1.0
    session.view.candidates = lambda: candidates
    marked = []
    for k in (-1, 0, 1, len(candidates)):
        client.content.clear()
        cards.candidate = k
        with client:
            assert cards.drawing(compare_result(False))
        (drawn,) = [e for e in client.elements.values() if isinstance(e, ui.html)]
        marked.append('class="mark"' in drawn.content)
    assert marked == [False, False, True, False]
    session.view.rig = lambda: None
    client.content.clear()
    with client:
        assert cards.drawing(compare_result(False))
    assert words(client) == ["Rig", "Its file is gone."]


def test_what_the_recordings_tell(session: Session, cards: Cards, client: Client) -> None:
    assert cards.check(compare_result(False))
    told = words(client)
    assert told[1:3] == ["12.3 s; 3 of 11 stretches are kept for judging.", "They were quiet."]
    at = told.index("sensor")
    assert told[at : at + 6] == ["sensor", "least", "most", "supply", "1.2 bar", "3.4 bar"]
    assert told[at + 6 : at + 9] == ["elbow", "-28.6 degrees", "14.3 degrees"]
    assert told[-4:] == ["port", "opened to", "valve.fill", percent(0.625)]
    assert "Choose by itself" not in buttons(client)
    press(buttons(client)["Keep the shown part aside"])
    assert session.said == ["kept aside: all is shown; zoom to the part that is to be kept"]
    session.kept_aside = [(0.0, 1.0)]
    cards.narrow(Part(2.0, 3.0))
    press(buttons(client)["Keep the shown part aside"])
    assert session.asked == [("keep_aside", [(0.0, 1.0), (2.0, 3.0)])]
    client.content.clear()
    with client:
        cards.check(compare_result(False))
    press(buttons(client)["Choose by itself"])
    assert session.asked[1:] == [("keep_aside", [])]


def test_where_the_model_fails(session: Session, cards: Cards, client: Client) -> None:
    left = both_begin(0.0)
    assert cards.errors(left)
    told = words(client)
    assert told[:3] == ["Where the model fails", "lag: 5.3 x noise", "before: 4.3 x noise"]
    at = told.index("sensor")
    assert told[at : at + 3] == ["sensor", "error", "beside"]
    assert told[at + 3 : at + 11] == [
        "supply", "1.2 x noise", "7.8 x noise", "valve_out", "222 x noise", "-", "end", "-"
    ]  # fmt: skip
    assert told[3] == "of all readings"
    cards.narrow(Part(1.0, 2.5, KEYS[1]))
    assert words(client)[3] == "of 1.00 to 2.50 s, flow direction, filling"
    session.view.beside = session.versions.all[0]
    client.content.clear()
    with client:
        cards.errors(left)
    assert "beside, rig: 3.3 x noise" in words(client)


def test_worst_stretches_lead_to_where_they_are(
    session: Session, cards: Cards, client: Client
) -> None:
    left = both_begin(100.0)
    cards.errors(left)
    every = [
        (s.rmse / left.noise_of[name], name, s)
        for name, of in left.models[0].sensors.items()
        for s in of.worst
    ]
    every.sort(key=lambda entry: -entry[0])
    links = [b for told, b in buttons(client).items() if " s: " in told]
    assert [b.text for b in links] == [
        f"{name}, {s.start_s:.2f} to {s.end_s:.2f} s: {over_noise(times)}"
        for times, name, s in every[:WORST]
    ]
    for link, (_, _, s) in zip(links, every, strict=False):
        session.asked.clear()
        press(link)
        since = 100.0 if s.recording == "run 4" else 0.0
        assert session.asked == [("show", since + s.start_s, since + s.end_s)]
    first = every[0][2]
    since = 100.0 if first.recording == "run 4" else 0.0
    middle = since + 0.5 * (first.start_s + first.end_s)
    cards.narrow(Part(middle, middle + 1e-6))
    assert links[0].visible
    assert not all(link.visible for link in links)
    cards.narrow(Part(since + first.end_s, 1e3))
    assert not links[0].visible  # it ends where the part begins
    cards.narrow(Part(None, None, KEYS[0]))  # of readings that only one sensor has
    assert [link.visible for link in links] == [name == "end" for _, name, _ in every[:WORST]]


def test_errors_by_regime(session: Session, cards: Cards, client: Client) -> None:
    assert cards.regimes(compare_result(False))
    told = words(client)[2:]
    assert told == ["when", "supply", "valve_out", "end", "1.0", "40.0", "as it fills", "2.0"]
    press(buttons(client)["at 1-2 bar"])
    assert session.asked == [("only", KEYS[0])]
    cards.narrow(Part(1.0, 2.0, KEYS[0]))
    assert words(client)[6:] == ["100", "40.0", "as it fills", "102"]
    link = buttons(client)["at 1-2 bar"]
    assert link.props["aria-pressed"] == "true" and "pneu-chosen" in link.classes
    cards.narrow(Part())
    assert link.props["aria-pressed"] == "false" and "pneu-chosen" not in link.classes


def test_what_is_missing(session: Session, cards: Cards, client: Client) -> None:
    found = session.view.found
    cards.candidate = 1
    assert cards.missing(compare_result(False))
    told = words(client)
    assert found.sentence in told and all(one in told for one in found.statements)
    assert "Adding one and fitting it takes about 0:05 to 0:09" in told
    for k, one in enumerate(found.candidates[:MOST]):
        assert one.title in told
        if one.held_out_gain is not None:
            gain = percent(one.held_out_gain)
            assert f"takes away {gain} of the squared error kept aside" in told
        at = "" if one.position_m is None else f", {number(1e3 * one.position_m)} mm along"
        assert any(line.startswith(f"{one.place}{at}: ") for line in told)
        press(buttons(client)[f"{'Hide' if k == 1 else 'Draw'} {k + 1}"])
        press(buttons(client)[f"Add {k + 1}"])
        assert session.asked == [("choose", k), ("add", k)]
        session.asked.clear()
    session.view.found = None
    client.content.clear()
    with client:
        cards.missing(compare_result(False))
    assert words(client)[1:] == ["That takes about 1:00 to 2:00"]
    press(buttons(client)["Find what is missing"])
    assert session.asked == [("suspect",)]


def test_while_work_goes_on_no_more_is_begun(
    session: Session, cards: Cards, client: Client
) -> None:
    left = compare_result(False)
    for running in (False, True):
        client.content.clear()
        cards.running = running
        with client:
            for card in (cards.check, cards.missing, cards.strength, cards.history):
                assert card(left)
        begun = ("Keep the shown part aside", "Add 1", "Try other strengths", "rig: 3.3 x noise")
        assert [buttons(client)[name].enabled for name in begun] == [not running] * 4


def test_strengths_are_tried(session: Session, cards: Cards, client: Client) -> None:
    left = compare_result(False)
    cards.strength(left)
    press(buttons(client)["Try other strengths"])
    assert session.asked == [("begin_trial",)]
    trial = SimpleNamespace(
        ready=False, fault="", title="leak", unit="m2", lower=1e-9, upper=5e-9,
        strength=2e-9, errors={"end": 1.26, "supply": 3.0},
    )  # fmt: skip
    session.trial = trial
    for fault, told in (("", "The model is being made ready."), ("it failed", "it failed")):
        trial.fault = fault
        client.content.clear()
        with client:
            cards.strength(left)
        assert words(client)[1:] == [told]
    trial.ready = True
    client.content.clear()
    with client:
        cards.strength(left)
    assert words(client)[1:] == ["leak, m2", f"{number(2e-9)}: end 1.3, supply 3.0 x noise"]
    (slider,) = [e for e in client.elements.values() if isinstance(e, ui.slider)]
    assert slider.value == NOTCHES // 4
    (moved,) = [x for x in slider._event_listeners.values() if x.throttle == 0.2]
    session.asked.clear()
    moved.handler(SimpleNamespace(args=150))  # type: ignore[misc]
    ((asked, strength),) = session.asked
    assert asked == "try_strength" and strength == pytest.approx(4e-9)
    assert buttons(client)["Keep this strength"].enabled
    trial.errors = {}
    cards.tried_anew()
    assert words(client)[-1] == f"{number(2e-9)}: as it is"
    assert not buttons(client)["Keep this strength"].enabled
    session.versions.go(0)  # to which nothing was added
    assert not cards.strength(left)


def test_versions_are_gone_to_and_drawn_beside(
    session: Session, cards: Cards, client: Client
) -> None:
    assert cards.history(compare_result(False))
    there = buttons(client)
    assert list(there) == [
        "rig: 3.3 x noise", "Draw beside: rig", "leak: 4.3 x noise", "Draw beside: leak",
        "lag: 5.3 x noise",
    ]  # fmt: skip
    for name in there:
        press(there[name])
    assert session.asked == [
        ("go", 0), ("look_beside", 0), ("go", 1), ("look_beside", None), ("go", 2)
    ]  # fmt: skip
    pressed = [there[f"Draw beside: {name}"].props["aria-pressed"] for name in ("rig", "leak")]
    assert pressed == ["false", "true"]


def test_a_refusal_is_said_and_the_page_looks_again() -> None:
    said: list[str] = []

    def refuse() -> None:
        raise InputError("recording: none was chosen")

    do = refusing(said.append, lambda: said.append("looked"))
    do(refuse)()
    do(lambda: None)()
    assert said == ["recording: none was chosen", "looked", "looked"]
