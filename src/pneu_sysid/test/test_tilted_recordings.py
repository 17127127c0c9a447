# SPDX-License-Identifier: Apache-2.0
"""Poses told in a frame that leans, at heights that are each recording's own."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation

from pneu_common.errors import InputError
from pneu_sysid.contacts.anew import anew
from pneu_sysid.contacts.arrow import Arrow, Zeros, eliminate
from pneu_sysid.contacts.chain import Chain, level
from pneu_sysid.contacts.effects import find_scene_effect
from pneu_sysid.contacts.estimate import Problem, State, parameters_of
from pneu_sysid.contacts.knots import chain_of
from pneu_sysid.contacts.manifold import Floats
from pneu_sysid.contacts.norms import Norm
from pneu_sysid.contacts.physics import Physics
from pneu_sysid.contacts.rest import touching_down
from pneu_sysid.contacts.rollouts import rolled_out
from pneu_sysid.contacts.scene import Loaded, Value, load_scene
from pneu_sysid.contacts.together import joint
from pneu_sysid.contacts.track import Series, Track, unbroken
from pneu_sysid.contacts.trajectories import begun

HOUSE = Path(__file__).resolve().parents[3]
TILT = (0.03, -0.02)
TURN = Rotation.from_rotvec([*TILT, 0.0])


def leaning() -> tuple[Value, ...]:
    return (
        Value(effect="frame_tilt_x", at="world", value=TILT[0]),
        Value(effect="frame_tilt_y", at="world", value=TILT[1]),
    )


def elbow(unzeroed: tuple[str, ...]) -> Loaded:
    loaded = load_scene(HOUSE / "scenes" / "elbow.yaml")
    sensors = dict(loaded.scene.sensors)
    sensors["position"] = sensors["position"].model_copy(update={"unzeroed": unzeroed})
    values = tuple(v for v in loaded.scene.values if not v.effect.startswith("frame_tilt"))
    scene = loaded.scene.model_copy(
        update={"sensors": sensors, "values": values, "horizon_s": None}
    )
    return Loaded(scene, HOUSE / "scenes")


def tossed(loaded: Loaded, seed: int, seconds: float = 0.5) -> tuple[Chain, Floats]:
    """A toss on a level floor, by the scene's own model: knots and configurations."""
    rng = np.random.default_rng(seed)
    model = loaded.setup(loaded.scene.values).spec.compile()
    t = np.arange(0.0, seconds, 1.0 / 592.0)
    data = mujoco.MjData(model)
    data.qpos[:3] = 0.3 * rng.normal(), 0.3 * rng.normal(), 0.12
    data.qpos[3:7] = Rotation.from_rotvec(0.5 * rng.normal(size=3)).as_quat(scalar_first=True)
    q = np.tile(data.qpos, (len(t), 1))
    v = np.concatenate([[0.5, 0.2, 0.0], rng.normal(size=4)])
    mujoco.mj_integratePos(model, q[1], v, t[1])
    sensors = {
        "position": Series(t, q[:, :3]),
        "orientation": Series(t, unbroken(q[:, 3:7])),
        "elbow": Series(t, q[:, 7:]),
    }
    chain = replace(chain_of(loaded, Track("toss", sensors), model, t[1]), time_s=t)
    motion = rolled_out(chain, model, loaded.setup(), q, np.array([0]))
    assert motion.there.all() and motion.q[:, 2].min() < 0.06
    return chain, motion.q


def seen(q: Floats, t: Floats, rise_m: float, every: int = 4) -> Track:
    """What motion capture in a frame that leans, its zero elsewhere, tells of it."""
    place = TURN.apply(q[:, :3]) + np.array([0.0, 0.0, rise_m])
    turned = TURN * Rotation.from_quat(q[:, 3:7], scalar_first=True)
    values = {
        "position": place,
        "orientation": unbroken(turned.as_quat(scalar_first=True)),
        "elbow": q[:, 7:],
    }
    return Track(
        f"rises by {rise_m}", {k: Series(t[::every], v[::every]) for k, v in values.items()}
    )


def test_a_frame_that_leans_sees_a_floor_and_gravity_that_lean() -> None:
    """The same motion leaves the same forces: those of translation turned."""
    loaded = elbow(())
    chain, q = tossed(loaded, 0)
    there = seen(q, chain.time_s, 0.0, 1)
    turned = q.copy()
    turned[:, :3] = there.sensors["position"].values
    turned[:, 3:7] = there.sensors["orientation"].values
    physics = Physics(1)
    found = []
    for at, values in ((q, ()), (turned, leaning())):
        setup = loaded.setup(values)
        found.append(chain.outputs(at, setup.spec.compile(), setup, physics).force[1:-1])
    level_one, tilted = found
    weight = 2 * 0.37 * 9.81
    assert np.max(np.abs(tilted[:, :3] - TURN.apply(level_one[:, :3]))) < 1e-6 * weight
    assert np.max(np.abs(tilted[:, 3:] - level_one[:, 3:])) < 1e-6 * weight
    assert np.max(np.abs(level_one)) < 1e-3 * weight  # a roll-out of the same model, as solved
    setup = loaded.setup()
    untold = chain.outputs(turned, setup.spec.compile(), setup, physics).force[1:-1]
    assert np.max(np.abs(untold)) > 0.02 * weight


