# SPDX-License-Identifier: Apache-2.0
"""Mechanisms in MuJoCo: levers, friction, states, errors, and the coupling with an exact gas."""

import math
import sys
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.integrate import solve_ivp

from pneu_common.errors import InputError
from pneu_common.validation import sentence
from pneu_sim.bodies.rail import Rail
from pneu_sim.mechanism.coupling import Coupling
from pneu_sim.mechanism.loading import mujoco_module
from pneu_sim.mechanism.mechanism import Mechanism
from pneu_sim.mechanism.settings import MechanismSettings

pytest.importorskip("mujoco.batch")

ARM = Path(__file__).parents[3] / "rigs" / "mjcf" / "arm4.xml"
ARM_SITES = {
    "left": ["left_base", "left_horn"],
    "right": ["right_base", "right_horn"],
    "boom": ["boom_base", "boom_rod"],
    "stick": ["stick_base", "stick_horn"],
}
ARM_OFFSET_M = {"left": 0.15, "right": 0.15, "boom": 0.1, "stick": 0.2}

# A pendulum, its joint at the origin, moved through a crank of 0.05 m by a cylinder that is hung up
# 0.2 m above the joint. The defaults are there to be overruled.
CRANK_M, ABOVE_M, WEIGHT_KG, CENTRE_M, INERTIA, G = 0.05, 0.2, 1.5, 0.2, 0.01, 9.80665
PENDULUM = f"""<mujoco model="pendulum">
  <compiler angle="radian"/>
  <option timestep="0.001" gravity="0 0 {-G}" integrator="implicitfast"/>
  <default>
    <motor gear="50" ctrlrange="-1 1" ctrllimited="true" forcelimited="true" forcerange="-1 1"/>
    <tendon frictionloss="7" stiffness="30" damping="2" limited="true" range="0 0.1"/>
  </default>
  <worldbody>
    <site name="above" pos="0 0 {ABOVE_M}"/>
    <site name="beside" pos="0 1 {ABOVE_M}"/>
    <body name="bob">
      <joint name="swing" axis="0 -1 0"/>
      <inertial pos="0 0 {-CENTRE_M}" mass="{WEIGHT_KG}" diaginertia="{INERTIA} {INERTIA} 1e-3"/>
      <site name="crank" pos="{CRANK_M} 0 0"/>
    </body>
    <body name="ball" pos="1 0 0"><joint name="round" type="ball"/><geom size="0.1"/></body>
  </worldbody>
  <actuator><motor name="other" joint="swing"/></actuator>
  <keyframe><key name="raised" qpos="0.3 1 0 0 0" ctrl="0"/></keyframe>
</mujoco>
"""


def rail(**changes):
    """The mass on a rail, as the package itself writes it; its step stands in its settings."""
    return Rail(kind="rail", cylinder="c", **{"mass_kg": 2.0, **changes})


def on_rail(folder, body=None, lanes=1, step_s=1e-3, coupling="second_order", damping=0.0, **more):
    """Masses on a rail."""
    (folder / "rail.xml").write_text((body or rail()).mjcf())
    settings = MechanismSettings(
        mjcf="rail.xml",
        cylinders={"c": {"tendon": "cylinder", "offset_m": more.pop("offset_m", 0.0)}},
        step_s=step_s,
        coupling=coupling,
        damping={"slide": damping} if damping else {},
        start=more.pop("start", {}),
    )
    return Mechanism(settings, lanes, folder, **more)


def pendulum(folder, text=PENDULUM, **changes):
    """The settings of the pendulum."""
    (folder / "pendulum.xml").write_text(text)
    cylinders = {"crank": {"sites": ["above", "crank"], "offset_m": 0.15}}
    return MechanismSettings(**{"mjcf": "pendulum.xml", "cylinders": cylinders, **changes})


def arm(**changes):
    """The settings of the arm with four cylinders."""
    cylinders = {n: {"sites": s, "offset_m": ARM_OFFSET_M[n]} for n, s in ARM_SITES.items()}
    return MechanismSettings(
        **{"mjcf": "arm4.xml", "cylinders": cylinders, "keyframe": "bent", **changes}
    )


