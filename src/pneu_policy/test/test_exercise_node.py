# SPDX-License-Identifier: Apache-2.0
"""The exercise node by the times of readings that are made up; nothing is published."""

import dataclasses
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.domains import own_domain_id

from pneu_runtime.hook import install

install()

import rclpy  # noqa: E402
from rclpy.exceptions import InvalidParameterValueException  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402

from pneu_common.errors import InputError  # noqa: E402
from pneu_policy.nodes.exercise import (  # noqa: E402
    APPROACH_S,
    REST_S,
    ExerciseNode,
    ExerciseParameters,
)

SCENES = Path(__file__).parents[3] / "scenes/phantom"
HAND, THREE = str(SCENES / "hand.yaml"), str(SCENES / "pushing.yaml")


@pytest.fixture
def context(monkeypatch: pytest.MonkeyPatch) -> Iterator[rclpy.Context]:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    one = rclpy.Context()
    rclpy.init(args=[], context=one, domain_id=own_domain_id())
    yield one
    one.try_shutdown()


def node_of(context: rclpy.Context, **given: Any) -> ExerciseNode:
    overrides = [Parameter(name, value=value) for name, value in given.items()]
    return ExerciseNode(context=context, parameter_overrides=overrides)


def test_parameters() -> None:
    fields = {
        f.name: (f.default, f.metadata["about"]) for f in dataclasses.fields(ExerciseParameters)
    }
    assert {name: (default, about.within) for name, (default, about) in fields.items()} == {
        "hand": ("", None),
        "arm": ("", None),
        "tip": ("", None),
        "thing": ("object", None),
        "seconds": (10.0, (1.0, 600.0)),
        "seed": (0, (0, 2**31 - 1)),
        "rate_hz": (500.0, (50.0, 2000.0)),
    }
    assert all(about.read_only for _, about in fields.values())


@pytest.mark.parametrize(
    "given", [{"seed": -1}, {"seed": 2**31}, {"seconds": 0.9}, {"rate_hz": 49.0}]
)
def test_what_is_out_of_range(context: rclpy.Context, given: dict[str, Any]) -> None:
    with pytest.raises(InvalidParameterValueException, match=next(iter(given))):
        node_of(context, hand=HAND, **given)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({}, "hand: found nothing, a hand file is needed"),
        ({"hand": THREE}, "arm: found '', FILE has one, two, three"),
        ({"hand": THREE, "arm": "four"}, "arm: found 'four', FILE has one, two, three"),
        ({"hand": HAND, "tip": "nose"}, "no geom or site 'nose'"),
        ({"hand": HAND, "thing": "cup"}, "no geom 'cup'"),
    ],
)
def test_what_cannot_be_exercised(context: rclpy.Context, given: dict[str, str], says: str) -> None:
    with pytest.raises(InputError) as caught:
        node_of(context, **given)
    assert str(caught.value).endswith(says.replace("FILE", THREE))


class Told:
    """An arm that keeps what it is commanded."""

    def __init__(self) -> None:
        self.angles_rad = np.array([0.1, -0.2, 0.3])
        self.got: list[tuple[Any, list[float], list[float]]] = []

    def command(self, stamp: Any, position: list[float], velocity: list[float]) -> None:
        self.got.append((stamp, position, velocity))


def test_it_goes_to_its_path_and_along_it_once(context: rclpy.Context) -> None:
    node = node_of(context, hand=HAND, seconds=1.0, rate_hz=50.0)
    try:
        assert node.count_publishers("phantom/command") == 1
        arm = Told()
        node._arm = arm  # type: ignore[assignment]
        path, begin = node._path, arm.angles_rad.copy()

        def at(since_s: float) -> tuple[list[float], list[float]]:
            count = len(arm.got)
            node._on_readings(500.0 + since_s, since_s)
            assert len(arm.got) == count + 1 and arm.got[-1][0] == since_s
            return arm.got[-1][1:]

        assert at(0.0) == (pytest.approx(begin.tolist()), [0.0, 0.0, 0.0])
        arm.angles_rad = np.zeros(3)  # where it is then makes no difference
        node._on_readings(500.01, 0.01)
        assert len(arm.got) == 1, "not due yet"
        share = 0.25**3 * (10.0 - 15.0 * 0.25 + 6.0 * 0.25**2)
        expected = begin + share * (path.angles_rad[0] - begin)
        assert at(0.25 * APPROACH_S) == (pytest.approx(expected.tolist()), [0.0, 0.0, 0.0])
        rest = (pytest.approx(path.angles_rad[0].tolist()), [0.0, 0.0, 0.0])
        assert at(APPROACH_S) == rest
        assert at(APPROACH_S + 0.9 * REST_S) == rest
        for along_s in (0.3037, 0.6213):
            angles, velocity = path.at(along_s)
            assert at(APPROACH_S + REST_S + along_s) == (
                pytest.approx(angles.tolist()), pytest.approx(velocity.tolist())
            )  # fmt: skip
            assert math.hypot(*velocity) > 1e-3
        end_s = APPROACH_S + float(path.time_s[-1]) + 2.0 * REST_S
        last = (pytest.approx(path.angles_rad[-1].tolist()), [0.0, 0.0, 0.0])
        assert at(end_s - 0.01) == last and not node.done.done()
        assert at(end_s + 0.01) == last and node.done.done()
    finally:
        node.destroy_node()


def test_the_seed_decides_the_path(context: rclpy.Context) -> None:
    paths = []
    for given in ({}, {"seed": 0}, {"seed": 1}, {"arm": "phantom", "tip": "phantom_tip"}):
        node = node_of(context, hand=HAND, seconds=1.0, **given)
        paths.append(node._path.angles_rad)
        node.destroy_node()
    assert np.array_equal(paths[0], paths[1]) and np.array_equal(paths[0], paths[3])
    assert paths[0].shape != paths[2].shape or not np.allclose(paths[0], paths[2])
