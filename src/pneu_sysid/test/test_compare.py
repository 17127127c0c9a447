# SPDX-License-Identifier: Apache-2.0
"""Comparison of models with recordings whose errors are known because they were put there."""

from __future__ import annotations

import dataclasses
import io
import json
import math
import re
import shutil
import subprocess
from importlib import resources
from pathlib import Path
from types import SimpleNamespace
from typing import Any, get_args

import numpy as np
import pytest
from rich.console import Console

from pneu_common.errors import InputError
from pneu_sim.rig.schema import Rig
from pneu_sim.simulator import Simulator
from pneu_sysid import compare as module
from pneu_sysid.compare import SERIES_POINTS, _distinct, compare, compare_table
from pneu_sysid.records import Finding, Recording, Signal, even_recording
from pneu_sysid.regimes import SampleSet
from pneu_sysid.report import write_report
from pneu_sysid.results.compare import CompareResult, Regime, RegimeKind
from pneu_sysid.results.files import result_of, write_json
from pneu_sysid.shift import Shift, estimate_shift

RATE_HZ = 500.0
NOISE_PA = 200.0
DURATION_S = 2.4
TAPS = ("supply", "start", "end")


def valve_rig(**changes: Any) -> Rig:
    """A supply, a 3/3-way valve, a closed tube of 1 m and an exhaust to the room."""
    ports = {
        "supply": {
            "from": "in",
            "to": "out",
            "conductance_m3_s_pa": 0.8e-8,
            "opening": {"voltage_v": [5.0, 10.0], "fraction": [0.0, 1.0]},
        },
        "exhaust": {
            "from": "out",
            "to": "vent",
            "conductance_m3_s_pa": 0.8e-8,
            "opening": {"mirror": "supply"},
        },
    }
    data: dict[str, Any] = {
        "name": "tube",
        # a whole number of steps in any interval of readings or commands
        "grid": {"dx_m": 0.1, "dt_s": 1.25e-4},
        "ambient": {"pressure_pa": 1e5},
        "reservoirs": {"supply": {"pressure_pa": 6e5}, "room": {"pressure_pa": 1e5}},
        "pipes": {
            "feed": {"from": "supply", "to": "in", "length_m": 0.5, "area_m2": 2e-5},
            "tube": {"from": "out", "to": "closed", "length_m": 1.0, "area_m2": 6e-6},
            "vent": {"from": "vent", "to": "room", "length_m": 0.2, "area_m2": 2e-5},
        },
        "valves": {"valve": {"command": "volts", "spool": {"bandwidth_hz": 60.0}, "ports": ports}},
        "commands": {"volts": {}},
        "taps": {
            "supply": {"pipe": "feed", "position_m": 0.45},
            "start": {"pipe": "tube", "position_m": 0.05},
            "end": {"pipe": "tube", "position_m": 0.95},
        },
        "fit": {"horizon_s": None},
    }
    return Rig.model_validate({**data, **changes})


def volts_of_steps(seed: int = 3) -> np.ndarray:
    """Steps of 40 to 120 ms, every third with the valve shut; the tube is vented first."""
    rng = np.random.default_rng(seed)
    volts = [0.0] * 60
    while len(volts) < DURATION_S * RATE_HZ:
        level = 5.0 if len(volts) % 3 == 0 else rng.uniform(1.0, 9.0)
        volts += [level] * int(rng.integers(20, 60))
    return np.array(volts[: int(DURATION_S * RATE_HZ)])


def record(
    rig: Rig, volts: np.ndarray | None = None, noise_pa: float = NOISE_PA, seed: int = 0
) -> Recording:
    """What a rig's sensors would have recorded."""
    volts = volts_of_steps() if volts is None else volts
    # In quarters, so that the simulator draws a valve's motion as finely as a comparison does.
    run = Simulator(rig).run(
        (volts.size - 1) / RATE_HZ, {"volts": np.repeat(volts[:-1], 4)}, 0.25 / RATE_HZ
    )
    rng = np.random.default_rng(seed)
    return even_recording(
        "made",
        np.arange(volts.size) / RATE_HZ,
        {"volts": volts},
        {t: x[::4] + noise_pa * rng.normal(size=volts.size) for t, x in run.taps.items()},
    )


