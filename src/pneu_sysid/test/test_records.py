# SPDX-License-Identifier: Apache-2.0
"""Recordings are read onto a uniform grid, and each defect is found, handled and told."""

import os
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import ValidationError
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from pneu_sim.channels import Channel, TextFormat
from pneu_sim.errors import InputError
from pneu_sysid.records import Recording, bag_topics, noise_floor_pa, read_recording

EPOCH_NS = 1_760_000_000_000_000_000
STEP_NS = 2_000_000  # 500 Hz
PRESSURE = "sensor_msgs/msg/FluidPressure"
FLOAT = "std_msgs/msg/Float64"
COMMANDS = {"valve": Channel(topic="/valve/voltage", type="std_msgs/Float64")}
PRESSURES = {"end": Channel(topic="/taps/end/pressure", field="fluid_pressure", type=PRESSURE)}

Row = tuple[str, str, int, Any]  # topic, type, log time ns, value or message

STORE = get_typestore(Stores.ROS2_JAZZY)
STORE.register(get_types_from_msg("float32 bar\nstring unit\n", "lab_msgs/msg/Gauge"))


def fluid_pressure(stamp_ns: int, value: float) -> Any:
    types = STORE.types
    stamp = types["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="end")
    return types[PRESSURE](header=header, fluid_pressure=float(value), variance=0.0)


def write_bag(
    path: Path, rows: Sequence[Row], mode: CompressionMode = CompressionMode.NONE
) -> Path:
    """Write rows in the order given, as a recorder does on arrival."""
    writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connections = {}
        for topic, msgtype, log_ns, message in rows:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, msgtype, typestore=STORE)
            if msgtype == FLOAT:
                message = STORE.types[FLOAT](data=float(message))
            raw = STORE.serialize_cdr(message, msgtype)
            writer.write(connections[topic], log_ns, raw)
    return path


def tap_rows(
    stamp_ns: NDArray[Any],
    values: NDArray[np.floating[Any]],
    log_ns: NDArray[Any] | None = None,
    topic: str = "/taps/end/pressure",
) -> list[Row]:
    log_ns = stamp_ns if log_ns is None else log_ns
    return [
        (topic, PRESSURE, int(log), fluid_pressure(int(stamp), value))
        for stamp, log, value in zip(stamp_ns, log_ns, values, strict=True)
    ]


def valve_rows(stamp_ns: NDArray[Any], values: NDArray[np.floating[Any]]) -> list[Row]:
    return [("/valve/voltage", FLOAT, int(t), v) for t, v in zip(stamp_ns, values, strict=True)]


def even(count: int = 400) -> NDArray[Any]:
    return EPOCH_NS + STEP_NS * np.arange(count, dtype=np.int64)


def ramp(stamp_ns: NDArray[Any]) -> NDArray[np.floating[Any]]:
    """Return a pressure linear in time, which interpolation must reproduce."""
    return 2.0e5 + 5.0e4 * (stamp_ns - EPOCH_NS) * 1e-9


def whole_bag(path: Path, mode: CompressionMode = CompressionMode.NONE) -> Path:
    t = even()
    rows = tap_rows(t, ramp(t)) + valve_rows(t, np.where(np.arange(400) < 100, 5.0, 7.5))
    return write_bag(path, sorted(rows, key=lambda row: row[2]), mode)


def read(path: Path, **kwargs: Any) -> Recording:
    return read_recording(path, **{"commands": COMMANDS, "pressures": PRESSURES, **kwargs})


def refusal(path: Path, **kwargs: Any) -> str:
    """Return the message of the refusal, which must be one sentence naming the file."""
    with pytest.raises(InputError) as caught:
        read(path, **kwargs)
    message = str(caught.value)
    assert "\n" not in message
    assert str(path) in message
    return message


def kinds(recording: Recording, channel: str = "end") -> dict[str, int]:
    return {f.kind: f.count for f in recording.report if f.channel == channel}


# ---- what is whole is taken unaltered -----------------------------------------------------------


