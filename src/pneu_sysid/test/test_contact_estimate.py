# SPDX-License-Identifier: Apache-2.0
"""Gradient and Hessian of the joint estimate against dense differences, and what it recovers."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pneu_sysid.contacts.arrow import eliminate
from pneu_sysid.contacts.estimate import Estimated, Problem, State, estimate, parameters_of
from pneu_sysid.contacts.fit import fit_scene
from pneu_sysid.contacts.knots import chain_of, guess
from pneu_sysid.contacts.manifold import Floats, manifold_of
from pneu_sysid.contacts.norms import STEEPEST, Norm
from pneu_sysid.contacts.outcome import OTHERS, UNITS, dof_names, result_of_fit, unit_of
from pneu_sysid.contacts.physics import Physics
from pneu_sysid.contacts.scene import (
    ControlSettings,
    ForceSettings,
    KnotSettings,
    Loaded,
    NormSettings,
    Scene,
    SensorSettings,
    Value,
)
from pneu_sysid.contacts.together import SceneFit
from pneu_sysid.contacts.track import Series, Track, unbroken
from pneu_sysid.contacts.trajectories import begun

LINKED = """<mujoco><option timestep="0.004" cone="elliptic"/>
<default><geom solref="-4000 -100" solimp="0 0.95 0.01 1 2"/></default>
<worldbody><geom name="floor" type="plane" size="1 1 .1"/>
<body name="b" pos="0 0 .12"><freejoint name="f"/>
 <geom name="g" type="box" size=".1 .08 .06" mass="1"/><site name="s" pos=".01 .02 .03"/>
 <body name="l" pos=".12 0 0"><joint name="h" axis="0 1 0" damping="0.01"/>
  <geom name="g2" type="capsule" fromto="0 0 0 .15 0 0.02" size=".03" mass=".4"/></body></body>