def with_added(recording: Recording, tap: str, pressure: Any) -> Recording:
    """The recording with something added to one tap: a number, or one at each reading."""
    signal = recording.pressures[tap]
    changed = Signal(signal.time_s, signal.values + pressure)
    return dataclasses.replace(recording, pressures={**recording.pressures, tap: changed})


def against(recording: Recording, rig: Rig, refine: bool = False) -> CompareResult:
    return compare(recording, [(rig.name, rig, None)], refine=refine)


def regimes(result: CompareResult, kind: str, tap: str) -> dict[str, Regime]:
    return {r.label: r for r in result.models[0].regimes if r.kind == kind and r.tap == tap}


def worst_of(parts: dict[str, Regime]) -> str:
    """The regime with the largest error, in multiples of the noise."""
    return max(parts, key=lambda label: parts[label].times_noise or 0.0)


@pytest.fixture(scope="module")
def truth() -> Recording:
    return record(valve_rig())


def test_the_true_model_leaves_the_noise(truth: Recording) -> None:
    result = against(truth, valve_rig())
    for tap, error in result.models[0].taps.items():
        assert error.rmse_pa == pytest.approx(NOISE_PA, rel=0.05), tap
        assert error.times_noise == pytest.approx(1.0, rel=0.2)
        assert abs(error.bias_pa or 0.0) < 5.0 * NOISE_PA / np.sqrt(DURATION_S * RATE_HZ)
        if error.lag_s is not None:
            assert abs(error.lag_s) < 1e-4
    assert result.models[0].times_noise == pytest.approx(1.0, rel=0.2)


def test_regimes_divide_the_samples_and_the_error(truth: Recording) -> None:
    result = against(truth, valve_rig())
    for tap in TAPS:
        for kind in ("flow_direction", "opening", "pressure", "frequency", "time"):
            parts = regimes(result, kind, tap).values()
            if kind == "pressure" and not parts:
                assert tap == "supply"  # it hardly moves
                continue
            assert sum(r.share for r in parts) == pytest.approx(1.0, abs=1e-9)
            if kind != "frequency":
                assert sum(r.samples for r in parts) == len(truth.pressures[tap])


def test_regimes_stand_in_the_order_of_their_numbers(truth: Recording) -> None:
    result = against(truth, valve_rig())
    assert list(regimes(result, "frequency", "end")) == [
        "below 5 Hz",
        "5-20 Hz",
        "20-60 Hz",
        "60-150 Hz",
        "above 150 Hz",
    ]
    opening = ("closed", "below 10 % open", "10-50 % open", "above 50 % open")
    found = list(regimes(result, "opening", "end"))
    assert found == [f"valve {word}" for word in opening if f"valve {word}" in found]
    assert len(found) > 2
    for kind in ("pressure", "time"):
        begins = [r.lower for r in regimes(result, kind, "end").values()]
        assert len(begins) > 1 and begins == sorted(begins, key=lambda x: x or 0.0)
    kinds = list(dict.fromkeys(r.kind for r in result.models[0].regimes))
    assert kinds == [kind for kind in get_args(RegimeKind) if kind in kinds]


