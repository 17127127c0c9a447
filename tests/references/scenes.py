# SPDX-License-Identifier: Apache-2.0
"""Experiments with a reference result for every effect of scenes: a closed form, or SciPy.

Each runs a small MuJoCo scene forwards, as the product predicts a recording, and reads its sensors.
The reference is the equation of motion, written out here: rigid bodies and damped oscillators
(Goldstein, Classical Mechanics), dry friction (Coulomb), drag (Stokes), and for soft contacts the
chapter "Computation" of MuJoCo's documentation: ``a1 + d (b v + k r) = (1 - d) a0`` with the
acceleration ``a0`` without contact, the distance ``r`` less the margin, the impedance ``d(r)`` of
at most ``dmax``, ``b = damping / dmax`` and ``k = stiffness d(r) / dmax^2``; contacts only push.
"""

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import solve_ivp

from pneu_sim.effects.proof import Finding
from pneu_sysid.contacts.effects import find_scene_effect
from pneu_sysid.contacts.effects.base import Setup
from pneu_sysid.contacts.knots import chain_of
from pneu_sysid.contacts.physics import Physics
from pneu_sysid.contacts.rollouts import rolled_out
from pneu_sysid.contacts.scene import ForceSettings, Loaded, NormSettings, Scene, SensorSettings
from pneu_sysid.contacts.track import Series, Track

Floats = NDArray[np.float64]

G = 9.81
EDGE = 2
"""Knots at each end of a run that are not compared: sensors of velocity have no reading there."""
PHYSICS = Physics(1)


@cache
def loaded(mjcf: str) -> Loaded:
    """Return a scene that uses all sensors of an MJCF.

    Args:
        mjcf: The MJCF.
    """
    model, norm = mujoco.MjModel.from_xml_string(mjcf), NormSettings(std=1.0)
    sensors = [model.sensor(k).name for k in range(model.nsensor)]
    force = ForceSettings(translation=norm, rotation=norm, along=norm)
    scene = Scene(
        name="reference",
        mjcf="scene.xml",
        sensors={name: SensorSettings(topic=name, norm=norm) for name in sensors},
        forces={model.joint(k).name: force for k in range(model.njnt)},
    )
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "scene.xml").write_text(mjcf, encoding="utf-8")
        return Loaded(scene, Path(folder))


@dataclass(frozen=True)
class SceneComparison:
    """A scene with a reference result.

    Attributes:
        what: Name of the reference.
        mjcf: The scene; it starts from the MJCF's configuration.
        place: Place of the effect.
        values: Values that are compared; the last one is close to a bound of the effect.
        predict: Returns the (n, sensor components) reference at n times, s, for a value.
        velocity: Velocity of the first degrees of freedom at the start; that of the others is 0.
        duration_s: Duration of the run, s.
        step_s: Time step, s.
        recorded: Returns what all sensors recorded at some times. Residuals against a recording of
            zeros are the predicted readings.
        allowed: Largest deviation, relative to the largest change that the effect makes.
    """

    what: str
    mjcf: str
    place: str
    values: tuple[float, float, float]
    predict: Callable[[Floats, float], ArrayLike]
    velocity: tuple[float, ...] = ()
    duration_s: float = 1.0
    step_s: float = 2e-3
    recorded: Callable[[Floats], Floats] = np.zeros_like
    allowed: float = 0.01

    @property
    def time_s(self) -> Floats:
        """Times of the knots, s: the first two lie around 0, where the initial state is given."""
        return np.asarray((np.arange(round(self.duration_s / self.step_s)) - 0.5) * self.step_s)

    def setup(self, name: str, value: float | None) -> Setup:
        """Return the scene with an effect.

        Args:
            name: Name of the effect.
            value: Its value; None for the MJCF as it is.
        """
        setup = loaded(self.mjcf).setup()
        if value is not None:
            find_scene_effect(name).put(setup, self.place, value)
        return setup

    def measure(self, setup: Setup) -> Floats:
        """Return the (n, sensor components) residuals of a run against what was recorded.

        Args:
            setup: The scene.
        """
        model, time_s = setup.spec.compile(), self.time_s
        read = self.recorded(time_s)[:, None]
        series = {name: Series(time_s, np.tile(read, w)) for name, w in setup.widths.items()}
        chain = chain_of(loaded(self.mjcf), Track("reference", series), model, self.step_s)
        half = np.zeros((1, model.nv))
        half[0, : len(self.velocity)] = 0.5 * self.step_s * np.array(self.velocity)
        q = np.tile(model.qpos0, (chain.size, 1))
        q[:1], q[1:2] = chain.manifold.moved(q[:1], -half), chain.manifold.moved(q[:1], half)
        run = rolled_out(chain, model, setup, q, np.array([0]))
        outputs = chain.outputs(run.q, model, setup, PHYSICS)
        return chain.rows(outputs, setup)[1][EDGE:-EDGE]


