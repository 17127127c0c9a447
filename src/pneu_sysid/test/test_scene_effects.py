# SPDX-License-Identifier: Apache-2.0
"""Every effect of scenes: what it declares, that it is where it says, and does something."""

import itertools
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

import pneu_sysid.contacts.effects as catalogue
from pneu_common.errors import InputError
from pneu_sysid.contacts.bearings import bearings_of, feel_load
from pneu_sysid.contacts.chain import Chain
from pneu_sysid.contacts.effects import find_scene_effect, scene_effects
from pneu_sysid.contacts.effects.base import SceneEffect, Setup
from pneu_sysid.contacts.knots import chain_of
from pneu_sysid.contacts.manifold import manifold_of
from pneu_sysid.contacts.physics import Physics
from pneu_sysid.contacts.scene import Loaded, Value, load_scene
from pneu_sysid.contacts.track import Series, Track, unbroken
from pneu_sysid.contacts.yielding import yielding_column

HOUSE = Path(__file__).resolve().parents[3]
EFFECTS = list(scene_effects().values())


@pytest.fixture(scope="module")
def loaded() -> Loaded:
    return load_scene(HOUSE / "scenes" / "elbow.yaml")


@pytest.fixture(scope="module")
def chain(loaded: Loaded) -> Chain:
    """The elbow sliding and turning on one edge, its hinge in motion."""
    setup = loaded.setup()
    model = setup.spec.compile()
    n = 12
    t = np.arange(n) / 148.0
    rng = np.random.default_rng(0)
    q = np.zeros((n, 8))
    q[:, 3] = 1.0
    q[:, 0], q[:, 2], q[:, 7] = 0.8 * t, 0.0245, 0.3 + 2.0 * t
    steps = np.cumsum(rng.normal(size=(n, 7)) * 1e-4, axis=0)
    steps[:, 3] += 0.01
    q = manifold_of(model).moved(q, steps)
    sensors = {
        "position": Series(t, q[:, :3]),
        "orientation": Series(t, unbroken(q[:, 3:7])),
        "elbow": Series(t, q[:, 7:]),
    }
    return chain_of(loaded, Track("made up", sensors), model)


def rows(chain: Chain, setup: Setup) -> np.ndarray:
    model = setup.spec.compile()
    said = chain.outputs(chain.start, model, setup, Physics(1))
    return np.nan_to_num(np.concatenate(chain.rows(said, setup), axis=1))


def test_every_file_is_registered() -> None:
    folder = Path(catalogue.__file__).parent
    files = {p.stem for p in folder.glob("*.py")} - {"__init__", "base"}
    assert files == set(scene_effects())
    with pytest.raises(InputError, match="did you mean 'joint_friction'"):
        find_scene_effect("joint_frictio")


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda e: e.name)
def test_what_it_declares(effect: SceneEffect, loaded: Loaded, chain: Chain) -> None:
    assert effect.lower < effect.upper and effect.typical > 0.0
    assert effect.formula and effect.source and effect.title
    places = effect.places(loaded.setup())
    assert places
    for place in places:
        setup = loaded.setup()
        now = effect.value(setup, place)
        if effect.absent is not None:
            assert now == pytest.approx(effect.absent, abs=1e-12)
            effect.put(setup, place, effect.absent)
            assert np.allclose(rows(chain, setup), rows(chain, loaded.setup()), atol=1e-9)
        there = float(now * 1.5 if effect.logarithmic else now + effect.typical)
        setup = loaded.setup()
        effect.put(setup, place, there)
        assert effect.value(setup, place) == pytest.approx(there, rel=1e-9)
        effect.put(setup, place, there)  # put, not added
        assert effect.value(setup, place) == pytest.approx(there, rel=1e-9)
        effect.put(setup, place, now)
        assert effect.value(setup, place) == pytest.approx(now, rel=1e-9, abs=1e-12)


WITHOUT = {"contact_spin"}
"""What contacts of three dimensions do not have."""