@pytest.mark.parametrize(
    "mode",
    [CompressionMode.NONE, CompressionMode.MESSAGE, CompressionMode.FILE, CompressionMode.STORAGE],
)
def test_samples_on_a_grid_are_unaltered(tmp_path: Path, mode: CompressionMode) -> None:
    recording = read(whole_bag(tmp_path / "run", mode))
    assert recording.name == "run"
    assert recording.rate_hz == pytest.approx(500.0, rel=1e-12)
    assert recording.start_time_s == pytest.approx(EPOCH_NS * 1e-9)
    np.testing.assert_allclose(recording.time_s, 0.002 * np.arange(400), atol=1e-9)
    np.testing.assert_array_equal(recording.pressures["end"], ramp(even()))
    np.testing.assert_array_equal(
        recording.commands["valve"], np.where(np.arange(400) < 100, 5.0, 7.5)
    )
    assert recording.report == []


def test_bare_file_and_folder_without_metadata(tmp_path: Path) -> None:
    folder = whole_bag(tmp_path / "run")
    bare = shutil.copy(folder / "run.mcap", tmp_path / "bare.mcap")
    whole = read(folder).pressures["end"]
    np.testing.assert_array_equal(read(Path(bare)).pressures["end"], whole)
    (folder / "metadata.yaml").unlink()
    orphan = read(folder)
    np.testing.assert_array_equal(orphan.pressures["end"], whole)
    assert kinds(orphan, "run") == {"no_metadata": 1}


def test_split_bag_is_read_in_listed_order(tmp_path: Path) -> None:
    t = even()
    one, two = (
        write_bag(tmp_path / name, tap_rows(part, ramp(part)) + valve_rows(part, part * 0.0))
        for name, part in (("b", t[:200]), ("a", t[200:]))
    )
    shutil.copy(two / "a.mcap", one / "a.mcap")
    meta = (one / "metadata.yaml").read_text()
    assert "- b.mcap" in meta and "message_count: 400" in meta
    (one / "metadata.yaml").write_text(
        meta.replace("- b.mcap", "- b.mcap\n  - a.mcap").replace(
            "message_count: 400", "message_count: 800"
        )
    )
    np.testing.assert_array_equal(read(one).pressures["end"], ramp(t))


def test_type_known_only_to_the_bag_is_decoded_and_scaled(tmp_path: Path) -> None:
    gauge = STORE.types["lab_msgs/msg/Gauge"]
    rows: list[Row] = [
        ("/gauge", "lab_msgs/msg/Gauge", int(t), gauge(bar=i / 8, unit="bar"))
        for i, t in enumerate(even(64))
    ]
    path = write_bag(tmp_path / "run", rows)
    channel = Channel(topic="/gauge", field="bar", scale=1e5, offset=101_325.0)
    recording = read(path, commands={}, pressures={"g": channel})
    np.testing.assert_allclose(recording.pressures["g"], 101_325.0 + 12_500.0 * np.arange(64))
    assert bag_topics(path) == {"/gauge": ("lab_msgs/msg/Gauge", 64)}
    text = refusal(path, commands={}, pressures={"g": Channel(topic="/gauge", field="unit")})
    assert "string, not a number" in text


def test_array_elements_share_one_topic(tmp_path: Path) -> None:
    types = STORE.types
    state = types["sensor_msgs/msg/JointState"]
    rows: list[Row] = []
    for i, t in enumerate(even(50)):
        header = fluid_pressure(int(t), 0.0).header
        position = np.array([1e5 + i, 2e5 - i])
        rows.append(
            (
                "/joints",
                "sensor_msgs/msg/JointState",
                int(t),
                state(header, ["a", "b"], position, np.zeros(0), np.zeros(0)),
            )
        )
    path = write_bag(tmp_path / "run", rows)
    taps = {f"p{k}": Channel(topic="/joints", field=f"position[{k}]") for k in (0, 1)}
    recording = read(path, commands={}, pressures=taps)
    np.testing.assert_array_equal(recording.pressures["p0"], 1e5 + np.arange(50))
    np.testing.assert_array_equal(recording.pressures["p1"], 2e5 - np.arange(50))
    for field, said in (
        ("position[2]", "no message has"),
        ("position", "is an array"),
        ("header", "not a number"),
        ("header.stamp.sec.x", "without fields"),
        ("a b", "not a path"),
    ):
        one = {"p": Channel(topic="/joints", field=field)}
        assert said in refusal(path, commands={}, pressures=one)


