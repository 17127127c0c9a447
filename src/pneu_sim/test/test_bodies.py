# SPDX-License-Identifier: Apache-2.0
"""Bodies: their equations against MuJoCo's, conservation laws, and what they refuse."""

import math

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError
from scipy.integrate import solve_ivp

from pneu_sim.bodies import kinds
from pneu_sim.bodies.crank import Crank, SliderCrank
from pneu_sim.bodies.dog import Dog
from pneu_sim.bodies.kokoro import Kokoro
from pneu_sim.bodies.link import Link
from pneu_sim.kernel.equations import kinds as equations

STATES = 200
EXACT = 1e-9  # relative to the largest entry

JOINT_J = {  # the single joint of data sheets: a crank of 35 mm, a pivot at 160 mm
    "kind": "kokoro",
    "theta_cylinder": "cylinder",
    "slider": {"pivot_m": 0.16, "crank_m": 0.035, "closed_length_m": 0.133},
    "theta_inertia_kg_m2": 0.02,
    "mass_kg": 1.5,
    "centre_m": 0.1,
    "theta": {"lower": -0.85, "upper": 0.85},
}
TWO_JOINTS = {
    **JOINT_J,
    "slider": {"pivot_m": 0.16, "crank_m": 0.035, "phase_rad": 0.3, "closed_length_m": 0.13},
    "alpha_cylinder": "rotary",
    "alpha_inertia_kg_m2": 0.03,
    "alpha": {},
}
ARM = {
    "kind": "arm",
    "upper_arm": {"length_m": 0.3, "tip_kg": 0.6, "mass_kg": 0.3, "centre_m": 0.12},
    "forearm": {"length_m": 0.25, "tip_kg": 0.4},
    "shoulder_cylinder": "one",
    "shoulder_crank": {"pivot_m": [0.05, -0.2], "pin_m": [0.06, 0.01], "closed_length_m": 0.15},
    "elbow_cylinder": "two",
    "elbow_crank": {
        "pivot_m": [-0.25, 0.03],
        "pin_m": [0.05, 0.0],
        "closed_length_m": 0.21,
        "offset_rad": 1.2,
    },
    "elbow": {"lower": -1.0, "upper": 1.5},
}
DOG = {
    "kind": "dog",
    "front": {"hip_cylinder": "fh", "knee_cylinder": "fk"},
    "rear": {"hip_cylinder": "rh", "knee_cylinder": "rk"},
}
EXAMPLES = {
    "rail": {"kind": "rail", "cylinder": "c", "mass_kg": 2.0, "incline_rad": 0.4},
    "cart_pole": {
        "kind": "cart_pole",
        "cylinder": "c",
        "cart_kg": 1.2,
        "rod": {"length_m": 0.5, "tip_kg": 0.2, "mass_kg": 0.1},
        "closed_at_m": -0.25,
    },
    "cart_pole of a point": {
        "kind": "cart_pole",
        "cylinder": "c",
        "cart_kg": 1.2,
        "rod": {"length_m": 0.5, "tip_kg": 0.2},
    },
    "arm": ARM,
    "level arm": {**ARM, "gravity_m_s2": 0.0},
    "kokoro": TWO_JOINTS,
    "kokoro without rotary": {**TWO_JOINTS, "alpha_cylinder": None},
    "far centre": {**TWO_JOINTS, "mass_kg": 0.6, "centre_m": 0.25},
    "dog": DOG,
    "uneven dog": {
        **DOG,
        "rear": {
            **DOG["rear"],
            "thigh": {"length_m": 0.23, "mass_kg": 0.4, "inertia_kg_m2": 0.003},
            "shank": {"length_m": 0.17, "tip_kg": 0.2},
        },
        "torso_inertia_kg_m2": 0.07,
    },
}


def read(document):
    return TypeAdapter(kinds.AnyBody).validate_python(document)


BODIES = {name: read(document) for name, document in EXAMPLES.items()}
each = pytest.mark.parametrize("body", BODIES.values(), ids=list(BODIES))


class Compiled:
    """A body with its compiled functions, as the second of two in the third of three lanes."""

    def __init__(self, body):
        numbers = body.numbers()
        self.kind = kinds.NUMBER[type(body)]
        self.n, self.cylinders = len(body.joints), len(body.driven_by)
        self.par = np.full((2, len(numbers), 3), np.nan)
        self.par[1, :, 2] = numbers

    def mechanics(self, q, v):
        mass, force = np.full((self.n, self.n), np.nan), np.full(self.n, np.nan)
        equations.mechanics(self.kind, self.par, 1, 2, q, v, mass, force)
        return mass, force

    def levers(self, q):
        extension = np.full(self.cylinders, np.nan)
        lever = np.full((self.cylinders, self.n), np.nan)
        equations.levers(self.kind, self.par, 1, 2, q, extension, lever)
        return extension, lever