@pytest.mark.parametrize(
    "effect", [e for e in EFFECTS if e.name not in WITHOUT], ids=lambda e: e.name
)
def test_it_changes_what_is_seen(effect: SceneEffect, loaded: Loaded, chain: Chain) -> None:
    base = rows(chain, loaded.setup())
    felt = []
    for place in effect.places(loaded.setup()):
        setup = loaded.setup()
        now = effect.value(setup, place)
        if effect.adds_joint:  # what it would change, where it is not
            force, read = yielding_column(chain, chain.start, setup, effect, place, Physics(1))
            felt.append(effect.typical * np.nanmax(np.abs(np.concatenate([force, read], axis=1))))
            continue
        effect.put(setup, place, now * 1.5 if effect.logarithmic else now + effect.typical)
        felt.append(np.max(np.abs(rows(chain, setup) - base)))
    assert max(felt) > 1e-6, effect.name


def numbers(setup: Setup) -> dict[str, np.ndarray]:
    """All real numbers of the model that a scene is made into."""
    model = setup.spec.compile()
    found = {name: getattr(model, name) for name in dir(model) if not name.startswith("_")}
    arrays = {n: np.array(a) for n, a in found.items() if isinstance(a, np.ndarray)}
    return {n: a for n, a in arrays.items() if a.dtype.kind == "f"} | {"g": model.opt.gravity}


def test_effects_are_the_same_in_either_order(loaded: Loaded) -> None:
    base = loaded.setup()
    sites = [(e, e.places(base)[-1]) for e in EFFECTS if e.in_mjcf and e.name not in WITHOUT]
    there = {}
    for effect, place in sites:
        now = effect.value(loaded.setup(), place)
        there[effect] = float(now * 1.5 if effect.logarithmic else now + effect.typical)
    for one, other in itertools.combinations(sites, 2):
        if one[0].adds_joint and other[0].adds_joint:
            continue  # a chain of two joints; a scene has them in one order, whichever it lists
        models = []
        for pair in ((one, other), (other, one)):
            setup = loaded.setup()
            for effect, place in pair:
                effect.put(setup, place, there[effect])
            models.append(numbers(setup))
        for name, array in models[0].items():
            said = f"{name}: {one[0].name} and {other[0].name}"
            np.testing.assert_allclose(array, models[1][name], 1e-9, 1e-12, err_msg=said)


def test_joints_that_are_added_move_each_other_in_one_order(loaded: Loaded) -> None:
    values = (
        Value(effect="springy_tip", at="second.x", value=500.0),
        Value(effect="link_bend", at="second.z", value=400.0),
        Value(effect="springy_tip", at="second.y", value=300.0),
    )
    one, other = (loaded.setup(order).spec.compile() for order in (values, values[::-1]))
    assert one.njnt == loaded.setup().spec.compile().njnt + 3
    assert [one.joint(k).name for k in range(one.njnt)] == [
        other.joint(k).name for k in range(other.njnt)
    ]
    np.testing.assert_array_equal(one.jnt_axis, other.jnt_axis)


def test_one_geom_alone_may_differ(loaded: Loaded) -> None:
    effect = find_scene_effect("contact_friction")
    setup = loaded.setup()
    effect.put(setup, "second", 0.9)
    model = setup.spec.compile()
    assert model.geom("second").friction[0] == 0.9
    assert model.geom("first").friction[0] == 0.3
    assert model.geom("second").priority > model.geom("floor").priority


def test_shapes_of_another_size_weigh_the_same(loaded: Loaded) -> None:
    setup = loaded.setup()
    find_scene_effect("geometry_scale").put(setup, "all", 0.1)
    model, base = setup.spec.compile(), loaded.setup().spec.compile()
    assert np.allclose(model.body_mass, base.body_mass)
    assert np.allclose(model.geom("first").size, 1.1 * base.geom("first").size)
    assert np.allclose(model.geom("floor").size, base.geom("floor").size)


def test_a_shifted_centre_of_mass_is_where_it_says(loaded: Loaded) -> None:
    setup = loaded.setup()
    find_scene_effect("centre_of_mass_y").put(setup, "second", 0.004)
    find_scene_effect("body_mass").put(setup, "second", 0.5)
    model, base = setup.spec.compile(), loaded.setup().spec.compile()
    assert model.body("second").ipos - base.body("second").ipos == pytest.approx([0, 0.004, 0])
    assert model.body("second").mass == pytest.approx(1.5 * base.body("second").mass)
    assert np.sort(model.body("second").inertia) == pytest.approx(
        1.5 * np.sort(base.body("second").inertia)
    )


