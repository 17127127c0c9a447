# SPDX-License-Identifier: Apache-2.0
"""Spools are found from their measured positions, which recordings may have or lack."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from pneu_common.errors import InputError
from pneu_sim.rig.build import spool_row
from pneu_sim.rig.schema import Rig, Spool
from pneu_sim.signals import Signal
from pneu_sim.valve import positions_along
from pneu_sysid.problem import record_for
from pneu_sysid.records import Recording
from pneu_sysid.spool_position import SpoolFit, fit_spools

Floats = NDArray[np.float64]

RATE_HZ = 500.0
NOISE_V = 0.02
STORE = get_typestore(Stores.ROS2_JAZZY)
FLOAT = "std_msgs/msg/Float64"
START_NS = 1_700_000_000_000_000_000


def rig_of(position: dict[str, Any] | None = None, **spool: Any) -> Rig:
    """A valve on a tube, whose measured position is recorded."""
    port = {
        "from": "tank",
        "to": "end",
        "conductance_m3_s_pa": 1e-9,
        "opening": {"voltage_v": [0.0, 10.0], "fraction": [0.0, 1.0]},
    }
    valve = {
        "command": "volts",
        "position": position or {"topic": "/valve/position", "column": "spool"},
        "spool": spool,
        "ports": {"port": port},
    }
    return Rig.model_validate(
        {
            "name": "bench",
            "reservoirs": {"tank": {"pressure_pa": 3e5}},
            "pipes": {"tube": {"from": "end", "to": "closed", "length_m": 1.0, "area_m2": 1e-5}},
            "valves": {"valve": valve},
            "commands": {"volts": {"channel": {"topic": "/valve/voltage", "column": "volts"}}},
            "taps": {
                "end": {
                    "pipe": "tube",
                    "position_m": 0.5,
                    "channel": {"topic": "/end", "column": "end"},
                }
            },
        }
    )


def recorded(
    spool: dict[str, Any], seed: int, gain: float = 1.0, offset_v: float = 0.0, swing_v: float = 5.0
) -> Recording:
    """A noisy position along steps, then a sine that gets faster, between two readings of it."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 6.0, 1.0 / RATE_HZ)
    volts = np.full(time.size, 5.0)
    half, i = time.size // 2, 100
    while i < half:
        j = i + int(rng.integers(40, 120))
        volts[i:j] = 5.0 + rng.uniform(-swing_v, swing_v)
        i = j
    s = time[half:] - time[half]
    volts[half:] = 5.0 + 0.9 * swing_v * np.sin(2.0 * np.pi * (2.0 + 3.0 * s) * s)
    command = Signal(time, volts)
    step = 2e-5
    read = time[:-1] + 0.0007
    knots = int(6.0 / step)
    row = spool_row(Spool(**spool))
    path = positions_along(row, command, 0.0, step, knots)
    x = np.interp(read, step * np.arange(knots), path)
    shown = gain * x + offset_v + NOISE_V * rng.standard_normal(x.size)
    gas = Signal(read, 1e5 + rng.standard_normal(read.size))
    positions = {"valve": Signal(read, shown)}
    return Recording("steps", {"volts": command}, {"end": gas}, positions=positions)


def holds(found: SpoolFit, truth: dict[str, Any], limits: set[str]) -> None:
    """Requires a spool to be the true one within three standard errors, and nothing else."""
    assert set(found.limits) == limits
    assert found.rms_v == pytest.approx(NOISE_V, rel=0.05)
    fitted = {path.removeprefix("valves.valve.spool."): e for path, e in found.std_error.items()}
    assert fitted.keys() == truth.keys()
    for field, error in fitted.items():
        assert abs(getattr(found.spool, field) - truth[field]) < 3.0 * error, field
        if field != "delay_s":
            assert error < 0.1 * truth[field]


SPOOLS: list[dict[str, Any]] = [
    {"bandwidth_hz": 60.0, "damping": 0.7, "delay_s": 0.003},
    {"bandwidth_hz": 40.0, "damping": 0.9, "delay_s": 0.002, "max_speed_v_s": 400.0},
    {"bandwidth_hz": 80.0, "damping": 0.6, "delay_s": 0.0, "max_acceleration_v_s2": 3e5},
    {"bandwidth_hz": 50.0, "damping": 0.8, "delay_s": 0.004, "closing_delay_s": 0.007},
    {
        "bandwidth_hz": 70.0,
        "damping": 0.8,
        "delay_s": 0.004,
        "closing_delay_s": 0.002,
        "max_speed_v_s": 500.0,
        "max_acceleration_v_s2": 4e5,
    },
    {"delay_s": 0.004, "max_speed_v_s": 300.0},
    {"delay_s": 0.004},
]