def states(body, seed=0, count=STATES):
    """Random positions, velocities and forces; a dog is in the air."""
    rng = np.random.default_rng(seed)
    n = len(body.joints)
    for _ in range(count):
        q, v, force = rng.uniform(-3.2, 3.2, n), rng.normal(0.0, 4.0, n), rng.normal(0.0, 5.0, n)
        if body.kind == "dog":
            q[1] += 5.0
        yield q, v, force


def close(found, expected, tolerance=EXACT, least=1e-3):
    """Whether arrays agree relative to the largest entry, or absolutely where all is small."""
    scale = max(float(np.max(np.abs(expected), initial=0.0)), least)
    assert np.max(np.abs(found - expected)) <= tolerance * scale


def closed_m(body):
    """Tendon length of each cylinder when closed."""
    return {
        "rail": lambda: [0.0],
        "cart_pole": lambda: [body.closed_at_m],
        "arm": lambda: [body.shoulder_crank.closed_length_m, body.elbow_crank.closed_length_m],
        "kokoro": lambda: [body.slider.closed_length_m, 0.0][: len(body.driven_by)],
        "dog": lambda: [
            crank.closed_length_m
            for leg in (body.front, body.rear)
            for crank in (leg.hip_crank, leg.knee_crank)
        ],
    }[body.kind]()


def in_mujoco(body):
    """MuJoCo's model of a body, without contacts, and its data."""
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(body.mjcf())
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    return mujoco, model, mujoco.MjData(model)


@each
def test_joints_and_cylinders_are_those_of_the_mjcf(body):
    mujoco, model, _ = in_mujoco(body)
    assert [model.joint(i).name for i in range(model.njnt)] == list(body.joint_fields)
    slides = [
        model.joint(i).name
        for i in range(model.njnt)
        if model.jnt_type[i] == mujoco.mjtJoint.mjJNT_SLIDE
    ]
    assert slides == list(body.slides)
    assert model.ntendon == len(body.driven_by)
    assert model.nv == len(body.joints)


@each
def test_accelerations_are_mujocos(body):
    mujoco, model, data = in_mujoco(body)
    compiled = Compiled(body)
    for q, v, torque in states(body):
        data.qpos[:], data.qvel[:], data.qfrc_applied[:] = q, v, torque
        mujoco.mj_forward(model, data)
        theirs = np.zeros((model.nv, model.nv))
        for row, unit in zip(theirs, np.eye(model.nv), strict=True):
            mujoco.mj_mulM(model, data, row, unit)
        mass, force = compiled.mechanics(q, v)
        close(mass, theirs)
        close(force, -data.qfrc_bias)
        close(np.linalg.solve(mass, force + torque), data.qacc)


@each
def test_levers_are_the_jacobian_of_mujocos_tendons(body):
    mujoco, model, data = in_mujoco(body)
    compiled = Compiled(body)
    for q, _, _ in states(body):
        extension, lever = compiled.levers(q)
        data.qpos[:] = q
        for column, unit in zip(lever.T, np.eye(model.nv), strict=True):
            data.qvel[:] = unit
            mujoco.mj_forward(model, data)
            close(column, data.ten_velocity)
        close(extension, data.ten_length - closed_m(body))


@each
def test_slope_of_the_potential_is_the_force_at_rest(body):
    compiled, step = Compiled(body), 1e-5
    for q, _, _ in states(body, count=50):
        if body.kind == "dog":
            q[1] -= 5.0  # of all dogs some stand in the ground
        _, force = compiled.mechanics(q, np.zeros(len(q)))
        slopes = [
            (body.potential_j(q + step * unit) - body.potential_j(q - step * unit)) / (2 * step)
            for unit in np.eye(len(q))
        ]
        close(force, -np.array(slopes), 1e-6)


@each
def test_a_passive_swing_keeps_its_energy(body):
    compiled, n = Compiled(body), len(body.joints)

    def slope(_, y):
        mass, force = compiled.mechanics(y[:n], y[n:])
        return np.concatenate([y[n:], np.linalg.solve(mass, force)])

    def energies(y):
        mass, _ = compiled.mechanics(y[:n], y[n:])
        return 0.5 * y[n:] @ mass @ y[n:], body.potential_j(y[:n])

    q, v, _ = next(states(body, seed=3))
    if body.kind == "dog":
        q[1] = 50.0
    solved = solve_ivp(slope, (0, 2), np.concatenate([q, v]), "DOP853", rtol=1e-11, atol=1e-11)
    kinetic, potential = np.array([energies(y) for y in solved.y.T]).T
    assert np.ptp(kinetic) > 1e-2 or not np.ptp(potential)
    close(kinetic + potential, kinetic[0] + potential[0], 1e-8)


