# SPDX-License-Identifier: Apache-2.0
"""Encoders in other units, turned over, stuck or not there: named in a sentence, or put right."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pneu_common.errors import InputError
from pneu_sim import bag
from pneu_sim.rig import load_rig
from pneu_sim.rig.schema import Rig
from pneu_sim.signals import Motion
from pneu_sysid.encoder_check import reading_range
from pneu_sysid.problem import record_for
from pneu_sysid.records import Recording, even_recording
from pneu_sysid.units import checked

ROOT = Path(__file__).parents[3]
RATE_HZ = 500.0
TIME_S = np.arange(1000) / RATE_HZ
DEGREE = np.pi / 180.0


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig(ROOT / "rigs" / "rig_j.yaml")


@pytest.fixture(scope="module")
def sled() -> Rig:
    """A mass on a rail; one encoder on the cylinder, one on its joint, which has no stops."""
    rig = load_rig(ROOT / "rigs" / "rig_j.yaml").dump()
    rig["bodies"] = {"sled": {"kind": "rail", "cylinder": "forearm", "mass_kg": 1.0}}
    rig["bodies"]["sled"]["slide"] = {"name": "way", "start": 0.03}
    rig["encoders"] = {"rod": {"cylinder": "forearm"}, "way": {}}
    return Rig.model_validate(rig)


def swing() -> np.ndarray:
    """An angle that comes near both stops."""
    rng = np.random.default_rng(1)
    return 0.8 * np.sin(7.0 * TIME_S) + rng.normal(0.0, 2e-4, TIME_S.size)


def recording(rig: Rig, **encoders: np.ndarray) -> Recording:
    rng = np.random.default_rng(3)
    taps = {
        tap: 3.7e5 + 2e5 * np.sin(9.0 * TIME_S + k) + rng.normal(0.0, 250.0, TIME_S.size)
        for k, tap in enumerate(rig.taps)
    }
    volts = {name: 5.0 + np.sin(TIME_S) for name in rig.commands}
    return even_recording("run", TIME_S, volts, taps, encoders)


def refusal(rig: Rig, **encoders: np.ndarray) -> str:
    with pytest.raises(InputError) as caught:
        checked(rig, "run.mcap", recording(rig, **encoders))
    text = str(caught.value)
    assert "\n" not in text and text.startswith("run.mcap: encoder ")
    return text


def test_angles_between_the_stops_are_left_alone(rig: Rig) -> None:
    found = checked(rig, "run.mcap", recording(rig, elbow=swing()))
    np.testing.assert_array_equal(found.encoders["elbow"].values, swing())
    assert not found.report


def test_a_little_beyond_the_stops_is_believed(rig: Rig) -> None:
    assert not checked(rig, "run.mcap", recording(rig, elbow=swing() + 0.1)).report


@pytest.mark.parametrize("zero", [0.0, 360.0])
def test_degrees_are_named(rig: Rig, zero: float) -> None:
    text = refusal(rig, elbow=swing() / DEGREE + zero)
    assert "in degrees: say so in its channel with scale: 0.0174533" in text
    assert "-0.85 to 0.85 rad" in text


def test_an_angle_of_another_joint_is_refused(rig: Rig) -> None:
    assert "scale and offset" in refusal(rig, elbow=swing() + 2.5)


def test_millimetres_are_named(sled: Rig) -> None:
    way = 0.03 + 0.025 * np.sin(7.0 * TIME_S)
    assert not checked(sled, "run.mcap", recording(sled, rod=way, way=way)).report
    for name in ("rod", "way"):
        text = refusal(sled, **{name: 1e3 * way})
        assert f"{name!r}" in text and "millimetres" in text and "scale: 0.001" in text


def test_a_joint_without_stops_may_read_what_its_piston_allows(sled: Rig) -> None:
    """The rail's joint is the cylinder's extension, from 0 to its stroke."""
    assert reading_range(sled, "rod") == (0.0, 0.06)
    assert reading_range(sled, "way") == pytest.approx((0.0, 0.06), abs=0.01)


def test_a_crank_without_stops_turns_as_far_as_its_piston_goes(rig: Rig) -> None:
    data = rig.dump()
    for stop in ("lower", "upper"):
        del data["bodies"]["arm"]["theta"][stop]
    found = reading_range(Rig.model_validate(data), "elbow")
    # pivot 0.160 m, crank 0.035 m, 0.1337 m long when closed: sqrt(p^2 + c^2 + 2 p c sin(theta))
    length = np.array([0.1337, 0.1337 + 0.060])
    sine = (length**2 - 0.160**2 - 0.035**2) / (2.0 * 0.160 * 0.035)
    assert found == pytest.approx(np.arcsin(sine), abs=0.01)


@pytest.mark.parametrize("turns", [-1.0, 1.0, 2.0])
def test_whole_turns_are_taken_off(rig: Rig, turns: float) -> None:
    found = checked(rig, "run.mcap", recording(rig, elbow=swing() + 2.0 * np.pi * turns))
    np.testing.assert_allclose(found.encoders["elbow"].values, swing(), atol=1e-9)
    assert [f.kind for f in found.report] == ["wrapped"]


@pytest.mark.parametrize("begins", [0.0, -0.3, -6.0])
def test_an_encoder_that_begins_again_is_unwrapped(rig: Rig, begins: float) -> None:
    """It reads from somewhere to a turn above; its joint passes that point again and again."""
    wrapped = begins + np.mod(swing() - begins, 2.0 * np.pi)
    found = checked(rig, "run.mcap", recording(rig, elbow=wrapped))
    np.testing.assert_allclose(found.encoders["elbow"].values, swing(), atol=1e-9)
    (told,) = found.report
    jumps = int(np.sum(np.abs(np.diff(wrapped)) > np.pi))
    assert told.kind == "wrapped" and told.count == jumps > 2


def test_an_encoder_that_stands_still_while_gas_moves_is_told(rig: Rig) -> None:
    stuck = swing()
    stuck[400:700] = stuck[400]
    found = checked(rig, "run.mcap", recording(rig, elbow=stuck))
    np.testing.assert_array_equal(found.encoders["elbow"].values, stuck)
    (told,) = found.report
    assert told.kind == "frozen" and "0.8 s" in told.action and "stuck" in told.action
    quiet = recording(rig, elbow=stuck)
    for signal in quiet.pressures.values():
        signal.values[400:700] = signal.values[400]
    assert not checked(rig, "run.mcap", quiet).report


def bag_of(folder: Path, rig: Rig, joints: dict[str, np.ndarray]) -> Path:
    made = recording(rig)
    motion = Motion(TIME_S, joints, joints) if joints else None
    path = folder / "run.mcap"
    bag.write_bag(path, rig, made.commands, made.pressures, motion=motion)
    return path


def test_bags_that_lack_the_joint_say_so(rig: Rig, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"'elbow'.*/joint_states"):
        record_for(rig, str(bag_of(tmp_path, rig, {})))
    other = tmp_path / "other"
    other.mkdir()
    path = str(bag_of(other, rig, {"elbow_joint": swing(), "shoulder": 0.0 * swing()}))
    with pytest.raises(InputError, match=r"no joint 'elbow', it has 'elbow_joint', 'shoulder'"):
        record_for(rig, path)
    data = rig.dump()
    data["encoders"] = {"elbow_joint": {"joint": "elbow"}}
    found = record_for(Rig.model_validate(data), path)
    np.testing.assert_allclose(found.encoders["elbow_joint"].values, swing(), atol=1e-12)


def test_a_bag_in_degrees_is_read_once_the_rig_file_says_so(rig: Rig, tmp_path: Path) -> None:
    path = str(bag_of(tmp_path, rig, {"elbow": swing() / DEGREE}))
    with pytest.raises(InputError, match=r"scale: 0\.0174533"):
        record_for(rig, path)
    data = rig.dump()
    data["encoders"]["elbow"]["channel"]["scale"] = 0.0174533
    found = record_for(Rig.model_validate(data), path)
    np.testing.assert_allclose(found.encoders["elbow"].values, swing(), atol=1e-5)