@pytest.mark.long
@pytest.mark.parametrize("truth", SPOOLS, ids=lambda truth: "-".join(truth))
def test_a_spool_is_found_from_its_noisy_position(truth: dict[str, Any]) -> None:
    found = fit_spools(rig_of(bandwidth_hz=30.0), recorded(truth, 3))["valve"]
    holds(found, truth, {field for field in truth if field.startswith("max_")})
    assert found.gain == pytest.approx(1.0, abs=1e-3)
    assert (found.spool.bandwidth_hz is None) == ("bandwidth_hz" not in truth)


@pytest.mark.long
def test_a_sensor_of_another_gain_and_offset_does_not_matter() -> None:
    truth = {"bandwidth_hz": 60.0, "damping": 0.7, "delay_s": 0.003}
    found = fit_spools(rig_of(), recorded(truth, 4, 0.98, 0.05))["valve"]
    holds(found, truth, set())
    assert found.gain == pytest.approx(0.98, abs=1e-3)
    assert found.offset_v == pytest.approx(0.05, abs=5e-3)


@pytest.mark.long
def test_errors_that_are_alike_for_a_while_count() -> None:
    """The same scatter tells less where it is of low frequency; it makes no limits either."""
    truth = {"bandwidth_hz": 30.0, "damping": 0.8, "delay_s": 0.003}
    white = recorded(truth, 5)
    signal = white.positions["valve"]
    rng = np.random.default_rng(6)
    smooth = np.convolve(rng.standard_normal(len(signal) + 49), np.ones(50) / 50**0.5, "valid")
    alike = Recording("alike", white.commands, white.pressures)
    alike.positions["valve"] = Signal(signal.time_s, signal.values + 0.05 * smooth)
    one, two = (fit_spools(rig_of(), r)["valve"] for r in (white, alike))
    path = "valves.valve.spool.bandwidth_hz"
    assert two.std_error[path] > 3.0 * one.std_error[path]
    assert two.spool.bandwidth_hz == pytest.approx(30.0, abs=3.0 * two.std_error[path])
    assert two.limits == ()


@pytest.mark.long
def test_several_recordings_make_one_spool() -> None:
    truth = {"bandwidth_hz": 60.0, "damping": 0.7, "delay_s": 0.003}
    parts = [recorded(truth, seed) for seed in (7, 8)]
    blind = Recording("blind", parts[0].commands, parts[0].pressures)
    found = fit_spools(rig_of(), [*parts, blind])["valve"]
    holds(found, truth, set())
    assert found.readings > 1.8 * len(parts[0].positions["valve"])
    assert fit_spools(rig_of(), blind) == {}


@pytest.mark.long
def test_a_limit_in_the_file_stays_unless_the_position_contradicts_it() -> None:
    truth = {"bandwidth_hz": 60.0, "damping": 0.7, "delay_s": 0.003, "hysteresis_v": 0.1}
    gentle = recorded(truth, 9, swing_v=0.3)
    rig = rig_of(bandwidth_hz=50.0, hysteresis_v=0.1, max_speed_v_s=1000.0)
    found = fit_spools(rig, gentle)["valve"]
    assert found.spool.max_speed_v_s == 1000.0
    assert found.spool.hysteresis_v == 0.1
    assert found.limits == ()
    assert "valves.valve.spool.max_speed_v_s" not in found.std_error
    assert fit_spools(rig, recorded(truth, 9))["valve"].spool.max_speed_v_s is None


def test_a_command_that_never_changes_tells_nothing() -> None:
    still = recorded({"bandwidth_hz": 60.0}, 10)
    still.commands["volts"] = Signal(np.array([-1.0, 3.0]), np.array([5.0, 5.0]))
    assert fit_spools(rig_of(), still) == {}


@pytest.mark.parametrize(
    ("gain", "offset", "said"),
    [(10.0, 0.0, r"found 10 V measured .* 0\.5 to 2; .* scale: 0\.1"), (-1.0, 10.0, r"found -1 V")],
)
def test_a_position_in_percent_is_refused_in_one_sentence(
    gain: float, offset: float, said: str
) -> None:
    wrong = recorded({"bandwidth_hz": 60.0}, 11, gain, offset)
    with pytest.raises(InputError, match=said) as caught:
        fit_spools(rig_of(), wrong)
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith("rig 'bench', recording steps: valves.valve.position (topic /valve/")


def test_a_position_of_something_else_is_refused() -> None:
    wrong = recorded({"bandwidth_hz": 60.0}, 12)
    signal = wrong.positions["valve"]
    noise = np.random.default_rng(1).standard_normal(len(signal))
    wrong.positions["valve"] = Signal(signal.time_s, noise)
    with pytest.raises(InputError, match=r"is it the position of this valve's spool\?"):
        fit_spools(rig_of(), wrong)


def test_the_first_part_of_a_recording_keeps_its_positions() -> None:
    whole = recorded({"bandwidth_hz": 60.0}, 13)
    part = whole.until(2.0).positions["valve"]
    assert 0 < len(part) < len(whole.positions["valve"])
    assert part.time_s[-1] <= 2.0


# ---- recordings --------------------------------------------------------------------------------


