# SPDX-License-Identifier: Apache-2.0
"""Single steps of bodies, as plain Python: which cylinder acts where, seals, and pistons with play.

The body of interest is an arm, the second of two bodies, whose two cylinders are the second and the
fourth of four, in the second of two lanes. The first body is a mass on a rail.
"""

import math

import numpy as np
import pytest
from pydantic import TypeAdapter
from tests.uncompiled import plain

from pneu_sim import kernel
from pneu_sim import layout as L
from pneu_sim.bodies import kinds
from pneu_sim.kernel import bodies as steps
from pneu_sim.kernel import play

DT = 1e-3
SHOULDER, ELBOW = 1, 3  # cylinders of the arm
CART, IDLE = 2, 0  # that of the rail, and one that moves nothing
LANE = 1
START = np.array([0.3, 0.9])
ARM = TypeAdapter(kinds.AnyBody).validate_python(
    {
        "kind": "arm",
        "gravity_m_s2": 0.0,
        "upper_arm": {"length_m": 0.3, "tip_kg": 0.6, "mass_kg": 0.3, "centre_m": 0.12},
        "forearm": {"length_m": 0.25, "tip_kg": 0.4},
        "shoulder_cylinder": "one",
        "shoulder_crank": {"pivot_m": [0.05, -0.2], "pin_m": [0.06, 0.01], "closed_length_m": 0.15},
        "elbow_cylinder": "two",
        "elbow_crank": {"pivot_m": [-0.25, 0.03], "pin_m": [0.05, 0.01], "closed_length_m": 0.21},
    }
)
RAIL = TypeAdapter(kinds.AnyBody).validate_python(
    {"kind": "rail", "cylinder": "three", "mass_kg": 2.0}
)


def extensions(q):
    """Extensions of the arm's cylinders, shoulder first, by the law of cosines."""
    cranks = ARM.shoulder_crank, ARM.elbow_crank
    return np.array([c.length_m(x) - c.closed_length_m for c, x in zip(cranks, q, strict=True)])


def levers(q):
    """Their growth per motion of the joints, by differences."""
    h = 1e-6
    return np.diag((extensions(np.add(q, h)) - extensions(np.subtract(q, h))) / (2.0 * h))


def mass_matrix(q):
    """Mass matrix of the arm from the velocities of its links' masses."""
    l1, m1, c1 = 0.3, 0.3, 0.12
    upper = m1 * l1**2 / 12.0 + m1 * c1**2 + 0.6 * l1**2
    fore = np.array([[-l1 * math.sin(q[0]), 0.0], [l1 * math.cos(q[0]), 0.0]])
    tip = 0.25 * np.array([-math.sin(q[0] + q[1]), math.cos(q[0] + q[1])])
    jacobian = fore + np.outer(tip, [1.0, 1.0])
    return np.diag([upper, 0.0]) + 0.4 * jacobian.T @ jacobian


