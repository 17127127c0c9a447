# SPDX-License-Identifier: Apache-2.0
"""Recordings are read at their own times, and each defect is found, handled and told."""

import csv
import os
import re
import shutil
import socket
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
import zstandard
from mcap.opcode import Opcode
from mcap.writer import CompressionType as McapCompression
from mcap.writer import Writer as McapWriter
from numpy.typing import NDArray
from pydantic import ValidationError
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from pneu_common.errors import InputError
from pneu_graph.bag import unpacking
from pneu_sim.channels import Channel, TextFormat
from pneu_sysid.records import Recording, Signal, bag_topics, read_recording
from pneu_sysid.records.bag import read_joints, read_messages

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
    """Return a pressure that tells its time."""
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


def seconds(stamp_ns: NDArray[Any], origin_ns: int = EPOCH_NS) -> NDArray[np.float64]:
    """Return stamps in s after an origin, to the last bit."""
    return np.array([(int(stamp) - origin_ns) / 1e9 for stamp in stamp_ns])


def same(signal: Signal, time_s: NDArray[Any], values: Any) -> None:
    """Require samples to be these, to the last bit."""
    np.testing.assert_array_equal(signal.time_s, time_s)
    np.testing.assert_array_equal(signal.values, values)


def said(recording: Recording, kind: str, channel: str = "end") -> str:
    return next(f.action for f in recording.report if (f.channel, f.kind) == (channel, kind))


def kinds(recording: Recording, channel: str = "end") -> dict[str, int]:
    return {f.kind: f.count for f in recording.report if f.channel == channel}


# ---- what is whole is taken unaltered -----------------------------------------------------------


@pytest.mark.parametrize(
    "mode",
    [CompressionMode.NONE, CompressionMode.MESSAGE, CompressionMode.FILE, CompressionMode.STORAGE],
)
def test_samples_are_unaltered(tmp_path: Path, mode: CompressionMode) -> None:
    recording = read(whole_bag(tmp_path / "run", mode))
    assert recording.name == "run"
    assert recording.start_time_s == EPOCH_NS / 1e9
    assert recording.end_s == 399 * 0.002
    same(recording.pressures["end"], seconds(even()), ramp(even()))
    same(recording.commands["valve"], seconds(even()), np.where(np.arange(400) < 100, 5.0, 7.5))
    assert recording.report == []


def test_bare_file_and_folder_without_metadata(tmp_path: Path) -> None:
    folder = whole_bag(tmp_path / "run")
    bare = shutil.copy(folder / "run.mcap", tmp_path / "bare.mcap")
    whole = read(folder).pressures["end"].values
    np.testing.assert_array_equal(read(Path(bare)).pressures["end"].values, whole)
    (folder / "metadata.yaml").unlink()
    orphan = read(folder)
    np.testing.assert_array_equal(orphan.pressures["end"].values, whole)
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
    same(read(one).pressures["end"], seconds(t), ramp(t))


def test_type_known_only_to_the_bag_is_decoded_and_scaled(tmp_path: Path) -> None:
    gauge = STORE.types["lab_msgs/msg/Gauge"]
    rows: list[Row] = [
        ("/gauge", "lab_msgs/msg/Gauge", int(t), gauge(bar=i / 8, unit="bar"))
        for i, t in enumerate(even(64))
    ]
    path = write_bag(tmp_path / "run", rows)
    channel = Channel(topic="/gauge", field="bar", scale=1e5, offset=101_325.0)
    recording = read(path, commands={}, pressures={"g": channel})
    expected = 101_325.0 + 12_500.0 * np.arange(64)
    np.testing.assert_allclose(recording.pressures["g"].values, expected)
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
    same(recording.pressures["p0"], seconds(even(50)), 1e5 + np.arange(50))
    same(recording.pressures["p1"], seconds(even(50)), 2e5 - np.arange(50))
    for field, words in (
        ("position[2]", "no message has"),
        ("position", "is an array"),
        ("header", "not a number"),
        ("header.stamp.sec.x", "without fields"),
        ("a b", "not a path"),
    ):
        one = {"p": Channel(topic="/joints", field=field)}
        assert words in refusal(path, commands={}, pressures=one)


def test_part_of_a_recording(tmp_path: Path) -> None:
    recording = read(whole_bag(tmp_path / "run"), start_s=0.1, end_s=0.3)
    t = even()
    begin_ns = int(t[50])
    same(recording.pressures["end"], seconds(t[50:151], begin_ns), ramp(t)[50:151])
    assert recording.start_time_s == begin_ns / 1e9
    # A valve that is late still answers to what was sent before.
    volts = np.where(np.arange(151) < 100, 5.0, 7.5)
    same(recording.commands["valve"], seconds(t[:151], begin_ns), volts)
    assert "0 usable" in refusal(tmp_path / "run", start_s=5.0)
    assert "2 usable sample(s) in the part read (of 400)" in refusal(
        tmp_path / "run", start_s=0.1, end_s=0.102
    )


@pytest.mark.long
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
    assert len(recording.pressures["4"]) == 7500
    assert end.user - begin.user < 4.0  # about 0.4 s; the bound leaves room for a busy machine


# ---- clocks -----------------------------------------------------------------------------------


def test_header_stamps_win_over_a_jittered_log(tmp_path: Path) -> None:
    t = even()
    late = np.sort(t + np.random.default_rng(1).integers(1_000_000, 9_000_000, t.size))
    path = write_bag(tmp_path / "run", tap_rows(t, ramp(t), late) + valve_rows(t, t * 0.0))
    same(read(path).pressures["end"], seconds(t), ramp(t))
    log = {"end": PRESSURES["end"].model_copy(update={"stamp": "log"})}
    by_log = read(path, pressures=log)
    assert "irregular" in kinds(by_log) and "keeps its time" in said(by_log, "irregular")
    same(by_log.pressures["end"], seconds(late, int(late[0])), ramp(t))


def test_simulated_time_in_headers_falls_back_to_the_log(tmp_path: Path) -> None:
    t = even()
    path = write_bag(
        tmp_path / "run", tap_rows(t - EPOCH_NS + 10**9, ramp(t), t) + valve_rows(t, t * 0.0)
    )
    recording = read(path)
    same(recording.pressures["end"], seconds(t), ramp(t))
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
    same(recording.pressures["end"], seconds(t), ramp(t))