def test_a_model_that_reads_too_low_leaves_a_positive_residual(
    truth: Recording, tmp_path: Path
) -> None:
    above_pa = 4000.0
    result = against(with_added(truth, "end", above_pa), valve_rig())
    write_json(tmp_path / "compare.json", result)
    data = json.loads((tmp_path / "compare.json").read_text())
    [model] = data["models"]
    assert model["taps"]["end"]["bias_pa"] == pytest.approx(above_pa, rel=0.02)
    parts = [r for r in model["regimes"] if r["tap"] == "end" and r["kind"] != "frequency"]
    assert parts and all(r["bias_pa"] == pytest.approx(above_pa, rel=0.1) for r in parts)
    series = data["series"]
    pairs = zip(series["measured"]["end"], series["model"]["tube"]["end"], strict=True)
    assert np.mean([a - b for a, b in pairs]) == pytest.approx(above_pa, rel=0.02)

    stream = io.StringIO()
    Console(file=stream, width=140).print(compare_table(result))
    text = stream.getvalue()
    assert "measured minus model" in text
    where = text[text.index("where it fails") : text.index("worst stretches")]
    rows = [line.split("│") for line in where.splitlines() if "│" in line]
    of_end = [row[6].strip() for row in rows if row[4].strip() == "end"]
    assert any(word.startswith("+4") or word.startswith("+3") for word in of_end)
    assert not any(word.startswith("-") and word != "-" for word in of_end)

    page = write_report(tmp_path / "report.html", compare=data).read_text(encoding="utf-8")
    assert "measured minus model" in page and "model minus measured" not in page
    assert "`measured − model, ${data.unit" in page and "model − measured" not in page
    assert "mean +4" in page or "mean +3.9" in page
    # What the page itself forms of the readings it holds.
    block = re.search(r'id="viewer-data">(.*?)</script>', page)
    assert block
    node = shutil.which("node")
    if node is not None:
        script = resources.files("pneu_sysid.report") / "templates" / "viewer.js"
        asked = f"const found = readSeries({block[1]}).models[0].residual[2];"
        program = f"{script.read_text(encoding='utf-8')}\n{asked}\n"
        program += "console.log(found.reduce((a, b) => a + b) / found.length);"
        (tmp_path / "asked.js").write_text(program, encoding="utf-8")
        done = subprocess.run(
            [node, str(tmp_path / "asked.js")], capture_output=True, text=True, check=True
        )
        assert float(done.stdout) == pytest.approx(above_pa, rel=0.02)


def test_flow_and_choking_follow_the_command() -> None:
    # 6 bar into a tube at 1 bar through a small opening: sonic until the tube has b times 6 bar.
    volts = np.repeat([0.0, 5.05, 5.0, 0.0], [100, 300, 150, 300])
    rig = valve_rig()
    rig.valves["valve"].spool.bandwidth_hz = None  # so that it opens as far as it is told at once
    result = against(record(rig, volts), rig)
    flow = regimes(result, "flow_direction", "end")
    assert set(flow) == {"fill", "exhaust", "still"}
    opening = regimes(result, "opening", "end")
    # (a reading at the very time of a step is on neither side)
    assert opening["valve closed"].samples == pytest.approx(150, abs=1)
    assert opening["valve below 10 % open"].samples == pytest.approx(300, abs=1)
    assert opening["valve above 50 % open"].samples == pytest.approx(400, abs=1)
    run = Simulator(rig).run(1.698, {"volts": volts[:-1]}, 2e-3)
    critical_ratio = 0.3  # that of a port whose rig file says nothing
    sonic = (run.taps["start"] < critical_ratio * run.taps["supply"])[100:400]
    assert 20 < sonic.sum() < 280
    choked = regimes(result, "choked", "end")
    assert choked["valve.supply choked"].samples == pytest.approx(sonic.sum(), abs=3)
    assert choked["valve.supply not choked"].samples == pytest.approx((~sonic).sum(), abs=3)
    # the supply line names the same direction as the tube that it feeds
    same = regimes(result, "flow_direction", "supply")
    assert {k: r.samples for k, r in same.items()} == {k: r.samples for k, r in flow.items()}


@pytest.mark.parametrize("tap", TAPS)
@pytest.mark.parametrize("bias_pa", [900.0, -1500.0])
def test_a_bias_is_found_at_its_tap(truth: Recording, tap: str, bias_pa: float) -> None:
    taps = against(with_added(truth, tap, bias_pa), valve_rig()).models[0].taps
    assert taps[tap].bias_pa == pytest.approx(bias_pa, rel=0.1)
    assert taps[tap].rmse_pa == pytest.approx(np.hypot(bias_pa, NOISE_PA), rel=0.1)
    for other in set(TAPS) - {tap}:
        assert abs(taps[other].bias_pa or 0.0) < 0.1 * abs(bias_pa)


@pytest.mark.parametrize("lag_s", [0.0007, 0.005, 0.02, -0.003])
def test_a_late_clock_is_found_at_its_tap(lag_s: float) -> None:
    late = valve_rig()
    late.taps["end"].offset_s = lag_s
    taps = against(record(late), valve_rig()).models[0].taps
    assert taps["end"].lag_s == pytest.approx(lag_s, rel=0.1)
    assert taps["end"].gain == pytest.approx(1.0, abs=0.02)
    assert abs(taps["start"].lag_s or 0.0) < 1e-4