def compare(name: str) -> list[Finding]:
    """Compare the change that an effect makes in its scene with the reference, for each value.

    Args:
        name: Name of the effect.
    """
    effect, one = find_scene_effect(name), COMPARISONS[name]
    plain, time_s = one.setup(name, None), one.time_s[EDGE:-EDGE]
    base = effect.value(plain, one.place) if effect.absent is None else effect.absent
    before, without = one.measure(plain), np.asarray(one.predict(time_s, base))
    found = []
    for value in one.values:
        expected = np.asarray(one.predict(time_s, value)) - without
        off = one.measure(one.setup(name, value)) - before - expected
        deviation = float(np.max(np.abs(off)) / np.max(np.abs(expected)))
        about = f"{one.what}, {value:g} {effect.unit}"
        found.append(Finding("reference", deviation, one.allowed, about))
    return found


def integrated(time_s: Floats, rates: Callable[..., Any], *start: float) -> Floats:
    """Return the (states, n) solution of a differential equation from time 0."""
    limits = {"rtol": 1e-8, "atol": 1e-11, "max_step": 0.02 * time_s[-1]}
    span = (0.0, time_s[-1])
    found = solve_ivp(lambda _, y: rates(*y), span, start, "DOP853", time_s, **limits)
    return np.asarray(found.y)


def columns(time_s: Floats, *components: ArrayLike) -> Floats:
    """Return (n, components) readings, some of which are constant."""
    return np.stack([np.broadcast_to(one, time_s.shape) for one in components], axis=1)


# -- bodies in free flight, and what sensors and clocks make of it --------------------------------

SPEED = 3.0
HEAVY = """<body name="heavy" pos="0 5 0"><freejoint name="heavy"/><geom size=".1" mass="4"/>
</body>"""


def flying(sensors: str = "", more: str = "") -> str:
    return f"""<mujoco><worldbody>
    <body name="ball" pos="1 2 3"><freejoint name="ball"/><geom size=".1" mass="1"/></body>
    {more}</worldbody><sensor><framepos name="place" objtype="body" objname="ball"/>{sensors}
    </sensor></mujoco>"""


def fallen(time_s: Floats, x: float = 0.0, y: float = 0.0, z: float = -G) -> Floats:
    return np.array([1.0, 2.0, 3.0]) + np.outer(0.5 * time_s**2, [x, y, z])


def slowed(time_s: Floats, drag: float) -> Floats:
    """``m v' = m g - drag v`` of a thrown ball of 1 kg and of a falling one of 4 kg."""

    def along(mass: float, start: float, v: float, a: float) -> Floats:
        if drag == 0.0:
            return np.asarray(start + v * time_s + 0.5 * a * time_s**2)
        lag = mass / drag
        gone = lag * (1.0 - np.exp(-time_s / lag))
        return np.asarray(start + v * gone + a * lag * (time_s - gone))

    fall = along(1.0, 3.0, 0.0, -G), 0.0, 5.0, along(4.0, 0.0, 0.0, -G)
    return columns(time_s, along(1.0, 1.0, SPEED, 0.0), 2.0, *fall)