def bag_of(path: Path, recording: Recording, topics: dict[str, Signal]) -> Path:
    """A bag of the command, the tap and whatever else."""
    signals = {
        "/valve/voltage": recording.commands["volts"],
        "/end": recording.pressures["end"],
        **topics,
    }
    events = [
        (round(t * 1e9), topic, value)
        for topic, signal in signals.items()
        for t, value in zip(signal.time_s, signal.values.tolist(), strict=True)
    ]
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {t: writer.add_connection(t, FLOAT, typestore=STORE) for t in signals}
        for at, topic, value in sorted(events):
            data = STORE.serialize_cdr(STORE.types[FLOAT](data=value), FLOAT)
            writer.write(connections[topic], START_NS + at, data)
    return path


def text_of(path: Path, recording: Recording, spool: Floats | None, heading: str = "spool") -> Path:
    """A table of the command, the tap and perhaps the position; NaN is an empty cell."""
    end = recording.pressures["end"]
    columns = [end.time_s, recording.commands["volts"].held(end.time_s), end.values]
    columns += [] if spool is None else [spool]
    rows = [
        ",".join("" if np.isnan(x) else repr(float(x)) for x in row)
        for row in zip(*columns, strict=True)
    ]
    names = "t,volts,end" + ("" if spool is None else f",{heading}")
    path.write_text("\n".join([names, *rows]) + "\n", encoding="utf-8")
    return path


PERCENT = {"topic": "/valve/position", "column": "spool", "scale": 0.1, "offset": -0.5}


@pytest.mark.parametrize("kind", ["bag", "text"])
def test_positions_are_read_through_their_channel(tmp_path: Path, kind: str) -> None:
    recording = recorded({"bandwidth_hz": 60.0}, 14)
    signal = recording.positions["valve"]
    raw = 10.0 * signal.values + 5.0
    if kind == "bag":
        topics = {"/valve/position": Signal(signal.time_s, raw)}
        path = bag_of(tmp_path / "bag", recording, topics)
    else:
        path = text_of(tmp_path / "table.csv", recording, raw)
    back = record_for(rig_of(PERCENT), str(path))
    np.testing.assert_allclose(back.positions["valve"].values, signal.values, atol=1e-9)
    np.testing.assert_allclose(back.positions["valve"].time_s, signal.time_s - 0.0007, atol=2e-9)
    assert not [f for f in back.report if f.channel == "valve.position"]


def missing(recording: Recording) -> str:
    """What is said of the position that a recording lacks."""
    assert recording.positions == {}
    assert len(recording.pressures["end"]) > 1000
    found = [f for f in recording.report if f.channel == "valve.position"]
    assert found[-1].kind == "absent"
    return found[-1].action


def test_a_bag_may_lack_the_position(tmp_path: Path) -> None:
    recording = recorded({"bandwidth_hz": 60.0}, 15)
    rig, few = rig_of(), recording.positions["valve"].within(0.0, 0.02)
    none = Signal(np.empty(0), np.empty(0))
    wordless = "topic '/valve/position' has no message in the bag"
    assert wordless in missing(record_for(rig, str(bag_of(tmp_path / "a", recording, {}))))
    silent = bag_of(tmp_path / "b", recording, {"/valve/position": none})
    assert wordless in missing(record_for(rig, str(silent)))
    short = bag_of(tmp_path / "c", recording, {"/valve/position": few})
    assert "10 usable sample(s) of 10" in missing(record_for(rig, str(short)))
    lost = Signal(few.time_s, np.full(len(few), np.nan))
    empty = bag_of(tmp_path / "d", recording, {"/valve/position": lost})
    assert "all 10 values are missing" in missing(record_for(rig, str(empty)))
    assert "no topic" in missing(record_for(rig_of({"column": 3}), str(tmp_path / "a")))


def test_a_table_may_lack_the_position(tmp_path: Path) -> None:
    recording = recorded({"bandwidth_hz": 60.0}, 16)
    bare = str(text_of(tmp_path / "a.csv", recording, None))
    assert "the file has no column 'spool'" in missing(record_for(rig_of(), bare))
    assert "the file has no column 3" in missing(record_for(rig_of({"column": 3}), bare))
    assert "it has no column" in missing(record_for(rig_of({"topic": "/p"}), bare))
    values = np.full(len(recording.pressures["end"]), np.nan)
    holed = str(text_of(tmp_path / "b.csv", recording, values))
    assert "values are missing" in missing(record_for(rig_of(), holed))


def test_a_spool_at_rest_is_no_stuck_sensor(tmp_path: Path) -> None:
    """A coarse converter shows one value for as long as the spool rests."""
    recording = recorded({"bandwidth_hz": 60.0}, 17)
    signal = recording.positions["valve"]
    values = np.where(signal.time_s < 3.0, np.round(signal.values, 3), 5.0)
    bag = bag_of(tmp_path / "bag", recording, {"/valve/position": Signal(signal.time_s, values)})
    assert len(record_for(rig_of(), str(bag)).positions["valve"]) == len(signal)