def test_a_gain_is_found_at_its_tap() -> None:
    steep = valve_rig()
    steep.taps["end"].gain = 1.03
    taps = against(record(steep), valve_rig()).models[0].taps
    assert taps["end"].gain == pytest.approx(1.03, abs=0.003)
    assert taps["start"].gain == pytest.approx(1.0, abs=0.003)


def test_shift_of_analytic_waves() -> None:
    tick_s = np.arange(400) * 2e-3
    rng = np.random.default_rng(1)
    # read at times of their own, between the ticks
    time = np.sort(rng.uniform(0.0, tick_s[-1], size=(2, 400)), axis=1)

    def wave(t: np.ndarray) -> np.ndarray:
        return np.sin(40.0 * t) + 0.5 * np.cos(95.0 * t + 1.0)

    predicted = [(tick_s, wave(tick_s)), (tick_s, wave(tick_s + 3.0))]
    of = np.array([0, 1])
    late = time - 0.0123
    measured = 7.0 + 0.9 * np.stack([wave(late[0]), wave(late[1] + 3.0)])
    measured[late < 0.0] = np.nan  # from before the prediction begins
    measured[0, 50:90] = np.nan
    shift = estimate_shift(measured, time, predicted, of)
    assert shift is not None
    assert shift.lag_s == pytest.approx(0.0123, abs=2e-5)
    assert shift.gain == pytest.approx(0.9, abs=1e-3)
    faint = [(tick_s, 1e-3 * values) for _, values in predicted]
    assert estimate_shift(rng.normal(size=(2, 400)), time, faint, of) is None
    still = [(tick_s, np.ones(400))] * 2
    assert estimate_shift(measured, time, still, of) is None


def test_a_leak_shows_while_the_valve_is_shut() -> None:
    leaky = valve_rig()
    tube = leaky.pipes["tube"].model_dump(by_alias=True)
    tube["leaks"] = [{"position_m": 0.95, "area_m2": 3e-8}]
    leaky = valve_rig(pipes={**leaky.model_dump(by_alias=True)["pipes"], "tube": tube})
    # vent, fill, hold: again and again
    volts = np.tile(np.repeat([0.0, 9.0, 5.0], [150, 60, 190]), 3)
    result = against(record(leaky, volts), valve_rig())
    assert (result.models[0].taps["end"].times_noise or 0.0) > 3.0
    for kind, where in (("flow_direction", "still"), ("opening", "valve closed")):
        parts = regimes(result, kind, "end")
        assert worst_of(parts) == where
        assert parts[where].share > 0.7
    assert (result.models[0].taps["end"].bias_pa or 0.0) < 0.0  # the rig holds less
    assert all("closed" in s.doing for s in result.models[0].taps["end"].worst[:3])


@pytest.mark.parametrize(
    ("frequency_hz", "band"),
    [
        (2.0, "below 5 Hz"),
        (12.0, "5-20 Hz"),
        (40.0, "20-60 Hz"),
        (100.0, "60-150 Hz"),
        (200.0, "above 150 Hz"),
    ],
)
def test_an_added_sine_is_in_its_band(truth: Recording, frequency_hz: float, band: str) -> None:
    sine = 2000.0 * np.sin(2.0 * np.pi * frequency_hz * truth.pressures["end"].time_s)
    result = against(with_added(truth, "end", sine), valve_rig())
    parts = regimes(result, "frequency", "end")
    assert worst_of(parts) == band
    assert parts[band].rmse_pa == pytest.approx(2000.0 / np.sqrt(2.0), rel=0.06)
    assert parts[band].share > 0.9