def test_header_clock_that_jumps_back_is_put_back_on_the_log_clock(tmp_path: Path) -> None:
    t = even()
    stamp = t.copy()
    stamp[250:] -= 300_000_000
    path = write_bag(tmp_path / "run", tap_rows(stamp, ramp(t), t) + valve_rows(t, t * 0.0))
    recording = read(path)
    assert kinds(recording)["clock_jump"] == 1
    same(recording.pressures["end"], seconds(t), ramp(t))


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
    same(recording.pressures["end"], seconds(t[150:], int(t[150])), ramp(t)[150:])
    same(recording.commands["valve"], seconds(t[150:], int(t[150])), volts[150:])


def test_header_clock_that_runs_backwards_gives_way_to_the_log(tmp_path: Path) -> None:
    t = even()
    path = write_bag(tmp_path / "run", tap_rows(t[::-1], ramp(t), t) + valve_rows(t, t * 0.0))
    recording = read(path)
    assert kinds(recording) == {"clock_jump": 400}
    assert "run backwards" in said(recording, "clock_jump")
    same(recording.pressures["end"], seconds(t), ramp(t))
    header = {"end": PRESSURES["end"].model_copy(update={"stamp": "header"})}
    message = refusal(path, pressures=header)
    assert "tap 'end'" in message and "run backwards in 399 of 399 steps" in message


