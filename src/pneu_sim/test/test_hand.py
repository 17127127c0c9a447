# SPDX-License-Identifier: Apache-2.0
"""Hands: their files, the plant in time, kinematics, and what a wrist's sensor says of a touch."""

import math
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from pneu_common.errors import InputError
from pneu_sim.hand.drive import JointCommand, Motors, torque_of
from pneu_sim.hand.exercise import exercise
from pneu_sim.hand.loading import Hand
from pneu_sim.hand.operator import STRONGEST_N, Operator
from pneu_sim.hand.pace import Pace
from pneu_sim.hand.paths import Kinematics, through, way
from pneu_sim.hand.reach import Reach
from pneu_sim.hand.settings import JointSettings
from pneu_sim.hand.truth import Change, Lie, Truth
from pneu_sim.hand.truth import _set as set_truth
from pneu_sim.hand.world import World
from pneu_sim.hand.wrist import Wrist

SCENES = Path(__file__).parents[3] / "scenes/phantom"
HAND = SCENES / "hand.yaml"


@pytest.fixture(scope="module")
def hand() -> Hand:
    return Hand(HAND)


def altered(folder: Path, old: str, new: str) -> Path:
    text = HAND.read_text()
    assert old in text
    for name in ("arm.xml", "hanging.xml"):
        (folder / name).write_text((SCENES / name).read_text())
    (folder / "hand.yaml").write_text(text.replace(old, new, 1))
    return folder / "hand.yaml"


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("pneu_hand: 1", "pneu_hand: 2", "pneu_hand: found 2, this version reads 1"),
        ("motor: phantom_waist", "motor: elbow", "no actuator 'elbow'; it has phantom_waist"),
        ("motor: phantom_shoulder", "motor: phantom_waist", "is that of arms.phantom.joints.waist"),
        ("encoder: phantom_linkage", "encoder: gyro", "has 3 components, 1 are needed"),
        ("position: place", "position: nowhere", "no sensor 'nowhere'"),
        ("lower_rad: -0.8", "lower_rad: 0.9", "lower_rad: found 0.9, allowed is below upper_rad"),
        ("torque_limit_n_m: 0.6", "torque_limit_n_m: 0.1", "continuous_n_m: found 0.13"),
        ("waist:", "waist 1:", "should match pattern"),
        ("mjcf: hanging.xml", "mjcf: none.xml", "none.xml: no such MJCF"),
    ],
)
def test_a_hand_file_that_is_wrong_is_one_sentence(
    tmp_path: Path, old: str, new: str, says: str
) -> None:
    with pytest.raises(InputError, match=says) as error:
        Hand(altered(tmp_path, old, new))
    assert "\n" not in str(error.value)


def test_an_arm_is_balanced_wherever_it_stands(hand: Hand) -> None:
    """Without torque, friction aside, no joint of the arm is pushed by weights."""
    model = hand.spec().compile()
    data = mujoco.MjData(model)
    for waist, shoulder, elbow in ((0.0, 0.0, 0.0), (0.5, 0.4, -0.3), (-0.3, -0.5, 0.9)):
        for name, at in (("waist", waist), ("shoulder", shoulder), ("elbow", elbow)):
            data.joint(f"phantom_{name}").qpos = at
        mujoco.mj_forward(model, data)
        for name in ("waist", "shoulder", "elbow"):
            dof = model.joint(f"phantom_{name}").dofadr[0]
            weight = data.qfrc_passive[dof] - data.qfrc_bias[dof]
            assert abs(weight) < 1e-4, name


def test_sensors_tell_at_their_own_rates_and_the_plants_time(hand: Hand) -> None:
    world = World(hand, seed=3)
    counts: dict[str, list[float]] = {}
    for _ in range(4000):
        for reading in world.advance({"phantom": [0.0, 0.0, 0.0]}):
            counts.setdefault(reading.kind, []).append(reading.time_s)
    assert world.time_s == pytest.approx(2.0)
    assert {k: len(v) for k, v in counts.items()} == {"wrench": 2000, "imu": 3600, "pose": 480}
    assert counts["pose"][-1] == pytest.approx(479 / 240, abs=world.step_s)