def test_kokoro_is_equation_9_1():
    """The thesis' equation as printed, with no damping."""
    body = BODIES["kokoro"]
    compiled = Compiled(body)
    w1, w2 = body.alpha_inertia_kg_m2, body.theta_inertia_kg_m2
    lgm = body.centre_m * body.gravity_m_s2 * body.mass_kg
    for (alpha, theta), (da, dt), (tau_a, tau_t) in states(body):
        sin, cos = math.sin(theta), math.cos(theta)
        expected = [
            (tau_a + 2 * da * dt * sin * cos * w2 + cos * math.sin(alpha) * lgm)
            / (w1 + cos**2 * w2),
            (tau_t - da**2 * cos * sin * w2 + sin * math.cos(alpha) * lgm) / w2,
        ]
        mass, force = compiled.mechanics(np.array([alpha, theta]), np.array([da, dt]))
        close(np.linalg.solve(mass, force + np.array([tau_a, tau_t])), np.array(expected))


def test_kokoro_with_alpha_held_is_the_single_joint():
    body = read(JOINT_J)
    assert body.alpha.held and body.driven_by == ["cylinder"]
    compiled = Compiled(body)
    for theta in np.linspace(-0.85, 0.85, 18):
        mass, force = compiled.mechanics(np.array([0.0, theta]), np.array([0.0, 2.0]))
        assert mass[1, 1] == 0.02
        assert force == pytest.approx([0.0, 0.15 * 9.80665 * math.sin(theta)])
        extension, lever = compiled.levers(np.array([0.0, theta]))
        length = math.sqrt(0.16**2 + 0.035**2 + 2 * 0.16 * 0.035 * math.sin(theta))
        assert extension[0] == pytest.approx(length - 0.133, abs=1e-15)
        assert lever[0] == pytest.approx([0.0, 0.16 * 0.035 * math.cos(theta) / length])


def test_least_and_greatest_length_of_a_crank():
    rng = np.random.default_rng(5)
    for _ in range(200):
        pivot, pin = rng.normal(0.0, 0.1, 2), rng.normal(0.0, 0.1, 2)
        crank = Crank(pivot_m=pivot, pin_m=pin, closed_length_m=0.1, offset_rad=rng.normal())
        low = rng.normal(0.0, 2.0)
        high = low + rng.uniform(0.1, 7.0)
        lengths = [crank.length_m(q) for q in np.linspace(low, high, 2001)]
        assert crank.range_m(low, high) == pytest.approx((min(lengths), max(lengths)), abs=1e-4)
        whole = abs(math.hypot(*pivot) - math.hypot(*pin)), math.hypot(*pivot) + math.hypot(*pin)
        assert crank.range_m(None, high) == pytest.approx(whole, abs=1e-9)


def test_links_are_rods_with_a_mass_at_their_end():
    """Against the rod cut into many points."""
    link = Link(length_m=0.4, tip_kg=0.3, mass_kg=0.5)
    places = (np.arange(20000) + 0.5) / 20000 * 0.4
    assert link.total_kg == 0.8
    assert link.first_moment_kg_m == pytest.approx(0.5 * places.mean() + 0.3 * 0.4)
    assert link.second_moment_kg_m2 == pytest.approx(0.5 * (places**2).mean() + 0.3 * 0.16)
    moved = Link(length_m=0.4, mass_kg=0.5, centre_m=0.1, inertia_kg_m2=0.01)
    assert moved.first_moment_kg_m == pytest.approx(0.05)
    assert moved.second_moment_kg_m2 == pytest.approx(0.015)


# The dog on its ground


def ground_force(ground, z, velocity):
    """The law at the top of ``ground``, written once more."""
    normal = max(0.0, -ground.stiffness_n_m * z * (1 - ground.damping_s_m * velocity[2]))
    normal = normal if z < 0 else 0.0
    x = velocity[0] / (
        2 * (ground.slip_m_s + ground.friction_coefficient * normal / ground.grip_n_s_m)
    )
    grip = math.copysign(1.0, x) if abs(x) > 1 else x * (2 - abs(x))
    return np.array([-ground.friction_coefficient * normal * grip, 0.0, normal])