def make(speed=(0.0, 0.0), **play_rad):
    """Bodies and cylinders in two lanes; the arm moves in the second, and all else is at rest."""
    table = np.zeros((2, L.BODY_COLUMNS), dtype=np.int64)
    table[0] = [kinds.NUMBER[type(RAIL)], 0, 1, 0, 1]
    table[1] = [kinds.NUMBER[type(ARM)], 1, 2, 1, 2]
    par = np.zeros((2, L.BODY_PARAMS, 2))
    for b, body in enumerate((RAIL, ARM)):
        par[b, : len(body.numbers())] = np.array(body.numbers())[:, None]
    joint = np.zeros((3, L.JOINT_PARAMS, 2))
    joint[:, L.PJ_LOWER], joint[:, L.PJ_UPPER] = -5.0, 5.0
    joint[1:, L.PJ_PLAY, LANE] = play_rad.get("shoulder", 0.0), play_rad.get("elbow", 0.0)
    state = np.zeros((3, L.JOINT_STATE, 2))
    state[0, L.SJ_POSITION] = 0.1
    state[1:, L.SJ_POSITION] = START[:, None]
    state[1:, L.SJ_VELOCITY, LANE] = speed
    sizes = [(2,)] * 3 + [(2, 2), (2,), (2, 2), (4, 2), (4, 2)] + [(4,)] * 5 + [(2,)] * 4 + [(2, 2)]
    bodies = kernel.Bodies(
        table, np.array([CART, SHOULDER, ELBOW]), par, joint, state, np.zeros((2, 2)),
        *(np.full(size, np.nan) for size in sizes),
    )  # fmt: skip
    cylinders = kernel.Cylinders(
        np.zeros((4, L.CYLINDER_COLUMNS), dtype=np.int64), np.array([-1, 1, 0, 1]),
        np.zeros((4, L.CYLINDER_PARAMS, 2)), np.zeros((4, L.CYLINDER_STATE, 2)),
        np.zeros((4, L.CYLINDER_WORK, 2)),
    )  # fmt: skip
    cylinders.par[:, L.PY_STROKE], cylinders.par[:, L.PY_STRIBECK] = 1.0, 0.01
    cylinders.par[:, L.PY_MASS, LANE] = [0.5, 0.05, 0.9, 0.07]
    cylinders.state[:, L.SY_SIDE] = 1.0
    plain(steps.stand)(bodies, cylinders)
    return bodies, cylinders


def of_arm(rows, column):
    """One number of the arm's cylinders in its lane, shoulder first."""
    return rows[[SHOULDER, ELBOW], column, LANE]


def push(cylinders, column, values):
    """Set one parameter of the arm's cylinders in its lane, shoulder first."""
    cylinders.par[[SHOULDER, ELBOW], column, LANE] = values


# ---- seals ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("speed", [0.3, -0.3, 0.02, -0.7])
@pytest.mark.parametrize("bent", [0.0, 3e-5, -3e-5, 4e-4])
def test_a_seal_bends_by_the_backward_euler_rule_and_grows_with_its_slope(speed, bent):
    bend, most, stiffness = plain(steps._bend), 0.02, 4e4
    after, growth = bend(speed, bent, most, DT, stiffness)
    limit = most / DT / stiffness
    rate = speed - abs(speed) * after / limit  # at the end of the step
    assert after - bent == pytest.approx(DT * rate, rel=1e-9, abs=1e-18)
    h = 1e-6
    high, low = (bend(speed + way, bent, most, DT, stiffness)[0] for way in (h, -h))
    assert growth == pytest.approx((high - low) / (2.0 * h), rel=1e-5)


def test_a_seal_at_the_limits():
    bend, most, stiffness = plain(steps._bend), 0.02, 4e4
    limit = most / DT / stiffness
    assert bend(0.0, 0.0, most, DT, stiffness) == (0.0, DT)
    assert bend(0.0, 2e-5, most, DT, stiffness)[0] == 2e-5
    for speed in (0.5, -0.5):  # bent as far as friction holds: it stays there
        after, growth = bend(speed, math.copysign(limit, speed), most, DT, stiffness)
        assert after == pytest.approx(math.copysign(limit, speed))
        assert growth == pytest.approx(0.0, abs=1e-12)
    # where the motion turns, the slope is that of either side
    for zero, sign in ((0.0, 1.0), (-0.0, -1.0)):
        growth = bend(zero, 3e-4, most, DT, stiffness)[1]
        assert growth == pytest.approx(DT - sign * DT / limit * 3e-4)


# ---- which cylinder acts where -------------------------------------------------------------------


def test_pistons_stand_where_their_own_joints_have_them():
    speed = np.array([0.7, -1.1])
    _, cylinders = make(speed)
    state = cylinders.state
    assert of_arm(state, L.SY_EXTENSION) == pytest.approx(extensions(START), rel=1e-12)
    assert of_arm(state, L.SY_SPEED) == pytest.approx(levers(START) @ speed, rel=1e-6)
    assert state[CART, L.SY_EXTENSION, LANE] == 0.1 and state[CART, L.SY_SPEED, LANE] == 0.0
    assert not state[IDLE, : L.SY_SIDE].any() and not state[:, L.SY_SPEED, 0].any()