class Springs:
    """Two closed chambers on either side of every piston, isentropic: exact, and always at rest.

    Attributes:
        x: (n_cyl, lanes) extensions, m.
    """

    AREA, DEAD_M, PRESSURE, GAMMA = 5e-4, 0.01, 4e5, 1.4

    def __init__(self, extension, stroke, middle=None):
        """Fills both chambers of cylinders of a stroke where the pistons stand in the middle."""
        self.x = np.array(extension)
        self.stroke, self.middle = stroke, 0.5 * stroke if middle is None else middle

    def pressures(self, x):
        """Pressures of both chambers."""
        lengths = (self.DEAD_M + x, self.DEAD_M + self.stroke - x)
        full = (self.DEAD_M + self.middle, self.DEAD_M + self.stroke - self.middle)
        return [self.PRESSURE * (f / n) ** self.GAMMA for f, n in zip(full, lengths, strict=True)]

    def force(self, x):
        """Force on a piston that stands at an extension."""
        one, two = self.pressures(x)
        return self.AREA * (one - two)

    def energy(self, x):
        """Internal energy of both chambers."""
        one, two = self.pressures(x)
        volume = [self.DEAD_M + x, self.DEAD_M + self.stroke - x]
        return self.AREA * (one * volume[0] + two * volume[1]) / (self.GAMMA - 1.0)

    def stiffness(self, x):
        """Its derivative by the extension, with the other sign."""
        one, two = self.pressures(x)
        volume = [self.DEAD_M + x, self.DEAD_M + self.stroke - x]
        return self.AREA * self.GAMMA * (one / volume[0] + two / volume[1])

    def __call__(self, speed, duration):
        """Moves the pistons; the mean force to rounding, by Gauss's quadrature."""
        nodes, weights = np.polynomial.legendre.leggauss(7)
        way = speed * duration
        mean = sum(
            0.5 * w * self.force(self.x + 0.5 * (1.0 + n) * way)
            for n, w in zip(nodes, weights, strict=True)
        )
        self.x = self.x + way
        return mean


# Levers


def test_a_mass_on_a_rail_moves_as_it_must(tmp_path):
    body = rail(incline_rad=0.4)
    mechanism = on_rail(tmp_path, body, lanes=3)
    force = np.array([[0.0, 10.0, -25.0]])
    moved = mechanism.advance(force, 0.05)
    acceleration = force / 2.0 - body.gravity_m_s2 * math.sin(0.4)
    np.testing.assert_allclose(moved, 0.5 * acceleration * 0.05**2, rtol=1e-10)
    np.testing.assert_allclose(mechanism.extension(), moved)
    np.testing.assert_allclose(mechanism.speed(), acceleration * 0.05, rtol=1e-10)
    assert mechanism.joints == ["slide"]
    np.testing.assert_allclose(mechanism.joint_positions(), moved)
    np.testing.assert_allclose(mechanism.joint_velocities(), mechanism.speed())


def crank(angle):
    """Length between crank and hook, and its derivative, by hand."""
    length = math.sqrt(ABOVE_M**2 + CRANK_M**2 - 2 * ABOVE_M * CRANK_M * math.sin(angle))
    return length, -ABOVE_M * CRANK_M * math.cos(angle) / length


def test_a_cylinder_between_two_sites_has_the_lever_of_the_line_between_them(tmp_path):
    for angle in (-0.7, 0.0, 0.4):
        for gear in (1.0, -2.0):
            cylinders = {"c": {"sites": ["above", "crank"], "offset_m": 0.05, "gear": gear}}
            mechanism = Mechanism(
                pendulum(tmp_path, cylinders=cylinders, start={"swing": angle}), folder=tmp_path
            )
            length, lever = crank(angle)
            assert mechanism.extension()[0, 0] == pytest.approx(gear * length - 0.05, abs=1e-12)
            force, h = 30.0, mechanism.step_s
            moved = mechanism.advance(np.array([[force]]), h)
            torque = gear * lever * force - WEIGHT_KG * G * CENTRE_M * math.sin(angle)
            swung = torque / (INERTIA + WEIGHT_KG * CENTRE_M**2) * h
            assert mechanism.joint_velocities()[0, 0] == pytest.approx(swung, rel=1e-4)
            assert mechanism.speed()[0, 0] == pytest.approx(gear * lever * swung, rel=1e-3)
            assert moved[0, 0] == pytest.approx(0.5 * gear * lever * swung * h, rel=1e-3)


