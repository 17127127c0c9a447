# SPDX-License-Identifier: Apache-2.0
"""The HTML report of a scene: what it draws is what was measured and foretold."""

import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from tests.pages import check, check_with_error, read_page, read_table

from pneu_sysid.contacts.chain import Floats
from pneu_sysid.contacts.foresee import Foreseen, foresee
from pneu_sysid.contacts.report import write_scene_report
from pneu_sysid.contacts.scene import Value, load_scene
from pneu_sysid.contacts.track import Series, Track
from pneu_sysid.results.scenes import (
    SceneCandidate,
    SceneDiagnoseResult,
    SceneFitResult,
    SceneLearnResult,
    SceneParameter,
    SceneStep,
)

HOUSE = Path(__file__).resolve().parents[3]
SECONDS = 0.4


def dropped(name: str, height_m: float) -> Track:
    """A cube that falls without turning, and lies."""
    t = np.arange(0.0, SECONDS, 1.0 / 148.0)
    z = np.maximum(height_m - 0.5 * 9.81 * t**2, 0.0524)
    place = np.stack([0.3 * t, 0.0 * t, z], axis=1)
    turn = np.tile([1.0, 0.0, 0.0, 0.0], (len(t), 1))
    return Track(name, {"position": Series(t, place), "orientation": Series(t, turn)})


@pytest.fixture(scope="module")
def foretold() -> dict[str, list[Foreseen]]:
    loaded = load_scene(HOUSE / "scenes" / "cube.yaml")
    tracks = [dropped("first <b>", 0.3), dropped("second", 0.4)]
    heavy = (Value(effect="gravity_strength", at="world", value=0.2), *loaded.scene.values)
    return {"as it is": foresee(loaded, tracks), "heavier": foresee(loaded, tracks, heavy)}


HEAD = {
    "pneu_version": "1",
    "scene": "scenes/cube.yaml",
    "recordings": ["first <b>", "second"],
    "sensors": {"position": "m", "orientation": "rad"},
}


def diagnosis() -> SceneDiagnoseResult:
    tried = SceneCandidate(
        effect="sensor_scale", title="scale of a sensor", place="position", unit="", score=3.0,
        step=0.0, step_t=1.0, strength=-0.02, std_error=0.001, held_out_gain=0.4,
        significance=7.0, indistinguishable_from=["clock_rate@clock"], tested=True,
    )  # fmt: skip
    scored = SceneCandidate(
        effect="air_drag", title="drag of air", place="air", unit="N s/m", score=1.0, step=0.0,
        step_t=1.0, tested=False,
    )  # fmt: skip
    return SceneDiagnoseResult(
        **HEAD, verdict="ambiguous", sentence="Missing: <scale>.", used=["second"],
        aside=["first <b>"], candidates=[tried, scored],
    )  # fmt: skip


def learned() -> SceneLearnResult:
    steps = [
        SceneStep(step=0, added=None, held_out_loss=4.0),
        SceneStep(step=1, added="sensor_scale", place="position", strength=-0.02, std_error=0.001,
                  unit="", held_out_loss=1.0),
    ]  # fmt: skip
    return SceneLearnResult(
        **HEAD, steps=steps, verdict="effect", sentence="Missing: scale.", output=None
    )


class Whole(HTMLParser):
    """Finds elements that are not closed."""

    VOID = ("br", "meta", "hr", "input", "link")

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: object) -> None:
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


def read(path: Path) -> tuple[str, str]:
    page = Whole()
    text = path.read_text()
    page.feed(text)
    assert not page.open
    return text, page.text


def curves(text: str, axis: str, name: str) -> Floats:
    """Heights, in pixels from the top, of a curve in the drawing with an axis."""
    drawing = next(d for d in re.findall(r"<svg.*?</svg>", text, re.S) if f">{axis}<" in d)
    points = re.search(rf'<polyline points="([^"]+)" class="curve {name}"', drawing)
    assert points is not None
    return np.array([float(p.split(",")[1]) for p in points[1].split()])