@pytest.mark.parametrize("loose", [False, True])
def test_speeds_are_predicted_at_the_middle_of_the_step(loose):
    speed, growth = np.array([0.7, -1.1]), np.array([30.0, -20.0])
    bodies, cylinders = make(speed, elbow=0.02 if loose else 0.0)
    bodies.state[1:, L.SJ_PUSH, LANE] = growth
    bodies.state[0, L.SJ_VELOCITY, LANE] = 0.4
    cylinders.state[IDLE, L.SY_SPEED] = 0.25, -0.6
    cylinders.state[ELBOW, L.SY_PUSH, LANE] = 8.0
    cylinders.state[ELBOW, L.SY_SPEED, LANE] = 0.2 if loose else np.nan
    cylinders.state[ELBOW, L.SY_SIDE, LANE] = 0.0
    plain(steps.foresee)(DT, bodies, cylinders)
    h = 0.5 * DT
    want = levers(START + h * (speed + 0.5 * h * growth)) @ (speed + h * growth)
    if loose:
        want[1] = 0.2 + h * 8.0
    assert of_arm(cylinders.work, L.WY_SPEED) == pytest.approx(want, rel=1e-6)
    assert cylinders.work[IDLE, L.WY_SPEED] == pytest.approx([0.25, -0.6])
    assert cylinders.work[CART, L.WY_SPEED] == pytest.approx([0.0, 0.4])


def test_forces_act_on_their_own_levers():
    """The rule of the middle of a step, with forces of gas, spring and damping of each cylinder."""
    bodies, cylinders = make()
    force, preload = np.array([40.0, -25.0]), np.array([3.0, 7.0])
    rate, viscous = np.array([2e3, 5e3]), np.array([60.0, 150.0])
    cylinders.state[[SHOULDER, ELBOW], L.SY_FORCE, LANE] = force
    cylinders.state[CART, L.SY_FORCE, LANE] = 6.0
    for column, values in zip(
        (L.PY_PRELOAD, L.PY_SPRING, L.PY_VISCOUS), (preload, rate, viscous), strict=True
    ):
        push(cylinders, column, values)
    cylinders.state[IDLE, L.SY_SPEED, LANE] = 0.3
    before = cylinders.state.copy()
    plain(steps.move)(DT, bodies, cylinders)
    new = bodies.state[1:, L.SJ_VELOCITY, LANE]
    lever, x = levers(START), extensions(START)
    grown = lever @ new  # of the pistons' speeds
    mean = force - preload - rate * (x + 0.25 * DT * grown) - viscous * 0.5 * grown
    assert mass_matrix(START) @ new / DT == pytest.approx(lever.T @ mean, rel=1e-6)
    q = START + 0.5 * DT * new
    assert bodies.state[1:, L.SJ_POSITION, LANE] == pytest.approx(q, rel=1e-12)
    assert bodies.state[1:, L.SJ_PUSH, LANE] == pytest.approx(new / DT)
    way = extensions(q) - x
    assert of_arm(cylinders.state, L.SY_EXTENSION) == pytest.approx(extensions(q), rel=1e-12)
    assert of_arm(cylinders.work, L.WY_MOVE) == pytest.approx(way, rel=1e-6)
    assert of_arm(cylinders.state, L.SY_SPEED) == pytest.approx(levers(q) @ new, rel=1e-6)
    assert of_arm(cylinders.state, L.SY_PUSH) == pytest.approx(levers(q) @ new / DT, rel=1e-6)
    assert bodies.heat[1, LANE] == pytest.approx(float(viscous @ way**2) / DT, rel=1e-6)
    # the mass on the rail, and what moves nothing but as it is told
    assert bodies.state[0, L.SJ_VELOCITY] == pytest.approx([0.0, DT * 6.0 / 2.0])
    assert cylinders.work[CART, L.WY_MOVE, LANE] == pytest.approx(0.5 * DT * DT * 3.0)
    assert cylinders.work[IDLE, L.WY_MOVE] == pytest.approx([0.0, DT * 0.3])
    assert cylinders.state[IDLE, L.SY_EXTENSION, LANE] == pytest.approx(DT * 0.3)
    # nothing pushes in the other lane
    assert np.array_equal(cylinders.state[..., 0], before[..., 0])
    assert not bodies.heat[:, 0].any() and bodies.heat[0, LANE] == 0.0