def test_the_worst_stretch_is_where_the_disturbance_is(truth: Recording) -> None:
    time = truth.pressures["end"].time_s
    blow = np.where((time >= 1.3) & (time < 1.4), 5000.0, 0.0)
    result = against(with_added(truth, "end", blow), valve_rig())
    worst = result.models[0].taps["end"].worst[0]
    assert (worst.start_s, worst.end_s) == pytest.approx((1.3, 1.4), abs=1e-6)
    assert worst.rmse_pa == pytest.approx(5000.0, rel=0.02)
    assert "volts" in worst.doing
    assert worst_of(regimes(result, "time", "end")) == "1-2 s"


@pytest.mark.long
def test_a_coarse_grid_is_told_from_missing_physics() -> None:
    fine = record(valve_rig(grid={"dx_m": 0.0125}))
    for order, dx_m in ((1, 0.1), (2, 0.2)):
        coarse = valve_rig(grid={"dx_m": dx_m, "order": order})
        result = against(fine, coarse, refine=True)
        assert (result.models[0].taps["end"].times_noise or 0.0) > 3.0
        assert result.numerics.discretisation
        assert result.numerics.refined_dx_m == pytest.approx(0.5 * dx_m)
        assert "is discretisation rather than physics" in result.numerics.sentence

    result = against(fine, valve_rig(grid={"dx_m": 0.025}), refine=True)
    assert not result.numerics.discretisation

    # an error that is physics: a tube of other area, on the same fine grid
    narrow = valve_rig(grid={"dx_m": 0.025})
    narrow.pipes["tube"].area_m2 *= 0.9
    result = against(fine, narrow, refine=True)
    assert (result.models[0].taps["end"].times_noise or 0.0) > 3.0
    assert not result.numerics.discretisation


@pytest.mark.long
def test_models_of_other_structure_side_by_side(truth: Recording) -> None:
    good = valve_rig(fit={"horizon_s": 0.5, "warm_up_s": 0.1})
    bad = valve_rig(name="other", fit={"horizon_s": 0.3})
    bad.pipes["tube"].area_m2 *= 1.3
    extra = {"pipe": "feed", "position_m": 0.1}
    data = bad.model_dump(by_alias=True)
    other = Rig.model_validate(
        {**data, "taps": {"extra": extra, **{t: data["taps"][t] for t in reversed(TAPS)}}}
    )
    seen: list[float] = []
    result = compare(
        truth, [("tube", good, "a.yaml"), ("other", other, None)], progress=seen.append
    )
    assert result.taps == list(TAPS)
    assert [m.file for m in result.models] == ["a.yaml", None]
    first, second = result.models
    assert (second.times_noise or 0.0) > 3.0 * (first.times_noise or 0.0)
    assert (first.times_noise or 0.0) < 3.0
    # four stretches of half a second or a little more, which leave out nothing but the warm-up
    segments = np.array(result.series.segments)
    assert segments.shape == (4, 2)
    assert np.allclose(segments[1:, 0], segments[:-1, 1])
    assert segments[[0, -1], [0, 1]] == pytest.approx([0.1, DURATION_S - 1.0 / RATE_HZ], abs=1e-6)
    for model in result.models:
        samples = sum(r.samples for r in model.regimes if r.kind == "time" and r.tap == "end")
        assert samples == (DURATION_S - 0.1) * RATE_HZ
    assert seen[-1] == 1.0 and seen == sorted(seen)
    twice = compare(truth, [("tube", good, "a.yaml"), ("tube", good, "b.yaml")], refine=False)
    assert twice.rigs == ["a", "b"]


def test_missing_samples_are_left_out(truth: Recording) -> None:
    end = truth.pressures["end"]
    kept = np.r_[:400, 480 : len(end)]
    recording = dataclasses.replace(
        truth,
        pressures={**truth.pressures, "end": Signal(end.time_s[kept], end.values[kept])},
        report=[Finding("end", "gap", 80, "left missing")],
    )
    result = against(recording, valve_rig())
    assert result.models[0].taps["end"].rmse_pa == pytest.approx(NOISE_PA, rel=0.06)
    assert result.series.measured["end"].count(None) == 80
    assert result.findings == ["end: gap (80): left missing"]