</worldbody><actuator><motor name="m" joint="h"/></actuator>
<sensor><framepos name="p" objtype="body" objname="b"/>
<framequat name="o" objtype="site" objname="s"/><jointpos name="a" joint="h"/>
<gyro name="w" site="s"/><accelerometer name="acc" site="s"/><force name="fo" site="s"/></sensor>
</mujoco>"""
"""A box with a driven link, that stands on the floor by both."""


def norm(std: float, kind: str = "square", **more: float) -> NormSettings:
    return NormSettings(std=std, kind=kind, **more)


def sensor(width: int, how: NormSettings) -> SensorSettings:
    return SensorSettings(columns=tuple("abcd"[:width]), norm=how)


def linked_scene(folder: Path) -> Loaded:
    (folder / "m.xml").write_text(LINKED)
    effects = {
        ("contact_friction", "all"): None,
        ("contact_stiffness", "all"): None,
        ("joint_damping", "h"): None,
        ("sensor_lag", "w"): 0.001,
        ("sensor_scale", "p"): 0.02,
        ("sensor_bias", "acc.x"): 0.02,
        ("clock_rate", "clock"): 0.01,
        ("centre_of_mass_x", "b"): 0.003,
    }
    scene = Scene(
        name="linked",
        mjcf="m.xml",
        sensors={
            "p": sensor(3, norm(0.001, "huber")),
            "o": sensor(4, norm(0.01, "barrier", width=0.05)),
            "a": sensor(1, norm(0.01)),
            "w": sensor(3, norm(0.05)),
            "acc": sensor(3, norm(1.0)),
            "fo": sensor(3, norm(0.3)),
        },
        controls={"m": ControlSettings(column="u")},
        forces={
            "f": ForceSettings(translation=norm(0.3), rotation=norm(0.03)),
            "h": ForceSettings(along=norm(0.01)),
        },
        values=tuple(
            Value(effect=e, at=at, value=v, std=0.01 if e.startswith("centre") else None)
            for (e, at), v in effects.items()
        ),
        knots=KnotSettings(step_s=0.0061),
    )
    return Loaded(scene, folder)


def wandering(loaded: Loaded, height_m: float, seed: int) -> tuple[Track, Floats]:
    """A made-up motion with uneven steps, and what sensors read along it, with noise."""
    rng = np.random.default_rng(seed)
    n = 14
    t = np.arange(n) * 0.004
    t[7:] += 0.002
    model = loaded.setup(loaded.scene.values).spec.compile()
    q = np.zeros((n, 8))
    q[:, 3] = 1.0
    q[:, 0], q[:, 2] = 0.3 * t, height_m + 0.001 * np.sin(20.0 * t)
    q = manifold_of(model).moved(q, np.cumsum(rng.normal(size=(n, 7)) * 2e-4, axis=0))
    data = mujoco.MjData(model)
    rows = []
    for at in q:
        data.qpos[:] = at
        mujoco.mj_forward(model, data)
        rows.append(data.sensordata.copy())
    table = np.array(rows)
    sensors = {}
    for name in loaded.names:
        number = model.sensor(name).id
        first, width = int(model.sensor_adr[number]), int(model.sensor_dim[number])
        values = table[:, first : first + width] + rng.normal(size=(n, width)) * 0.002
        sensors[name] = Series(t.copy(), unbroken(values) if width == 4 else values)
    return Track("made up", sensors, {"m": Series(t, rng.normal(size=(n, 1)) * 0.1)}), q


def dense(problem: Problem, state: State) -> tuple[Floats, Floats, Floats]:
    """Gradient and Gauss-Newton Hessian by differences of all residuals in every unknown."""
    chain = problem.chains[0]
    n, k, c = chain.size, chain.manifold.nv, len(state.x)

    def residuals(step: Floats) -> Floats:
        model, setup = problem.model(state.x + step[n * k :])
        q = chain.manifold.moved(state.q[0], step[: n * k].reshape(n, k))
        said = chain.outputs(q, model, setup, problem.physics)
        return np.concatenate(chain.rows(said, setup), axis=1)

    here = residuals(np.zeros(n * k + c))
    there = np.isfinite(here)
    sizes = [1e-6] * (n * k) + [p.effect.step for p in problem.parameters]
    J = np.empty((there.sum(), n * k + c))
    for j, size in enumerate(sizes):
        step = np.zeros(n * k + c)
        step[j] = size
        J[:, j] = (residuals(step) - residuals(-step))[there] / (2.0 * size)
    columns = [(norm, here[:, i]) for i, norm in enumerate(chain.norms())]
    slope = np.stack([f.slope(np.nan_to_num(r)) for f, r in columns], axis=1)[there]
    bend = np.stack([f.curvature(np.nan_to_num(r)) for f, r in columns], axis=1)[there]
    return J.T @ slope, J.T @ (J * bend[:, None]), J


@pytest.mark.parametrize("height_m", [0.059, 0.3], ids=["in contact", "in flight"])
def test_gradient_and_hessian_are_those_of_dense_differences(
    tmp_path: Path, height_m: float
) -> None:
    loaded = linked_scene(tmp_path)
    track, q = wandering(loaded, height_m, 0)
    model = loaded.setup(loaded.scene.values).spec.compile()
    chain = chain_of(loaded, track, model)
    assert chain.size == len(q)
    # half of the knots count less, as they would where bodies touch
    slack = np.ones((chain.size, 7))
    slack[::2] = 3.0
    chain = replace(chain, slack=slack)
    physics = Physics(1)
    problem = Problem(
        loaded, [chain], loaded.scene.values, parameters_of(loaded, loaded.scene.values), physics
    )
    state = State((q,), problem.start())
    touching = physics.contact_forces(model, chain.motion(q, loaded.setup(loaded.scene.values)))
    assert np.any(touching) == (height_m < 0.1)
    arrow = problem.arrows(state)[0]
    gradient, hessian, _ = dense(problem, state)
    assert np.linalg.norm(arrow.gradient() - gradient) < 1e-6 * np.linalg.norm(gradient)
    assert np.linalg.norm(arrow.dense() - hessian) < 1e-6 * np.linalg.norm(hessian)
    # and each unknown in its own unit
    scale = np.sqrt(np.maximum(np.diag(hessian), 1e-300))
    seen = np.diag(hessian) > 0.0
    apart = ((arrow.dense() - hessian) / np.outer(scale, scale))[np.ix_(seen, seen)]
    assert np.max(np.abs(apart)) < 2e-6


def test_elimination_solves_the_whole_system(tmp_path: Path) -> None:
    loaded = linked_scene(tmp_path)
    track, q = wandering(loaded, 0.059, 1)
    model = loaded.setup(loaded.scene.values).spec.compile()
    problem = Problem(
        loaded,
        [chain_of(loaded, track, model)],
        loaded.scene.values,
        parameters_of(loaded, loaded.scene.values),
        Physics(1),
    )
    arrow = problem.arrows(State((q,), problem.start()))[0]
    gone = eliminate(arrow, 0.0)
    assert gone is not None
    whole, slope = arrow.dense(), arrow.gradient()
    n = arrow.slope.size
    inverse = np.linalg.inv(whole[:n, :n])
    schur = whole[n:, n:] - whole[n:, :n] @ inverse @ whole[:n, n:]
    scale = np.sqrt(np.outer(np.diag(arrow.tip), np.diag(arrow.tip)))
    assert np.allclose(gone.hessian / scale, schur / scale, atol=1e-6)
    rest = slope[n:] - whole[n:, :n] @ inverse @ slope[:n]
    assert np.allclose(gone.slope, rest, rtol=1e-5, atol=1e-6 * np.abs(slope[n:]).max())


def test_norms_have_the_slopes_and_curvatures_of_their_costs() -> None:
    r = np.linspace(-0.02, 0.02, 41) + 1e-4
    for kind in ("square", "huber", "barrier"):
        how = Norm(10.0, kind, 0.005)
        e = 1e-7
        assert np.allclose(how.slope(r), (how.cost(r + e) - how.cost(r - e)) / (2 * e), rtol=1e-5)
        assert np.all(how.curvature(r) > 0.0)
    # table 2.1: 10 * 0.001^2 * (exp(r^2 / 0.001^2) - 1)
    assert Norm(10.0, "barrier", 0.001).cost(np.array([0.001]))[0] == pytest.approx(
        10.0 * 0.001**2 * (np.e - 1.0)
    )
    far = Norm(1.0, "barrier", 1.0)
    edge = np.sqrt(STEEPEST)
    assert far.cost(np.array([edge * 1.001]))[0] == pytest.approx(
        far.cost(np.array([edge * 0.999]))[0], rel=0.1
    )
    assert np.isfinite(far.cost(np.array([1e6]))[0])


def test_steps_on_the_manifold_are_scipys_rotations() -> None:
    model = mujoco.MjModel.from_xml_string(LINKED)
    man = manifold_of(model)
    rng = np.random.default_rng(2)
    q = rng.normal(size=(50, 8))
    q[:, 3:7] /= np.linalg.norm(q[:, 3:7], axis=1, keepdims=True)
    step = rng.normal(size=(50, 7))
    moved = man.moved(q, step)
    turned = Rotation.from_quat(q[:, 3:7], scalar_first=True) * Rotation.from_rotvec(step[:, 3:6])
    off = turned.inv() * Rotation.from_quat(moved[:, 3:7], scalar_first=True)
    assert np.max(off.magnitude()) < 1e-12
    assert np.allclose(man.between(q, moved), step, atol=1e-12)
    by_start, by_end = man.between_by(step)
    for k in range(7):
        e = np.zeros((50, 7))
        e[:, k] = 1e-6
        slope = (man.between(q, man.moved(moved, e)) - man.between(q, man.moved(moved, -e))) / 2e-6
        assert np.allclose(by_end[:, :, k], slope, atol=1e-8)
        slope = (man.between(man.moved(q, e), moved) - man.between(man.moved(q, -e), moved)) / 2e-6
        assert np.allclose(by_start[:, :, k], slope, atol=1e-8)


FINGER = """<mujoco><option timestep="{step}" cone="elliptic" impratio="1">
 <flag eulerdamp="disable"/></option>