def test_part_of_a_recording(tmp_path: Path) -> None:
    recording = read(whole_bag(tmp_path / "run"), start_s=0.1, end_s=0.3)
    np.testing.assert_array_equal(recording.pressures["end"], ramp(even())[50:151])
    assert recording.time_s[0] == 0.0
    assert recording.start_time_s == pytest.approx(EPOCH_NS * 1e-9 + 0.1, abs=1e-6)
    assert recording.commands["valve"][49:51].tolist() == [5.0, 7.5]
    assert "0 usable" in refusal(tmp_path / "run", start_s=5.0)


def test_reading_is_fast(tmp_path: Path) -> None:
    t = even(7500)
    rows = [
        row for k in range(5) for row in tap_rows(t, ramp(t), topic=f"/taps/{k}/pressure")
    ] + valve_rows(t, t * 0.0)
    path = write_bag(tmp_path / "run", rows)
    taps = {str(k): Channel(topic=f"/taps/{k}/pressure", field="fluid_pressure") for k in range(5)}
    begin = os.times()
    recording = read(path, pressures=taps)
    end = os.times()
    assert len(recording.time_s) == 7500
    assert end.user - begin.user < 4.0  # about 0.4 s; the bound leaves room for a busy machine


# ---- clocks -----------------------------------------------------------------------------------


def test_header_stamps_win_over_a_jittered_log(tmp_path: Path) -> None:
    t = even()
    late = np.sort(t + np.random.default_rng(1).integers(1_000_000, 9_000_000, t.size))
    path = write_bag(tmp_path / "run", tap_rows(t, ramp(t), late) + valve_rows(t, t * 0.0))
    by_header = read(path)
    np.testing.assert_array_equal(by_header.pressures["end"], ramp(t))
    log = {"end": PRESSURES["end"].model_copy(update={"stamp": "log"})}
    assert "irregular" in kinds(read(path, pressures=log))


def test_simulated_time_in_headers_falls_back_to_the_log(tmp_path: Path) -> None:
    t = even()
    path = write_bag(
        tmp_path / "run", tap_rows(t - EPOCH_NS + 10**9, ramp(t), t) + valve_rows(t, t * 0.0)
    )
    recording = read(path)
    np.testing.assert_array_equal(recording.pressures["end"], ramp(t))
    assert "clock_offset" in kinds(recording)
    header = {"end": PRESSURES["end"].model_copy(update={"stamp": "header"})}
    assert "no time in common" in refusal(path, pressures=header)


def test_offset_between_clocks_is_told(tmp_path: Path) -> None:
    t = even()
    rows = tap_rows(t, ramp(t), t + 150_000_000) + valve_rows(t, t * 0.0)
    finding = next(f for f in read(write_bag(tmp_path / "run", rows)).report)
    assert finding.kind == "clock_offset"
    assert "0.15 s before the log time" in finding.action


def test_zero_header_stamps_are_absent(tmp_path: Path) -> None:
    t = even()
    path = write_bag(tmp_path / "run", tap_rows(t * 0, ramp(t), t) + valve_rows(t, t * 0.0))
    recording = read(path)
    assert kinds(recording) == {"no_header_stamp": 400}
    np.testing.assert_array_equal(recording.pressures["end"], ramp(t))


def test_header_clock_that_jumps_back_is_put_back_on_the_log_clock(tmp_path: Path) -> None:
    t = even()
    stamp = t.copy()
    stamp[250:] -= 300_000_000
    path = write_bag(tmp_path / "run", tap_rows(stamp, ramp(t), t) + valve_rows(t, t * 0.0))
    recording = read(path)
    assert kinds(recording)["clock_jump"] == 1
    np.testing.assert_array_equal(recording.pressures["end"], ramp(t))


