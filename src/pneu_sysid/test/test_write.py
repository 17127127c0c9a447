# SPDX-License-Identifier: Apache-2.0
"""A recording written as a bag reads back as it was, every signal at its own times."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mcap.records import Message
from mcap.stream_reader import StreamReader
from rosbags.rosbag2 import Reader

from pneu_common.errors import InputError
from pneu_sim.rig.load import load_rig
from pneu_sim.rig.schema import Rig
from pneu_sysid.problem import record_for
from pneu_sysid.records import Recording, Signal, bag_topics, read_recording
from pneu_sysid.records.write import write_bag

START_NS = 1_700_000_000_000_000_000


@pytest.fixture
def rig() -> Rig:
    return load_rig(Path(__file__).parents[3] / "rigs" / "rig_a.yaml")


@pytest.fixture
def recording(rig: Rig) -> Recording:
    """Taps at rates and instants of their own, and a command that begins before them."""
    rng = np.random.default_rng(5)
    pressures = {}
    for k, tap in enumerate(rig.taps):
        steps_ns = rng.integers(2_000_000 + k, 50_000_000, 200 - k)
        time_ns = np.cumsum(steps_ns) - steps_ns[0]
        pressures[tap] = Signal(time_ns / 1e9, rng.uniform(1e5, 6e5, time_ns.size))
    sent_ns = np.cumsum(rng.integers(1_000_000, 30_000_000, 100)) - 300_000_000
    volts = Signal(sent_ns / 1e9, rng.uniform(0.0, 10.0, 100))
    return Recording("run", {"voltage": volts}, pressures, start_time_s=START_NS / 1e9)


def read(rig: Rig, path: Path) -> Recording:
    return read_recording(
        path,
        commands={n: c.channel for n, c in rig.commands.items() if c.channel is not None},
        pressures={n: t.channel for n, t in rig.taps.items() if t.channel is not None},
    )


@pytest.mark.parametrize("name", ["run", "run.mcap"])
def test_a_bag_reads_back_as_it_was(
    rig: Rig, recording: Recording, tmp_path: Path, name: str
) -> None:
    path = tmp_path / name
    write_bag(path, rig, recording)
    assert [p.name for p in tmp_path.iterdir()] == [name]
    topics = bag_topics(path)
    count = len(recording.pressures["end"])
    assert topics["/taps/end/pressure"] == ("sensor_msgs/msg/FluidPressure", count)
    assert topics["/valve/voltage"] == ("std_msgs/msg/Float64", 100)
    back = read(rig, path)
    assert back.start_time_s == START_NS / 1e9
    assert back.commands["voltage"].time_s[0] < -0.2
    for part, found in ((recording.commands, back.commands), (recording.pressures, back.pressures)):
        for key, signal in part.items():
            np.testing.assert_array_equal(found[key].time_s, signal.time_s)
            np.testing.assert_array_equal(found[key].values, signal.values)


def test_messages_are_in_the_order_of_time(rig: Rig, recording: Recording, tmp_path: Path) -> None:
    write_bag(tmp_path / "bag", rig, recording)
    with Reader(tmp_path / "bag") as reader:
        stamps = [stamp for _, stamp, _ in reader.messages()]
    with (tmp_path / "bag" / "bag.mcap").open("rb") as file:
        chunks = [r for r in StreamReader(file).records if isinstance(r, Message)]
    assert [message.log_time for message in chunks] == sorted(stamps)


def test_values_that_are_missing_are_left_out(
    rig: Rig, recording: Recording, tmp_path: Path
) -> None:
    end = recording.pressures["end"]
    holed = np.where(np.arange(len(end)) == 50, np.nan, end.values)
    recording.pressures["end"] = Signal(end.time_s, holed)
    write_bag(tmp_path / "bag", rig, recording)
    back = read(rig, tmp_path / "bag").pressures["end"]
    np.testing.assert_array_equal(back.time_s, np.delete(end.time_s, 50))


def test_scale_and_offset_are_undone(rig: Rig, recording: Recording, tmp_path: Path) -> None:
    channel = rig.taps["end"].channel
    assert channel is not None
    gauge_bar = channel.model_copy(update={"scale": 1e5, "offset": 101325.0})
    changed = rig.model_copy(deep=True)
    changed.taps["end"].channel = gauge_bar
    write_bag(tmp_path / "bag", changed, recording)
    raw = read(rig, tmp_path / "bag").pressures["end"].values
    expected = (recording.pressures["end"].values - 101325.0) / 1e5
    np.testing.assert_allclose(raw, expected, rtol=1e-12)


@pytest.mark.parametrize("early_s", [0.0, 4.0])
def test_a_recording_without_a_clock_keeps_its_first_sample(
    rig: Rig, recording: Recording, tmp_path: Path, early_s: float
) -> None:
    volts = recording.commands["voltage"]
    recording.commands["voltage"] = Signal(volts.time_s - early_s, volts.values)
    recording.start_time_s = 0.0
    write_bag(tmp_path / "bag", rig, recording)
    back = read(rig, tmp_path / "bag")
    assert len(back.commands["voltage"]) == 100
    np.testing.assert_array_equal(back.pressures["end"].time_s, recording.pressures["end"].time_s)


def test_refusals_are_one_sentence_and_leave_nothing(
    rig: Rig, recording: Recording, tmp_path: Path
) -> None:
    (tmp_path / "old").mkdir()
    with pytest.raises(InputError, match=r"old: exists already"):
        write_bag(tmp_path / "old", rig, recording)
    with pytest.raises(InputError, match=r"cannot be written"):
        write_bag(tmp_path / "nowhere" / "bag", rig, recording)
    blind = rig.model_copy(deep=True)
    blind.taps["end"].channel = None
    with pytest.raises(InputError, match=r"taps\.end has no topic"):
        write_bag(tmp_path / "bag", blind, recording)
    volts = recording.commands["voltage"]
    recording.commands["voltage"] = Signal(volts.time_s[1:], volts.values)
    with pytest.raises(InputError, match=r"commands\.voltage: found 99 times of 100 values"):
        write_bag(tmp_path / "bag", rig, recording)
    with pytest.raises(InputError, match="found no signal to write"):
        write_bag(tmp_path / "bag", rig, Recording("empty", {}, {}))
    assert [p.name for p in tmp_path.iterdir()] == ["old"]


def test_commands_of_valves_on_one_topic_read_back_by_name(tmp_path: Path) -> None:
    """Two valves that move at instants of their own, in the messages of the graph."""
    rig = load_rig(Path(__file__).parents[3] / "rigs" / "kokoro.yaml")
    taps = {name: Signal(np.linspace(0.0, 2.0, 401), np.full(401, 2e5)) for name in rig.taps}
    head = Signal(np.array([0.0, 0.5, 1.1]), np.array([5.0, 8.0, 2.0]))
    rod = Signal(np.array([0.0, 0.7, 1.1]), np.array([5.0, 1.5, 6.0]))
    elbow = Signal(np.linspace(0.0, 2.0, 401), np.linspace(-0.5, 0.5, 401))
    recording = Recording("run", {"head": head, "rod": rod}, taps, encoders={"elbow": elbow})
    path = tmp_path / "run.mcap"
    write_bag(path, rig, recording)
    assert bag_topics(path)["/valve/command"] == ("pneu_msgs/msg/ValveCommand", 4)
    back = record_for(rig, path)
    for name, signal in recording.commands.items():
        np.testing.assert_allclose(back.commands[name].time_s, signal.time_s, atol=1e-9)
        np.testing.assert_array_equal(back.commands[name].values, signal.values)
    np.testing.assert_array_equal(back.encoders["elbow"].values, elbow.values)


def test_a_bag_that_names_other_valves_is_refused(tmp_path: Path) -> None:
    rig = load_rig(Path(__file__).parents[3] / "rigs" / "kokoro.yaml")
    taps = {name: Signal(np.linspace(0.0, 2.0, 401), np.full(401, 2e5)) for name in rig.taps}
    volts = Signal(np.array([0.0, 0.5]), np.array([5.0, 8.0]))
    elbow = Signal(np.linspace(0.0, 2.0, 401), np.linspace(-0.5, 0.5, 401))
    recording = Recording("run", {"head": volts}, taps, encoders={"elbow": elbow})
    path = tmp_path / "run.mcap"
    write_bag(path, rig, recording)
    with pytest.raises(InputError, match=r"found values of 'head', none of 'rod'"):
        record_for(rig, path)
