# SPDX-License-Identifier: Apache-2.0
"""A recording written as a bag reads back as it was."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pneu_sim.errors import InputError
from pneu_sim.rig.load import load_rig
from pneu_sim.rig.schema import Rig
from pneu_sysid.problem import record_for
from pneu_sysid.records import Recording, bag_topics
from pneu_sysid.records.write import write_bag

RATE = 500.0


@pytest.fixture
def rig() -> Rig:
    return load_rig(Path(__file__).parents[3] / "rigs" / "rig_a.yaml")


@pytest.fixture
def recording(rig: Rig) -> Recording:
    rng = np.random.default_rng(5)
    time = np.arange(200) / RATE
    return Recording(
        name="run",
        time_s=time,
        commands={"voltage": np.repeat(rng.uniform(0.0, 10.0, 20), 10)},
        pressures={tap: rng.uniform(1e5, 6e5, 200) for tap in rig.taps},
        rate_hz=RATE,
        start_time_s=1.7e9,
    )


@pytest.mark.parametrize("name", ["run", "run.mcap"])
def test_a_bag_reads_back_as_it_was(
    rig: Rig, recording: Recording, tmp_path: Path, name: str
) -> None:
    recording.pressures["end"][50] = np.nan
    path = tmp_path / name
    write_bag(path, rig, recording)
    assert [p.name for p in tmp_path.iterdir()] == [name]
    topics = bag_topics(path)
    assert topics["/taps/end/pressure"] == ("sensor_msgs/msg/FluidPressure", 199)
    assert topics["/valve/voltage"] == ("std_msgs/msg/Float64", 200)
    back = record_for(rig, str(path))
    assert back.rate_hz == pytest.approx(RATE, rel=1e-9)
    assert back.start_time_s == pytest.approx(1.7e9, abs=1e-6)
    for command, volts in recording.commands.items():
        np.testing.assert_array_equal(back.commands[command], volts)
    for tap, pressure in recording.pressures.items():
        keep = np.isfinite(pressure)
        np.testing.assert_array_equal(back.pressures[tap][keep], pressure[keep])


def test_scale_and_offset_are_undone(rig: Rig, recording: Recording, tmp_path: Path) -> None:
    channel = rig.taps["end"].channel
    assert channel is not None
    gauge_bar = channel.model_copy(update={"scale": 1e5, "offset": 101325.0})
    changed = rig.model_copy(deep=True)
    changed.taps["end"].channel = gauge_bar
    write_bag(tmp_path / "bag", changed, recording)
    raw = record_for(rig, str(tmp_path / "bag")).pressures["end"]
    np.testing.assert_allclose(raw, (recording.pressures["end"] - 101325.0) / 1e5, rtol=1e-12)


def test_a_recording_without_a_clock_keeps_its_first_sample(
    rig: Rig, recording: Recording, tmp_path: Path
) -> None:
    recording.start_time_s = 0.0
    write_bag(tmp_path / "bag", rig, recording)
    assert record_for(rig, str(tmp_path / "bag")).time_s.size == 200


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
    assert [p.name for p in tmp_path.iterdir()] == ["old"]