def test_what_hangs_still_is_read_as_it_is(hand: Hand) -> None:
    world = World(hand, seed=5)
    rows: dict[str, list[np.ndarray]] = {}
    for _ in range(4000):
        for reading in world.advance({"phantom": [0.0, 0.0, 0.0]}):
            if world.time_s > 1.5:
                rows.setdefault(reading.kind, []).append(reading.values)
    wrench, imu = (np.mean(rows[k], axis=0) for k in ("wrench", "imu"))
    assert wrench[2] == pytest.approx(0.022 * 9.81, abs=0.002)  # the tip hangs on its sensor
    assert imu[5] == pytest.approx(9.81, abs=0.02)
    assert np.std(np.array(rows["pose"])[:, 1]) == pytest.approx(1e-4, rel=0.2)
    assert np.std(np.array(rows["wrench"])[:, 0]) == pytest.approx(0.01, rel=0.1)


def test_what_is_hidden_is_in_the_plant_and_in_its_sensors(hand: Hand) -> None:
    truth = Truth(
        model=(
            Change(of="joint", name="phantom_tip_x", set="stiffness", times=0.5),
            Change(of="geom", name="object", set="friction", to=0.27),
            Change(of="geom", name="object", set="stiffness", to=9000.0),
        ),
        sensors={"phantom_waist": Lie(gain=1.02), "place": Lie(lag_s=0.004)},
    )
    world, plain = World(hand, truth), World(hand)
    assert world.model.joint("phantom_tip_x").stiffness[0] == pytest.approx(
        0.5 * plain.model.joint("phantom_tip_x").stiffness[0]
    )
    assert world.model.geom("object").friction[0] == 0.27
    assert world.model.geom("object").solref[0] == -9000.0
    assert world.model.geom("object").solref[1] == plain.model.geom("object").solref[1]
    for one in (world, plain):
        one.data.joint("phantom_waist").qpos = 0.3
        one.data.joint("object").qvel[:3] = [0.5, 0.0, 0.0]
    told: dict[int, dict[float, float]] = {}
    for one in (world, plain):
        for _ in range(40):
            for reading in one.advance({"phantom": [0.0, 0.0, 0.0]}):
                if reading.kind == "pose":
                    told.setdefault(id(one), {})[reading.time_s] = float(reading.values[0])
    assert world.counts("phantom")[0] == pytest.approx(1.02 * plain.counts("phantom")[0], abs=1)
    late = [told[id(plain)][t] - told[id(world)][t] for t in told[id(world)] if t > 0.008]
    assert np.mean(late) == pytest.approx(0.5 * 0.004, abs=2e-4)


@pytest.mark.parametrize(
    ("what", "to"), [("stiffness", (-8000.0, -160.0)), ("damping", (-4000.0, -320.0))]
)
def test_a_contact_by_time_constant_is_one_by_stiffness(what: str, to: tuple[float, float]) -> None:
    """k = 1 / (t z)^2 and b = 2 / t, per mass (MuJoCo, solver parameters)."""
    geom = SimpleNamespace(solref=np.array([0.0125, 1.26491106]))
    set_truth(geom, Change(of="geom", name="object", set=what, times=2.0))
    assert geom.solref == pytest.approx(to, rel=1e-6)


@pytest.mark.parametrize(
    ("truth", "says"),
    [
        (Truth(model=(Change(of="joint", name="x", set="damping", to=1.0),)), "no joint 'x'"),
        (
            Truth(model=(Change(of="geom", name="object", set="colour", to=1.0),)),
            "found 'colour', of a geom friction, mass",
        ),
        (Truth(model=(Change(of="geom", name="object", set="mass"),)), "either to or times"),
        (Truth(sensors={"nose": Lie()}), "no sensor 'nose'"),
    ],
)
def test_what_cannot_be_hidden_is_said(hand: Hand, truth: Truth, says: str) -> None:
    with pytest.raises(InputError, match=says):
        World(hand, truth)


def test_angles_bring_the_tip_where_it_should_be(hand: Hand) -> None:
    kinematics = Kinematics(hand, "phantom", "phantom_tip")
    # by hand: 0.215 m forward, 0.170 m down from a shoulder at 0.3 m
    assert kinematics.tip(np.zeros(3)) == pytest.approx([0.215, 0.0, 0.13])
    a, b, c = 0.2, 0.3, -0.25
    reach = 0.215 * math.cos(b) + 0.17 * math.sin(c)
    height = 0.3 + 0.215 * math.sin(b) - 0.17 * math.cos(c)
    told = kinematics.tip(np.array([a, b, c]))
    assert told == pytest.approx([reach * math.cos(a), reach * math.sin(a), height])
    angles = kinematics.angles(told, np.zeros(3))
    assert angles == pytest.approx([a, b, c], abs=1e-3)
    slope = kinematics.slope(np.array([a, b, c]))
    for k in range(3):
        e = np.zeros(3)
        e[k] = 1e-6
        change = kinematics.tip(np.array([a, b, c]) + e) - kinematics.tip(np.array([a, b, c]) - e)
        assert slope[:, k] == pytest.approx(change / 2e-6, abs=1e-6)
    with pytest.raises(InputError, match=r"its tip cannot reach \(0.900, 0.000, 0.100\) m"):
        kinematics.angles(np.array([0.9, 0.0, 0.1]), np.zeros(3))