def mistimed(time_s: Floats, error: float) -> Floats:
    """A second of the recording lasts ``1 + error`` s; distances per recorded second are given."""
    rate = 1.0 + error
    place = fallen(time_s, z=-G * rate**2) + np.outer(time_s, [SPEED, 0.0, 0.0])
    return np.hstack([place, columns(time_s, SPEED / rate, 0.0, -G * rate * time_s)])


def bell(time_s: Floats) -> Floats:
    return np.asarray(np.exp(-(((time_s - 0.5) / 0.1) ** 2)))


# -- joints ---------------------------------------------------------------------------------------


def slider(mass_kg: float, axis: str = "1 0 0", joint: str = "") -> str:
    return f"""<mujoco><worldbody><body><joint name="rail" type="slide" axis="{axis}" {joint}/>
    <geom size=".1" mass="{mass_kg}"/></body></worldbody>
    <sensor><jointpos name="position" joint="rail"/></sensor></mujoco>"""


def rubbed(time_s: Floats, speed: float, slowing: float) -> Floats:
    """An even deceleration until rest."""
    moving = np.minimum(time_s, speed / slowing) if slowing > 0.0 else time_s
    return np.asarray(speed * moving - 0.5 * slowing * moving**2)


def damped(time_s: Floats, rate: float) -> Floats:
    """Distance at a speed that decays exponentially."""
    return SPEED * time_s if rate == 0.0 else SPEED * (1.0 - np.exp(-rate * time_s)) / rate


def sprung(time_s: Floats, square: float, damping: float, goal: float) -> Floats:
    """``x'' + damping x' + square (x - goal) = 0`` from rest at 0."""
    root = np.sqrt(complex(0.25 * damping**2 - square))
    a, b = -0.5 * damping + root, -0.5 * damping - root
    rest = (b * np.exp(a * time_s) - a * np.exp(b * time_s)) / (b - a)
    return np.asarray(goal * (1.0 - rest.real))


PIN = """<mujoco><worldbody><body pos="0 0 1"><joint name="pin" axis="0 1 0"/>
<inertial pos="0 0 -2" mass="2" diaginertia="1e-6 1e-6 1e-6"/></body></worldbody>
<sensor><jointpos name="angle" joint="pin"/></sensor></mujoco>"""


def bearing(time_s: Floats, lever_m: float) -> Floats:
    """A point mass on a rod of 2 m whose pin rubs in proportion to the force that it carries."""
    mass, rod = 2.0, 2.0

    def rates(angle: float, speed: float) -> tuple[float, float]:
        # across the rod the pin transmits the friction torque over the rod's length
        share = lever_m * np.tanh(speed / 0.1)
        along = mass * (G * np.cos(angle) + rod * speed**2)
        torque = share * abs(along) / np.sqrt(1.0 - (share / rod) ** 2)
        return speed, -G / rod * np.sin(angle) - torque / (mass * rod**2)

    return integrated(time_s, rates, 0.0, SPEED)[:1].T


# -- bodies: a physical pendulum, turned about the vertical, so that its x is not the world's -----

HALF_M = (0.03, 0.05, 0.2)


def pendulum(axis: str, joint: str = "") -> str:
    return f"""<mujoco><worldbody><body name="arm" pos="0 0 1" euler="0 0 90">
    <joint name="pin" axis="{axis}" {joint}/>
    <geom type="box" size="{" ".join(map(str, HALF_M))}" pos="0 0 -.5" mass="2"/></body></worldbody>
    <sensor><jointpos name="angle" joint="pin"/></sensor></mujoco>"""


def swung(
    time_s: Floats,
    x: float = 0.0,
    z: float = -0.5,
    half_m: tuple[float, float] = (HALF_M[0], HALF_M[2]),
    mass: float = 2.0,
    spring: float = 0.0,
) -> Floats:
    """Angle of a box on a pin, its centre of mass at x and z from it."""
    inertia = mass * (x**2 + z**2 + (half_m[0] ** 2 + half_m[1] ** 2) / 3.0)

    def rates(angle: float, speed: float) -> tuple[float, float]:
        moment = mass * G * (x * np.cos(angle) + z * np.sin(angle)) - spring * angle
        return speed, moment / inertia

    return integrated(time_s, rates, 0.0, SPEED)[:1].T