@pytest.mark.parametrize("name", ["dog", "uneven dog"])
def test_the_ground_acts_on_feet_knees_and_hips(name):
    body = BODIES[name]
    mujoco, model, data = in_mujoco(body)
    compiled = Compiled(body)
    points = [f"{leg}_{at}" for leg in ("front", "rear") for at in ("foot", "knee", "hip")]
    touched = dict.fromkeys(points, 0)
    for q, v, _ in states(body, seed=1):
        q[1] -= 5.0
        v *= 0.1
        data.qpos[:], data.qvel[:] = q, v
        mujoco.mj_forward(model, data)
        expected = np.zeros(7)
        for point in points:
            geom = model.geom(point).id
            jacobian = np.zeros((3, 7))
            mujoco.mj_jacGeom(model, data, jacobian, None, geom)
            height = data.geom_xpos[geom, 2]
            touched[point] += height < 0
            expected += jacobian.T @ ground_force(body.ground, height, jacobian @ v)
        _, force = compiled.mechanics(q, v)
        close(force + data.qfrc_bias, expected)
    assert min(touched.values()) > STATES // 10


def walk(body, q, v, seconds, held=(), step_s=125e-6):
    """Positions and velocities at steps of the gas kernel, velocities first; some joints held."""
    compiled = Compiled(body)
    free = [i for i in range(7) if i not in held]
    q, v = np.array(q), np.array(v)
    for _ in range(round(seconds / step_s)):
        mass, force = compiled.mechanics(q, v)
        v[free] += step_s * np.linalg.solve(mass[np.ix_(free, free)], force[free])
        q += step_s * v
        yield q, v


LEGS = (3, 4, 5, 6)


def standing(body, seconds=1.5):
    q = [joint.start for joint in body.joints]
    return list(walk(body, q, np.zeros(7), seconds, LEGS))[-1]


def weight_n(body):
    links = [link for leg in (body.front, body.rear) for link in (leg.thigh, leg.shank)]
    return (body.torso_kg + sum(link.total_kg for link in links)) * body.gravity_m_s2


@pytest.mark.parametrize("name", ["dog", "uneven dog"])
def test_standing_feet_carry_the_weight(name):
    body = BODIES[name]
    mujoco, model, data = in_mujoco(body)
    q, v = standing(body)
    data.qpos[:] = q
    mujoco.mj_forward(model, data)
    feet = [data.geom(f"{leg}_foot").xpos for leg in ("front", "rear")]
    loads = [-body.ground.stiffness_n_m * foot[2] for foot in feet]
    assert np.max(np.abs(v)) < 1e-2
    assert min(loads) > 5.0
    assert sum(loads) == pytest.approx(weight_n(body), rel=2e-3)
    # By moments: the centre of mass lies between the feet as the loads say.
    centre = data.subtree_com[model.body("torso").id][0]
    assert np.dot(loads, [foot[0] for foot in feet]) / sum(loads) == pytest.approx(centre, abs=1e-3)


def test_a_slide_stops_by_friction():
    mu, speed = 0.4, 1.0
    body = read({**DOG, "ground": {"friction_coefficient": mu}})
    q, _ = standing(body)
    slowing = mu * body.gravity_m_s2
    track = [v[0] for _, v in walk(body, q, [speed, *[0.0] * 6], 0.5, LEGS)]
    step_s, last = 125e-6, round(0.8 * speed / slowing / 125e-6)
    assert (track[0] - track[last]) / (last * step_s) == pytest.approx(slowing, rel=0.02)
    assert max(np.abs(track[-100:])) < 0.02


@pytest.mark.parametrize("seed", range(4))
def test_a_falling_dog_only_loses_energy(seed):
    """No bounce, slip or tumble of limp legs makes energy, at the gas kernel's steps."""
    body = read({**DOG, "front_knee": {"start": -1.0}})
    rng = np.random.default_rng(seed)
    q = np.array([0.0, 0.8, *rng.uniform(-1.0, 1.0, 5)])
    v = np.array([rng.normal(0, 2), 0.0, *rng.normal(0, 3, 5)])
    compiled = Compiled(body)
    energies = []
    for q_now, v_now in walk(body, q, v, 1.5):
        mass, _ = compiled.mechanics(q_now, v_now)
        energies.append(0.5 * v_now @ mass @ v_now + body.potential_j(q_now))
    rises = np.max(np.array(energies) - np.minimum.accumulate(energies))
    assert rises < 1e-3 * (energies[0] - energies[-1])
    assert energies[-1] < energies[0] - 5.0


# What is refused


def changed(document, **fields):
    return {**document, **fields}