def test_tips_of_many_arms_are_where_each_arms_kinematics_say() -> None:
    three = Hand(SCENES / "pushing.yaml")
    reach = Reach(three)
    rng = np.random.default_rng(3)
    angles, speed = rng.uniform(-0.4, 0.4, (2, 3, 3)), rng.normal(size=(2, 3, 3))
    model = three.spec().compile()
    plants = []
    for k in range(2):
        data = mujoco.MjData(model)
        # a tip that is bent is not known of
        data.joint("two_tip_x").qpos[0] = 0.2
        reach.put(data, angles[k], speed[k])
        mujoco.mj_kinematics(model, data)
        plants.append(data)
    place, velocity, slope = reach.tips(plants)
    for number, arm in enumerate(reach.arms):
        alone = Kinematics(three, arm, f"{arm}_tip")
        for k in range(2):
            at = angles[k, number]
            np.testing.assert_allclose(place[k, number], alone.tip(at), atol=1e-12)
            np.testing.assert_allclose(slope[k, number], alone.slope(at), atol=1e-9)
            ahead = alone.tip(at + 1e-6 * speed[k, number]) - alone.tip(
                at - 1e-6 * speed[k, number]
            )
            np.testing.assert_allclose(velocity[k, number], ahead / 2e-6, atol=1e-6)
    rest = reach.home_m - [0.0, 0.0, reach.home_m[0, 2]]
    np.testing.assert_allclose(np.linalg.norm(rest, axis=1), 0.06, atol=1e-9)


def test_a_plant_may_go_slower_than_the_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [100.0]
    monkeypatch.setattr("pneu_sim.hand.pace.time.monotonic", lambda: clock[0])
    monkeypatch.setattr(
        "pneu_sim.hand.pace.time.sleep", lambda s: clock.__setitem__(0, clock[0] + s + 1e-9)
    )
    pace = Pace(2.0, rate=0.25)
    for step in range(1, 101):
        pace.wait(2.0 + 0.0005 * step)
    assert clock[0] == pytest.approx(100.0 + 0.05 / 0.25, abs=1e-5)
    clock[0] += 1.0  # held up: it stands still rather than leaps
    pace.wait(2.05)
    pace.wait(2.06)
    assert pace.stood_s == pytest.approx(1.0, abs=1e-5)
    assert clock[0] == pytest.approx(101.2 + 0.01 / 0.25, abs=1e-5)


def test_a_path_begins_and_ends_at_rest_and_goes_straight(hand: Hand) -> None:
    kinematics = Kinematics(hand, "phantom", "phantom_tip")
    begin, end = np.array([0.215, 0.0, 0.13]), np.array([0.235, 0.02, 0.15])
    path = through(kinematics, np.vstack([begin, way(begin, end, 0.5)]))
    tips = np.array([kinematics.tip(a) for a in path.angles_rad])
    off = (tips - begin) - np.outer((tips - begin) @ (end - begin), end - begin) / 0.0012
    assert np.max(np.abs(off)) < 1e-4
    assert np.max(np.abs(path.at(0.0)[1])) < 0.02
    assert path.at(99.0)[1] == pytest.approx(np.zeros(3))


def test_an_exercise_touches_and_slides_and_lets_go(hand: Hand) -> None:
    kinematics = Kinematics(hand, "phantom", "phantom_tip")
    path = exercise(hand, kinematics, "phantom_tip", "object", 6.0, seed=1)
    assert np.array_equal(
        path.angles_rad, exercise(hand, kinematics, "phantom_tip", "object", 6.0, 1).angles_rad
    )
    assert np.max(np.abs(np.diff(path.angles_rad, axis=0))) < 0.02  # without jumps
    world = World(hand, touch=True)
    motors = Motors(list(hand.settings.arms["phantom"].joints.values()))
    wrist, touches, raw = Wrist(hand, "phantom"), [], []
    for _ in range(round(6.0 / world.step_s)):
        wanted = [JointCommand(*both) for both in zip(*path.at(world.time_s), strict=True)]
        torques = motors.drive(world.counts("phantom"), world.time_s, wanted)
        for reading in world.advance({"phantom": torques}):
            if reading.kind == "touch":
                touches.append(reading.values[:3])
            elif reading.kind == "wrench":
                raw.append(wrist.push(np.array(motors.position_rad), reading.values[:3]))
    true = np.array(touches)
    size = np.linalg.norm(true, axis=1)
    assert 0.2 < np.mean(size > 0.01) < 0.9
    assert 0.3 < np.max(size) < 5.0
    # at the wrist the same is felt, but for what moves beyond it, and noise of 0.01 N
    off = np.array(raw)[: len(true)] - true
    assert np.sqrt(np.mean(off**2)) < 0.03
    assert np.corrcoef(np.array(raw)[: len(true), 0], true[:, 0])[0, 1] > 0.98