def test_a_cylinder_turns_a_joint_by_a_pinion(tmp_path):
    cylinders = {"rack": {"joint": "swing", "gear": 0.02, "offset_m": -0.05}}
    mechanism = Mechanism(pendulum(tmp_path, cylinders=cylinders), folder=tmp_path)
    assert mechanism.extension()[0, 0] == pytest.approx(0.05)
    mechanism.advance(np.array([[40.0]]), 1e-3)
    swung = 0.02 * 40.0 / (INERTIA + WEIGHT_KG * CENTRE_M**2) * 1e-3
    assert mechanism.joint_velocities()[0, 0] == pytest.approx(swung, rel=1e-4)


def test_a_keyframe_is_where_it_starts_and_other_actuators_are_left_alone(tmp_path):
    settings = pendulum(tmp_path, keyframe="raised")
    mechanism = Mechanism(settings, folder=tmp_path)
    assert mechanism.joint_positions()[0, 0] == 0.3
    assert mechanism.model.actuator("other").gear[0] == 50.0
    mechanism = Mechanism(settings.model_copy(update={"start": {"swing": 0.1}}), folder=tmp_path)
    assert mechanism.joint_positions()[0, 0] == 0.1


def test_rigs_differ_in_mass_damping_offset_and_start(tmp_path):
    base = pendulum(tmp_path, start={"swing": 0.5})
    heavy = base.model_copy(update={"masses_kg": {"bob": 2 * WEIGHT_KG}})
    damped = base.model_copy(update={"damping": {"swing": 0.3}})
    grip = base.cylinders["crank"].model_copy(update={"offset_m": 0.1})
    other = base.model_copy(update={"cylinders": {"crank": grip}, "start": {"swing": 0.2}})
    rigs = [base, heavy, damped, other]
    together = Mechanism(rigs, folder=tmp_path, stroke_m={"crank": 0.15})
    pushed = np.full((1, 4), 20.0)
    for _ in range(100):
        together.advance(pushed, 1e-3)
    for lane, one in enumerate(rigs):
        alone = Mechanism(one, folder=tmp_path, stroke_m={"crank": 0.15})
        for _ in range(100):
            alone.advance(pushed[:, :1], 1e-3)
        np.testing.assert_array_equal(alone.extension()[:, 0], together.extension()[:, lane])
    assert len(np.unique(together.joint_positions())) == 4
    # mass and inertia of the second are twice the first's
    text = PENDULUM.replace(f'mass="{WEIGHT_KG}"', f'mass="{2 * WEIGHT_KG}"').replace(
        f"{INERTIA} {INERTIA} 1e-3", f"{2 * INERTIA} {2 * INERTIA} 2e-3"
    )
    alone = Mechanism(pendulum(tmp_path, text, start={"swing": 0.5}), folder=tmp_path)
    for _ in range(100):
        alone.advance(pushed[:, :1], 1e-3)
    np.testing.assert_allclose(alone.extension()[:, 0], together.extension()[:, 1], rtol=1e-12)


# Friction and ends


@pytest.mark.parametrize("coupling", ["thesis", "second_order"])
def test_what_sticks_stays_and_what_slides_loses_what_friction_takes(tmp_path, coupling):
    mechanism = on_rail(tmp_path, lanes=3, coupling=coupling)
    force, friction = np.array([[49.0, 60.0, 60.0]]), np.array([[50.0, 50.0, 0.0]])
    for _ in range(1000):
        mechanism.advance(force, 1e-3, friction)
    stuck, slid, free = mechanism.extension()[0]
    assert abs(stuck) < 1e-5
    # a step of semi-implicit Euler is half a step ahead
    assert slid == pytest.approx(0.5 * 10.0 / 2.0, rel=2e-3)
    assert free == pytest.approx(0.5 * 60.0 / 2.0, rel=2e-3)
    for _ in range(2000):  # both come to rest, and stay
        mechanism.advance(np.array([[0.0, 0.0, 60.0]]), 1e-3, friction)
    assert abs(mechanism.speed()[0, 1]) < 1e-9
    rest = 0.5 * 10.0 / 2.0 + 5.0**2 / (2 * 25.0)
    assert mechanism.extension()[0, 1] == pytest.approx(rest, rel=2e-3)