def chamber_rig(**fit: Any) -> Rig:
    """A chamber on its own, with a stub to its sensor; its gas follows its wall within 2 s."""
    data = {
        "name": "chamber",
        "grid": {"dx_m": 0.1, "dt_s": 1.25e-4},
        "pipes": {"stub": {"from": "chamber", "to": "closed", "length_m": 0.2, "area_m2": 1e-5}},
        "chambers": {"chamber": {"volume_m3": 1e-4, "heat_w_per_k": 0.4}},
        "taps": {"chamber": {"chamber": "chamber"}},
        "fit": fit,
    }
    return Rig.model_validate(data)


def cooling(rig: Rig, temperature_k: float, seconds: float = 12.0) -> Recording:
    """What the sensor of a chamber shows whose gas begins at 7 bar and some temperature."""
    simulator = Simulator(rig)
    simulator.reset({"stub": 7e5, "chamber": 7e5})
    simulator.set_chamber("chamber", 7e5, temperature_k)
    pressure = simulator.run(seconds, {}, 0.02).taps["chamber"]
    noise = NOISE_PA * np.random.default_rng(2).normal(size=pressure.size)
    return even_recording(
        "made", 0.02 * np.arange(pressure.size), {}, {"chamber": pressure + noise}
    )


def test_gas_that_begins_warm_is_no_error_of_the_model() -> None:
    rig = chamber_rig(horizon_s=3.0, warm_up_s=0.2)
    recording = cooling(rig, rig.ambient.temperature_k + 25.0)
    values = recording.pressures["chamber"].values
    assert values[0] - values[-1] > 100.0 * NOISE_PA  # it cools
    error = against(recording, rig).models[0].taps["chamber"]
    assert error.rmse_pa == pytest.approx(NOISE_PA, rel=0.1)


def test_result_survives_its_file(truth: Recording, tmp_path: Any) -> None:
    result = against(truth, valve_rig())
    write_json(tmp_path / "out.json", result)
    text = (tmp_path / "out.json").read_text(encoding="utf-8")
    assert "NaN" not in text
    data = json.loads(text)
    assert data["schema"] == "pneu.compare/1"
    assert result_of(data) == result
    assert len(data["series"]["time_s"]) == len(truth.pressures["end"]) <= SERIES_POINTS


@pytest.mark.long
def test_long_series_are_thinned_but_for_the_worst() -> None:
    recording = record(valve_rig(), np.tile(volts_of_steps(), 10))
    assert sum(len(signal) for signal in recording.pressures.values()) > SERIES_POINTS
    recording.pressures["end"].values[5000:5050] += 9000.0
    result = against(recording, valve_rig())
    time = np.array(result.series.time_s)
    assert (np.diff(time) > 0.0).all()
    kept = np.array([[x is not None for x in result.series.measured[tap]] for tap in TAPS])
    assert 0.5 * SERIES_POINTS < kept.sum() <= SERIES_POINTS
    assert (kept.sum(axis=1) > 0.25 * SERIES_POINTS / len(TAPS)).all()
    assert kept[TAPS.index("end"), (time > 9.999) & (time < 10.099)].sum() == 50


def test_table_names_every_tap_and_model(truth: Recording) -> None:
    result = against(truth, valve_rig(), refine=True)
    stream = io.StringIO()
    Console(file=stream, width=140).print(compare_table(result))
    text = stream.getvalue()
    for word in (*TAPS, "tube", "RMSE Pa", "worst stretches", "half the length"):
        assert word in text


def test_unusable_input_is_one_sentence(truth: Recording) -> None:
    with pytest.raises(InputError, match="no rig was given"):
        compare(truth, [])
    nothing = dataclasses.replace(truth, pressures={"elsewhere": truth.pressures["end"]})
    with pytest.raises(InputError, match="recorded: elsewhere"):
        against(nothing, valve_rig())
    with pytest.raises(InputError, match="command 'volts' is not in recording 'made'"):
        against(dataclasses.replace(truth, commands={}), valve_rig())


def test_models_of_one_name_are_numbered(truth: Recording) -> None:
    """By their files where they have any, else by numbers that are free."""
    rig = valve_rig()
    named = [
        ("tube", rig, None),
        ("tube (2)", rig, None),
        ("tube", rig, None),
        ("tube", rig, "c/a.yaml"),
    ]
    assert _distinct(named) == ["tube", "tube (2)", "tube (3)", "a"]


