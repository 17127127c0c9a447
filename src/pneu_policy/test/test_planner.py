# SPDX-License-Identifier: Apache-2.0
"""Plans of forces, and the inverse dynamics behind them, against simulated motion."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pneu_common.errors import InputError
from pneu_policy.control.drive import Drive
from pneu_policy.control.joint import JointGains, JointPid
from pneu_policy.control.plan_settings import PlanSettings
from pneu_policy.control.planner import Planner
from pneu_policy.control.robot_controllers import ComputedTorque, JointPidController, TorqueGains
from pneu_policy.control.robot_recipe import Push
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


def test_joints_may_be_tracked_in_any_order() -> None:
    rig, rng = load_rig(RIGS / "arm.yaml"), np.random.default_rng(1)
    straight = Planner(PlanSettings(), rig, ["shoulder", "elbow"], 0.01, 0.05)
    reverse = Planner(PlanSettings(), rig, ["elbow", "shoulder"], 0.01, 0.05)
    assert straight.cylinders == reverse.cylinders == ["shoulder", "elbow"]
    for _ in range(3):
        place = rng.uniform(-0.3, 0.6, (2, 2))
        targets = rng.uniform(-0.3, 0.6, (2, 2, straight.reach))
        one, other = straight.plan(place, targets), reverse.plan(place[:, ::-1], targets[:, ::-1])
        np.testing.assert_allclose(one[0], other[0], rtol=1e-9)
        np.testing.assert_allclose(one[1], other[1], rtol=1e-9)
    assert not np.allclose(one[0][:, 0], one[0][:, 1], rtol=0.1)


ROOM_PA = 101325.0
HEAD_M2 = {"elbow": 3e-4, "shoulder": 5e-4}
ROD_M2 = {"elbow": 2.4e-4, "shoulder": 4.1e-4}


def drives() -> list[Drive]:
    """Drives of the arm, the elbow first; rig and cylinders have the shoulder first."""
    return [
        Drive(
            name, name, f"{name}_out", f"{name}_in",
            Push(head_tap=f"{name}_head", rod_tap=f"{name}_rod", head_m2=HEAD_M2[name],
                 rod_m2=ROD_M2[name], room_pa=ROOM_PA),
            null_v,
        )
        for name, null_v in (("elbow", 4.7), ("shoulder", 5.2))
    ]  # fmt: skip


def told(rng: np.random.Generator) -> tuple[dict[str, float], dict[str, float]]:
    """Readings, in the order of the rig."""
    positions = {name: float(rng.uniform(-0.3, 0.6)) for name in ("shoulder", "elbow")}
    sides = [f"{name}_{side}" for name in ("shoulder", "elbow") for side in ("rod", "head")]
    return positions, {tap: float(rng.uniform(2e5, 5e5)) for tap in sides}


def gas_force(name: str, taps: dict[str, float]) -> float:
    """Net force of the gas on a piston."""
    head, rod = taps[f"{name}_head"] - ROOM_PA, taps[f"{name}_rod"] - ROOM_PA
    return head * HEAD_M2[name] - rod * ROD_M2[name]


def test_each_joint_has_its_own_pid() -> None:
    gains = [JointGains(3.0, 1.1, 0.2, 0.004), JointGains(4.2, 0.7, 0.3, 0.006)]
    controller = JointPidController(drives(), gains, 0.007)
    assert controller.tracked == ("elbow", "shoulder")
    assert controller.taps == ("elbow_head", "elbow_rod", "shoulder_head", "shoulder_rod")
    pids = [JointPid(g) for g in gains]
    for seed in range(2):
        rng = np.random.default_rng(seed)
        for pid in pids:
            pid.reset()
        controller.reset()
        for _ in range(5):
            positions, taps = told(rng)
            targets = rng.uniform(-0.3, 0.6, (2, 1))
            wanted = {}
            for k, (name, null_v) in enumerate((("elbow", 4.7), ("shoulder", 5.2))):
                force = gas_force(name, taps)
                u = pids[k].step(float(targets[k, 0]), positions[name], force, 0.007)
                wanted |= {f"{name}_out": null_v + u, f"{name}_in": null_v - u}
            assert controller.step(positions, taps, targets) == pytest.approx(wanted)


TORQUE = [
    TorqueGains(0.010, 0.05, lead_s=0.025, most_v=60.0, integral_v=50.0),
    TorqueGains(0.017, 0.09, lead_s=0.04, most_v=70.0, integral_v=40.0),
]


def test_each_cylinder_makes_the_force_of_its_own_plan() -> None:
    """Forces are taken from the plan at leads of their own, one between two periods."""
    rig = load_rig(RIGS / "arm.yaml")
    controller = ComputedTorque(drives(), TORQUE, PlanSettings(), rig, 0.01)
    plain = Planner(PlanSettings(), rig, ["shoulder", "elbow"], 0.01, 0.04)
    assert controller.reach == plain.reach
    for seed in range(2):
        rng, integral = np.random.default_rng(seed), {"elbow": 0.0, "shoulder": 0.0}
        controller.reset()
        plain.reset()
        for _ in range(4):
            positions, taps = told(rng)
            targets = rng.uniform(-0.3, 0.6, (2, plain.reach))
            now = np.array([[positions["shoulder"], positions["elbow"]]])
            forces = plain.plan(now, targets[None, ::-1])[0][0]
            asked = {"shoulder": forces[0][4], "elbow": 0.5 * (forces[1][2] + forces[1][3])}
            wanted = {}
            for g, name, null_v in zip(TORQUE, ("elbow", "shoulder"), (4.7, 5.2), strict=True):
                missing = asked[name] - gas_force(name, taps)
                integral[name] += g.ki_v_n_s * missing * 0.01
                u = g.kf_v_n * missing + integral[name]
                wanted |= {f"{name}_out": null_v + u, f"{name}_in": null_v - u}
            assert controller.step(positions, taps, targets) == pytest.approx(wanted)
        assert min(map(abs, integral.values())) > 0.01


@pytest.mark.parametrize(
    ("begun", "missing", "integral", "volts"),
    [
        # volts are 0.01 missing + integral, within 3; 100 N that are missing add 0.5 V
        (0.4, 100.0, 0.9, 1.9),
        (0.4, -100.0, -0.1, -1.1),
        (0.4, 170.0, 1.25, 2.95),
        (0.4, 180.0, 0.4, 2.2),  # the integral would lead beyond the limit
        (0.4, 900.0, 0.4, 3.0),
        (-0.4, -180.0, -0.4, -2.2),
        (-0.4, -900.0, -0.4, -3.0),
        (-2.0, 310.0, -0.45, 2.65),
        (-2.0, 400.0, 0.0, 4.0 - 1.0),  # towards zero, though beyond the limit
        (1.9, 100.0, 2.0, 3.0),  # the integral's own limits
        (-1.9, -90.0, -2.0, -2.9),
    ],
)
def test_the_integral_of_a_force_waits_at_the_limit(
    begun: float, missing: float, integral: float, volts: float
) -> None:
    rig = load_rig(RIGS / "arm.yaml")
    gains = TorqueGains(0.01, 0.5, integral_v=2.0, most_v=3.0)
    controller = ComputedTorque(drives(), [TORQUE[0], gains], PlanSettings(), rig, 0.01)
    positions = {"shoulder": 0.2, "elbow": 0.4}
    targets = np.tile([[0.4], [0.2]], (1, controller.reach))
    plain = Planner(PlanSettings(), rig, ["elbow", "shoulder"], 0.01, 0.025)
    holding = float(plain.plan(np.array([[0.4, 0.2]]), targets[None])[0][0, 0, 0])
    taps = dict.fromkeys(controller.taps, ROOM_PA)
    taps["shoulder_head"] += (holding - missing) / HEAD_M2["shoulder"]
    controller._integral_v[1] = begun
    found = controller.step(positions, taps, targets)
    assert found["shoulder_out"] == pytest.approx(5.2 + volts, abs=1e-9)
    assert found["shoulder_in"] == pytest.approx(5.2 - volts, abs=1e-9)
    assert controller._integral_v[1] == pytest.approx(integral, abs=1e-9)


def test_a_plan_needs_every_joint_that_moves() -> None:
    rig = load_rig(RIGS / "arm.yaml")
    with pytest.raises(InputError, match=r"recipe\.tracked: found shoulder; a plan needs every"):
        Planner(PlanSettings(), _with_encoders(rig), ["shoulder"], 0.01, 0.2)


def _with_encoders(rig):  # type: ignore[no-untyped-def]
    from pneu_sim.rig.schema import Encoder

    return rig.model_copy(update={"encoders": {n: Encoder() for n in ("shoulder", "elbow")}})