def test_all_clocks_jump_back_and_the_longest_stretch_is_kept(tmp_path: Path) -> None:
    t = even()
    stamp = t.copy()
    stamp[150:] -= 5_000_000_000
    volts = np.arange(400.0)
    rows = [
        row
        for pair in zip(tap_rows(stamp, ramp(t)), valve_rows(stamp, volts), strict=True)
        for row in pair
    ]
    recording = read(write_bag(tmp_path / "run", rows))
    assert "clock_jump" in kinds(recording) or "clock_jump" in kinds(recording, "valve")
    np.testing.assert_array_equal(recording.pressures["end"], ramp(t)[150:])
    np.testing.assert_array_equal(recording.commands["valve"], volts[150:])


@pytest.mark.parametrize("where", [0, 200, 399])
def test_one_wild_stamp_costs_one_sample(tmp_path: Path, where: int) -> None:
    t = even()
    stamp = t.copy()
    stamp[where] += 10**17 if where else -(10**17)
    path = write_bag(tmp_path / "run", tap_rows(stamp, ramp(t), t) + valve_rows(t, t * 0.0))
    recording = read(path)
    assert "clock_jump" in kinds(recording)
    pressure = recording.pressures["end"]
    assert len(pressure) >= 399
    first = round((recording.start_time_s - EPOCH_NS * 1e-9) / 0.002)
    expected = ramp(t)[first : first + len(pressure)]
    np.testing.assert_allclose(pressure, expected, rtol=1e-9)


# ---- samples ----------------------------------------------------------------------------------


def test_duplicates_and_late_samples(tmp_path: Path) -> None:
    t = even()
    order = np.arange(400)
    order[[100, 101]] = order[[101, 100]]
    order[200:204] = [203, 200, 201, 202]
    order = np.insert(order, 300, 299)
    volts = np.arange(400.0)
    repeated = valve_rows(t[order], volts[order])
    repeated[300] = ("/valve/voltage", FLOAT, int(t[299]), -1.0)
    path = write_bag(tmp_path / "run", tap_rows(t[order], ramp(t)[order]) + repeated)
    recording = read(path)
    assert kinds(recording) == {"out_of_order": 4, "duplicate": 1}
    assert kinds(recording, "valve") == {"out_of_order": 4, "duplicate": 1}
    np.testing.assert_array_equal(recording.pressures["end"], ramp(t))
    volts[299] = -1.0  # of two commands at one instant the later to arrive stands
    np.testing.assert_array_equal(recording.commands["valve"], volts)


def test_missing_is_bridged_and_a_gap_is_nan(tmp_path: Path) -> None:
    t = even()
    keep = np.ones(400, dtype=bool)
    keep[[50, 80, 81]] = False  # neighbours 2 and 3 periods apart: bridged
    keep[200:210] = False
    path = write_bag(tmp_path / "run", tap_rows(t[keep], ramp(t)[keep]) + valve_rows(t, t * 0.0))
    recording = read(path)
    found = kinds(recording)
    assert (found["missing"], found["gap"], found["interpolated"]) == (3, 1, 3)
    expected = ramp(t)
    expected[200:210] = np.nan
    np.testing.assert_allclose(recording.pressures["end"], expected, rtol=1e-12)


def test_nan_and_inf_are_missing(tmp_path: Path) -> None:
    t = even()
    values = ramp(t)
    values[[10, 20]] = [np.nan, np.inf]
    volts = np.where(np.arange(400) == 30, np.nan, 6.0)
    path = write_bag(tmp_path / "run", tap_rows(t, values) + valve_rows(t, volts))
    recording = read(path)
    assert kinds(recording)["not_finite"] == 2
    np.testing.assert_allclose(recording.pressures["end"], ramp(t), rtol=1e-12)
    assert np.all(recording.commands["valve"] == 6.0)