def test_a_spring_and_a_damper_pull_as_they_are_told() -> None:
    joint = JointSettings(
        motor="m", encoder="e", torque_limit_n_m=1.0, continuous_n_m=0.2, lower_rad=-1.0,
        upper_rad=1.0, stiffness_n_m_rad=5.0, damping_n_m_s_rad=0.1,
    )  # fmt: skip
    assert torque_of(joint, JointCommand(), 0.3, 2.0) == 0.0
    assert torque_of(joint, JointCommand(effort_n_m=0.2), 0.3, 2.0) == 0.2
    assert torque_of(joint, JointCommand(0.5), 0.3, 2.0) == pytest.approx(1.0 - 0.2)
    assert torque_of(joint, JointCommand(0.5, 3.0, -0.1), 0.3, 2.0) == pytest.approx(
        1.0 + 0.1 - 0.1
    )
    assert torque_of(joint, JointCommand(velocity_rad_s=3.0), 0.3, 2.0) == pytest.approx(0.1)


@pytest.mark.long
def test_an_operator_leads_one_arm_and_the_other_touches() -> None:
    """Coupled position to position, what the follower presses on is felt by who leads."""
    two = Hand(SCENES / "teleoperation.yaml")
    operator = Operator(two, "leader", "phantom", "object", 4.0, seed=1)
    assert operator.ends_s == pytest.approx(6.5, abs=0.01)
    world = World(two, seed=1, operator=operator, touch=True)
    arms = {a: Motors(list(its.joints.values())) for a, its in two.settings.arms.items()}
    leader, follower = arms["leader"], arms["phantom"]
    commands: dict[str, list[JointCommand]] = {}
    touch, rows = 0.0, []
    while world.time_s < operator.ends_s:
        now_s = world.time_s
        torques = {a: m.drive(world.counts(a), now_s, commands.get(a)) for a, m in arms.items()}
        for reading in world.advance(torques):
            if reading.kind == "touch" and reading.name == "phantom":
                touch = float(np.linalg.norm(reading.values[:3]))
        pairs = zip(
            follower.joints,
            leader.position_rad,
            leader.velocity.velocity_rad_s,
            follower.position_rad,
            follower.velocity.velocity_rad_s,
            strict=True,
        )
        follow, feel = [], []
        for joint, lq, lv, fq, fv in pairs:
            follow.append(JointCommand(lq, lv))
            feel.append(JointCommand(effort_n_m=torque_of(joint, JointCommand(fq, fv), lq, lv)))
        commands = {"phantom": follow, "leader": feel}
        off = np.subtract(leader.position_rad, follower.position_rad)
        hand = np.linalg.norm(operator.wanted(now_s) - world.data.site("leader_wrench").xpos)
        rows.append((now_s, touch, np.abs(off).max(), np.abs(leader.torque_n_m).max(), hand))
    time_s, touches, off, felt, hand = np.array(rows).T
    assert touches[time_s < 2.5].max() == 0.0 < 0.3 < touches.max()
    assert off.max() < 0.1 and np.median(off) < 0.01
    pressed, free = touches > 0.3, (touches == 0.0) & (off < 0.02)
    assert np.median(felt[pressed]) > 3.0 * np.median(felt[free])
    assert np.median(hand) < 0.004 and np.abs(world.data.qfrc_applied).max() < STRONGEST_N


@pytest.mark.parametrize(
    ("leader", "follower", "thing", "says"),
    [
        ("mine", "phantom", "object", "leader: found 'mine'.*has phantom, leader"),
        ("leader", "yours", "object", "follower: found 'yours'"),
        ("leader", "phantom", "cup", "no geom 'cup'"),
    ],
)
def test_an_operator_needs_arms_and_a_thing(
    leader: str, follower: str, thing: str, says: str
) -> None:
    with pytest.raises(InputError, match=says):
        Operator(Hand(SCENES / "teleoperation.yaml"), leader, follower, thing, 2.0, 0)