SHORT = {"pivot_m": [0.1, 0.0], "pin_m": [0.05, 0.0], "closed_length_m": 0.2}
REFUSED = {
    "longer than the circle": (
        changed(ARM, shoulder_crank=SHORT),
        "closed_length_m 0.2 of shoulder_crank is no shorter than 0.15 m, the greatest distance"
        " from pivot to pin",
    ),
    "longer than the stops allow": (
        changed(
            ARM,
            elbow_crank={**SHORT, "closed_length_m": 0.1},
            elbow={"lower": -0.5, "upper": 0.5},
        ),
        "closed_length_m 0.1 of elbow_crank is no shorter than 0.0610",
    ),
    "closed at its start": (
        changed(ARM, shoulder_crank={**SHORT, "closed_length_m": 0.1}),
        "at start 0 pivot and pin of shoulder_crank are 0.05 m apart, less than closed_length_m",
    ),
    "pin in the joint": (
        changed(ARM, shoulder_crank={**SHORT, "pin_m": [0.0, 0.0]}),
        "the pin of shoulder_crank lies in the joint, which it cannot turn",
    ),
    "pivot and pin meet": (
        changed(
            ARM,
            shoulder_crank={"pivot_m": [0.1, 0.0], "pin_m": [0.0, 0.1], "closed_length_m": 0.1},
        ),
        "pivot and pin of shoulder_crank meet; make one nearer to the joint",
    ),
    "no mass": (changed(ARM, forearm={"length_m": 0.2}), "a link needs a mass"),
    "no inertia": (
        changed(ARM, forearm={"length_m": 0.2, "mass_kg": 1, "centre_m": 0, "inertia_kg_m2": 0}),
        "a link needs inertia: its whole mass lies in its joint",
    ),
    "no cart": (changed(EXAMPLES["cart_pole"], cart_kg=0.0), "greater than 0"),
    "no inertia of theta": (changed(JOINT_J, theta_inertia_kg_m2=0.0), "greater than 0"),
    "alpha without inertia": (
        changed(JOINT_J, alpha={}),
        "alpha_inertia_kg_m2 is needed where alpha is not held",
    ),
    "slider too long": (
        changed(JOINT_J, slider={"pivot_m": 0.16, "crank_m": 0.035, "closed_length_m": 0.3}),
        "closed_length_m 0.3 of slider is no shorter than 0.187",
    ),
    "dog in the ground": (
        changed(DOG, z={"start": 0.2}),
        "at its start the lowest point is 0.16 m below the ground; start z higher",
    ),
    "dog's crank": (
        changed(DOG, rear={**DOG["rear"], "hip_crank": SHORT}),
        "closed_length_m 0.2 of rear.hip_crank is no shorter than",
    ),
    "no such kind": (changed(DOG, kind="cat"), "cat"),
}


@pytest.mark.parametrize(("document", "said"), REFUSED.values(), ids=list(REFUSED))
def test_what_cannot_be_is_refused_in_one_sentence(document, said):
    with pytest.raises(ValidationError) as caught:
        read(document)
    (error,) = caught.value.errors()
    assert said in error["msg"]
    assert "\n" not in error["msg"]


def test_defaults_are_a_creature_that_can_stand():
    body = read(DOG)
    assert isinstance(body, Dog)
    assert 3.0 < weight_n(body) / body.gravity_m_s2 < 5.0
    for leg, names in ((body.front, body.joints[3:5]), (body.rear, body.joints[5:7])):
        for crank, joint in zip((leg.hip_crank, leg.knee_crank), names, strict=True):
            least, greatest = crank.range_m(joint.lower, joint.upper)
            assert 0.0 < least - crank.closed_length_m < 0.01
            assert 0.04 < greatest - crank.closed_length_m < 0.07
            # no dead centre between the stops
            slope = np.diff([crank.length_m(q) for q in np.linspace(joint.lower, joint.upper, 50)])
            assert np.all(slope > 0) or np.all(slope < 0)
    # Knees bear what stands on them: 16 mm bore at 6 bar is 100 N.
    _, lever = Compiled(body).levers(np.array([joint.start for joint in body.joints]))
    foot = body.front.shank.length_m * math.sin(0.45)
    assert 100.0 * abs(lever[1, 4]) > 0.5 * weight_n(body) * foot


def test_a_slider_crank_is_a_crank():
    slider = SliderCrank(pivot_m=0.16, crank_m=0.035, phase_rad=0.3, closed_length_m=0.1)
    crank = Crank(pivot_m=(0, -0.16), pin_m=(0.035, 0), offset_rad=0.3, closed_length_m=0.1)
    assert slider.numbers() == pytest.approx(crank.numbers())
    assert isinstance(read(JOINT_J), Kokoro)