def test_a_piston_stops_at_the_ends_of_its_cylinder(tmp_path):
    mechanism = on_rail(tmp_path, lanes=2, offset_m=-0.1, stroke_m={"c": [0.2, 0.15]}, step_s=5e-4)
    deepest = fastest = 0.0
    for push, end in ((300.0, mechanism.stroke_m[0]), (-300.0, np.zeros(2))):
        for _ in range(1000):
            mechanism.advance(np.full((1, 2), push), 5e-4)
            fastest = max(fastest, np.abs(mechanism.speed()).max())
            x = mechanism.extension()[0]
            deepest = max(deepest, (x - mechanism.stroke_m[0]).max(), (-x).max())
        np.testing.assert_allclose(mechanism.extension()[0], end, atol=1e-5)
        np.testing.assert_allclose(mechanism.speed(), 0.0, atol=1e-6)
    assert fastest > 7.0
    assert 0.0 < deepest < 1.6 * fastest * 5e-4  # what it goes in a step, and a half


# States and threads


def run_arm(mechanism, gas, steps):
    """Moves the arm with its gas, with friction that differs by rig and cylinder."""
    coupling = Coupling(mechanism)
    friction = 5.0 + np.arange(4 * mechanism.lanes).reshape(4, -1) % 7
    for _ in range(steps):
        coupling.step(gas, friction)
    return coupling


def arm_springs(mechanism, push=0.03):
    """Gas springs for the arm, filled off their balance."""
    return Springs(mechanism.extension(), 0.25, mechanism.extension() + push)


@pytest.mark.parametrize("coupling", ["thesis", "second_order"])
def test_threads_change_no_bit(coupling):
    found = []
    for threads in (1, 2, 3):
        mechanism = Mechanism(arm(coupling=coupling), 16, ARM.parent, threads=threads)
        push = np.linspace(-0.01, 0.03, 16)
        found.append(run_arm(mechanism, arm_springs(mechanism, push), 200).state())
    for other in found[1:]:
        for one, two in zip(found[0], other, strict=True):
            np.testing.assert_array_equal(one, two)
    alone = Mechanism(arm(coupling=coupling), 16, ARM.parent, threads=1)
    assert not np.array_equal(alone.state()[0], found[0][0])


@pytest.mark.parametrize("coupling", ["thesis", "second_order"])
def test_a_state_put_back_gives_the_same_future_in_any_lane(coupling):
    mechanism = Mechanism(arm(coupling=coupling), 6, ARM.parent)
    gas = arm_springs(mechanism, np.linspace(-0.01, 0.03, 6))
    coupled = run_arm(mechanism, gas, 50)
    state, x = coupled.state(), gas.x.copy()
    middle = gas.middle.copy()
    coupled.advance(gas, 0.1)
    first = coupled.state()
    lanes = np.array([4, 0, 5, 1, 1, 3])
    other = Coupling(Mechanism(arm(coupling=coupling), 6, ARM.parent))
    gas.x, gas.middle = x[:, lanes], middle[:, lanes]
    other.set_state([part[..., lanes] for part in state])
    other.advance(gas, 0.1)
    for one, two in zip(first, other.state(), strict=True):
        np.testing.assert_array_equal(one[..., lanes], two)
    coupled.mechanism.reset()
    np.testing.assert_array_equal(
        coupled.mechanism.extension(), Mechanism(arm(), 6, ARM.parent).extension()
    )