def test_what_has_no_reading_has_no_figure(truth: Recording) -> None:
    """A tap that one of two recordings lacks, and one that is lost in the stretches compared."""
    rig = valve_rig()
    early = truth.until(1.2)
    none = Signal(np.zeros(0), np.zeros(0))
    lacking = dataclasses.replace(early, name="lacking", pressures={**early.pressures, "end": none})
    result = compare([truth, lacking], [("tube", rig, None)], refine=False)
    (model,) = result.models
    alone = against(truth, rig).models[0]
    assert model.taps["end"].rmse_pa == pytest.approx(alone.taps["end"].rmse_pa, rel=1e-6)
    assert {w.recording for w in model.taps["end"].worst} == {"made"}
    assert {w.recording for w in model.taps["start"].worst} == {"made", "lacking"}


def test_errors_of_no_reading_are_none() -> None:
    lost = np.full((2, 40), np.nan)
    shown = SimpleNamespace(
        taps=["feed", "end"],
        measured=np.stack([np.ones((2, 40)), np.arange(80.0).reshape(2, 40)], axis=-1),
        time_s=np.tile(0.002 * np.arange(80.0).reshape(2, 40, 1), (1, 1, 2)),
    )
    figures = module._error(lost, 3.0, "end", shown, None)
    assert set(figures) == {"rmse", "normalised", "times_noise", "bias", "lag_s", "gain"}
    assert set(figures.values()) == {None}
    assert module._worst(lost, "end", shown, None) == []
    assert module._regimes(lost, 3.0, "end", shown, None) == []
    # One that never moves has no spread that an error could be a share of.
    error = np.tile([6.0, -2.0], (2, 20))
    for tap, spread in (("feed", None), ("end", float(np.std(np.arange(80.0))))):
        figures = module._error(error, 3.0, tap, shown, Shift(0.25, 1.5, 0.1))
        rmse = math.sqrt(20.0)
        assert figures == {
            "rmse": pytest.approx(rmse), "times_noise": pytest.approx(rmse / 3.0),
            "normalised": None if spread is None else pytest.approx(rmse / spread),
            "bias": pytest.approx(2.0), "lag_s": 0.25, "gain": 1.5,
        }  # fmt: skip
    # Sets of which too few readings are left are none.
    masks = np.zeros((2, 2, 40), dtype=bool)
    masks[0, 0, :6], masks[1, 1, 4:] = True, True
    sets = [
        SampleSet("time", f"set {k}", mask, "", 0.5 * k, 0.5 * k + 0.5)
        for k, mask in enumerate(masks)
    ]
    error[0, :2] = np.nan
    work = SimpleNamespace(sets=lambda tap: sets)
    (kept, *bands) = module._regimes(error, 3.0, "end", shown, work)
    assert (kept["label"], kept["lower"], kept["upper"]) == ("set 1", 0.5, 1.0)
    assert (kept["samples"], kept["bias"]) == (36, pytest.approx(2.0))
    assert kept["share"] == pytest.approx(36 / 78)
    assert {band["kind"] for band in bands} == {"frequency"}