def test_a_moving_body_is_pushed_as_at_the_middle_of_the_step():
    """Coriolis forces are those of the kinetic energy, by differences of the mass matrix."""
    speed, growth, force = np.array([3.0, -4.0]), np.array([50.0, -70.0]), np.array([40.0, -25.0])
    bodies, cylinders = make(speed)
    bodies.state[1:, L.SJ_PUSH, LANE] = growth
    bodies.state[1:, L.SJ_POSITION, LANE] = START
    cylinders.state[[SHOULDER, ELBOW], L.SY_FORCE, LANE] = force
    bodies.joint[1:, L.PJ_DAMPING, LANE] = 0.3, 0.2
    plain(steps.move)(DT, bodies, cylinders)
    half, step = 0.5 * DT, 1e-6
    q, v = START + half * (speed + 0.5 * half * growth), speed + half * growth
    slopes = [
        (mass_matrix(q + step * unit) - mass_matrix(q - step * unit)) / (2.0 * step)
        for unit in np.eye(2)
    ]
    turning = [0.5 * v @ slope @ v for slope in slopes] - sum(slopes * v[:, None, None]) @ v
    new = bodies.state[1:, L.SJ_VELOCITY, LANE]
    damped = np.array([0.3, 0.2]) * 0.5 * (speed + new)
    found = mass_matrix(q) @ (new - speed) / DT
    assert found == pytest.approx(turning + levers(q).T @ force - damped, rel=1e-6)
    assert bodies.state[1:, L.SJ_POSITION, LANE] == pytest.approx(START + half * (speed + new))
    assert bodies.heat[1, LANE] == pytest.approx(DT * damped @ (speed + new) / 2.0)


@pytest.mark.parametrize("stuck", [False, True])
def test_each_seal_holds_its_own_piston(stuck):
    bodies, cylinders = make()
    force = np.array([250.0, -120.0])
    cylinders.state[[SHOULDER, ELBOW], L.SY_FORCE, LANE] = force
    cylinders.work[[SHOULDER, ELBOW], L.WY_FACE, LANE] = 3e5, 6e5
    cylinders.work[[SHOULDER, ELBOW], L.WY_FACE_ROD, LANE] = 2e5, 5e5
    cylinders.par[:, L.PY_ROOM_P] = 1e5
    push(cylinders, L.PY_COULOMB, [5.0, 1e4 if stuck else 4.0])
    push(cylinders, L.PY_PER_PA, [2e-5, 1e-5])
    push(cylinders, L.PY_BREAKAWAY, [6.0, 3.0])
    bodies.joint[1:, L.PJ_FRICTION, LANE] = 0.02, 0.03
    plain(steps.move)(DT, bodies, cylinders)
    new, lever = bodies.state[1:, L.SJ_VELOCITY, LANE], levers(START)
    sign = np.sign(lever @ new)
    on_joint = np.array([0.02, 0.03]) * np.sign(new)
    grip = np.array([5.0 + 2e-5 * 1.5e5 + 6.0, 4.0 + 1e-5 * 4.5e5 + 3.0])
    left = lever.T @ (force - grip * sign) - on_joint
    if stuck:
        assert new[1] == pytest.approx(0.0, abs=1e-9 * abs(new[0]))
        assert mass_matrix(START)[0, 0] * new[0] == pytest.approx(DT * left[0], rel=1e-6)
        work = grip[0] * abs(lever[0, 0] * new[0]) + abs(on_joint[0] * new[0])
    else:
        assert sign == pytest.approx(np.sign(force))
        assert mass_matrix(START) @ new == pytest.approx(DT * left, rel=1e-6)
        work = grip @ np.abs(lever @ new) + on_joint @ new
    assert bodies.heat[1, LANE] == pytest.approx(0.5 * DT * work, rel=1e-6)