def test_jittered_samples_are_interpolated(tmp_path: Path) -> None:
    jitter = np.random.default_rng(2).integers(-600_000, 600_000, 400)
    t = even() + jitter
    path = write_bag(tmp_path / "run", tap_rows(t, ramp(t)) + valve_rows(even(), t * 0.0))
    recording = read(path)
    found = kinds(recording)
    assert found["irregular"] > 200 and found["interpolated"] > 200
    assert recording.rate_hz == pytest.approx(500.0, rel=1e-3)
    clock_ns = np.rint((recording.start_time_s + recording.time_s) * 1e9).astype(np.int64)
    # A snapped sample stands up to 5 % of a period (5 Pa here) from its grid point.
    np.testing.assert_allclose(recording.pressures["end"], ramp(clock_ns), atol=6.0)


def test_commands_are_held_not_interpolated(tmp_path: Path) -> None:
    t = even()
    sent = t[[0, 37, 38, 150, 320]]
    path = write_bag(
        tmp_path / "run", tap_rows(t, ramp(t)) + valve_rows(sent, np.array([1.0, 2, 3, 4, 5]))
    )
    recording = read(path)
    expected = np.repeat([1.0, 2.0, 3.0, 4.0, 5.0], [37, 1, 112, 170, 80])
    np.testing.assert_array_equal(recording.commands["valve"], expected)
    assert kinds(recording, "valve") == {"event_driven": 5}


def test_grid_starts_where_commands_are_known(tmp_path: Path) -> None:
    t = even()
    path = write_bag(
        tmp_path / "run", tap_rows(t, ramp(t)) + valve_rows(t[40:300], np.arange(260.0))
    )
    recording = read(path)
    np.testing.assert_array_equal(recording.pressures["end"], ramp(t)[40:300])
    np.testing.assert_array_equal(recording.commands["valve"], np.arange(260.0))
    assert kinds(recording, "valve") == {"cropped": 1}


def test_rates_differ_and_a_rate_may_be_asked_for(tmp_path: Path) -> None:
    t = even()
    slow = t[::5]
    rows = (
        tap_rows(t, ramp(t))
        + tap_rows(slow, ramp(slow), topic="/slow")
        + tap_rows(t, ramp(t), topic="/third")
    )
    path = write_bag(tmp_path / "run", rows)
    taps = PRESSURES | {
        name: Channel(topic=f"/{name}", field="fluid_pressure") for name in ("slow", "third")
    }
    recording = read(path, commands={}, pressures=taps)
    assert recording.rate_hz == pytest.approx(500.0)
    np.testing.assert_allclose(recording.pressures["slow"][:396], ramp(t)[:396], rtol=1e-12)
    assert np.isnan(recording.pressures["slow"][396:]).all()
    tenth = read(path, commands={}, pressures=taps, rate_hz=50.0)
    np.testing.assert_array_equal(tenth.pressures["end"], ramp(t)[::10])


def test_frozen_and_suspicious_values(tmp_path: Path) -> None:
    t = even(2000)
    noisy = ramp(t) + np.random.default_rng(3).normal(0.0, 250.0, t.size)
    stuck = noisy.copy()
    stuck[500:900] = stuck[500]
    rows = (
        tap_rows(t, stuck)
        + tap_rows(t, t * 0.0 + 3e5, topic="/dead")
        + tap_rows(t, noisy * 1e-5, topic="/bar")
    )
    taps = PRESSURES | {
        name: Channel(topic=f"/{name}", field="fluid_pressure") for name in ("dead", "bar")
    }
    recording = read(write_bag(tmp_path / "run", rows), commands={}, pressures=taps)
    assert kinds(recording)["frozen"] == 399
    assert np.isnan(recording.pressures["end"][501:900]).all()
    np.testing.assert_array_equal(recording.pressures["end"][900:], noisy[900:])
    assert kinds(recording, "dead") == {"frozen": 2000}
    assert kinds(recording, "bar") == {"suspicious_unit": 2000}