@pytest.mark.parametrize("turned", [False, True])
def test_the_share_of_cells_in_an_error(turned: bool) -> None:
    """A rig that was fitted on its cells may be worse on finer ones: it is to be fitted again."""
    rng = np.random.default_rng(2)
    measured = rng.normal(size=(3, 50, 2)) * [1.0, 1.0]
    apart = rng.choice([-1.0, 1.0], (3, 50, 2))
    coarse = measured + apart * [60.0, 3.0]
    change = np.array([-40.0, 1.3]) * (-1.0 if turned else 1.0)
    finer = coarse + apart * change
    given = SimpleNamespace(
        dx_m=None, taps=["start", "end"], noise_pa=np.array([2.5, 2.0]),
        target=lambda: measured,
        with_grid=lambda dx_m: SimpleNamespace(
            simulate=lambda rigs, progress: SimpleNamespace(readings=finer[None])
        ),
    )  # fmt: skip
    rig = valve_rig()
    remaining = 1.0 - 0.5**rig.grid.order
    predicted = {"start": coarse[..., 0], "end": coarse[..., 1]}
    found = module.grid_check(given, rig, predicted)
    assert found.change_pa == pytest.approx({"start": 40.0, "end": 1.3})
    excess = [math.sqrt(60.0**2 - 6.25) / 2.5, math.sqrt(9.0 - 4.0) / 2.0]
    of_grid = [40.0 / remaining / 2.5, 1.3 / remaining / 2.0]
    share = min(100.0 * math.hypot(*of_grid) / math.hypot(*excess), 100.0)
    assert found.discretisation
    turn = (
        "rises from 60 to 100 Pa: refine the grid and fit again"
        if turned
        else ("falls from 60 to 20 Pa: refine the grid")
    )
    assert found.sentence == (
        "On cells of half the length (5 instead of 10 cm) the prediction at start changes by 40 Pa:"
        f" about {share:.0f} % of the error above noise is discretisation rather than physics."
        f" The error at start {turn}."
    )
    # The share of all sensors decides; one alone is only named.
    finer[..., 0] = coarse[..., 0] + apart[..., 0]
    finer[..., 1] = coarse[..., 1] - 2.0 * apart[..., 1]
    found = module.grid_check(given, rig, predicted)
    assert not found.discretisation
    assert found.sentence.endswith(
        "predictions change by at most 2 Pa (at end), so the error is not one of the grid, except"
        " at end."
    )


def test_stretches_that_are_too_many_are_not_all_kept() -> None:
    """Those of the largest error over the noise first, as long as there is room."""
    time = np.arange(40.0).reshape(1, 40) * 0.1
    there = np.ones((1, 40), dtype=bool)
    given = SimpleNamespace(
        recordings=[SimpleNamespace(name="made")], taps=["start", "end"],
        noise_pa=np.array([1.0, 10.0]), of=np.zeros(1, dtype=int),
    )  # fmt: skip
    places = {
        "start": [(0.0, 1.0, 50.0), (2.0, 2.5, 9.0)],
        "end": [(1.0, 3.0, 400.0), (3.5, 4.0, 80.0)],
    }
    sensors = {
        name: SimpleNamespace(
            worst=[
                SimpleNamespace(recording=None, start_s=a, end_s=b, rmse=rmse) for a, b, rmse in of
            ]
        )
        for name, of in places.items()
    }
    chosen = module._worst_of(there, time + 1e-6, given, [SimpleNamespace(sensors=sensors)], 16)
    # The 20 of the second have no room beside the 10 of the first; the 5 of the third do.
    assert np.flatnonzero(chosen[0]).tolist() == [*range(10), *range(20, 25)]


def test_stretches_of_one_time_are_told_once() -> None:
    def stretch(a: float, b: float, rmse: float, recording: str | None = None) -> Any:
        return SimpleNamespace(recording=recording, start_s=a, end_s=b, rmse=rmse)

    sensors = {
        "start": SimpleNamespace(worst=[stretch(1.0, 2.0, 90.0), stretch(1.5, 2.5, 8.0)]),
        "end": SimpleNamespace(worst=[stretch(1.9, 3.0, 300.0), stretch(1.5, 4.0, 40.0, "other")]),
    }
    noise = {"start": 1.0, "end": 10.0}
    found = module._merged(SimpleNamespace(sensors=sensors), noise)
    assert [(s.start_s, s.recording, taps) for s, taps in found] == [
        (1.0, None, ["start", "end"]), (1.5, "other", ["end"]),
    ]  # fmt: skip


def test_a_command_that_a_recording_lacks_is_none_there(truth: Recording) -> None:
    rig = valve_rig()
    more = {**truth.commands, "spare": Signal(np.array([0.0]), np.array([3.5]))}
    both = [dataclasses.replace(truth.until(0.6), commands=more), truth.until(0.5)]
    both[1] = dataclasses.replace(both[1], name="bare")
    series = compare(both, [("tube", rig, None)], refine=False).series
    spare, begin = series.command["spare"], series.begins_s[1]
    time = np.array(series.time_s)
    assert {x for x, t in zip(spare, time, strict=True) if t < begin} == {3.5}
    assert {x for x, t in zip(spare, time, strict=True) if t >= begin} == {None}
    assert None not in series.command["volts"]