def test_each_soft_seal_is_bent_by_its_own_piston():
    speed = np.array([0.02, -0.03])
    bodies, cylinders = make(speed)
    stiffness = np.array([3e4, 5e4])
    bent = np.array([4e-5, -2e-5])
    push(cylinders, L.PY_COULOMB, [9.0, 4.0])
    push(cylinders, L.PY_BREAKAWAY, [2.0, 3.0])
    push(cylinders, L.PY_STRIBECK, [1e-3, 2e-3])
    push(cylinders, L.PY_SOFT, 1.0 / stiffness)
    push(cylinders, L.PY_SOFT_DAMPING, [20.0, 30.0])
    cylinders.state[[SHOULDER, ELBOW], L.SY_BENT, LANE] = bent
    q = START + 0.5 * DT * speed
    plain(steps.move)(DT, bodies, cylinders)
    new, lever = bodies.state[1:, L.SJ_VELOCITY, LANE], levers(q)
    faster = np.array([2.0, 3.0]) * np.exp(-((lever @ speed / np.array([1e-3, 2e-3])) ** 2))
    grip = np.array([9.0, 4.0]) + faster
    after = of_arm(cylinders.state, L.SY_BENT)
    moved = lever @ new
    rate = moved - np.abs(moved) * after * stiffness / grip
    assert after - bent == pytest.approx(DT * rate, rel=1e-5)
    # at these speeds Coriolis forces are below a thousandth of what the seals do
    held = stiffness * after + np.array([20.0, 30.0]) * (after - bent) / DT
    gained = mass_matrix(q) @ (new - speed) / DT
    assert gained == pytest.approx(-lever.T @ held, rel=5e-3)


# ---- play ----------------------------------------------------------------------------------------


def test_the_mass_of_a_loose_piston_is_no_part_of_its_body():
    bodies, cylinders = make(elbow=0.02, shoulder=0.03)
    lever = np.array([[0.6, 0.0], [0.0, -0.8]])
    for side, at in ((SHOULDER, 1.0), (ELBOW, 0.0)):
        cylinders.state[side, L.SY_SIDE, LANE] = at
    for own, taken in ((0.07, 0.07 * 0.64), (5.0, 0.9 * 0.5)):  # something of a body is left
        cylinders.par[ELBOW, L.PY_MASS, LANE] = own
        bodies.lever[:], bodies.mass[:] = lever, [[1.1, 0.2], [0.2, 0.5]]
        bodies.force[:] = 3.0, 4.0
        plain(steps._leave_behind)(1, LANE, bodies, cylinders)
        assert bodies.mass == pytest.approx(np.array([[1.1, 0.2], [0.2, 0.5 - taken]]))
        assert bodies.force == pytest.approx([3.0, 4.0])  # only on a rail is it part of the weight


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("held", [1.0, -1.0])
def test_a_piston_lets_go_of_a_face_that_would_hold_it_back(side, held):
    """What its face does to it: what accelerates it, less all other forces."""
    bodies, cylinders = make(elbow=0.02, shoulder=0.03)
    lever, now, new = np.diag([0.6, -0.8]), np.array([0.4, 0.5]), np.array([0.43, 0.44])
    bodies.lever[:], bodies.v[:] = lever, new
    bodies.state[1:, L.SJ_VELOCITY, LANE] = now
    bodies.loose[:], bodies.row[:] = [0.0, play.LEANS], [0.0, 1.0]
    bodies.impulse[:2] = 50.0, 0.002
    speed, viscous, rate = lever[1] @ (now + new) / 2.0, 40.0, 3e3
    x = cylinders.state[ELBOW, L.SY_EXTENSION, LANE]
    mean = x + 0.25 * DT * lever[1] @ (now + new)
    others = 0.002 / DT - viscous * speed - rate * mean - 2.5
    needed = 0.07 * (lever[1] @ (new - now)) / DT
    cylinders.par[ELBOW, L.PY_VISCOUS, LANE] = viscous
    cylinders.par[ELBOW, L.PY_SPRING, LANE] = rate
    cylinders.par[ELBOW, L.PY_PRELOAD, LANE] = 2.5
    # the piston presses on its face by a thousandth of a newton, or would have to pull as hard
    cylinders.state[ELBOW, L.SY_FORCE, LANE] = needed - others + 1e-3 * held
    cylinders.state[ELBOW, L.SY_SIDE, LANE] = side
    plain(steps._let_go)(1, LANE, DT, bodies, cylinders)
    gone = held * side < 0.0
    assert bodies.row == pytest.approx([0.0, steps.LET_GO if gone else 1.0])
    bodies.loose[1], bodies.row[1] = play.LOOSE, 1.0  # a loose piston has no face to let go of
    plain(steps._let_go)(1, LANE, DT, bodies, cylinders)
    assert bodies.row[1] == 1.0