def test_rest_without_noise_is_not_called_frozen(tmp_path: Path) -> None:
    t = even(2000)
    calm = np.maximum(ramp(t), 2.5e5)
    recording = read(write_bag(tmp_path / "run", tap_rows(t, calm)), commands={})
    assert recording.report == []
    np.testing.assert_array_equal(recording.pressures["end"], calm)


# ---- refusals ---------------------------------------------------------------------------------


def test_missing_and_foreign_paths(tmp_path: Path) -> None:
    assert "no such file" in refusal(tmp_path / "absent")
    (tmp_path / "empty").mkdir()
    assert "not a rosbag2 MCAP" in refusal(tmp_path / "empty")
    (tmp_path / "old.db3").write_bytes(b"SQLite format 3\0")
    assert "'.db3' storage is not read" in refusal(tmp_path / "old.db3")
    (tmp_path / "zero.mcap").write_bytes(b"")
    assert "not an MCAP file" in refusal(tmp_path / "zero.mcap")
    (tmp_path / "text.mcap").write_text("time,pressure\n" * 50)
    assert "not an MCAP file" in refusal(tmp_path / "text.mcap")
    bag = whole_bag(tmp_path / "run")
    meta = (bag / "metadata.yaml").read_text()
    (bag / "metadata.yaml").write_text(meta.replace("- run.mcap", "- other.mcap"))
    assert "lists 'other.mcap'" in refusal(bag)
    (bag / "metadata.yaml").write_text(meta.replace(": mcap", ": sqlite3"))
    assert "'sqlite3'" in refusal(bag)
    (bag / "metadata.yaml").write_text("{[")
    assert "not valid rosbag2 metadata" in refusal(bag)


@pytest.mark.parametrize("part", [0.01, 0.3, 0.6, 0.9])
def test_bag_cut_in_its_data_is_refused(tmp_path: Path, part: float) -> None:
    file = whole_bag(tmp_path / "run") / "run.mcap"
    size = file.stat().st_size
    os.truncate(file, int(part * size))
    bare = tmp_path / "bare.mcap"
    shutil.copy(file, bare)
    if part == 0.9:  # this cut is behind the data: nothing is lost but the index
        assert kinds(read(bare), "bare.mcap") == {"truncated": 1}
        return
    message = refusal(bare)
    assert "truncated" in message or "cut off" in message
    assert f"{int(part * size)} bytes" in message


def test_bag_cut_behind_its_last_chunk_is_read(tmp_path: Path) -> None:
    folder = whole_bag(tmp_path / "run")
    os.truncate(folder / "run.mcap", (folder / "run.mcap").stat().st_size - 20)
    recording = read(folder)
    assert kinds(recording, "run.mcap") == {"truncated": 1}
    np.testing.assert_array_equal(recording.pressures["end"], ramp(even()))
    meta = (folder / "metadata.yaml").read_text()
    assert "message_count: 800" in meta
    (folder / "metadata.yaml").write_text(meta.replace("message_count: 800", "message_count: 900"))
    assert "holds 800 of the 900 messages" in refusal(folder)