def test_a_bearing_is_slowed_by_what_it_carries() -> None:
    """A wheel that spins by itself: the pin carries its weight, its friction is a share of it."""
    spec = mujoco.MjSpec.from_string(
        """<mujoco><option timestep="0.001"/><worldbody><body pos="0 0 1">
        <joint name="pin" axis="0 1 0"/><geom type="cylinder" size=".1 .01" mass="2"
        quat="0.7071068 0.7071068 0 0"/></body></worldbody></mujoco>"""
    )
    feel_load(spec, "pin")
    model = spec.compile()
    bearings = bearings_of(model, {"pin": 0.003})
    assert bearings is not None and bearings_of(model, {"pin": 0.0}) is None
    data = mujoco.MjData(model)
    data.qvel[0] = -5.0
    mujoco.mj_forward(model, data)
    assert bearings.torque(data.sensordata, data.qvel) == pytest.approx(
        [-0.003 * 2.0 * 9.81], rel=1e-6
    )
    inertia = float(model.body_inertia[1].max())
    speeds = []
    for _ in range(3000):
        data.qfrc_applied[0] = -bearings.slowing(model, data, 0.001)[0]
        mujoco.mj_step(model, data)
        speeds.append(data.qvel[0])
    slowing = 0.003 * 2.0 * 9.81 / inertia
    assert speeds[0] == pytest.approx(-5.0 + 0.001 * slowing, rel=1e-4)
    assert np.all(np.diff(np.abs(speeds)) <= 0.0) and abs(speeds[-1]) < 0.01  # and no chatter


def test_slopes_of_a_bearing_are_those_of_its_friction(loaded: Loaded, chain: Chain) -> None:
    setup = loaded.setup()
    find_scene_effect("joint_load_friction").put(setup, "elbow", 0.003)
    model = setup.spec.compile()
    bearings = bearings_of(model, setup.loaded)
    motion = chain.motion(chain.start, setup)
    physics = Physics(1)
    slopes = physics.slopes(model, motion, True, bearings)
    plain = physics.slopes(model, motion, True)
    rng = np.random.default_rng(0)
    found, foretold = [], []
    for kind, size in enumerate((1e-7, 1e-5, 1e-3)):
        step = size * rng.normal(size=motion.v.shape)
        ends = []
        for way in (1.0, -1.0):
            there = [
                replace(motion, q=chain.manifold.moved(motion.q, way * step)),
                replace(motion, v=motion.v + way * step),
                replace(motion, a=motion.a + way * step),
            ][kind]
            slowed, free = (physics.evaluate(model, there, b)[0] for b in (bearings, None))
            ends.append(slowed - free)
        found.append(0.5 * (ends[0] - ends[1])[:, 6])
        changes = slopes.force[kind] - plain.force[kind]
        foretold.append(np.einsum("nko,nk->no", changes, step)[:, 6])
        assert np.max(np.abs(ends[0])) > 1e-3  # N m
    for one, other in zip(found, foretold, strict=True):
        close = np.isclose(one, other, rtol=1e-3, atol=1e-3 * np.max(np.abs(one)))
        assert np.mean(close) > 0.95  # all but where a contact just opens


def test_what_one_message_tells_is_late_together() -> None:
    loaded = load_scene(Path(__file__).resolve().parents[3] / "scenes/phantom/hanging.yaml")
    lag, setup = find_scene_effect("sensor_lag"), loaded.setup()
    wrench = "/lab/phantom/wrench"
    sought = [place for effect, place in loaded.candidates(setup) if effect.name == "sensor_lag"]
    assert wrench in sought
    assert not {"phantom_force", "phantom_torque"} & set(sought)
    assert "phantom_force" in lag.places(setup)  # one alone may be said to be
    lag.put(setup, wrench, 0.003)
    late = {name for name, reading in setup.readings.items() if reading.lag_s == 0.003}
    assert late == {"phantom_force", "phantom_torque"}
    assert lag.value(setup, wrench) == 0.003