def test_all_sections_stand_with_names_escaped(tmp_path: Path, foretold: dict) -> None:
    path = write_scene_report(
        tmp_path / "r.html", learned(), foretold, diagnosis=diagnosis(), learned=learned()
    )
    text, said = read(path)
    assert "first <b>" in said and "first <b>" not in text
    for words in ("scale of a sensor", "40 %", "clock_rate@clock", "drag of air", "+ sensor_scale"):
        assert words in said
    widths = re.findall(r'<rect x="0" y="2" width="([0-9.]+)" height="12" class="held"', text)
    assert [float(w) for w in widths] == [240.0, 60.0, 48.0]


def test_what_is_drawn_is_what_was_measured_and_foretold(tmp_path: Path, foretold: dict) -> None:
    text, said = read(write_scene_report(tmp_path / "r.html", diagnosis(), foretold))
    height_m = 0.4 if "second, which is foretold worst" in said else 0.3
    measured = curves(text, "position z, m", "measured")
    right, wrong = curves(text, "position z, m", "m0"), curves(text, "position z, m", "m1")
    # heights fall down the page as the cube does, and what is heavier falls ahead
    t = np.arange(0.0, SECONDS, 1.0 / 148.0)
    z = np.maximum(height_m - 0.5 * 9.81 * t**2, 0.0524)
    there = t < 0.2
    assert np.corrcoef(measured[there], z[there])[0, 1] < -0.9999
    assert np.max(np.abs(right - measured)[there]) < 1.0
    assert np.all((wrong - right)[(t > 0.12) & there] > 2.0)


def test_a_model_that_ran_away_is_said_to(tmp_path: Path, foretold: dict) -> None:
    lost = [
        replace(
            f,
            off={k: np.full_like(v, np.inf) for k, v in f.off.items()},
            told={k: np.full_like(v, np.nan) for k, v in f.told.items()},
        )
        for f in foretold["as it is"]
    ]
    text, said = read(write_scene_report(tmp_path / "r.html", diagnosis(), {"lost": lost}))
    assert said.count("ran away") == 4
    assert "nan" not in text and "inf," not in text


def cell(table, row, heading: str):
    """The cell of a row below a heading."""
    return row[table.column(heading)]