<default><geom solref="-{stiffness} -100" solimp="0 0.95 0.002 1 2"
 friction="{friction}"/></default>
<worldbody><geom name="floor" type="plane" size="5 5 .1"/>
<body name="slide" pos="0 0 .05"><joint name="x" type="slide" axis="1 0 0" damping="1"/>
 <geom type="box" size=".02 .02 .02" mass=".2" contype="0" conaffinity="0"/>
 <body name="lift"><joint name="z" type="slide" axis="0 0 1" damping="1"/>
  <geom type="box" size=".01 .01 .01" mass=".1" contype="0" conaffinity="0"/>
  <body name="tip" pos="0 0 -.0395">
   <joint name="bend" type="slide" axis="1 0 0" stiffness="{spring}" damping="1.5"/>
   <geom name="tip" type="sphere" size=".01" mass=".03"/><site name="f" pos="0 0 .01"/>
 </body></body></body></worldbody>
<actuator><motor name="ux" joint="x"/><motor name="uz" joint="z"/></actuator>
<sensor><jointpos name="x" joint="x"/><jointpos name="z" joint="z"/>
<force name="force" site="f"/></sensor></mujoco>"""
"""A finger with a springy tip and a force sensor, that slides on a floor and presses (fig. 2.1)."""

TRUE = {"friction": 0.31, "stiffness": 9000.0, "spring": 250.0}
FAR = {"friction": 0.6, "stiffness": 4000.0, "spring": 120.0}
EVERY_S = 0.004


def pressed(seconds: float = 2.0, step_s: float = 0.00025, seed: int = 3) -> tuple[Track, Floats]:
    """The finger sliding to and fro, at a step of an eighth of the estimate's."""
    model = mujoco.MjModel.from_xml_string(FINGER.format(step=step_s, **TRUE))
    data = mujoco.MjData(model)
    rng = np.random.default_rng(seed)
    every, count = round(EVERY_S / step_s), round(seconds / EVERY_S)
    rows, q, told = [], [], []
    for i in range(count * every):
        if i % every == 0:
            t = i * step_s
            wanted = 0.03 * np.sin(2.0 * np.pi * 1.3 * t)
            down = 1.275 - 1.5 - 1.2 * np.sin(2.0 * np.pi * 2.1 * t)
            data.ctrl[:] = (
                60.0 * (wanted - data.qpos[0]) - 6.0 * data.qvel[0],
                down - 4.0 * data.qvel[1],
            )
            mujoco.mj_forward(model, data)
            rows.append(data.sensordata.copy())
            q.append(data.qpos.copy())
            told.append(data.ctrl.copy())
        mujoco.mj_step(model, data)
    t = np.arange(count) * EVERY_S
    table, u = np.array(rows), np.array(told)
    table[:, :2] += rng.normal(size=(count, 2)) * 1e-5
    table[:, 2:] += rng.normal(size=(count, 3)) * 0.02
    sensors = {
        "x": Series(t, table[:, :1]),
        "z": Series(t, table[:, 1:2]),
        "force": Series(t, table[:, 2:]),
    }
    controls = {"ux": Series(t, u[:, :1]), "uz": Series(t, u[:, 1:])}
    return Track("pressed", sensors, controls), np.array(q)