def test_cutting_into_calls_changes_no_bit():
    one, two = (Mechanism(arm(), 2, ARM.parent) for _ in range(2))
    force = np.array([[20.0, -5.0], [0.0, 3.0], [120.0, 90.0], [-30.0, 10.0]])
    one.advance(force, 0.02, np.ones((4, 2)))
    for _ in range(20):
        two.advance(force, 0.001, np.ones((4, 2)))
    for a, b in zip(one.state(), two.state(), strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_rig_that_becomes_unstable_is_not_finite_and_the_others_go_on():
    together, alone = (Mechanism(arm(), n, ARM.parent) for n in (3, 1))
    force = np.zeros((4, 3))
    force[:, 1] = np.nan
    for _ in range(20):
        together.advance(force, 1e-3)
        alone.advance(force[:, :1], 1e-3)
        force[:] = 10.0
    assert np.isnan(together.extension()[:, 1]).all()
    assert np.isnan(together.joint_positions()[:, 1]).all()
    np.testing.assert_array_equal(together.extension()[:, [0, 2]], alone.extension()[:, [0, 0]])
    together.reset()
    assert np.isfinite(together.extension()).all()


def test_a_rig_whose_step_is_too_long_for_its_damping_is_given_up(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo leaves a log there
    (tmp_path / "rail.xml").write_text(rail().mjcf())
    base = MechanismSettings(mjcf="rail.xml", cylinders={"c": {"joint": "slide"}}, step_s=1e-3)
    rigs = [base, base.model_copy(update={"damping": {"slide": 8e3}})]
    mechanism = Mechanism(rigs, folder=tmp_path)
    for _ in range(200):
        mechanism.advance(np.full((1, 2), 10.0), 1e-3)
    assert mechanism.extension()[0, 0] == pytest.approx(0.5 * 5.0 * 0.2**2)
    assert np.isnan(mechanism.extension()[0, 1])


# The coupling

MASS, STROKE, PUSH = 2.0, 0.2, 0.03


def exact_spring(time, damping):
    """Position and speed of the mass between two chambers, by an integrator of high order."""
    gas = Springs(0.0, STROKE)
    solved = solve_ivp(
        lambda t, y: [y[1], (gas.force(y[0]) - damping * y[1]) / MASS],
        (0.0, time),
        [0.5 * STROKE + PUSH, 0.0],
        "DOP853",
        rtol=1e-12,
        atol=1e-14,
    )
    return solved.y[:, -1]


@pytest.mark.parametrize("damping", [0.0, 20.0])
@pytest.mark.parametrize(("coupling", "least"), [("thesis", 0.8), ("second_order", 1.8)])
def test_order_of_convergence_of_a_gas_spring(tmp_path, coupling, least, damping):
    time = 0.32
    exact = exact_spring(time, damping)
    errors = []
    for step_s in (4e-3, 2e-3, 1e-3, 5e-4):
        mechanism = on_rail(
            tmp_path,
            step_s=step_s,
            coupling=coupling,
            damping=damping,
            start={"slide": 0.5 * STROKE + PUSH},
        )
        gas = Springs(mechanism.extension(), STROKE)
        Coupling(mechanism).advance(gas, time)
        np.testing.assert_allclose(gas.x, mechanism.extension(), rtol=1e-12)
        scale = np.array([PUSH, PUSH * math.sqrt(gas.stiffness(0.5 * STROKE) / MASS)])
        found = np.array([mechanism.extension()[0, 0], mechanism.speed()[0, 0]])
        errors.append(np.linalg.norm((found - exact) / scale))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert orders.min() > least
    if coupling == "thesis":
        assert orders.max() < 1.4
    else:
        assert errors[2] < 2e-3


@pytest.mark.long
def test_order_of_convergence_of_an_arm():
    """Coriolis forces, levers and four cylinders; compared with itself at a fine step."""
    found = {}
    for coupling in ("thesis", "second_order"):
        for step_s in (4e-3, 2e-3, 1e-3, 1.25e-4):
            mechanism = Mechanism(arm(coupling=coupling, step_s=step_s), folder=ARM.parent)
            gas = arm_springs(mechanism, np.array([[0.02], [-0.005], [0.03], [0.01]]))
            Coupling(mechanism).advance(gas, 0.2)
            np.testing.assert_allclose(gas.x, mechanism.extension(), rtol=1e-12)
            found[coupling, step_s] = mechanism.joint_positions()[:, 0]
    exact = found["second_order", 1.25e-4]
    order = {}
    for coupling in ("thesis", "second_order"):
        errors = [np.linalg.norm(found[coupling, h] - exact) for h in (4e-3, 2e-3, 1e-3)]
        order[coupling] = np.log2(np.array(errors[:-1]) / errors[1:])
    assert order["second_order"].min() > 1.8
    assert order["thesis"].min() > 0.7 and order["thesis"].max() < 1.4


def test_frequency_of_a_pendulum_between_two_chambers(tmp_path):
    """Small swings about the bottom, where the chambers balance."""
    length, lever = crank(0.0)
    gas = Springs(np.array([[length - 0.15]]), 0.12, length - 0.15)
    inertia = INERTIA + WEIGHT_KG * CENTRE_M**2
    stiffness = gas.stiffness(gas.x)[0, 0] * lever**2 + WEIGHT_KG * G * CENTRE_M
    expected = math.sqrt(stiffness / inertia) / (2 * math.pi)
    mechanism = Mechanism(pendulum(tmp_path, start={"swing": 1e-3}), folder=tmp_path)
    gas.x = mechanism.extension()
    coupling, angles = Coupling(mechanism), []
    for _ in range(2000):
        coupling.step(gas)
        angles.append(mechanism.joint_positions()[0, 0])
    a = np.array(angles)
    up = np.flatnonzero((a[:-1] < 0) & (a[1:] >= 0))
    crossings = up + a[up] / (a[up] - a[up + 1])
    found = 1.0 / (np.diff(crossings).mean() * mechanism.step_s)
    assert found == pytest.approx(expected, rel=2e-4)


def test_energy_and_momentum_of_a_gas_spring(tmp_path):
    mechanism = on_rail(tmp_path, start={"slide": 0.5 * STROKE + PUSH})
    gas = Springs(mechanism.extension(), STROKE)
    coupling = Coupling(mechanism)

    def energy():
        speed = mechanism.speed()[0, 0]
        return gas.energy(gas.x)[0, 0] - gas.energy(0.5 * STROKE) + 0.5 * MASS * speed**2

    begin = energy()
    impulse, told = 0.0, 0.0

    def counted(speed, duration):
        nonlocal impulse
        mean = gas(speed, duration)
        impulse += duration * mean[0, 0]
        return mean

    energies = []
    for _ in range(2000):
        told += coupling.step(counted)[0, 0] * mechanism.step_s
        energies.append(energy())
    frequency = math.sqrt(gas.stiffness(0.5 * STROKE) / MASS)
    loss = 1.0 - energies[-1] / begin
    # twice that of the amplitude, in 2 s
    assert loss == pytest.approx(4.0 * frequency * (frequency * 1e-3) ** 3 / 16, rel=0.3)
    assert loss < 2e-3
    # all the gas gave has arrived but for what the last step owes
    assert told == pytest.approx(MASS * mechanism.speed()[0, 0], abs=1e-9)
    assert told == pytest.approx(impulse, abs=1e-4 * frequency * MASS * PUSH)


def test_the_gas_is_not_led_beyond_the_ends_of_a_cylinder(tmp_path):
    mechanism = on_rail(tmp_path, lanes=2, start={"slide": 0.19}, stroke_m={"c": 0.2}, step_s=2e-3)
    coupling, went = Coupling(mechanism), [mechanism.extension()]

    def push(speed, duration):
        went.append(went[-1] + speed * duration)
        return np.full((1, 2), 500.0)

    most = 0.0
    for _ in range(20):
        coupling.step(push)
        np.testing.assert_allclose(went[-1], mechanism.extension(), atol=1e-15)
        most = max(most, mechanism.extension().max())
    assert most > 0.2 and np.max(went) <= most + 1e-12


def test_meshes_lie_beside_the_mjcf(tmp_path):
    (tmp_path / "models" / "shapes").mkdir(parents=True)
    (tmp_path / "models" / "shapes" / "corner.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    )
    (tmp_path / "models" / "corner.xml").write_text(
        """<mujoco><compiler meshdir="shapes"/><asset><mesh file="corner.obj"/></asset>
        <worldbody><body><joint name="j" type="slide"/><geom type="mesh" mesh="corner"/></body>
        </worldbody></mujoco>"""
    )
    settings = MechanismSettings(mjcf="models/corner.xml", cylinders={"c": {"joint": "j"}})
    mechanism = Mechanism(settings, folder=tmp_path)
    mechanism.advance(np.array([[1000.0 / 6.0]]), mechanism.step_s)  # of a sixth of a cubic metre
    gained = mechanism.speed()[0, 0] / mechanism.step_s
    assert gained == pytest.approx(1.0 - 9.81)


# Errors


def refused(run):
    """The one sentence of an error."""
    with pytest.raises(InputError) as caught:
        run()
    text = str(caught.value)
    assert "\n" not in text
    return text


def test_without_mujoco_one_sentence_says_how_to_get_it(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    text = refused(lambda: Mechanism(pendulum(tmp_path), folder=tmp_path))
    assert "pip install '.[robots]'" in text
    monkeypatch.undo()
    monkeypatch.setitem(sys.modules, "mujoco.batch", None)  # one that is too old
    monkeypatch.delattr(sys.modules["mujoco"], "batch", raising=False)
    assert "3.17" in refused(mujoco_module)


def held(**grip):
    return {"c": grip}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"mjcf": "gone.xml"}, "gone.xml: mjcf: there is no such file"),
        (
            {"cylinders": held(joint="knee")},
            "cylinders.c.joint: found 'knee', the MJCF has 'swing'",
        ),
        ({"cylinders": held(tendon="rope")}, "cylinders.c.tendon: found 'rope', the MJCF has none"),
        (
            {"cylinders": held(sites=["above", "below"])},
            "sites: found 'below', the MJCF has 'above'",
        ),
        ({"cylinders": held(sites=["above", "beside"])}, "which do not move against one another"),
        ({"cylinders": held(joint="round")}, "joint: found 'round', a ball joint"),
        ({"keyframe": "low"}, "keyframe: found 'low', the MJCF has 'raised'"),
        ({"start": {"round": 0.1}}, "start: found 'round', a ball or free joint"),
        ({"damping": {"knee": 0.1}}, "damping: found 'knee', the MJCF has 'swing', 'round'"),
        (
            {"masses_kg": {"leg": 0.1}},
            "masses_kg: found 'leg', the MJCF has 'world', 'bob', 'ball'",
        ),
        ({"start": {"swing": -1.2}}, "cylinders.crank: found an extension of"),
    ],
)
def test_what_does_not_fit_the_mjcf_is_refused(tmp_path, change, said):
    settings = pendulum(tmp_path, **change)
    stroke = None if "cylinders" in change else {"crank": 0.06}
    text = refused(lambda: Mechanism(settings, folder=tmp_path, stroke_m=stroke))
    assert said in text
    assert ".xml" in text


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("<mujoco ", "<mujoko ", "MuJoCo cannot compile it: XML"),
        ('mass="1.5"', 'mass="0"', "MuJoCo cannot compile it: mass and inertia"),
        ("<default>", '<option><flag limit="disable"/></option><default>', "found limit=disable"),
    ],
)
def test_an_mjcf_that_cannot_be_used_is_refused_with_mujocos_reason(tmp_path, old, new, said):
    settings = pendulum(tmp_path, PENDULUM.replace(old, new))
    text = refused(lambda: Mechanism(settings, folder=tmp_path))
    assert said in text and "pendulum.xml" in text


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"c": {"sites": ["a", "b"]}, "d": {"sites": ["b", "a"]}}, "'c' holds already"),
        ({"c": {"joint": "a", "tendon": "b"}}, "found joint and tendon, one of"),
        ({"c": {}}, "found none, one of"),
        ({"c": {"joint": "a", "gear": 0.0}}, "other than 0"),
        ({"c": {"sites": ["a", "a"]}}, "found 'a' twice"),
    ],
)
def test_bindings_that_contradict_one_another_are_refused(settings, said):
    with pytest.raises(ValidationError) as caught:
        MechanismSettings(mjcf="x.xml", cylinders=settings)
    assert said in sentence(caught.value, MechanismSettings)


def test_a_duration_that_is_no_whole_number_of_steps_is_refused(tmp_path):
    mechanism = Mechanism(pendulum(tmp_path, step_s=2e-3), folder=tmp_path)
    assert mechanism.steps(0.01) == 5
    for duration in (1e-3, 5e-3, 0.0):
        assert "a whole number of steps" in refused(
            lambda duration=duration: mechanism.advance(np.zeros((1, 1)), duration)
        )


def test_rigs_side_by_side_are_bound_alike(tmp_path):
    base = pendulum(tmp_path)
    slow = base.model_copy(update={"step_s": 5e-3})
    assert "mechanism.step_s" in refused(lambda: Mechanism([base, slow], folder=tmp_path))
    other = pendulum(tmp_path, cylinders={"crank": {"joint": "swing"}})
    assert "mechanism.cylinders" in refused(lambda: Mechanism([base, other], folder=tmp_path))