def test_flipped_bytes_are_refused(tmp_path: Path) -> None:
    file = whole_bag(tmp_path / "run") / "run.mcap"
    data = bytearray(file.read_bytes())
    data[len(data) // 3] ^= 0xFF
    file.write_bytes(data)
    assert "damaged" in refusal(tmp_path / "run" / "run.mcap")
    packed = whole_bag(tmp_path / "packed", CompressionMode.FILE) / "packed.mcap.zstd"
    os.truncate(packed, packed.stat().st_size // 2)
    with pytest.raises(InputError, match=r"packed\.mcap\.zstd"):
        read(tmp_path / "packed")


def test_wrong_topic_type_and_field(tmp_path: Path) -> None:
    bag = whole_bag(tmp_path / "run")

    def tap(**kwargs: Any) -> dict[str, dict[str, Channel]]:
        return {"pressures": {"end": Channel(**kwargs)}}

    message = refusal(bag, **tap(topic="/tap/end/pressure"))
    assert "no topic '/tap/end/pressure'" in message and "nearest: /taps/end/pressure" in message
    message = refusal(bag, **tap(topic="xyz"))
    assert "it has: /taps/end/pressure, /valve/voltage" in message
    message = refusal(bag, **tap(topic="/valve/voltage", type=PRESSURE))
    assert f"has message type {FLOAT}, expected {PRESSURE}" in message
    message = refusal(bag, **tap(topic="/taps/end/pressure", field="pressure"))
    assert "no field 'pressure'" in message and "header, fluid_pressure, variance" in message
    message = refusal(bag, **tap(topic="/valve/voltage", stamp="header"))
    assert "has no header stamp" in message
    assert "has no topic" in refusal(bag, **tap(column=1))
    assert "at least one is needed" in refusal(bag, pressures={})
    assert "rate_hz" in refusal(bag, rate_hz=-1.0)


def test_too_few_all_nan_and_no_overlap(tmp_path: Path) -> None:
    t = even()
    three = write_bag(tmp_path / "three", tap_rows(t[:3], ramp(t[:3])))
    assert "3 usable sample(s), at least 20" in refusal(three, commands={})
    nan = write_bag(tmp_path / "nan", tap_rows(t, t * np.nan))
    assert "all 400 values are NaN" in refusal(nan, commands={})
    apart = write_bag(tmp_path / "apart", tap_rows(t, ramp(t)) + valve_rows(t + 10**10, t * 0.0))
    message = refusal(apart, pressures={"end": PRESSURES["end"]})
    assert "no time in common: tap 'end'" in message


def test_channel_model_refuses_nonsense() -> None:
    bad: list[dict[str, Any]] = [
        {},
        {"topic": "/a", "scale": 0.0},
        {"topic": "/a", "scale": float("nan")},
        {"topic": "/a", "unit": "bar"},
        {"topic": "/a", "stamp": "receive"},
    ]
    for fields in bad:
        with pytest.raises(ValidationError):
            Channel(**fields)


# ---- text -------------------------------------------------------------------------------------


def test_grouped_thousands(tmp_path: Path) -> None:
    path = tmp_path / "chamber.csv"
    lines = [
        f"{ms // 1000}.{ms % 1000:03d}.000" if ms > 999 else f"{ms}.000"
        for ms in range(0, 4000, 100)
    ]
    path.write_text("".join(f"{t};3.658;{7.3 - 0.01 * i:.3f}\n" for i, t in enumerate(lines)))
    layout = TextFormat(delimiter=";", time_scale=1e-3, thousands_separator=".")
    tap = {"end": Channel(column=2, scale=1e5, offset=101_325.0)}
    recording = read(path, commands={}, pressures=tap, text=layout)
    assert recording.name == "chamber"
    assert recording.rate_hz == pytest.approx(10.0)
    expected = 101_325.0 + 1e5 * (7.3 - 0.01 * np.arange(40))
    np.testing.assert_allclose(recording.pressures["end"], expected, rtol=1e-12)


HEADING: list[tuple[Literal["plain", "comment", "names", "comma"], str]] = [
    ("plain", "# run 1\ntime(sec) pressure cmd\n"),
    ("comment", "# run 1\n# time(sec) pressure cmd\n"),
    ("names", "garbage line\n"),
    ("comma", '"time(sec)";"pressure";"cmd"\n'),
]


@pytest.mark.parametrize(("style", "heading"), HEADING)
def test_headings_and_decimal_commas(tmp_path: Path, style: str, heading: str) -> None:
    rows = [f"{0.01 * i:.3f} {10.0 + 0.5 * i:.3f} {i % 2}.0" for i in range(60)]
    layout = TextFormat(time="time(sec)")
    if style == "names":
        layout = TextFormat(time="time(sec)", names=("time(sec)", "pressure", "cmd"), skip_rows=1)
    if style == "comma":
        rows = [row.replace(" ", ";").replace(".", ",") for row in rows]
        layout = TextFormat(time="time(sec)", decimal=",")
    path = tmp_path / "run.dat"
    path.write_text(heading + "\n".join(rows) + "\n")
    recording = read(
        path,
        commands={"cmd": Channel(column="cmd")},
        pressures={"lung": Channel(column="pressure", scale=98.0665, offset=101_325.0)},
        text=layout,
    )
    assert recording.rate_hz == pytest.approx(100.0)
    np.testing.assert_allclose(
        recording.pressures["lung"], 101_325.0 + 98.0665 * (10.0 + 0.5 * np.arange(60))
    )
    np.testing.assert_array_equal(recording.commands["cmd"], np.arange(60) % 2)
    wrong = {"lung": Channel(column="flow")}
    message = refusal(path, commands={}, pressures=wrong, text=layout)
    assert "no column 'flow' (the file has: time(sec), pressure, cmd)" in message
    message = refusal(path, commands={}, pressures={"lung": Channel(column=3)}, text=layout)
    assert "no column 3; the rows have columns 0 to 2" in message


def test_spoilt_rows_of_text(tmp_path: Path) -> None:
    rows = [f"{0.1 * i:.1f},{1e5 + 10 * i:.1f}" for i in range(60)]
    rows[10] = "1.0,"
    rows[20] = "2.0,ERR"
    rows[30] = "x,100300.0"
    rows[59] = "5.9"  # cut off while it was written
    path = tmp_path / "run.csv"
    path.write_text("t,p\n" + "\n".join(rows))
    taps = {"end": Channel(column="p")}
    recording = read(path, commands={}, pressures=taps, text=TextFormat(time="t"))
    np.testing.assert_allclose(recording.pressures["end"], 1e5 + 10.0 * np.arange(59), rtol=1e-12)
    assert kinds(recording, "run.csv") == {"short_row": 1, "unreadable": 1}
    assert kinds(recording)["unreadable"] == 1 and kinds(recording)["not_finite"] == 2
    path.write_text("t,p\n" + "".join(f"{i},open\n" for i in range(30)))
    assert "not numeric (line 2 has 'open')" in refusal(path, commands={}, pressures=taps)
    path.write_text("")
    assert "holds no rows" in refusal(path, commands={}, pressures=taps)
    path.write_bytes(b"\xff\xfe\x00\x81" * 9)
    assert "is not text" in refusal(path, commands={}, pressures=taps)


# ---- noise ------------------------------------------------------------------------------------


def test_noise_floor_of_quantised_white_noise_on_transients() -> None:
    rng = np.random.default_rng(4)
    estimates = []
    for _ in range(20):
        t = np.arange(7500) / 500.0
        # Fills with 20 ms fronts every half second: they pass through most windows' quiet.
        true = 3e5 + 2e5 * np.tanh(np.sin(2.0 * np.pi * t) / 0.1)
        measured = true + rng.normal(0.0, 250.0, t.size)
        estimates.append(noise_floor_pa(np.round(measured / 170.0) * 170.0))
    expected = np.hypot(250.0, 170.0 / np.sqrt(12.0))
    assert np.mean(estimates) == pytest.approx(expected, rel=0.03)
    assert np.std(estimates) < 0.05 * expected


def test_noise_floor_at_the_edges() -> None:
    rng = np.random.default_rng(5)
    assert noise_floor_pa(np.full(500, 1e5)) == 0.0
    assert np.isnan(noise_floor_pa(np.full(500, np.nan)))
    assert np.isnan(noise_floor_pa([1.0, 2.0, 3.0]))
    # Noise below the resolution: most differences vanish, the rounding remains.
    slow = np.round(np.linspace(1e5, 1.02e5, 5000) / 100.0) * 100.0
    assert noise_floor_pa(slow) == pytest.approx(100.0 / np.sqrt(12.0), rel=0.05)
    holed = rng.normal(1e5, 80.0, 6000)
    holed[rng.integers(0, 6000, 20)] = np.nan
    assert noise_floor_pa(holed) == pytest.approx(80.0, rel=0.06)
    assert noise_floor_pa(rng.normal(0.0, 3.0, 40)) == pytest.approx(3.0, rel=0.7)
