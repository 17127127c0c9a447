# SPDX-License-Identifier: Apache-2.0
"""Vector sensors whose readings are in another frame than the model's."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pneu_sysid.contacts.chain import POSITION
from pneu_sysid.contacts.frames import turned_frames, words

VECTORS = np.random.default_rng(5).normal(size=(40, 3)) * [3.0, 2.0, 1.0]


def found(turn: Rotation, vectors: Any = VECTORS, noise: float = 0.0, **more: Any) -> Any:
    """Return the turned frames found for one sensor whose readings are the model's, rotated."""
    about = {"name": "imu", "size": 3, "turns": False, "stage": "forces", "address": 2}
    channel = SimpleNamespace(**about | more, knots=slice(None))
    off = noise * np.random.default_rng(6).normal(size=vectors.shape)
    chain: Any = SimpleNamespace(
        channels=[channel], measured=lambda here, reading: turn.apply(vectors) + off
    )
    said: Any = SimpleNamespace(sensors=np.hstack([np.full((len(vectors), 2), 9.0), vectors]))
    setup: Any = SimpleNamespace(readings={"imu": None})
    return turned_frames([chain], [said], setup)


def test_a_large_turn_is_found_with_its_axis() -> None:
    axis = np.array([0.6, 0.0, 0.8])
    ((name, (angle, about)),) = found(Rotation.from_rotvec(1.2 * axis)).items()
    assert name == "imu" and angle == pytest.approx(1.2)
    assert about == pytest.approx(axis)
    assert "'imu' tells its vectors turned by 69° about (0.60, 0.00, 0.80)" in words(
        {name: (angle, about)}
    )


def test_vectors_that_are_all_along_one_are_brought_to_it_the_shortest_way() -> None:
    flat = np.outer(np.linspace(1.0, 2.0, 40), [0.0, 0.0, 1.0])
    ((angle, about),) = found(Rotation.from_euler("x", 90.0, degrees=True), flat).values()
    assert angle == pytest.approx(np.pi / 2)
    assert np.abs(about) == pytest.approx([1.0, 0.0, 0.0], abs=1e-6)


@pytest.mark.parametrize(
    "more",
    [{"size": 1}, {"turns": True}, {"stage": POSITION}, {"turns": True, "stage": POSITION}],
)
def test_what_is_no_vector_of_a_frame_is_left_alone(more: dict[str, Any]) -> None:
    assert found(Rotation.from_rotvec([1.2, 0.0, 0.0]), **more) == {}


def test_what_a_mounting_may_be_off_by_is_no_other_frame() -> None:
    assert found(Rotation.from_rotvec([0.36, 0.0, 0.0])) != {}
    assert found(Rotation.from_rotvec([0.34, 0.0, 0.0])) == {}
    assert found(Rotation.identity()) == {}


def test_a_turn_that_explains_little_is_none() -> None:
    assert found(Rotation.from_rotvec([1.2, 0.0, 0.0]), noise=4.0) == {}


def test_few_readings_tell_of_no_frame() -> None:
    turn = Rotation.from_rotvec([1.2, 0.0, 0.0])
    assert found(turn, VECTORS[:10]) != {} and found(turn, VECTORS[:9]) == {}
    missing = VECTORS.copy()
    missing[::2, 1] = np.nan
    assert found(turn, missing)["imu"][0] == pytest.approx(1.2)
