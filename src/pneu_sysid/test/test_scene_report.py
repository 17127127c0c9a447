# SPDX-License-Identifier: Apache-2.0
"""The HTML report of a scene: what it draws is what was measured and foretold."""

import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from pneu_sysid.contacts.chain import Floats
from pneu_sysid.contacts.foresee import Foreseen, foresee
from pneu_sysid.contacts.report import write_scene_report
from pneu_sysid.contacts.scene import Value, load_scene
from pneu_sysid.contacts.track import Series, Track
from pneu_sysid.results.scenes import (
    SceneCandidate,
    SceneDiagnoseResult,
    SceneLearnResult,
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