def finger_scene(
    folder: Path, step_s: float = 0.002, fitted: bool = True, **start: float
) -> Loaded:
    (folder / "finger.xml").write_text(FINGER.format(step=step_s, **(FAR | start)))
    scene = Scene(
        name="finger",
        mjcf="finger.xml",
        sensors={
            "x": sensor(1, norm(2e-5)),
            "z": sensor(1, norm(2e-5)),
            "force": sensor(3, norm(0.02)),
        },
        controls={name: ControlSettings(column=name) for name in ("ux", "uz")},
        forces={name: ForceSettings(along=norm(0.01)) for name in ("x", "z", "bend")},
        values=(
            Value(effect="contact_friction", at="all", fit=fitted),
            Value(effect="contact_stiffness", at="all", fit=fitted),
            Value(effect="joint_stiffness", at="bend", fit=fitted),
        ),
        knots=KnotSettings(step_s=step_s),
    )
    return Loaded(scene, folder)


def depth(model: mujoco.MjModel, q: Floats) -> Floats:
    """How deep the tip is in the floor at each configuration, m."""
    data = mujoco.MjData(model)
    out = []
    for at in q:
        data.qpos[:] = at
        mujoco.mj_fwdPosition(model, data)
        out.append(min([0.0, *(float(c.dist) for c in data.contact)]))
    return np.array(out)