def test_what_is_mounted_leans_and_what_moves_freely_does_not() -> None:
    loaded = elbow(())
    setup = loaded.setup()
    world = setup.spec.worldbody
    arm = world.add_body(name="arm", pos=[0.0, 0.5, 0.2])
    arm.add_joint(name="shoulder", type=mujoco.mjtJoint.mjJNT_HINGE)
    arm.add_geom(name="arm", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.01, 0.0, 0.0])
    world.add_site(name="mark", pos=[0.1, 0.2, 0.3])
    nested = world.add_frame(name="nested", pos=[0.0, 0.0, 1.0])
    box = world.add_geom(name="box", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.01, 0.0, 0.0])
    box.set_frame(nested)
    effect = find_scene_effect("frame_tilt_x")
    effect.put(setup, "world", TILT[0])
    find_scene_effect("frame_tilt_y").put(setup, "world", TILT[1])
    find_scene_effect("gravity_strength").put(setup, "world", 0.1)
    model = setup.spec.compile()
    assert model.body("arm").pos == pytest.approx(TURN.apply([0.0, 0.5, 0.2]))
    assert model.site("mark").pos == pytest.approx(TURN.apply([0.1, 0.2, 0.3]))
    assert model.geom("box").pos == pytest.approx(TURN.apply([0.0, 0.0, 1.0]))
    assert model.body("first").pos == pytest.approx([0.0, 0.0, 0.1])
    assert model.opt.gravity == pytest.approx(1.1 * TURN.apply([0.0, 0.0, -9.81]))
    effect.put(setup, "world", 0.0)
    find_scene_effect("frame_tilt_y").put(setup, "world", 0.0)
    assert setup.spec.compile().body("arm").pos == pytest.approx([0.0, 0.5, 0.2])


def test_a_body_comes_down_to_what_is_fixed() -> None:
    loaded = elbow(("z",))
    setup = loaded.setup(leaning())
    model = setup.spec.compile()
    q = np.tile(model.qpos0, (40, 1))
    q[:, :2] = 0.2, -0.3
    q[:, 3:7] = TURN.as_quat(scalar_first=True)  # flat on the floor
    up = TURN.apply([0.0, 0.0, 1.0])
    lowest = (0.025 - up[0] * 0.2 + up[1] * 0.3) / up[2]
    q[:, 2] = lowest + 0.007
    q[:10, 2] += 0.05  # before it lay
    assert touching_down(q, 0, 2, model) == pytest.approx(-0.007, abs=1e-6)
    q[:, 2] += 50.0
    assert touching_down(q, 0, 2, model) == 0.0  # nothing within reach


@pytest.mark.parametrize("kind", ["square", "huber", "barrier"])
def test_the_zero_found_is_the_one_of_least_cost(kind: str) -> None:
    rng = np.random.default_rng(3)
    misread = 0.004 + 0.0005 * rng.standard_t(2, size=50)
    norm = Norm(1e6, kind, 0.001 if kind == "huber" else 0.01)
    best = minimize_scalar(
        lambda m: float(np.sum(norm.cost(misread - m))), bounds=(0.0, 0.01), method="bounded",
        options={"xatol": 1e-12},
    )  # fmt: skip
    assert level(misread, norm) == pytest.approx(best.x, abs=1e-8)
    assert level(np.array([0.003]), norm) == 0.003
    assert level(np.zeros(0), norm) == 0.0


def test_elimination_takes_zeros_out_too() -> None:
    rng = np.random.default_rng(4)
    n, k, c, z = 6, 2, 3, 2
    J = rng.normal(size=(80, n * k + c + z))
    J[:, : n * k] *= 0.0
    for row in range(80):  # a residual knows three knots
        i = row % (n - 2)
        J[row, i * k : (i + 3) * k] = rng.normal(size=3 * k)
    whole, slope = J.T @ J, J.T @ rng.normal(size=80)
    slope[n * k + c :] = 0.0
    free = whole[: n * k, : n * k].reshape(n, k, n, k)

    def blocks(off: int) -> Floats:
        return np.array([free[i + off, :, i, :] for i in range(n - off)])

    p, q = slice(n * k, n * k + c), slice(n * k + c, None)
    arrow = Arrow(
        blocks(0), blocks(1), blocks(2), whole[: n * k, p].reshape(n, k, c), whole[p, p],
        slope[: n * k].reshape(n, k), slope[p], 1.0,
        Zeros(whole[: n * k, q].reshape(n, k, z), whole[p, q], whole[q, q]),
    )  # fmt: skip
    gone = eliminate(arrow)
    assert gone is not None
    inner = np.r_[0 : n * k, n * k + c : n * k + c + z]
    taken = np.linalg.solve(whole[np.ix_(inner, inner)], whole[inner, p])
    assert gone.hessian == pytest.approx(whole[p, p] - whole[inner, p].T @ taken, rel=1e-6)
    assert gone.slope == pytest.approx(slope[p] - taken.T @ slope[inner], rel=1e-6)
    by = rng.normal(size=c)
    step = np.linalg.solve(whole[np.ix_(inner, inner)], -slope[inner] - whole[inner, p] @ by)
    assert (gone.step + gone.lever @ by).ravel() == pytest.approx(step[: n * k], rel=1e-6)
    held = whole[p, p] - whole[p, q] @ np.linalg.solve(whole[q, q], whole[q, p])
    assert arrow.held() == pytest.approx(held, rel=1e-6)


