# SPDX-License-Identifier: Apache-2.0
"""Friction from drag tests: drawn ones, by equations of their own, and files that are spoilt."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from studies.dragged import Case, draw_case, rig_text, write_case
from studies.seal_confusion import off, wanted
from typer.testing import CliRunner

from pneu_common.cli import build_app
from pneu_common.errors import InputError
from pneu_sim.rig import load_rig
from pneu_sysid.seals.cells import _cut, pieces_of
from pneu_sysid.seals.identify import Identified, identify, with_friction
from pneu_sysid.seals.reading import read_drag
from pneu_sysid.seals.strokes import strokes_of, turning_points
from pneu_sysid.seals.words import base_and_growth, sentence_of, statements_of

PLAIN = replace(
    draw_case("growing", 0),
    bore_m=0.02,
    stroke_m=0.05,
    constant_n=5.0,
    per_bar_n=0.6,
    gauge_bar=(1.0, 3.0, 6.0),
    speed_m_s=(0.02, 0.02, 0.02),
    course="triangle",
    cycles=4,
    noise_n=0.05,
    texture=0.02,
    run_in=0.02,
)


def found_in(case: Case, folder: Path) -> Identified:
    rig, files = write_case(case, folder)
    loaded = load_rig(rig)
    return identify(loaded, [read_drag(loaded, f) for f in files])


@pytest.mark.long
@pytest.mark.parametrize(
    ("kind", "seed"),
    [
        ("none", 0),
        ("none", 1),
        ("constant", 2),
        ("constant", 4),
        ("growing", 1),
        ("growing", 2),
        ("growing", 3),
        ("viscous", 0),
        ("viscous", 2),
        ("viscous", 5),
        ("stribeck", 1),
        ("stribeck", 5),
    ],
)
def test_the_friction_that_was_drawn_is_named(kind: str, seed: int, tmp_path: Path) -> None:
    case = draw_case(kind, seed)
    found = found_in(case, tmp_path)

    assert set(found.best.law) == wanted(case)
    assert found.verdict == ("nothing_missing" if kind == "none" else "effect")
    for term, deviation in off(case, found).items():
        assert abs(deviation) < 4.0, term
        assert found.best.std_error[term] < 0.25 * found.best.strength[term]
    if kind == "none":
        assert found.times_noise < 1.2
    else:
        assert found.steps[-1].judged_n < 0.25 * found.steps[0].judged_n
    if kind == "stribeck":  # the shape differs, a Lorentz's for a Gauss's; both ends are told
        slow = found.best.strength["constant"] + found.best.strength["breakaway"]
        assert slow == pytest.approx(case.constant_n + case.rise_n, rel=0.3)
        assert found.best.strength["constant"] == pytest.approx(case.constant_n, rel=0.25)


@pytest.mark.long
def test_a_cell_tared_under_pressure_and_signs_turned_change_nothing(tmp_path: Path) -> None:
    plain = found_in(PLAIN, tmp_path)
    rig = tmp_path / "rig.yaml"
    rig.write_text(rig_text(PLAIN).replace("scale: -1.0e-3", "scale: 1.0e-3"), encoding="utf-8")
    for path in tmp_path.glob("drag_*.csv"):
        rows = np.loadtxt(path)
        rows[:, 3] = -rows[:, 3]
        np.savetxt(path, rows, fmt="%.3f", delimiter="\t")
    loaded = load_rig(rig)
    tests = [read_drag(loaded, f) for f in sorted(tmp_path.glob("drag_*.csv"))]
    turned = identify(loaded, tests)

    assert all(any("force: turned" in f for f in t.findings) for t in tests)
    assert any("position: turned" in f for f in turned.pieces.findings)
    assert turned.best.law == plain.best.law == ("constant", "pressure")
    for term in plain.best.law:
        assert turned.best.strength[term] == pytest.approx(plain.best.strength[term], rel=0.01)


def test_what_strokes_cannot_tell_is_said(tmp_path: Path) -> None:
    case = replace(PLAIN, gauge_bar=(3.0,), speed_m_s=(0.02,))
    found = found_in(case, tmp_path)

    assert found.best.law == ("constant",)  # all of it, at this pressure
    assert found.best.strength["constant"] == pytest.approx(5.0 + 3.0 * 0.6, rel=0.05)
    assert base_and_growth(found) is None
    said = " ".join(statements_of(found))
    assert "One pressure only (3.00 bar)" in said
    assert "viscous friction and breakaway (Stribeck) cannot be told" in said


@pytest.mark.long
def test_pressures_within_one_recording_are_levels_of_their_own(tmp_path: Path) -> None:
    rig, files = write_case(PLAIN, tmp_path)
    parts = [np.loadtxt(f) for f in files]
    late = 0.0
    for part in parts:
        part[:, 0] += late
        late = part[-1, 0] + 500.0
    np.savetxt(tmp_path / "all.csv", np.vstack(parts), fmt="%.3f", delimiter="\t")
    loaded = load_rig(rig)
    found = identify(loaded, [read_drag(loaded, tmp_path / "all.csv")])

    assert [round(1e-5 * level.gauge_pa) for level in found.pieces.levels] == [1, 3, 6]
    known = base_and_growth(found)
    assert known is not None
    (base, base_error), (growth, growth_error) = known
    assert base == pytest.approx(5.0, abs=4.0 * base_error)
    assert growth == pytest.approx(0.6, abs=4.0 * growth_error)


def test_strokes_speeds_and_turns(tmp_path: Path) -> None:
    case = replace(PLAIN, gauge_bar=(3.0,), speed_m_s=(0.02,), cycles=5)
    rig, files = write_case(case, tmp_path)
    test = read_drag(load_rig(rig), files[0])
    strokes = strokes_of(test)

    assert strokes.extending.size == 10
    assert not strokes.extending[0] and strokes.extending[1]
    inwards = ~strokes.extending[strokes.stroke]
    assert np.median(strokes.speed_m_s[inwards]) == pytest.approx(0.02, rel=0.01)
    # Each way's speed again, from how far it goes and how long that takes.
    for s in range(10):
        of = strokes.index[strokes.stroke == s]
        way = abs(test.extension_m[of[-1]] - test.extension_m[of[0]])
        mean = way / (test.time_s[of[-1]] - test.time_s[of[0]])
        assert np.mean(strokes.speed_m_s[strokes.stroke == s]) == pytest.approx(mean, rel=0.02)
    assert turning_points(np.array([0.0, 1.0, 0.9, 2.0, 0.0, 1.0]), 0.5) == [0, 3, 4, 5]


@pytest.mark.long
def test_a_rig_with_the_friction_that_was_found_lacks_nothing(tmp_path: Path) -> None:
    found = found_in(PLAIN, tmp_path)
    rig = with_friction(load_rig(tmp_path / "rig.yaml"), found)
    again = identify(rig, [read_drag(rig, f) for f in sorted(tmp_path.glob("drag_*.csv"))])

    assert again.verdict == "nothing_missing"
    assert "the friction of the rig file" in sentence_of(again)


def test_few_strokes_are_not_kept_aside(tmp_path: Path) -> None:
    found = found_in(replace(PLAIN, cycles=1), tmp_path)
    assert found.steps[0].held_out_n is None
    assert "too few strokes" in " ".join(statements_of(found))
    assert found.verdict == "effect"


def test_pieces_are_few_however_many_strokes_there_are(tmp_path: Path) -> None:
    case = replace(PLAIN, gauge_bar=(3.0,), speed_m_s=(0.2,), cycles=200)
    rig, files = write_case(case, tmp_path)
    pieces = pieces_of([read_drag(load_rig(rig), files[0])])
    assert pieces.level.size <= 850
    assert pieces.cycle_friction()[0].mean() == pytest.approx(5.0 + 3.0 * 0.6, rel=0.05)


def test_few_readings_a_second_do(tmp_path: Path) -> None:
    rig, files = write_case(PLAIN, tmp_path)
    for path in files:
        lines = path.read_text(encoding="utf-8").splitlines()
        path.write_text("\n".join(lines[::10]), encoding="utf-8")
    loaded = load_rig(rig)
    found = identify(loaded, [read_drag(loaded, f) for f in files])
    assert found.best.law == ("constant", "pressure")
    assert found.best.strength["constant"] == pytest.approx(5.0, rel=0.15)


def spoilt(path: Path, column: int, change: float | None) -> None:
    """Scales a column of a recording, or takes it away."""
    rows = np.loadtxt(path)
    if change is None:
        rows = np.delete(rows, column, axis=1)
    else:
        rows[:, column] *= change
    np.savetxt(path, rows, fmt="%.9f", delimiter="\t")


@pytest.mark.parametrize(
    ("column", "change", "sentence"),
    [
        (3, None, r"channel 'force': no column 3; the rows have columns 0 to 2"),
        (3, 1e-3, r"force reads 0\.\d+ N at most where .* scale to newtons \(1000 for kN\)"),
        (3, 1e6, r"force reads .* drag\.force needs the scale to newtons"),
        (3, np.nan, r"force.*all \d+ values are NaN"),
        (1, 1e-3, r"position moves over .* nothing was dragged"),
        (1, 1e3, r"position moves over .* the cylinder's stroke_m is 0\.05; .* metres"),
        (1, 0.0, r"nothing was dragged"),
        (2, 1e5, r"pressure is .* allowed is up to 1e\+08"),
        (2, -1e-5, r"absolute pascals are needed|force"),
        (0, -1.0, r"times run backwards"),
    ],
)
def test_bad_recordings_are_refused_in_a_sentence(
    column: int, change: float | None, sentence: str, tmp_path: Path
) -> None:
    rig, files = write_case(replace(PLAIN, gauge_bar=(3.0,), speed_m_s=(0.02,)), tmp_path)
    if (column, change) == (2, -1e-5):  # gauge read as if absolute
        text = rig.read_text(encoding="utf-8").replace(
            "scale: 1.0e+5, offset: 101325.0", "scale: 1"
        )
        rig.write_text(text, encoding="utf-8")
    else:
        spoilt(files[0], column, change)
    with pytest.raises(InputError, match=sentence) as told:
        read_drag(load_rig(rig), files[0])
    assert "\n" not in str(told.value) and files[0].name in str(told.value)


def test_strokes_one_way_are_refused(tmp_path: Path) -> None:
    rig, files = write_case(replace(PLAIN, gauge_bar=(3.0,), speed_m_s=(0.02,)), tmp_path)
    lines = files[0].read_text(encoding="utf-8").splitlines()
    files[0].write_text("\n".join(lines[:150]), encoding="utf-8")
    loaded = load_rig(rig)
    with pytest.raises(InputError, match="strokes one way only"):
        identify(loaded, [read_drag(loaded, files[0])])
    files[0].write_text("", encoding="utf-8")
    with pytest.raises(InputError, match="holds no rows"):
        read_drag(loaded, files[0])


@pytest.mark.long
def test_readings_that_are_missing_do_no_harm(tmp_path: Path) -> None:
    rig, files = write_case(PLAIN, tmp_path)
    rng = np.random.default_rng(5)
    for path in files:
        rows = np.loadtxt(path)
        for column in (1, 2, 3):
            rows[rng.random(len(rows)) < 0.1, column] = np.nan
        np.savetxt(path, rows, fmt="%.3f", delimiter="\t")
    loaded = load_rig(rig)
    found = identify(loaded, [read_drag(loaded, f) for f in files])
    assert found.best.law == ("constant", "pressure")
    assert found.best.strength["constant"] == pytest.approx(5.0, rel=0.1)


@pytest.mark.long
def test_the_command_writes_rig_result_and_figure(tmp_path: Path) -> None:
    rig, files = write_case(PLAIN, tmp_path)
    out = {name: tmp_path / name for name in ("out.yaml", "out.json", "out.png")}
    options = ["--rig", str(rig), "-o", str(out["out.yaml"]), "--json", str(out["out.json"])]
    told = CliRunner().invoke(
        build_app(), ["friction", *map(str, files), *options, "--figure", str(out["out.png"])]
    )
    assert told.exit_code == 0, told.output
    assert "Missing: friction that grows with pressure" in told.output
    data = json.loads(out["out.json"].read_text(), parse_constant=pytest.fail)
    assert data["schema"] == "pneu.friction/1" and data["verdict"] == "effect"
    assert data["per_bar_n"] == pytest.approx(0.6, rel=0.15)
    assert data["laws"][0] == {"terms": ["constant", "pressure"], "behind": 0.0}
    # The rig's law goes by the mean of both sides, of which one is open to the room.
    friction = load_rig(out["out.yaml"]).cylinders["c"].friction
    assert 0.5e5 * friction.coulomb_n_per_pa == pytest.approx(data["per_bar_n"])
    assert out["out.png"].read_bytes().startswith(b"\x89PNG")


def test_pieces_share_the_readings_from_end_to_end() -> None:
    """Nine readings of each stroke, three in each piece: the one at the very end is in the last."""
    out = np.linspace(0.01, 0.05, 9)
    x = np.concatenate([out, out[::-1]] * 2)
    stroke = np.repeat(np.arange(4), 9)
    ones = np.ones(x.size)
    test: Any = SimpleNamespace(
        name="drag", extension_m=x, rest_n=5.0 * ones, load_n=0.1 * x, gauge_pa=1e5 * ones,
        mean_gauge_pa=0.8e5 * ones, noise_n=0.1,
    )  # fmt: skip
    strokes: Any = SimpleNamespace(
        index=np.arange(x.size), stroke=stroke, extending=np.array([True, False] * 2),
        speed_m_s=0.02 * ones,
    )  # fmt: skip
    pieces, findings = _cut(test, strokes, [0, 1, 2, 3], 1e5, 3)
    assert findings == []
    assert pieces.stroke.tolist() == np.repeat(np.arange(4), 3).tolist()
    assert np.bincount(pieces.readings.piece).tolist() == [3] * 12
    middles = [(k - 4.0) / 8.0 for k in (1.0, 4.0, 7.0)]
    assert pieces.place.reshape(4, 3) == pytest.approx(np.tile(middles, (4, 1)))