@pytest.mark.long
def test_a_recording_of_a_finer_step_tells_friction_stiffness_and_spring(tmp_path: Path) -> None:
    track, truth = pressed(1.0)
    loaded = finger_scene(tmp_path)
    found = fit_scene(loaded, [track], physics=Physics(2))
    told = {p.label: found.told(k)[0] for k, p in enumerate(found.parameters)}
    assert found.estimated.converged
    assert told["contact_friction@all"] == pytest.approx(TRUE["friction"], rel=0.02)
    assert told["contact_stiffness@all"] == pytest.approx(TRUE["stiffness"], rel=0.10)
    assert told["joint_stiffness@bend"] == pytest.approx(TRUE["spring"], rel=0.10)
    model = loaded.setup(found.values).spec.compile()
    chain = found.chains[0]
    at = np.searchsorted(chain.time_s, track.sensors["x"].time_s - 1e-9)
    off = depth(model, found.q[0][at]) - depth(model, truth)
    assert np.sqrt(np.mean(off**2)) < 2e-5
    assert np.min(depth(model, truth)) < -5e-5  # it presses


@pytest.mark.long
def test_an_estimate_of_the_trajectory_settles_in_about_six_iterations(tmp_path: Path) -> None:
    track, _ = pressed()
    loaded = finger_scene(tmp_path, fitted=False, **TRUE)
    found = fit_scene(loaded, [track], physics=Physics(2))
    history = found.estimated.history
    assert history[min(6, len(history) - 1)] < 1.02 * history[-1]


@pytest.mark.long
def test_poses_alone_foretell_no_force_and_the_joint_estimate_does(tmp_path: Path) -> None:
    """Fig. 2.1: poses that are 0.2 mm off say nothing of forces; the joint estimate knows them."""
    track, _ = pressed()
    off = {
        "x": track.sensors["x"],
        "z": Series(track.sensors["z"].time_s, track.sensors["z"].values + 2e-4),
        "force": track.sensors["force"],
    }
    loaded = finger_scene(tmp_path, fitted=False, **TRUE)
    scene = loaded.scene.model_copy(
        update={"sensors": loaded.scene.sensors | {"z": sensor(1, norm(3e-4))}}
    )
    loaded = Loaded(scene, tmp_path)
    track = replace(track, sensors=off)
    physics = Physics(2)
    found = fit_scene(loaded, [track], physics=physics)
    chain = found.chains[0]
    setup = loaded.setup(found.values)
    model = setup.spec.compile()
    force = next(c for c in chain.channels if c.name == "force")
    alone = chain.misreadings(force, chain.outputs(chain.start, model, setup, physics), setup)
    joint = chain.misreadings(force, chain.outputs(found.q[0], model, setup, physics), setup)
    usual = np.sqrt(np.mean(track.sensors["force"].values[:, 2] ** 2))
    assert np.sqrt(np.mean(alone[:, 2] ** 2)) > 0.5 * usual
    assert np.sqrt(np.mean(joint[:, 2] ** 2)) < 0.05 * usual


@pytest.mark.long
def test_a_force_that_is_left_out_is_foretold(tmp_path: Path) -> None:
    """2.7.1: without the force's term, from poses and what drives the finger."""
    track, _ = pressed()
    loaded = finger_scene(tmp_path, fitted=False, **TRUE)
    free = loaded.scene.model_copy(
        update={"sensors": loaded.scene.sensors | {"force": sensor(3, norm(1e6))}}
    )
    found = fit_scene(Loaded(free, tmp_path), [track], physics=Physics(2))
    chain = found.chains[0]
    setup = loaded.setup(found.values)
    said = chain.outputs(found.q[0], setup.spec.compile(), setup, Physics(1))
    force = next(c for c in chain.channels if c.name == "force")
    off = chain.misreadings(force, said, setup)
    span = np.ptp(track.sensors["force"].values[:, 2])
    assert np.sqrt(np.mean(off[:, 2] ** 2)) < 0.05 * span