# -- links that yield -----------------------------------------------------------------------------

HAND = """<mujoco><worldbody><body name="arm"><joint name="rail" type="slide" axis="0 1 0"/>
<geom size=".02" mass="1" contype="0" conaffinity="0"/><body name="tip" pos=".3 0 0">
<geom name="tip" size=".02" pos=".1 0 0" mass=".1"/><site name="tip" pos=".1 0 0"/></body></body>
</worldbody><sensor><framepos name="tip" objtype="site" objname="tip"/></sensor></mujoco>"""
TIP_KG, TIP_M, SETTLING_S = 0.1, 0.1, 0.002


def yielded(time_s: Floats, compliance: float) -> Floats:
    """``m z'' + (z + T z') / compliance = -m g`` of a body on a damped spring."""
    if compliance == 0.0:
        return columns(time_s, 0.4, 0.0, 0.0)
    square = 1.0 / (compliance * TIP_KG)
    z = sprung(time_s, square, SETTLING_S * square, -TIP_KG * G * compliance)
    return columns(time_s, 0.4, 0.0, z)


def bent(time_s: Floats, compliance: float) -> Floats:
    """The same with a moment: a ball at the end of a lever that turns on a damped spring."""
    if compliance == 0.0:
        return columns(time_s, 0.4, 0.0, 0.0)

    def rates(angle: float, speed: float) -> tuple[float, float]:
        moment = TIP_KG * G * TIP_M * np.cos(angle) - (angle + SETTLING_S * speed) / compliance
        return speed, moment / (TIP_KG * (TIP_M**2 + 0.4 * 0.02**2))

    angle = integrated(time_s, rates, 0.0, 0.0)[0]
    return columns(time_s, 0.3 + TIP_M * np.cos(angle), 0.0, -TIP_M * np.sin(angle))


# -- contacts: a ball above a floor, and another on which an effect of the first has no influence -

BALL_M = 0.1


def contacts(solref: str, solimp: str = ".8 .8 .001") -> str:
    return f"""<mujoco><option timestep="1e-4"/>
    <default><geom condim="1" solref="{solref}" solimp="{solimp}"/></default>
    <worldbody><geom name="floor" type="plane" size="5 5 1"/>"""


def balls(gap_m: float, *solver: str) -> str:
    bodies = "".join(
        f'<body name="{name}" pos="{x} 0 {BALL_M + gap_m}"><freejoint name="{name}"/>'
        f'<geom name="{name}" size="{BALL_M}" mass="2"/></body>'
        for name, x in (("ball", 0), ("other", 1))
    )
    return f"""{contacts(*solver)}{bodies}</worldbody><sensor>
    <framepos name="ball" objtype="body" objname="ball"/>
    <framepos name="other" objtype="body" objname="other"/></sensor></mujoco>"""


def both(time_s: Floats, gap_m: Floats, other_m: Floats) -> Floats:
    return columns(time_s, 0.0, 0.0, BALL_M + gap_m, 1.0, 0.0, BALL_M + other_m)


def gap(
    time_s: Floats,
    start_m: float,
    margin_m: float = 0.0,
    stiffness: float = 2500.0,
    damping: float = 100.0,
    impedance: Callable[[float], float] = lambda depth: 0.8,
    hardest: float = 0.8,
) -> Floats:
    """Distance of a falling ball from the floor, with MuJoCo's equation of soft contacts."""

    def rates(z: float, v: float) -> tuple[float, float]:
        depth = margin_m - z
        if depth <= 0.0:
            return v, -G
        d = impedance(depth)
        reference = -damping / hardest * v + stiffness * d / hardest**2 * depth
        return v, max(-G, d * reference - (1.0 - d) * G)

    return integrated(time_s, rates, start_m, 0.0)[0]