@pytest.mark.parametrize("kind", ["steady", "shuffled", "two clocks"])
def test_a_log_that_runs_backwards_is_refused(tmp_path: Path, kind: str) -> None:
    t = even()
    if kind == "steady":
        t = t[::-1]
    elif kind == "shuffled":
        t = np.random.default_rng(6).permutation(t)
    else:  # two computers write to one topic, and their clocks differ by a minute
        t = t + 60_000_000_000 * (np.arange(400) // 2 % 2)
    for rows in (tap_rows(t, ramp(t)), tap_rows(even(), ramp(even())) + valve_rows(t, t * 0.0)):
        path = write_bag(tmp_path / f"run{len(rows)}", rows)
        message = refusal(path, commands={} if len(rows) == 400 else COMMANDS)
        assert "run backwards in" in message and "steps" in message


def test_text_whose_time_falls_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("t,p\n" + "".join(f"{9.0 - 0.1 * i:.1f},{1e5 + i}\n" for i in range(60)))
    taps = {"end": Channel(column="p")}
    message = refusal(path, commands={}, pressures=taps, text=TextFormat(time="t"))
    assert "its times run backwards in 59 of 59 steps" in message


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
    first = round((recording.start_time_s - EPOCH_NS / 1e9) / 0.002)
    index = first + np.rint(pressure.time_s / 0.002).astype(int)
    np.testing.assert_array_equal(pressure.values, ramp(t)[index])


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
    same(recording.pressures["end"], seconds(t), ramp(t))
    volts[299] = -1.0  # of two commands at one instant the later to arrive stands
    same(recording.commands["valve"], seconds(t), volts)


def _when(recording: Recording, kind: str) -> list[Any]:
    """When what was found of a tap is, approximately."""
    return [
        (pytest.approx(a, abs=1e-6), pytest.approx(b, abs=1e-6))
        for a, b, finding in recording.marks()
        if (finding.channel, finding.kind) == ("end", kind)
    ]


def test_nothing_stands_in_for_what_is_missing(tmp_path: Path) -> None:
    t = even()
    keep = np.ones(400, dtype=bool)
    keep[[50, 80, 81]] = False  # neighbours 2 and 3 periods apart: no gap
    keep[200:210] = False
    path = write_bag(tmp_path / "run", tap_rows(t[keep], ramp(t)[keep]) + valve_rows(t, t * 0.0))
    recording = read(path)
    found = kinds(recording)
    assert found == {"missing": 3, "gap": 1}
    assert "0.022 s or 2.8 % of the recording in all" in said(recording, "gap")
    when = seconds(t)
    assert _when(recording, "gap") == [(when[199], when[210])]
    assert _when(recording, "missing") == [(when[49], when[51]), (when[79], when[82])]
    same(recording.pressures["end"], seconds(t[keep]), ramp(t)[keep])


@pytest.mark.parametrize("half", ["first", "last"])
def test_a_tap_missing_for_half_keeps_its_readings(tmp_path: Path, half: str) -> None:
    t = even()
    part = t[:200] if half == "last" else t[200:]
    rows = tap_rows(t, ramp(t)) + tap_rows(part, ramp(part), topic="/half")
    path = write_bag(tmp_path / "run", rows + valve_rows(t, t * 0.0))
    taps = PRESSURES | {"half": Channel(topic="/half", field="fluid_pressure")}
    recording = read(path, pressures=taps)
    same(recording.pressures["half"], seconds(part), ramp(part))
    same(recording.pressures["end"], seconds(t), ramp(t))
    assert kinds(recording) == {}
    assert kinds(recording, "half") == {"gap": 1}
    assert "50 % of the recording in all" in said(recording, "gap", "half")
    assert "\n" not in said(recording, "gap", "half")


def test_taps_that_take_turns(tmp_path: Path) -> None:
    t = even()
    rows = tap_rows(t[:200], ramp(t[:200])) + tap_rows(t[200:], ramp(t[200:]), topic="/other")
    path = write_bag(tmp_path / "run", rows)
    taps = PRESSURES | {"other": Channel(topic="/other", field="fluid_pressure")}
    recording = read(path, commands={}, pressures=taps)
    same(recording.pressures["other"], seconds(t[200:]), ramp(t[200:]))
    rows = tap_rows(t, ramp(t)) + tap_rows(t + 10**13, ramp(t), topic="/other")
    apart = write_bag(tmp_path / "apart", rows)
    assert "no time in common" in refusal(apart, commands={}, pressures=taps)


def test_nan_and_inf_are_missing(tmp_path: Path) -> None:
    t = even()
    values = ramp(t)
    values[[10, 20]] = [np.nan, np.inf]
    volts = np.where(np.arange(400) == 30, np.nan, 6.0)
    path = write_bag(tmp_path / "run", tap_rows(t, values) + valve_rows(t, volts))
    recording = read(path)
    assert kinds(recording)["not_finite"] == 2
    when = seconds(t)
    assert _when(recording, "not_finite") == [(when[10], when[10]), (when[20], when[20])]
    good = np.isfinite(values)
    same(recording.pressures["end"], seconds(t[good]), ramp(t)[good])
    assert len(recording.commands["valve"]) == 399
    assert np.all(recording.commands["valve"].values == 6.0)


def test_jittered_samples_keep_their_times(tmp_path: Path) -> None:
    jitter = np.random.default_rng(2).integers(-600_000, 600_000, 400)
    t = even() + jitter
    path = write_bag(tmp_path / "run", tap_rows(t, ramp(t)) + valve_rows(even(), t * 0.0))
    recording = read(path)
    (finding,) = (one for one in recording.report if one.kind == "irregular")
    off = np.diff(t) / np.median(np.diff(t)) - 1.0
    off = off[off <= 0.5]  # beyond that a sample is missing
    assert finding.count == np.sum(np.abs(off) > 0.1) > 200
    assert f", {100.0 * np.sqrt(np.mean(off**2)):.3g} % rms;" in finding.action
    inside = t >= EPOCH_NS  # the first command is there
    same(recording.pressures["end"], seconds(t[inside], int(t[inside][0])), ramp(t)[inside])


def test_uneven_instants_are_kept_to_the_nanosecond(tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    t = EPOCH_NS + np.cumsum(rng.integers(20_000_000, 50_000_001, 300))
    sent = t[0] - 7 + np.cumsum(rng.integers(1_000_000, 9_000_000, 2500)) - 30_000_000
    volts = rng.uniform(0.0, 10.0, sent.size)
    path = write_bag(tmp_path / "run", tap_rows(t, ramp(t)) + valve_rows(sent, volts))
    recording = read(path)
    begin_ns = int(t[0])
    same(recording.pressures["end"], seconds(t, begin_ns), ramp(t))
    used = sent <= t[-1]
    same(recording.commands["valve"], seconds(sent[used], begin_ns), volts[used])
    assert "gap" not in kinds(recording) and "missing" not in kinds(recording)


def test_commands_are_held_not_interpolated(tmp_path: Path) -> None:
    t = even()
    sent = t[[0, 37, 38, 150, 320]]
    path = write_bag(
        tmp_path / "run", tap_rows(t, ramp(t)) + valve_rows(sent, np.array([1.0, 2, 3, 4, 5]))
    )
    recording = read(path)
    same(recording.commands["valve"], seconds(sent), [1.0, 2, 3, 4, 5])
    expected = np.repeat([1.0, 2.0, 3.0, 4.0, 5.0], [37, 1, 112, 170, 80])
    np.testing.assert_array_equal(recording.commands["valve"].held(seconds(t)), expected)
    assert kinds(recording, "valve") == {"event_driven": 5}


def test_time_starts_where_commands_are_known(tmp_path: Path) -> None:
    t = even()
    path = write_bag(
        tmp_path / "run", tap_rows(t, ramp(t)) + valve_rows(t[40:300], np.arange(260.0))
    )
    recording = read(path)
    same(recording.pressures["end"], seconds(t[40:300], int(t[40])), ramp(t)[40:300])
    same(recording.commands["valve"], seconds(t[40:300], int(t[40])), np.arange(260.0))
    found = [(f.kind, f.count) for f in recording.report]
    assert found == [("cropped", 40), ("cropped", 100)]
    assert "in the 0.08 s before its first sample" in said(recording, "cropped", "valve")


def test_readings_before_the_first_of_two_commands_are_left_out(tmp_path: Path) -> None:
    t = even()
    other = [("/other", FLOAT, int(at) + 500_000, 3.0) for at in t[[100, 350]]]
    path = write_bag(tmp_path / "run", tap_rows(t, ramp(t)) + valve_rows(t, t * 0.0) + other)
    commands = COMMANDS | {"other": Channel(topic="/other", type=FLOAT)}
    recording = read(path, commands=commands)
    begin_ns = int(t[101])
    same(recording.pressures["end"], seconds(t[101:], begin_ns), ramp(t)[101:])
    # Known before time 0 and kept: what was sent then still moves the valve.
    same(recording.commands["valve"], seconds(t, begin_ns), t * 0.0)
    same(recording.commands["other"], [-0.0015, 0.4985], [3.0, 3.0])
    assert kinds(recording, "other") == {"event_driven": 2, "constant": 2, "cropped": 101}


def test_commands_begin_long_before_the_first_reading(tmp_path: Path) -> None:
    t = even()
    sent = np.array([EPOCH_NS - 7_000_000_003, EPOCH_NS - 1, EPOCH_NS + 5])
    path = write_bag(tmp_path / "run", tap_rows(t, ramp(t)) + valve_rows(sent, np.arange(3.0)))
    recording = read(path)
    same(recording.commands["valve"], np.array([-7.000000003, -1e-9, 5e-9]), np.arange(3.0))
    same(recording.pressures["end"], seconds(t), ramp(t))
    # One that was sent once holds, however long the rig then rests.
    once = write_bag(tmp_path / "once", tap_rows(t, ramp(t)) + valve_rows(sent[:1], np.ones(1)))
    same(read(once).commands["valve"], np.array([-7.000000003]), [1.0])


def test_no_reading_after_the_first_command(tmp_path: Path) -> None:
    t = even()
    late = np.array([t[-1] + 1, t[-1] + 50_000_000])
    path = write_bag(tmp_path / "none", tap_rows(t, ramp(t)) + valve_rows(late, np.ones(2)))
    assert "no time in common: tap 'end'" in refusal(path)
    path = write_bag(tmp_path / "few", tap_rows(t, ramp(t)) + valve_rows(t[390:392], np.ones(2)))
    assert "10 usable sample(s) in the part read (of 400), at least 20" in refusal(path)


def test_every_tap_keeps_its_rate(tmp_path: Path) -> None:
    t = even()
    slow, third = t[::5] + 333_333, t[::3] - 1
    rows = (
        tap_rows(t, ramp(t))
        + tap_rows(slow, ramp(slow), topic="/slow")
        + tap_rows(third, ramp(third), topic="/third")
    )
    path = write_bag(tmp_path / "run", rows)
    taps = PRESSURES | {
        name: Channel(topic=f"/{name}", field="fluid_pressure") for name in ("slow", "third")
    }
    recording = read(path, commands={}, pressures=taps)
    begin_ns = EPOCH_NS - 1
    assert recording.start_time_s == begin_ns / 1e9
    for name, stamp in (("end", t), ("slow", slow), ("third", third)):
        same(recording.pressures[name], seconds(stamp, begin_ns), ramp(stamp))
    assert recording.report == []


def test_a_rate_asked_for_thins_readings_and_no_command(tmp_path: Path) -> None:
    t = even()
    slow = t[::20]
    jitter = t + np.random.default_rng(8).integers(0, 900_000, t.size)
    rows = (
        tap_rows(t, ramp(t))
        + tap_rows(slow, ramp(slow), topic="/slow")
        + tap_rows(jitter, ramp(jitter), topic="/jitter")
    )
    path = write_bag(tmp_path / "run", rows + valve_rows(t, np.arange(400.0)))
    taps = PRESSURES | {
        name: Channel(topic=f"/{name}", field="fluid_pressure") for name in ("slow", "jitter")
    }
    recording = read(path, pressures=taps, rate_hz=50.0)
    same(recording.pressures["end"], seconds(t[::10]), ramp(t)[::10])
    same(recording.pressures["slow"], seconds(slow), ramp(slow))
    same(recording.commands["valve"], seconds(t), np.arange(400.0))
    assert kinds(recording) == {"thinned": 360} and kinds(recording, "slow") == {}
    assert "at most 50 per second" in said(recording, "thinned")
    uneven = recording.pressures["jitter"]
    assert len(uneven) in (40, 41)
    assert np.isin(uneven.values, ramp(jitter)).all()
    assert np.diff(uneven.time_s).min() > 0.017
    assert "8 reading(s) left at rate_hz 10" in refusal(path, rate_hz=10.0)


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
    assert _when(recording, "frozen") == [(seconds(t)[501], seconds(t)[899])]
    live = np.r_[:501, 900:2000]
    same(recording.pressures["end"], seconds(t[live]), stuck[live])
    assert kinds(recording, "dead") == {"frozen": 2000}
    assert kinds(recording, "bar") == {"suspicious_unit": 2000}


def test_rest_without_noise_is_not_called_frozen(tmp_path: Path) -> None:
    t = even(2000)
    calm = np.maximum(ramp(t), 2.5e5)
    recording = read(write_bag(tmp_path / "run", tap_rows(t, calm)), commands={})
    assert recording.report == []
    same(recording.pressures["end"], seconds(t), calm)


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
    assert "metadata.yaml: is not YAML, line 1" in refusal(bag)
    (bag / "metadata.yaml").write_text("{}")
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
    same(recording.pressures["end"], seconds(even()), ramp(even()))
    meta = (folder / "metadata.yaml").read_text()
    assert "message_count: 800" in meta
    (folder / "metadata.yaml").write_text(meta.replace("message_count: 800", "message_count: 900"))
    assert "holds 800 of the 900 messages" in refusal(folder)


def test_a_bag_cut_anywhere_says_what_is_lost(tmp_path: Path) -> None:
    """In a chunk, messages are lost and it is refused; behind the last one, only the index is."""
    whole = tmp_path / "whole.mcap"
    text, _ = STORE.generate_msgdef("std_msgs/msg/Float64")
    t = even(400)
    with whole.open("wb") as file:
        writer = McapWriter(file, chunk_size=2000, compression=McapCompression.NONE)
        writer.start(profile="ros2")
        schema = writer.register_schema("std_msgs/msg/Float64", "ros2msg", text.encode())
        channels = [writer.register_channel(name, "cdr", schema) for name in ("/volts", "/end")]
        for stamp in t:
            for channel, value in zip(channels, (5.0, 2e5), strict=True):
                message = STORE.types["std_msgs/msg/Float64"](data=value)
                raw = bytes(STORE.serialize_cdr(message, "std_msgs/msg/Float64"))
                writer.add_message(channel, int(stamp), raw, int(stamp))
        writer.finish()
    data = whole.read_bytes()
    records, at = [], len(b"\x89MCAP0\r\n")
    while data[at] != Opcode.DATA_END:
        end = at + 9 + int.from_bytes(data[at + 1 : at + 9], "little")
        records.append((data[at], at, end))
        at = end
    chunks = [k for k, (opcode, _, _) in enumerate(records) if opcode == Opcode.CHUNK]
    assert len(chunks) > 5
    mapped = {
        "commands": {"valve": Channel(topic="/volts")},
        "pressures": {"end": Channel(topic="/end")},
    }
    for k in range(chunks[1], len(records)):
        opcode, begin, end = records[k]
        cut = tmp_path / f"cut_{k}.mcap"
        cut.write_bytes(data[: (begin + end) // 2])
        if opcode == Opcode.CHUNK:
            assert "truncated or damaged" in refusal(cut, **mapped)
        elif k > chunks[-1]:  # in the index of the last chunk
            assert kinds(read(cut, **mapped), cut.name) == {"truncated": 1}


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
    expected = 101_325.0 + 1e5 * (7.3 - 0.01 * np.arange(40))
    np.testing.assert_array_equal(recording.pressures["end"].time_s, np.arange(40) / 10)
    np.testing.assert_allclose(recording.pressures["end"].values, expected, rtol=1e-12)


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
    lung = recording.pressures["lung"]
    np.testing.assert_array_equal(lung.time_s, np.arange(60) / 100)
    np.testing.assert_allclose(lung.values, 101_325.0 + 98.0665 * (10.0 + 0.5 * np.arange(60)))
    same(recording.commands["cmd"], np.arange(60) / 100, np.arange(60) % 2)
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
    good = np.setdiff1d(np.arange(59), [10, 20, 30])
    same(recording.pressures["end"], good / 10, 1e5 + 10.0 * good)
    assert kinds(recording, "run.csv") == {"short_row": 1, "unreadable": 1}
    assert kinds(recording)["unreadable"] == 1 and kinds(recording)["not_finite"] == 2
    path.write_text("t,p\n" + "".join(f"{i},open\n" for i in range(30)))
    assert "not numeric (line 2 has 'open')" in refusal(path, commands={}, pressures=taps)
    path.write_text("")
    assert "holds no rows" in refusal(path, commands={}, pressures=taps)
    path.write_bytes(b"\xff\xfe\x00\x81" * 9)
    assert "is not text" in refusal(path, commands={}, pressures=taps)


LAYOUTS = [
    TextFormat(delimiter=";", time="t", time_scale=1e-3, decimal=","),
    TextFormat(time="t", time_scale=60.0),
    TextFormat(delimiter="|", comment="%", time=2, skip_rows=2),
    TextFormat(delimiter=" ", time="t", time_scale=1e-6),
    TextFormat(delimiter="\t", time="t", thousands_separator="'", time_scale=1e-3),
    TextFormat(time="when", names=("b", "a", "when", "c"), skip_rows=1),
    TextFormat(delimiter=";", time="t", decimal=".", thousands_separator=".", time_scale=1e-3),
]


@pytest.mark.parametrize("guess", [False, True], ids=["told", "guessed"])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_each_layout_of_text(tmp_path: Path, layout: TextFormat, guess: bool) -> None:
    """Time is the third of four columns, and every channel has another scale and offset."""
    rng = np.random.default_rng(2)
    time_s = np.cumsum(rng.integers(50, 150, 40)) * 1e-3
    raw = {name: np.round(rng.uniform(-5000.0, 5000.0, 40), 3) for name in "bac"}

    def word(value: float, places: int) -> str:
        text = f"{abs(value):.{places}f}"
        head, _, tail = text.partition(".")
        group = layout.thousands_separator
        if group:
            head = re.sub(r"(?<=\d)(?=(\d{3})+$)", group, head)
        return ("-" if value < 0 else "") + head + layout.decimal + tail

    delimiter = layout.delimiter or ","
    rows = [
        delimiter.join(
            [word(raw["b"][k], 3), word(raw["a"][k], 3), word(time_s[k] / layout.time_scale, 12),
             word(raw["c"][k], 3)]
        )
        for k in range(40)
    ]  # fmt: skip
    head = [] if layout.names or layout.time == 2 else [delimiter.join("batc")]
    # rows that would do as readings, were they not skipped
    junk = [delimiter.join(["1", "2", f"{0.01 * k:.2f}", "4"]) for k in range(layout.skip_rows)]
    notes = [f"{layout.comment} a note"] if layout.comment != "#" or not layout.skip_rows else []
    path = tmp_path / "run.txt"
    path.write_text("\n".join([*junk, *notes, *head, *rows]) + "\n")
    by_number = layout.time == 2

    def column(name: str) -> str | int:
        return "ba_c".index(name) if by_number else name

    taps = {
        "first": Channel(column=column("a"), scale=1e2, offset=9e5),
        "second": Channel(column=column("c"), scale=-3.0, offset=2e5),
    }
    commands = {"volts": Channel(column=column("b"), scale=0.001, offset=-2.5)}
    told = layout
    if guess and delimiter in ";\t, ":
        told = layout.model_copy(update={"delimiter": None})
    recording = read(path, commands=commands, pressures=taps, text=told)
    begin = time_s[0]
    for signal, values in (
        (recording.pressures["first"], 1e2 * raw["a"] + 9e5),
        (recording.pressures["second"], -3.0 * raw["c"] + 2e5),
        (recording.commands["volts"], 1e-3 * raw["b"] - 2.5),
    ):
        np.testing.assert_allclose(signal.values, values, rtol=1e-12)
        np.testing.assert_allclose(signal.time_s - signal.time_s[0], time_s - begin, atol=2e-9)


@pytest.mark.parametrize("stamp", ["auto", "header", "log"])
def test_each_clock(tmp_path: Path, stamp: Literal["auto", "header", "log"]) -> None:
    """Readings arrive late by times that differ; commands have no header."""
    t = even(120)
    late = (1_000_000 + 100_000 * (np.arange(120) % 7)).astype(np.int64)
    rows = tap_rows(t, ramp(t), t + late) + valve_rows(t, np.arange(120.0))
    path = write_bag(tmp_path / "run", sorted(rows, key=lambda row: row[2]))
    tap = {"end": PRESSURES["end"].model_copy(update={"stamp": stamp})}
    signal = read(path, pressures=tap).pressures["end"]
    wanted = t + late if stamp == "log" else t
    same(signal, seconds(wanted, int(wanted[0])), ramp(t))


def test_a_unit_is_converted_before_it_is_judged() -> None:
    """Scale first, then offset, of every sign; what is beyond all sensors is infinite."""
    raw = np.array([-2.5, 0.0, 0.5, 4.0, 1e25, -1e26])
    found = Channel(column=0, scale=-2e5, offset=7e3).convert(raw)
    np.testing.assert_allclose(found[:4], [507e3, 7e3, -93e3, -793e3])
    assert (found[4:] == np.inf).all()


# ---- bags that other recorders, or nobody, would have written ----------------------------------


def raw_bag(
    path: Path,
    definitions: dict[str, tuple[str, str, str]],
    rows: Sequence[tuple[str, int, bytes]],
    encoding: str = "cdr",
) -> Path:
    """Write messages as they are.

    Args:
        path: The .mcap file.
        definitions: Per topic its type, and the encoding and the text of its definition.
        rows: Topic, log time in ns and bytes of each message.
        encoding: Of the messages.
    """
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start(profile="ros2")
        channels = {}
        for topic, (msgtype, written_in, text) in definitions.items():
            schema = writer.register_schema(msgtype, written_in, text.encode())
            channels[topic] = writer.register_channel(topic, encoding, schema)
        for topic, stamp, raw in rows:
            writer.add_message(channels[topic], stamp, raw, stamp)
        writer.finish()
    return path


def float_rows(topic: str, values: NDArray[Any]) -> list[tuple[str, int, bytes]]:
    """Messages of one number each, at 500 Hz."""
    kind = STORE.types[FLOAT]
    return [
        (topic, int(stamp), bytes(STORE.serialize_cdr(kind(data=float(value)), FLOAT)))
        for stamp, value in zip(even(values.size), values, strict=True)
    ]


FLOAT_TEXT = STORE.generate_msgdef(FLOAT)[0]
END = {"commands": {}, "pressures": {"end": Channel(topic="/end")}}


def test_a_type_without_definition_is_that_of_ros(tmp_path: Path) -> None:
    """Recorders write an empty one where they cannot find the package."""
    values = ramp(even(60))
    rows = float_rows("/end", values)
    recording = read(raw_bag(tmp_path / "a.mcap", {"/end": (FLOAT, "ros2msg", "")}, rows), **END)
    np.testing.assert_array_equal(recording.pressures["end"].values, values)
    assert kinds(recording) == {"no_definition": 1}
    assert f"no definition of {FLOAT}; that of ROS 2 Jazzy" in said(recording, "no_definition")
    own = raw_bag(tmp_path / "b.mcap", {"/end": ("lab/msg/Own", "ros2msg", "")}, rows)
    assert "topic '/end' (lab/msg/Own): the bag has no definition of this message type" in refusal(
        own, **END
    )


@pytest.mark.parametrize("written_in", ["ros2idl", "omgidl"])
@pytest.mark.parametrize("headed", [True, False])
def test_definitions_written_as_idl_are_read(tmp_path: Path, written_in: str, headed: bool) -> None:
    """With the heading that recorders put above each part, or as one text."""
    text = "module lab { module msg { struct Own { double data; }; }; };\n"
    if headed:
        other = "module lab { module msg { struct Other { float part; }; }; };\n"
        line = "=" * 80 + "\n"
        text = f"{line}IDL: lab/msg/Own\n{text}{line}IDL: lab/msg/Other\n{other}"
    values = ramp(even(60))
    bag = raw_bag(
        tmp_path / "a.mcap", {"/end": ("lab/msg/Own", written_in, text)}, float_rows("/end", values)
    )
    np.testing.assert_array_equal(read(bag, **END).pressures["end"].values, values)


@pytest.mark.parametrize(
    ("written_in", "text", "words"),
    [
        ("protobuf", "message Own {}", "is written in 'protobuf' (allowed: ros2msg, ros2idl"),
        ("ros2msg", "float64 float64 float64\n\n=", "the embedded definition cannot be parsed ("),
        ("ros2msg", "float64 other\n", "topic '/end' (lab/msg/Own) has no field 'data'"),
        ("ros2msg", "float64[3] data\n", "'data' is an array, write 'data[0]'"),
        ("ros2msg", "string data\n", "field 'data' is a string, not a number"),
    ],
)
def test_definitions_that_do_not_serve(
    tmp_path: Path, written_in: str, text: str, words: str
) -> None:
    bag = raw_bag(
        tmp_path / "a.mcap",
        {"/end": ("lab/msg/Own", written_in, text)},
        float_rows("/end", ramp(even(60))),
    )
    assert words in refusal(bag, **END)


def test_elements_of_what_is_fixed_in_length(tmp_path: Path) -> None:
    """One beyond the end of all arrays, one of what is no array, and one that few messages have."""
    kind = get_types_from_msg("float64[3] three\nfloat64[] many\nfloat64 one\n", "lab/msg/Rows")
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(kind)
    rows = []
    for k, stamp in enumerate(even(60)):
        many = np.array([7.0, 2e5 + k][: 1 + k % 2])
        message = store.types["lab/msg/Rows"](np.array([1.0, 2.0, 3e5 + k]), many, 5.0)
        rows.append(("/end", int(stamp), bytes(store.serialize_cdr(message, "lab/msg/Rows"))))
    text = "float64[3] three\nfloat64[] many\nfloat64 one\n"
    bag = raw_bag(tmp_path / "a.mcap", {"/end": ("lab/msg/Rows", "ros2msg", text)}, rows)

    def element(path: str) -> dict[str, Any]:
        return {"commands": {}, "pressures": {"end": Channel(topic="/end", field=path)}}

    assert "'three' has only 3 elements" in refusal(bag, **element("three[3]"))
    assert "'one' is not an array" in refusal(bag, **element("one[0]"))
    assert "no message has a numeric element 'many[2]'" in refusal(bag, **element("many[2]"))
    np.testing.assert_array_equal(
        read(bag, **element("three[2]")).pressures["end"].values, 3e5 + np.arange(60)
    )
    few = read(bag, **element("many[1]"))
    np.testing.assert_array_equal(few.pressures["end"].values, 2e5 + np.arange(1, 60, 2))


def test_a_message_may_carry_its_stamp_without_a_header(tmp_path: Path) -> None:
    text = (
        "builtin_interfaces/Time stamp\nfloat64 data\n" + "=" * 80
        + "\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
    )  # fmt: skip
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(text, "lab/msg/Own"))
    rows, early = [], 40_000_000
    for stamp, value in zip(even(60), ramp(even(60)), strict=True):
        seconds_, nanoseconds = divmod(int(stamp) - early, 10**9)
        time = store.types["builtin_interfaces/msg/Time"](seconds_, nanoseconds)
        raw = store.serialize_cdr(store.types["lab/msg/Own"](time, value), "lab/msg/Own")
        # The log is late by a time of its own for every other message.
        rows.append(("/end", int(stamp) + 300_000 * (len(rows) % 2), bytes(raw)))
    bag = raw_bag(tmp_path / "a.mcap", {"/end": ("lab/msg/Own", "ros2msg", text)}, rows)
    np.testing.assert_array_equal(read(bag, **END).pressures["end"].time_s, seconds(even(60)))


def test_messages_that_do_not_decode(tmp_path: Path) -> None:
    """One that is cut, and one whose own compression is spoilt; others around them are whole."""
    definitions = {"/end": (FLOAT, "ros2msg", FLOAT_TEXT)}
    rows = float_rows("/end", ramp(even(60)))
    topic, stamp, raw = rows[41]
    rows[41] = (topic, stamp, raw[:7])
    bag = raw_bag(tmp_path / "a.mcap", definitions, rows)
    assert "message 42 of 60 does not decode (" in refusal(bag, **END)
    packed = zstandard.compress(raw)
    rows[41] = (topic, stamp, packed)
    whole = read(raw_bag(tmp_path / "b.mcap", definitions, rows), **END)
    np.testing.assert_array_equal(whole.pressures["end"].values, ramp(even(60)))
    rows[41] = (topic, stamp, packed[:4] + b"\xff" * 30)
    bag = raw_bag(tmp_path / "c.mcap", definitions, rows)
    assert "message 42 of 60 does not decode (" in refusal(bag, **END)


def test_messages_that_unpack_to_far_more_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(unpacking, "FREE_BYTES", 1000)
    rows = float_rows("/end", ramp(even(60)))
    definitions = {"/end": (FLOAT, "ros2msg", FLOAT_TEXT)}
    for size, refused in ((60_000, False), (160_000, True)):
        rows[3] = (*rows[3][:2], zstandard.compress(rows[4][2] + bytes(size)))
        bag = raw_bag(tmp_path / f"{size}.mcap", definitions, rows)
        if refused:
            message = refusal(bag, **END)
            assert "topic '/end'" in message and "bytes unpack to more than 0 MB" in message
        else:
            assert "message 4 of 60 does not decode (" in refusal(bag, **END)


def test_a_chunk_that_unpacks_to_far_more_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(unpacking, "FREE_BYTES", 1000)
    monkeypatch.setattr(unpacking, "LARGEST_RATIO", 1)
    bag = whole_bag(tmp_path / "run", CompressionMode.STORAGE)
    message = refusal(bag)
    assert "bytes unpack to more than 0 MB" in message and "damaged" not in message


def test_topics_that_do_not_serve(tmp_path: Path) -> None:
    """Of several types, of none that is meant, without a message, and not of ROS 2."""
    rows = float_rows("/end", ramp(even(60)))
    two = tmp_path / "two.mcap"
    with two.open("wb") as file:
        writer = McapWriter(file)
        writer.start(profile="ros2")
        texts = {
            FLOAT: FLOAT_TEXT,
            "std_msgs/msg/Float32": STORE.generate_msgdef("std_msgs/msg/Float32")[0],
        }
        for msgtype, text in texts.items():
            schema = writer.register_schema(msgtype, "ros2msg", text.encode())
            channel = writer.register_channel("/end", "cdr", schema)
            for _, stamp, raw in rows[:30]:
                writer.add_message(channel, stamp, raw, stamp)
        writer.finish()
    assert (
        "channel 'end': topic '/end' carries several message types"
        " (std_msgs/msg/Float32, std_msgs/msg/Float64); name one with 'type'"
    ) in refusal(two, **END)
    definitions = {"/end": (FLOAT, "ros2msg", FLOAT_TEXT), "/idle": (FLOAT, "ros2msg", FLOAT_TEXT)}
    bag = raw_bag(tmp_path / "idle.mcap", definitions, rows)
    idle = {"commands": {}, "pressures": {"end": Channel(topic="/idle")}}
    assert "topic '/idle' is in the bag but holds no message" in refusal(bag, **idle)
    other = raw_bag(tmp_path / "ros1.mcap", definitions, rows, encoding="ros1")
    assert "topic '/end' is encoded as 'ros1', only 'cdr' (ROS 2) is read" in refusal(other, **END)


def test_numbers_of_names_that_no_message_has(tmp_path: Path) -> None:
    """Joints and commands that are named beside their numbers, of which there are too few."""
    joint = "sensor_msgs/msg/JointState"
    text, _ = STORE.generate_msgdef(joint)
    time = STORE.types["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
    header = STORE.types["std_msgs/msg/Header"](stamp=time, frame_id="")
    none = np.zeros(0)
    rows = []
    for k, stamp in enumerate(even(60)):
        message = STORE.types[joint](header, ["elbow", "wrist"], np.array([0.01 * k]), none, none)
        rows.append(("/joints", int(stamp), bytes(STORE.serialize_cdr(message, joint))))
    bag = raw_bag(tmp_path / "a.mcap", {"/joints": (joint, "ros2msg", text)}, rows)

    def of(name: str, role: str) -> dict[str, Any]:
        channel = {name: Channel(topic="/joints", field="position", stamp="log")}
        return {"commands": {}, "pressures": {}, role: channel}

    found = read(bag, **of("elbow", "encoders"))
    np.testing.assert_allclose(found.encoders["elbow"].values, 0.01 * np.arange(60))
    message = refusal(bag, **of("wrist", "encoders"))
    assert "no message has a position of joint 'wrist'" in message
    message = refusal(bag, **of("hand", "encoders"))
    assert "no joint 'hand', it has 'elbow', 'wrist'" in message
    # Nor does a bag without such a topic tell anything of joints.
    stream, told = read_joints(bag, "/joints")
    assert stream is not None and told[7] == {"elbow": pytest.approx(0.07)}
    assert read_joints(bag, "/elsewhere") == (None, [])
    # Stamps that are zero are none: messages are then told by when they were written.
    messages, _ = read_messages(bag, {"arm": "/joints", "again": "/joints"})
    assert list(messages) == ["/joints"]
    np.testing.assert_array_equal(messages["/joints"].stamp_ns, even(60))


def test_taps_are_known_by_the_names_beside_their_numbers(tmp_path: Path) -> None:
    kind, text = "pneu_msgs/msg/TapPressures", "string[] name\nfloat64[] pressure_pa\n"
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(text, kind))
    rows = []
    for k, stamp in enumerate(even(60)):
        message = store.types[kind](["start", "end"], np.array([1e5 + k]))
        rows.append(("/taps", int(stamp), bytes(store.serialize_cdr(message, kind))))
    bag = raw_bag(tmp_path / "a.mcap", {"/taps": (kind, "ros2msg", text)}, rows)

    def of(name: str) -> dict[str, Any]:
        channel = Channel(topic="/taps", field="pressure_pa[0]")
        return {"commands": {}, "pressures": {name: channel}}

    found = read(bag, **of("start")).pressures["start"]
    np.testing.assert_array_equal(found.values, 1e5 + np.arange(60))
    assert "no message has a number in pressure_pa of 'end'" in refusal(bag, **of("end"))
    words = "found values of 'start', 'end', none of 'middle'; the rig file names them as the bag"
    assert words in refusal(bag, **of("middle"))


def test_some_zero_header_stamps_are_dropped(tmp_path: Path) -> None:
    t = even()
    stamp = np.where(np.arange(400) % 50 == 7, 0, t)
    path = write_bag(tmp_path / "run", tap_rows(stamp, ramp(t), t) + valve_rows(t, t * 0.0))
    recording = read(path)
    assert kinds(recording) == {"no_header_stamp": 8, "missing": 8}
    assert said(recording, "no_header_stamp") == ("sample(s) with a zero header stamp were dropped")
    kept = stamp != 0
    same(recording.pressures["end"], seconds(t[kept]), ramp(t)[kept])


def test_a_gap_of_a_command_is_told(tmp_path: Path) -> None:
    """Of a command that is sampled; over it the value before holds."""
    t = even()
    keep = np.ones(400, dtype=bool)
    keep[120:150] = keep[300:310] = False
    rows = tap_rows(t, ramp(t)) + valve_rows(t[keep], 5.0 + np.arange(400)[keep] * 0.01)
    recording = read(write_bag(tmp_path / "run", rows))
    assert kinds(recording, "valve") == {"gap": 2}
    assert said(recording, "gap", "valve") == (
        "gap(s) longer than 3 sample periods, 0.084 s in all, the longest 0.062 s; the value before"
        " each holds"
    )
    when = seconds(t)
    found = [(a, b) for a, b, finding in recording.marks() if finding.channel == "valve"]
    np.testing.assert_allclose(found, when[[[119, 150], [299, 310]]], atol=1e-6)


def test_a_summary_that_lists_more_is_not_believed(tmp_path: Path) -> None:
    bag = raw_bag(
        tmp_path / "a.mcap",
        {"/end": (FLOAT, "ros2msg", FLOAT_TEXT)},
        float_rows("/end", ramp(even(60))),
    )
    data = bag.read_bytes()
    count = (60).to_bytes(8, "little")
    # The record of the statistics begins with its opcode, its length and the number of messages.
    at = data.index(bytes([Opcode.STATISTICS]), data.rindex(bytes([Opcode.DATA_END]) + bytes([4])))
    at = data.index(count, at)
    bag.write_bytes(data[:at] + (67).to_bytes(8, "little") + data[at + 8 :])
    message = refusal(bag, **END)
    assert "holds 60 of the 67 messages that its summary lists" in message


def test_what_is_no_file_and_arguments_that_contradict(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = whole_bag(tmp_path / "run")
    twice = {"end": Channel(topic="/valve/voltage")}
    assert "'end' names two of commands, taps and measured positions" in refusal(
        bag, commands=twice
    )
    assert "start_s (0.5) must be before end_s (0.5)" in refusal(bag, start_s=0.5, end_s=0.5)
    (tmp_path / "folder" / "part.mcap").mkdir(parents=True)
    with pytest.raises(InputError, match=r"part\.mcap: cannot be read \(Is a directory\)"):
        read(tmp_path / "folder")
    (tmp_path / "broken.mcap.zstd").write_bytes(b"\x28\xb5\x2f\xfd" + b"\xff" * 40)
    assert "the zstd compression of the file is damaged" in refusal(tmp_path / "broken.mcap.zstd")
    assert "is no file and no bag" in refusal(Path("/dev/null"))
    with socket.socket(socket.AF_UNIX) as listener:
        monkeypatch.chdir(tmp_path)  # a socket's path is short
        listener.bind("plug")
        assert "cannot be read (No such device or address)" in refusal(tmp_path / "plug")


def test_texts_without_rows_and_with_odd_ones(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    text = {"commands": {}, "pressures": {"end": Channel(column="end")}}
    path.write_text("time,end\n", encoding="utf-8")
    assert "the file holds a heading but no rows" in refusal(path, **text)
    path.write_text("# a\n\n# time,end\n", encoding="utf-8")
    assert "the file holds no rows (3 lines)" in refusal(path, **text)
    path.write_bytes(b"time,end\n0.0,1\xff\n")
    assert "byte 14 is not text" in refusal(path, **text)
    rows = [f"{0.01 * k:.2f},{2e5 + k}" for k in range(40)]
    path.write_text("\n".join(["time,end", *rows, "x" * 200_000]), encoding="utf-8")
    message = refusal(path, **text)
    assert "line 42 cannot be split into columns (" in message
    # What separates thousands separates no columns.
    path.write_text("\n".join(f"{k},000.5 {2 * k},500.5" for k in range(40)), encoding="utf-8")
    grouped = TextFormat(thousands_separator=",", time_scale=1e-3)
    found = read(path, text=grouped, commands={}, pressures={"end": Channel(column=1)})
    np.testing.assert_array_equal(found.pressures["end"].values[:3], [500.5, 2500.5, 4500.5])
    # A comment above names the columns; one between the rows, and one of other columns, does not.
    above = ["# run of monday", "# time,end", rows[0], "# volts,other", "", *rows[1:]]
    path.write_text("\n".join(above), encoding="utf-8")
    found = read(path, text=TextFormat(comment="#"), **text)
    np.testing.assert_array_equal(found.pressures["end"].values, 2e5 + np.arange(40))
    path.write_text("\n".join(["# run of monday", *rows]), encoding="utf-8")
    message = refusal(path, text=TextFormat(comment="#"), **text)
    assert "no column 'end' (the file has: no names, 2 columns numbered from 0)" in message
    longest = csv.field_size_limit()
    path.write_text("\n".join(["# " + "x" * (longest + 1), *rows]), encoding="utf-8")
    message = refusal(path, text=TextFormat(comment="#"), **text)
    assert "the comment above the numbers cannot be split into columns (" in message