def test_an_interrupted_estimate_goes_on(tmp_path: Path) -> None:
    track, _ = pressed(0.5)
    loaded = finger_scene(tmp_path)
    chains, q = begun(loaded, [track], loaded.scene.values, Physics(1))
    values = loaded.scene.values
    problem = Problem(loaded, chains, values, parameters_of(loaded, values), Physics(1))
    start = State(q, problem.start())
    whole = estimate(problem, start, iterations=40)
    kept = tmp_path / "kept.npz"

    class StopError(Exception):
        pass

    def stop(note: str, done: float) -> None:
        if "iteration 4" in note:
            raise StopError

    with pytest.raises(StopError):
        estimate(problem, start, iterations=40, tell=stop, kept=kept)
    assert kept.exists()
    rest = estimate(problem, start, iterations=40, kept=kept)
    assert not kept.exists()
    assert rest.history == pytest.approx(whole.history, rel=1e-12)
    assert np.array_equal(rest.state.x, whole.state.x)


@pytest.mark.long
def test_parameters_stay_within_their_bounds(tmp_path: Path) -> None:
    track, _ = pressed(0.5)
    loaded = finger_scene(tmp_path)
    values = tuple(
        v.but(upper=0.2, value=0.1) if v.effect == "contact_friction" else v
        for v in loaded.scene.values
    )
    found = fit_scene(loaded, [track], values, Physics(1))
    told = {p.label: found.told(k)[0] for k, p in enumerate(found.parameters)}
    assert told["contact_friction@all"] == pytest.approx(0.2)


COUPLED = """<mujoco><worldbody>
<body><joint name="a" axis="0 1 0"/><geom size=".1" mass="1"/><site name="s"/>
 <body pos="0 0 1"><joint name="b" axis="0 1 0"/><geom size=".1" mass="1"/><site name="t"/>
  <body pos="0 0 1"><joint name="c" axis="1 0 0"/><geom size=".1" mass="1"/>
   <body pos="0 0 1"><joint name="d" axis="1 0 0"/><geom size=".1" mass="1"/>
   </body></body></body></body>
</worldbody><tendon>
<spatial name="way"><site site="s"/><site site="t"/></spatial>
<fixed name="sum"><joint joint="a" coef="2"/><joint joint="b" coef="-0.5"/></fixed>
<fixed name="rest"><joint joint="b" coef="3"/><joint joint="c" coef="1.5"/></fixed>
</tendon><sensor>
<tendonpos name="first" tendon="way"/><tendonpos name="second" tendon="sum"/>
<tendonpos name="third" tendon="rest"/><jointpos name="own" joint="{own}"/>
</sensor></mujoco>"""


def coupled(folder: Path, own: str) -> Loaded:
    (folder / "m.xml").write_text(COUPLED.format(own=own))
    names = ("first", "second", "third", "own")
    scene = Scene(
        name="coupled",
        mjcf="m.xml",
        sensors={name: sensor(1, norm(0.01)) for name in names},
        forces={name: ForceSettings(along=norm(0.1)) for name in "abcd"},
    )
    return Loaded(scene, folder)


@pytest.mark.parametrize("own", ["a", "b", "c"])
@pytest.mark.parametrize("spatial", [False, True])
def test_joints_that_fixed_tendons_tell_together(own: str, spatial: bool, tmp_path: Path) -> None:
    loaded = coupled(tmp_path, own)
    model = loaded.setup(()).spec.compile()
    t = np.arange(30) * 0.01
    told = {"a": 0.3 + 0.2 * t, "b": -0.4 + 0.5 * t, "c": 0.7 - 0.9 * t}
    lengths = {
        "first": 1.0 + 0.1 * t,  # through space: tells no joint
        "second": 2.0 * told["a"] - 0.5 * told["b"],
        "third": 3.0 * told["b"] + 1.5 * told["c"],
        "own": told[own],
    }
    if not spatial:
        del lengths["first"]
    track = Track("made up", {k: Series(t, v[:, None]) for k, v in lengths.items()}, {})
    q = guess(loaded, track, t, model)
    inner = slice(5, -5)  # smoothing bends what is near the ends
    for name, values in told.items():
        at = model.joint(name).qposadr[0]
        np.testing.assert_allclose(q[inner, at], values[inner], atol=1e-6, err_msg=name)
    assert not q[:, model.joint("d").qposadr[0]].any()