SOFT = "-2500 -100"
STIFFNESS, DAMPING, STIFF = 1.6e5, 400.0, "0.005 0.5"
"""The same contact: the MJCF has a time constant and a damping ratio."""
TOUCHING_M = -1e-7


def pressed(time_s: Floats, stiffness: float, damping: float) -> Floats:
    """With a constant impedance the contact is a damped spring, from rest where it just touches."""
    goal = -0.2 * G / stiffness
    return TOUCHING_M + sprung(time_s, stiffness, damping, goal - TOUCHING_M)


def hardened(time_s: Floats, width_m: float) -> Floats:
    """Impedance from 0.2 to 0.95 over a width, two parabolas that meet at half of it."""

    def impedance(depth: float) -> float:
        x = min(depth / width_m, 1.0)
        return 0.2 + 0.75 * (2.0 * x**2 if x < 0.5 else 1.0 - 2.0 * (1.0 - x) ** 2)

    return gap(time_s, 0.0, 0.0, 4e4, 400.0, impedance, 0.95)


TILTED = f"""{contacts(SOFT)}
<body pos=".3 -.2 .15"><freejoint name="ball"/><geom size="{BALL_M}" mass="2"/><site name="ball"/>
</body><body pos=".5 .4 1"><joint name="rail" type="slide" axis="1 0 0"/><geom size=".02"/>
<site name="cart"/></body></worldbody><sensor><framepos name="ball" objtype="site" objname="ball"/>
<framepos name="cart" objtype="site" objname="cart"/></sensor></mujoco>"""


def tilted(axis: int) -> Callable[[Floats, float], Floats]:
    """A ball falls along the normal of the turned floor, and a cart stays where its rail is."""

    def predict(time_s: Floats, angle: float) -> Floats:
        c, s = np.cos(angle), np.sin(angle)
        about_x, about_y = [[1, 0, 0], [0, c, -s], [0, s, c]], [[c, 0, s], [0, 1, 0], [-s, 0, c]]
        turn = np.array(about_x if axis == 0 else about_y)
        normal, start = turn[:, 2], np.array([0.3, -0.2, 0.15])
        above = float(start @ normal) - BALL_M
        ball = start + np.outer(gap(time_s, above) - above, normal)
        return np.hstack([ball, columns(time_s, *(turn @ [0.5, 0.4, 1.0]))])

    return predict


SIZED = f"""{contacts(SOFT)}<body name="ball" pos="0 0 .25"><freejoint name="ball"/>
<geom size=".1" pos="0 0 -.05" mass="2"/></body>
<body pos="1 0 2"><joint name="pin" axis="0 1 0" stiffness="5"/>
<geom type="box" size=".03" fromto="0 0 -.7 0 0 -.3" density="{2.0 / 0.00144}"/></body></worldbody>
<sensor><framepos name="ball" objtype="xbody" objname="ball"/><jointpos name="angle" joint="pin"/>
</sensor></mujoco>"""


def sized(time_s: Floats, error: float) -> Floats:
    """A ball touches the floor earlier, and a box of the same mass swings more slowly."""
    by = 1.0 + error
    reach = 0.15 * by  # from the ball's frame to its lowest point
    half_m = (HALF_M[0] * by, HALF_M[2] * by)
    angle = swung(time_s, z=-0.5 * by, half_m=half_m, spring=5.0)[:, 0]
    return columns(time_s, 0.0, 0.0, reach + gap(time_s, 0.25 - reach), angle)


def sleds(joint: str, geom: str = "") -> str:
    """Return two bodies that slide or spin on a floor."""
    bodies = "".join(
        f'<body pos="0 {y} .1"><joint name="{name}" {joint}/>'
        f'<joint name="{name} up" type="slide" axis="0 0 1"/>'
        f'<geom name="{name}" size=".1" mass="2"/></body>'
        for name, y in (("sled", 0), ("other", 1))
    )
    return f"""<mujoco><option cone="elliptic" timestep="1e-4"/>
    <default><geom friction=".4 .005 0" {geom}/></default>
    <worldbody><geom name="floor" type="plane" size="5 5 1"/>{bodies}</worldbody>
    <sensor><jointpos name="sled" joint="sled"/><jointpos name="other" joint="other"/></sensor>
    </mujoco>"""


