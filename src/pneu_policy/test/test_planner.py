# SPDX-License-Identifier: Apache-2.0
"""Plans of forces, and the inverse dynamics behind them, against simulated motion."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pneu_common.errors import InputError
from pneu_policy.control.plan_settings import PlanSettings
from pneu_policy.control.planner import Planner
from pneu_sim.inverse import InverseDynamics
from pneu_sim.plant import Plant
from pneu_sim.rig.load import load_rig

RIGS = Path(__file__).parents[3] / "rigs"


@pytest.mark.parametrize(("name", "share"), [("kokoro", 0.1), ("arm", 0.1), ("rail", 0.02)])
def test_required_forces_are_those_that_moved_the_simulated_robot(name: str, share: float) -> None:
    rig = load_rig(RIGS / f"{name}.yaml")
    inverse = InverseDynamics(rig)
    plant = Plant([rig], 0.25)
    plant.reset(dict.fromkeys([*rig.pipes, *plant.plan.chambers], 3.5e5))
    volts = np.full((1, len(rig.valves), 120), 5.0)
    volts[:, 0] = 6.5
    volts[:, 0, 60:] = 4.0
    series, _ = plant.advance(volts, 1e-3)
    q, v = series.joints[:, :, 0, 0], series.joints[:, :, 1, 0]
    force, extension = inverse.required(q, v, np.gradient(v, 1e-3, axis=0))
    np.testing.assert_allclose(extension, series.cylinders[:, :, 0, 0], atol=1e-9)
    moving = np.abs(series.cylinders[:, :, 1, 0]) > 0.02  # at rest dry friction may be anything
    moving[:2] = False
    off = (force - series.cylinders[:, :, 2, 0])[moving]
    assert moving.sum() > 50
    assert np.sqrt(np.mean(off**2)) < share * series.cylinders[:, :, 2, 0][moving].std()


def test_a_held_joint_needs_no_cylinder() -> None:
    inverse = InverseDynamics(load_rig(RIGS / "kokoro.yaml"))
    assert inverse.joints == ["shoulder", "elbow"]
    assert inverse.cylinders == ["forearm"]
    at_rest, _ = inverse.required(np.array([[9.0, 0.0]]), np.zeros((1, 2)), np.zeros((1, 2)))
    assert at_rest[0, 0] == pytest.approx(0.0, abs=1e-9)  # upright, whatever the held one says


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("cart_pole", "found 1 cylinders that move 2 joints"),
        ("dog", "found 4 cylinders that move 7 joints"),
        ("rig_a", "inverse dynamics are those of bodies, it has none"),
    ],
)
def test_robots_without_inverse_dynamics_are_refused(name: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        InverseDynamics(load_rig(RIGS / f"{name}.yaml"))


def planner(**settings: float) -> Planner:
    """Plans of the rail's cart, 0.2 s ahead in periods of 10 ms."""
    rig = load_rig(RIGS / "rail.yaml")
    return Planner(PlanSettings(**settings), rig, ["cart"], 0.01, 0.2)


def test_on_its_target_a_joint_is_pushed_as_the_target_moves() -> None:
    """A cart that is where it should be: mass times acceleration, plus friction."""
    one = planner(speed_hz=1000.0)
    w, middle, way = 2.0 * np.pi * 1.0, 0.15, 0.05
    times = np.arange(one.reach + 60) * 0.01
    course = middle + way * np.sin(w * times)
    for k in range(40):  # so that its speed is known
        force, extension = one.plan(course[None, None, k], course[None, None, k : k + one.reach])
    ahead = times[39 : 39 + one.steps + 1]
    v, a = way * w * np.cos(w * ahead), -way * w * w * np.sin(w * ahead)
    np.testing.assert_allclose(force[0, 0], 1.2 * a + 15.0 * v, atol=0.15)
    np.testing.assert_allclose(extension[0, 0], (middle + way * np.sin(w * ahead)) / 0.3, atol=2e-3)


def test_away_from_its_target_a_joint_is_led_there() -> None:
    one = planner(joining_hz=4.0, damping=1.0)
    targets = np.full((1, 1, one.reach), 0.2)
    force, way = one.plan(np.array([[0.1]]), targets)
    assert force[0, 0, 0] == pytest.approx(1.2 * (2.0 * np.pi * 4.0) ** 2 * 0.1, rel=1e-6)
    assert way[0, 0, 0] == pytest.approx(0.1 / 0.3)
    assert 0.195 / 0.3 < way[0, 0, -1] < 0.202 / 0.3  # critically damped: there, and not beyond
    limited = planner(joining_hz=4.0, most_rad_s2=10.0)
    force, _ = limited.plan(np.array([[0.1]]), targets)
    assert force[0, 0, 0] == pytest.approx(1.2 * 10.0)


def test_speeds_are_not_late() -> None:
    """A filter of differences alone would be 10 ms late: off by a tenth of their amplitude."""
    one = planner(speed_hz=30.0)
    times = np.arange(100 + one.reach) * 0.01
    w = 2.0 * np.pi * 1.5
    course = 0.15 + 0.05 * np.sin(w * times)
    speeds = []
    for k in range(100):
        one.plan(course[None, None, k], course[None, None, k : k + one.reach])
        assert one._speed is not None
        speeds.append(float(one._speed[0, 0]))
    true = 0.05 * w * np.cos(w * times[:100])
    off = np.array(speeds)[20:] - true[20:]
    assert np.sqrt(np.mean(off**2)) < 0.02 * 0.05 * w


def test_plans_do_not_depend_on_who_is_beside() -> None:
    rng = np.random.default_rng(0)
    many, alone = planner(), planner()
    for _ in range(5):
        place = rng.uniform(0.1, 0.2, (3, 1))
        targets = rng.uniform(0.1, 0.2, (3, 1, many.reach))
        together = many.plan(place, targets)
        own = alone.plan(place[1:2], targets[1:2])
        for one, other in zip(together, own, strict=True):
            np.testing.assert_allclose(one[1:2], other, rtol=1e-12)


def test_a_plan_needs_every_joint_that_moves() -> None:
    rig = load_rig(RIGS / "arm.yaml")
    with pytest.raises(InputError, match=r"recipe\.tracked: found shoulder; a plan needs every"):
        Planner(PlanSettings(), _with_encoders(rig), ["shoulder"], 0.01, 0.2)


def _with_encoders(rig):  # type: ignore[no-untyped-def]
    from pneu_sim.rig.schema import Encoder

    return rig.model_copy(update={"encoders": {n: Encoder() for n in ("shoulder", "elbow")}})