def test_an_encoder_between_joints_is_shared_by_its_coefficients(tmp_path: Path) -> None:
    loaded = coupled(tmp_path, "d")
    model = loaded.setup(()).spec.compile()
    t = np.arange(30) * 0.01
    length = 1.0 + 0.5 * t
    track = Track("made up", {"second": Series(t, length[:, None])}, {})
    q = guess(loaded, track, t, model)[10]
    # The least motion that gives the length.
    assert q[model.joint("a").qposadr[0]] == pytest.approx(length[10] * 2.0 / 4.25)
    assert q[model.joint("b").qposadr[0]] == pytest.approx(length[10] * -0.5 / 4.25)
    assert q[model.joint("c").qposadr[0]] == 0.0


def test_figures_of_a_fit(tmp_path: Path) -> None:
    loaded = linked_scene(tmp_path)
    track, q = wandering(loaded, 0.3, 2)
    other = replace(track, name="second")
    values = loaded.scene.values
    model = loaded.setup(values).spec.compile()
    chains = [chain_of(loaded, x, model) for x in (track, other)]
    parameters = parameters_of(loaded, values)
    at = {"joint_damping": 0.03, "sensor_scale": 0.04}
    x = np.array(
        [p.coordinate(at.get(p.effect.name, 0.5 * (p.lower + p.upper))) for p in parameters]
    )
    x[0], x[-1] = (
        parameters[0].coordinate(parameters[0].lower),
        parameters[-1].coordinate(parameters[-1].upper),
    )
    errors = 0.1 + 0.01 * np.arange(x.size)
    n = len(parameters)
    estimated = Estimated(
        values, State((q, q), x), parameters, [9.0, 4.0], np.ones(2), np.zeros((2, n, n)),
        np.zeros((2, n)), 3, True,
    )  # fmt: skip
    found = SceneFit(
        loaded, values, parameters, x, errors, chains, (q, q), estimated, None,
        np.array([0.25, 0.75]), ["a note"],
    )  # fmt: skip
    result = result_of_fit(Path("s.yaml"), Path("o.yaml"), found, [track, other], 1.5)

    # A floating body and a joint: seven directions at every knot of both recordings.
    assert result.unknowns == 2 * len(q) * 7 + n and n > 3
    assert (result.scene, result.output, result.seconds) == ("s.yaml", "o.yaml", 1.5)
    assert result.recordings == ["made up", "second"]
    assert result.loss == {"made up": 0.25, "second": 0.75}
    assert (result.history, result.converged, result.notes) == ([9.0, 4.0], True, ["a note"])
    for k, (p, told) in enumerate(zip(parameters, result.parameters, strict=True)):
        assert (told.effect, told.place, told.unit) == (p.effect.name, p.place, p.effect.unit)
        value = float(np.exp(x[k])) if p.effect.logarithmic else float(x[k])
        assert told.value == pytest.approx(value)
        scale = value if p.effect.logarithmic else 1.0
        assert told.std_error == pytest.approx(scale * errors[k])
        assert told.at_bound is (k in (0, n - 1)), told.effect
    starts = {(v.effect, v.at): v.value for v in values}
    for told in result.parameters:
        if starts.get((told.effect, told.place)) is not None:
            assert told.start == pytest.approx(starts[told.effect, told.place])
    assert set(result.force) == {"f.x", "f.y", "f.z", "f.rx", "f.ry", "f.rz", "h"}
    assert set(result.rmse) == set(loaded.names)
    # Made along this motion, readings differ by their noise of 0.002 in each component.
    assert result.rmse["a"] == pytest.approx(0.002, rel=0.6)


def test_units_and_names(tmp_path: Path) -> None:
    setup = linked_scene(tmp_path).setup()
    wanted = {"p": "m", "o": "rad", "a": "rad or m", "w": "rad/s", "acc": "m/s^2", "fo": "N"}
    assert {name: unit_of(setup, name) for name in wanted} == wanted
    assert not set(UNITS) & set(OTHERS)
    every = """<mujoco><worldbody><body><joint name="h" type="hinge"/><joint name="s" type="slide"/>
    <geom size=".1"/></body><body><joint name="b" type="ball"/><geom size=".1"/></body>
    <body><freejoint name="f"/><geom size=".1"/></body></worldbody></mujoco>"""
    assert dof_names(mujoco.MjModel.from_xml_string(every)) == [
        "h", "s", "b.rx", "b.ry", "b.rz", "f.x", "f.y", "f.z", "f.rx", "f.ry", "f.rz",
    ]  # fmt: skip