SOFT_CONTACT = "MuJoCo's soft contact, "
COMPARISONS = {
    "contact_friction": SceneComparison(
        "Coulomb, a body that slides until it rests",
        sleds('type="slide" axis="1 0 0"'), "sled", (0.2, 0.8, 2.9),
        lambda t, mu: columns(t, rubbed(t, 2.0, mu * G), rubbed(t, 2.0, 0.4 * G)),
        velocity=(2.0, 0.0, 2.0, 0.0), duration_s=0.5, step_s=5e-4,
    ),
    "contact_spin": SceneComparison(
        "Coulomb, a body that spins until it rests",
        sleds('axis="0 0 1" armature=".2"', 'condim="4"'), "all", (0.02, 0.05, 0.095),
        # the inertia of a ball of 2 kg and of the armature
        lambda t, arm: columns(t, *2 * [rubbed(t, 6.0, arm * 2.0 * G / (0.008 + 0.2))]),
        velocity=(6.0, 0.0, 6.0, 0.0),
    ),
    "contact_stiffness": SceneComparison(
        SOFT_CONTACT + "a damped spring in closed form",
        balls(TOUCHING_M, STIFF), "ball", (5e4, 1e6, 9e6),
        lambda t, k: both(t, pressed(t, k, DAMPING), pressed(t, STIFFNESS, DAMPING)),
        duration_s=0.01, step_s=1e-5,
    ),
    "contact_damping": SceneComparison(
        SOFT_CONTACT + "a damped spring in closed form",
        balls(TOUCHING_M, STIFF), "all", (100.0, 2e3, 9e4),
        lambda t, c: both(t, *2 * [pressed(t, STIFFNESS, c)]), duration_s=0.01, step_s=1e-5,
    ),
    "contact_width": SceneComparison(
        SOFT_CONTACT + "integrated",
        balls(0.0, "-4e4 -400", ".2 .95 .001 .5 2"), "ball", (3e-3, 8e-3, 0.019),
        lambda t, width: both(t, hardened(t, width), hardened(t, 1e-3)),
        duration_s=0.1, step_s=1e-4,
    ),
    "remote_distance": SceneComparison(
        SOFT_CONTACT + "after a fall, integrated", balls(0.02, SOFT), "all", (4e-3, 0.01, 0.019),
        lambda t, margin: both(t, *2 * [gap(t, 0.02, margin)]), duration_s=0.12, step_s=1e-4,
    ),
    "joint_friction": SceneComparison(
        "Coulomb, a mass that slides until it rests", slider(1.0), "rail", (2.0, 10.0, 48.0),
        lambda t, force: columns(t, rubbed(t, 20.0, force)), velocity=(20.0,),
    ),
    "joint_load_friction": SceneComparison(
        "pendulum whose pin rubs in proportion to its load, integrated",
        PIN, "pin", (0.02, 0.2, 0.95), bearing, velocity=(SPEED,),
    ),
    "joint_damping": SceneComparison(
        "exponential decay", slider(10.0), "rail", (1.0, 10.0, 95.0),
        lambda t, c: columns(t, damped(t, c / 10.0)), velocity=(SPEED,),
    ),
    "joint_stiffness": SceneComparison(
        "harmonic oscillation about the rest position",
        slider(100.0, joint='springref=".3"'), "rail", (1e3, 1e4, 9.5e4),
        lambda t, k: columns(t, 0.3 * (1.0 - np.cos(np.sqrt(k / 100.0) * t))),
    ),
    "armature": SceneComparison(
        "fall of a mass that turns a rotor", slider(2.0, "0 0 1"), "rail", (0.5, 2.0, 9.5),
        lambda t, rotor: columns(t, -2.0 * G / (2.0 + rotor) * 0.5 * t**2),
    ),
    "springy_tip": SceneComparison(
        "damped oscillator in closed form",
        HAND, "tip.z", (1e-3, 1e-2, 0.095), yielded, duration_s=0.5, step_s=5e-4,
    ),
    "link_bend": SceneComparison(
        "pendulum on a damped spring, integrated",
        HAND, "tip.y", (0.1, 0.7, 9.5), bent, duration_s=0.5, step_s=5e-4,
    ),
    "geometry_scale": SceneComparison(
        "impact of a ball, and physical pendulum, integrated",
        SIZED, "all", (0.05, -0.2, 0.29), sized,
        velocity=(0.0,) * 6 + (SPEED,), duration_s=0.5, step_s=5e-4,
    ),
    "body_mass": SceneComparison(
        "physical pendulum with a spring, integrated",
        pendulum("0 1 0", 'stiffness="5"'), "arm", (0.3, -0.5, 4.8),
        lambda t, error: swung(t, mass=2.0 * (1.0 + error), spring=5.0), velocity=(SPEED,),
    ),
    **{
        f"centre_of_mass_{along}": SceneComparison(
            "physical pendulum, integrated",
            pendulum(hinge), "arm", (0.02, -0.1, 0.48), predict, velocity=(SPEED,),
        )
        for along, hinge, predict in (
            ("x", "0 1 0", lambda t, shift: swung(t, x=shift)),
            # turned about x, what lies towards y rises
            ("y", "1 0 0", lambda t, shift: swung(t, x=-shift, half_m=HALF_M[1:])),
            ("z", "0 1 0", lambda t, shift: swung(t, z=-0.5 + shift)),
        )
    },
    "gravity_strength": SceneComparison(
        "free fall",
        flying(), "world", (0.05, -0.2, 0.48), lambda t, error: fallen(t, z=-G * (1.0 + error)),
    ),
    "gravity_tilt_x": SceneComparison(
        "free fall", flying(), "world", (0.02, -0.1, 0.29),
        lambda t, angle: fallen(t, x=G * np.sin(angle), z=-G * np.cos(angle)),
    ),
    "gravity_tilt_y": SceneComparison(
        "free fall", flying(), "world", (0.02, -0.1, 0.29),
        lambda t, angle: fallen(t, y=G * np.sin(angle), z=-G * np.cos(angle)),
    ),
    **{
        f"frame_tilt_{along}": SceneComparison(
            "fall on an inclined plane, integrated, and a turned rail",
            TILTED, "world", (0.02, -0.1, 0.29), tilted(axis), duration_s=0.3, step_s=2e-4,
        )
        for axis, along in enumerate("xy")
    },
    "air_drag": SceneComparison(
        "Stokes, a throw and a fall",
        flying('<framepos name="heavy" objtype="body" objname="heavy"/>', HEAVY), "air",
        (0.1, 2.0, 9.5), slowed, velocity=(SPEED,),
    ),
    "clock_rate": SceneComparison(
        "throw, in seconds of the recording",
        flying('<framelinvel name="speed" objtype="body" objname="ball"/>'), "clock",
        (0.05, -0.2, 0.29), mistimed, velocity=(SPEED,),
    ),
    "sensor_scale": SceneComparison(
        "free fall, times 1 + error",
        flying(), "place", (0.05, -0.2, 0.48), lambda t, error: (1.0 + error) * fallen(t),
    ),
    "sensor_bias": SceneComparison(
        "free fall, plus the bias",
        flying(), "place.y", (0.1, -20.0, 950.0), lambda t, bias: fallen(t) + bias * np.eye(3)[1],
    ),
    # a late sensor shows what was a lag before: the reading of an instant comes a lag after it
    "sensor_lag": SceneComparison(
        "free fall, less the recording a lag later",
        flying(), "place", (0.005, -0.02, 0.048), lambda t, lag: fallen(t) - bell(t + lag)[:, None],
        recorded=bell,
    ),
}  # fmt: skip