def test_every_cell_is_that_of_the_results(tmp_path: Path) -> None:
    """Of candidates, steps and parameters, by heading and row; with all numbers different."""
    candidates = [
        SceneCandidate(
            effect="air_drag", title="drag of air", place="cube", unit="N s/m", score=31.0,
            step=0.1, step_t=2.3, strength=-0.217, std_error=0.034, held_out_gain=0.63,
            significance=7.7, indistinguishable_from=["mass@cube", "clock@clock"], tested=True,
        ),
        SceneCandidate(
            effect="sensor_lag", title="lag of a sensor", place="position", unit="s", score=12.0,
            step=0.2, step_t=1.4, strength=0.0213, std_error=0.0045, held_out_gain=-0.21,
            significance=-1.9, tested=True,
        ),
        SceneCandidate(
            effect="link_bend", title="bend of a link", place="arm.x", unit="rad/N", score=0.87,
            step=0.3, step_t=0.6, tested=False,
        ),
        SceneCandidate(
            effect="springy_tip", title="springy tip", place="tip.z", unit="m/N", score=5.3,
            step=0.3, step_t=0.6, tested=False,
        ),
    ]  # fmt: skip
    diagnosis = SceneDiagnoseResult(
        **HEAD, verdict="ambiguous", sentence="Two.", used=[], aside=[], candidates=candidates
    )
    steps = [
        SceneStep(step=0, added=None, held_out_loss=2.7),
        SceneStep(step=1, added="drag", place="air", strength=-0.31, std_error=0.02, unit="N s/m",
                  held_out_loss=4.1),
        SceneStep(step=2, added="lag", place="position", strength=0.043, std_error=0.0061,
                  unit="s", held_out_loss=0.53),
    ]  # fmt: skip
    learned = SceneLearnResult(
        **HEAD, steps=steps, verdict="effect", sentence="Added.", output=None
    )
    parameters = [
        SceneParameter(effect="mass", place="cube", value=0.371, std_error=0.012, start=0.42,
                       unit="kg", at_bound=False),
        SceneParameter(effect="tilt", place="frame", value=-1.37, std_error=None, start=0.9,
                       unit="", at_bound=True),
    ]  # fmt: skip
    fit = SceneFitResult(
        **HEAD, output=None, parameters=parameters, unknowns=413, history=[], converged=True,
        loss={}, force={}, rmse={}, notes=["a note"],
    )  # fmt: skip
    path = write_scene_report(
        tmp_path / "r.html", learned, {}, fit=fit, diagnosis=diagnosis, learned=learned
    )
    page = read_page(path.read_text())
    refitted, scored = (read_table(t) for t in page.section("ranking").every("table"))
    for row, c in zip(refitted.rows, candidates[:2], strict=True):
        assert cell(refitted, row, "effect").text == f"{c.title}at {c.place}"
        scale, unit = (1e3, "ms") if c.unit == "s" else (1.0, c.unit)
        strength = cell(refitted, row, "strength").text
        check_with_error(strength, scale * c.strength, scale * c.std_error, unit)
        gain = cell(refitted, row, "explains of what is kept aside")
        check(gain.text.strip().removesuffix(" %"), 100.0 * c.held_out_gain)
        width = gain.the("rect").number("width")
        assert width == pytest.approx(120.0 * max(c.held_out_gain, 0.0), abs=0.1)
        check(cell(refitted, row, "standard errors").text, c.significance)
        others = ", ".join(c.indistinguishable_from) or "-"
        assert cell(refitted, row, "not to be told from").text == others
    for row, c in zip(scored.rows, candidates[2:], strict=True):
        assert cell(scored, row, "effect").text == f"{c.title} at {c.place}"
        check(cell(scored, row, "log-likelihood it would add").text, c.score)
    table = read_table(page.section("waterfall").the("table"))
    for row, step in zip(table.rows, steps, strict=True):
        name = "the scene as it was" if step.added is None else f"+ {step.added} at {step.place}"
        assert row[0].text == name
        check(cell(table, row, "cost per knot").text, step.held_out_loss)
        width = row[-1].the("rect").number("width")
        assert width == pytest.approx(240.0 * step.held_out_loss / 4.1, abs=0.1)
        if step.added is None:
            assert cell(table, row, "strength").text == ""
            continue
        scale, unit = (1e3, "ms") if step.unit == "s" else (1.0, step.unit)
        text = cell(table, row, "strength").text
        check_with_error(text, scale * step.strength, scale * step.std_error, unit)
    table = read_table(page.section("fit").the("table"))
    assert page.section("fit").the("caption").text == "413 unknowns"
    for row, p in zip(table.rows, parameters, strict=True):
        assert cell(table, row, "parameter").text == f"{p.effect} at {p.place}"
        check(cell(table, row, "start").text, p.start)
        check_with_error(cell(table, row, "found").text, p.value, p.std_error, p.unit)
        assert row[-1].text == ("at its bound" if p.at_bound else "")
    card = page.the("div", "card")
    assert "effect" in card.classes and card.the("p", "sentence").text == "Added."


def test_errors_of_each_recording_in_the_unit_of_their_heading(
    tmp_path: Path, foretold: dict
) -> None:
    result = diagnosis()
    page = read_page(write_scene_report(tmp_path / "r.html", result, foretold).read_text())
    table = read_table(list(page.section("errors").every("table"))[-1])
    for k, row in enumerate(table.rows):
        assert row[0].text == HEAD["recordings"][k]
        for sensor, unit, scale in (("position", "m", 1.0), ("orientation", "°", 180.0 / np.pi)):
            for model, each in foretold.items():
                text = cell(table, row, f"{sensor}, {unit}: {model}").text
                check(text, scale * float(np.mean(each[k].off[sensor])), digits=3)
    names = [s.classes[-1] for s in page.section("errors").the("p", "key").every("span")]
    assert names == ["m0", "m1"]
    key = page.section("errors").the("p", "key").text
    assert key.index("as it is") < key.index("heavier")