def ends(q, play_rad):
    """Least and greatest extension of the elbow's piston within its play."""
    faces = (extensions(np.add(q, [0.0, way * 0.5 * play_rad]))[1] for way in (-1.0, 1.0))
    return sorted(faces)


def loosen(play_rad, at, speed):
    """An arm at rest whose elbow's piston is loose at some share of its play, at some speed."""
    bodies, cylinders = make(elbow=play_rad)
    low, high = ends(START, play_rad)
    cylinders.state[ELBOW, L.SY_SIDE, LANE] = 0.0
    cylinders.state[ELBOW, L.SY_EXTENSION, LANE] = low + at * (high - low)
    cylinders.state[ELBOW, L.SY_SPEED, LANE] = speed
    return bodies, cylinders


@pytest.mark.parametrize("soft", [False, True])
@pytest.mark.parametrize("speed", [0.2, -0.3])
def test_a_loose_piston_moves_by_its_own_mass(soft, speed):
    bodies, cylinders = loosen(0.3, 0.4, speed)
    own, force, preload, rate, viscous, grip = 0.07, 5.0, 3.0, 400.0, 15.0, 1.2
    for column, value in (
        (L.PY_PRELOAD, preload), (L.PY_SPRING, rate), (L.PY_VISCOUS, viscous),
        (L.PY_COULOMB, grip), (L.PY_SOFT, 2e-4 if soft else 0.0), (L.PY_SOFT_DAMPING, 6.0),
    ):  # fmt: skip
        cylinders.par[ELBOW, column, LANE] = value
    cylinders.state[ELBOW, L.SY_FORCE, LANE] = force
    cylinders.state[ELBOW, L.SY_BENT, LANE] = 3e-5
    cylinders.state[[IDLE, CART, SHOULDER], L.SY_BENT, LANE] = 7.0
    bodies.joint[1, L.PJ_DAMPING, LANE], bodies.state[1, L.SJ_VELOCITY, LANE] = 3.0, 0.02
    x = cylinders.state[ELBOW, L.SY_EXTENSION, LANE]
    plain(steps.move)(DT, bodies, cylinders)
    new, bent = cylinders.state[ELBOW, [L.SY_SPEED, L.SY_BENT], LANE]
    way = 0.5 * DT * (speed + new)
    held = math.copysign(grip, new)
    if soft:
        assert bent - 3e-5 == pytest.approx(DT * (new - abs(new) * bent / (grip * 2e-4)))
        held = bent / 2e-4 + 6.0 * (bent - 3e-5) / DT
    else:
        assert bent == 3e-5
    want = force - preload - rate * (x + 0.5 * way) - viscous * way / DT - held
    assert own * (new - speed) / DT == pytest.approx(want, rel=1e-9)
    assert cylinders.state[ELBOW, L.SY_PUSH, LANE] == pytest.approx((new - speed) / DT)
    assert cylinders.state[ELBOW, L.SY_EXTENSION, LANE] == pytest.approx(x + way, rel=1e-12)
    assert cylinders.work[ELBOW, L.WY_MOVE, LANE] == pytest.approx(way, rel=1e-9)
    assert cylinders.state[ELBOW, L.SY_SIDE, LANE] == 0.0
    # only the damping of its shoulder acts on the arm
    mean = 0.5 * (0.02 + bodies.state[1, L.SJ_VELOCITY, LANE])
    assert 0.019 < mean < 0.02
    damped = DT * 3.0 * mean**2
    assert bodies.heat[1, LANE] == pytest.approx(viscous * way**2 / DT + held * way + damped)
    assert cylinders.state[[IDLE, CART, SHOULDER], L.SY_BENT, LANE] == pytest.approx([7.0] * 3)