def test_the_slope_is_that_of_the_cost_with_the_best_zero() -> None:
    loaded = elbow(("x", "z"))
    chain, q = tossed(loaded, 1, 0.3)
    physics = Physics(1)
    values = (*loaded.scene.values, *leaning())
    begun_chains, starts = begun(loaded, [seen(q, chain.time_s, 0.4)], values, physics)
    rng = np.random.default_rng(5)
    trust = rng.uniform(0.2, 3.0, begun_chains[0].size)  # and where knots count unevenly
    chains = [replace(begun_chains[0], trust=trust)]
    problem = Problem(loaded, chains, values, parameters_of(loaded, values), physics)
    state = State(starts, problem.start())
    arrow = problem.arrows(state)[0]
    step = 1e-10 * rng.normal(size=arrow.slope.shape)
    by = 1e-10 * rng.normal(size=len(state.x))
    ahead = problem.cost(problem.moved(state, [step], by, 1.0))
    back = problem.cost(problem.moved(state, [step], by, -1.0))
    foretold = float(np.sum(arrow.slope * step) + arrow.tip_slope @ by)
    assert 0.5 * (ahead - back) == pytest.approx(foretold, rel=1e-3)


@pytest.mark.long
def test_tilt_and_heights_are_found() -> None:
    """From a level start, of three tosses whose heights were zeroed in three ways."""
    loaded = elbow(("z",))
    tracks = []
    truly = []
    for seed, rise_m in ((2, 0.5), (3, -0.02), (4, 0.0)):
        chain, q = tossed(loaded, seed)
        tracks.append(seen(q, chain.time_s, rise_m))
        truly.append((chain.time_s, TURN.apply(q[:, :3])[:, 2]))
    physics = Physics()
    values = (
        *(v.but(fit=False) for v in loaded.scene.values),
        *(v.but(value=0.0) for v in leaning()),
    )
    chains, starts = begun(loaded, tracks, values, physics)
    fitted = parameters_of(loaded, values)
    found = anew(loaded, tracks, chains, starts, values, fitted, physics)
    assert found.x == pytest.approx(TILT, abs=0.001)
    assert np.all(np.diff(found.history) < 0.0)
    for (t, height), chain, q in zip(truly, found.chains, found.q, strict=True):
        off = q[:, 2] - np.interp(chain.time_s, t, height)
        assert np.median(np.abs(off)) < 3e-4  # m, above the floor's zero


@pytest.mark.long
def test_drawing_anew_finds_what_one_estimate_does_not() -> None:
    """Everything at once, contacts too: the first estimate creeps on beside the level floor."""
    loaded = elbow(("z",))
    tracks = []
    for seed, rise_m in ((2, 0.5), (3, -0.02), (4, 0.0)):
        chain, q = tossed(loaded, seed)
        tracks.append(seen(q, chain.time_s, rise_m))
    physics = Physics()
    values = (*loaded.scene.values, *(v.but(value=0.0) for v in leaning()))
    chains, starts = begun(loaded, tracks, values, physics)
    once = joint(loaded, chains, values, starts, physics)
    often = joint(loaded, chains, values, starts, physics, tracks=tracks)
    names = [p.effect.name for p in often.parameters]
    tilt = [names.index("frame_tilt_x"), names.index("frame_tilt_y")]
    assert not once.estimated.converged
    assert np.max(np.abs(once.x[tilt] - TILT)) > 0.004
    assert often.x[tilt] == pytest.approx(TILT, abs=0.002)
    assert often.estimated.cost < 0.1 * once.estimated.cost


def test_zeros_are_of_vectors() -> None:
    loaded = elbow(())
    sensors = dict(loaded.scene.sensors)
    sensors["elbow"] = sensors["elbow"].model_copy(update={"unzeroed": ("z",)})
    with pytest.raises(InputError, match="elbow: unzeroed: has 1 components"):
        Loaded(loaded.scene.model_copy(update={"sensors": sensors}), HOUSE / "scenes")
