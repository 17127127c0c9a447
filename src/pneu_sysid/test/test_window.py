# SPDX-License-Identifier: Apache-2.0
"""The fixed-lag estimate beside the truth of an emulated arm that taps and presses."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pneu_sim.hand.drive import JointCommand, Motors
from pneu_sim.hand.exercise import exercise
from pneu_sim.hand.loading import Hand
from pneu_sim.hand.paths import Kinematics
from pneu_sim.hand.world import World
from pneu_sysid.contacts.scene import load_scene
from pneu_sysid.contacts.window import Estimate, Window

SCENES = Path(__file__).parents[3] / "scenes/phantom"
SECONDS = 2.5


@pytest.fixture(scope="module")
def moved() -> tuple[list[tuple[float, str, Any]], np.ndarray]:
    """What sensors told and motors were given, in order, and the true force on the cylinder."""
    hand = Hand(SCENES / "hand.yaml")
    path = exercise(
        hand, Kinematics(hand, "phantom", "phantom_tip"), "phantom_tip", "object", 4.0, 1
    )
    world = World(hand, seed=1, touch=True)
    joints = list(hand.settings.arms["phantom"].joints.values())
    motors = Motors(joints)
    pairs = {
        "wrench": ("phantom_force", "phantom_torque"),
        "imu": ("gyro", "accelerometer"),
        "pose": ("place", "turn"),
    }
    events: list[tuple[float, str, Any]] = []
    true = []
    for number in range(round(SECONDS / world.step_s)):
        wanted = [JointCommand(*both) for both in zip(*path.at(world.time_s), strict=True)]
        torques = motors.drive(world.counts("phantom"), world.time_s, wanted)
        angles = motors.position_rad
        if number % 2 == 0:
            for joint, angle, torque in zip(joints, angles, torques, strict=True):
                events.append((world.time_s, joint.encoder, np.array([angle])))
                events.append((world.time_s, joint.motor, torque))
        for reading in world.advance({"phantom": torques}):
            if reading.kind == "touch":
                true.append([reading.time_s, *reading.values[:3]])
            else:
                first, second = pairs[reading.kind]
                events.append((reading.time_s, first, reading.values[:3]))
                events.append((reading.time_s, second, reading.values[3:]))
    return events, np.array(true)


def run(
    window: Window, events: list[tuple[float, str, Any]], every_s: float = 0.01
) -> Iterator[Estimate]:
    next_s = 0.2
    for at, name, value in events:
        if isinstance(value, float):
            window.control(name, at, value)
        else:
            window.sensor(name, at, value)
        if at >= next_s:
            next_s += every_s
            found = window.advance()
            if found is not None:
                yield found


def off(found: list[Estimate], true: np.ndarray) -> tuple[float, float]:
    """RMSE of the force, and the force's own, N."""
    when = [e.time_s for e in found]
    there = np.stack([np.interp(when, true[:, 0], true[:, k]) for k in (1, 2, 3)], axis=1)
    said = np.array([e.touch[:3] for e in found])
    return float(np.sqrt(np.mean((said - there) ** 2))), float(np.sqrt(np.mean(there**2)))


@pytest.mark.long
def test_force_is_known_ten_milliseconds_later(moved: Any) -> None:
    events, true = moved
    loaded = load_scene(SCENES / "hanging.yaml")
    window = Window(loaded, loaded.scene.values, "phantom_tip")
    found = list(run(window, [e for e in events if e[0] < 1.7]))
    error, size = off(found, true)
    assert size > 0.05
    assert error < 0.05 * size
    assert error < 0.3 * 0.01  # of the sensor's noise
    lags = [e.lag_s for e in found]
    assert np.median(lags) == pytest.approx(0.0095, abs=0.0011)  # three and a half knots
    assert window.restarts == 0
    free = [e for e in found if np.interp(e.time_s, true[:, 0], np.abs(true[:, 1])) == 0.0]
    assert np.mean([np.abs(e.touch[:3]).max() for e in free]) < 0.002


@pytest.mark.long
def test_readings_that_did_not_come_for_a_while_are_made_up_for(moved: Any) -> None:
    events, true = moved
    loaded = load_scene(SCENES / "hanging.yaml")
    window = Window(loaded, loaded.scene.values, "phantom_tip")
    gap = [e for e in events if not 1.2 < e[0] < 1.3]
    found = list(run(window, gap))
    after = [e for e in found if e.time_s > 1.45]
    assert after
    error, size = off(after, true)
    assert error < 0.1 * size
    window = Window(loaded, loaded.scene.values, "phantom_tip")
    after = [e for e in run(window, [e for e in events if not 1.0 < e[0] < 1.8])]
    assert window.restarts == 1
    assert off([e for e in after if e.time_s > 2.0], true)[0] < 0.1 * size


def test_what_comes_late_or_twice_changes_nothing(moved: Any) -> None:
    events, _ = moved
    loaded = load_scene(SCENES / "hanging.yaml")
    some = [e for e in events if e[0] < 0.5]
    twice = [copy for e in some for copy in (e, e)]
    mixed = [*twice[:400], *some[:40], *twice[400:]]  # old ones once more
    plain, other = (
        list(run(Window(loaded, loaded.scene.values, "phantom_tip"), these))
        for these in (some, mixed)
    )
    assert len(plain) == len(other)
    assert np.allclose(plain[-1].q, other[-1].q, atol=1e-9)


def test_nothing_is_told_before_all_sensors_do(moved: Any) -> None:
    events, _ = moved
    loaded = load_scene(SCENES / "hanging.yaml")
    window = Window(loaded, loaded.scene.values, "phantom_tip")
    silent = [e for e in events if e[1] not in ("place", "turn") and e[0] < 1.0]
    assert not list(run(window, silent))