@pytest.mark.parametrize("moving", [0.0, 0.05])
@pytest.mark.parametrize(
    ("at", "speed", "side"), [(0.999, 0.3, 1.0), (0.001, -0.3, -1.0), (0.2, 0.3, 0.0)]
)
def test_a_loose_piston_takes_its_body_along_from_the_face_that_it_meets(at, speed, side, moving):
    """An inelastic impact: what moves along the lever then has both masses."""
    width, own, before = 0.02, 0.07, moving * np.array([1.0, -2.0])
    bodies, cylinders = loosen(width, at, speed)
    bodies.state[1:, L.SJ_VELOCITY, LANE] = before
    plain(steps.move)(DT, bodies, cylinders)
    assert cylinders.state[ELBOW, L.SY_SIDE, LANE] == side
    q, new = bodies.state[1:, [L.SJ_POSITION, L.SJ_VELOCITY], LANE].T
    low, high = ends(q, width)
    x = cylinders.state[ELBOW, L.SY_EXTENSION, LANE]
    # Coriolis forces change these velocities by less than a ten-thousandth in a step
    assert q == pytest.approx(START + DT * before, rel=1e-7)
    if side == 0.0:
        assert new == pytest.approx(before, rel=1e-3, abs=1e-15) and low < x < high
        return
    assert x == pytest.approx(high if side > 0.0 else low, rel=1e-12)
    forward = 1.0 if levers(q)[1, 1] > 0.0 else -1.0
    there, here = levers(np.add(q, [0.0, side * forward * 0.5 * width]))[1], levers(q)[1]
    alone = mass_matrix(q) - own * np.outer(here, here)
    together = alone + own * np.outer(there, there)
    want = np.linalg.solve(together, alone @ before + own * speed * there)
    assert new == pytest.approx(want, rel=1e-3 if moving else 1e-6)
    assert cylinders.state[ELBOW, L.SY_SPEED, LANE] == pytest.approx(there @ new, rel=1e-6)
    # the shoulder's piston has no play, and goes with its joint
    shoulder = cylinders.state[SHOULDER, L.SY_SPEED, LANE]
    assert shoulder == pytest.approx(levers(q)[0, 0] * new[0], rel=1e-6)


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("force", [9.0, -9.0])
def test_a_piston_that_is_drawn_off_its_face_is_loose_from_the_next_step(side, force):
    bodies, cylinders = make(elbow=0.02)
    cylinders.state[ELBOW, L.SY_SIDE, LANE] = side
    cylinders.state[ELBOW, L.SY_FORCE, LANE] = force
    plain(steps.move)(DT, bodies, cylinders)
    assert cylinders.state[ELBOW, L.SY_SIDE, LANE] == (side if force * side > 0.0 else 0.0)
    assert cylinders.state[SHOULDER, L.SY_SIDE, LANE] == 1.0


@pytest.mark.parametrize("at", [-0.5, 0.3, 1.5])
def test_a_loose_piston_is_put_within_its_play(at):
    width = 0.02
    bodies, cylinders = loosen(width, at, 0.4)
    plain(steps.stand)(bodies, cylinders)
    low, high = ends(START, width)
    want = low + min(max(at, 0.0), 1.0) * (high - low)
    assert cylinders.state[ELBOW, L.SY_EXTENSION, LANE] == pytest.approx(want, rel=1e-12)
    assert cylinders.state[ELBOW, [L.SY_SPEED, L.SY_SIDE], LANE] == pytest.approx([0.4, 0.0])
    assert of_arm(cylinders.state, L.SY_EXTENSION)[0] == pytest.approx(extensions(START)[0])
