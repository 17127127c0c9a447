# SPDX-License-Identifier: Apache-2.0
"""Loads that joints may come to carry: as the rig with that payload, and found by what is read."""

from pathlib import Path

import numpy as np
import pytest

from pneu_sim.effects.places import joints
from pneu_sim.full_solver import FullSolver
from pneu_sim.observe.drifts import Drifts
from pneu_sim.observe.loads import Loads
from pneu_sim.observe.observer import Observer
from pneu_sim.observe.settings import Drift, ObserverSettings
from pneu_sim.plant import Plant
from pneu_sim.rig import load_rig
from pneu_sim.rig.schema import AttachedEffect

RIGS = Path(__file__).parents[3] / "rigs"
LOADED = ("rail", "cart_pole", "arm", "dog", "kokoro")


def with_payload(rig, place, mass_kg, distance_m):
    values = {"mass_kg": mass_kg, "distance_m": distance_m}
    payload = AttachedEffect(effect="payload", place=place, parameters=values)
    return rig.model_copy(update={"effects": [*rig.effects, payload]})


def loads_of(plant):
    assert isinstance(plant.solver, FullSolver)
    return Loads(plant.solver, plant.rigs[0])


@pytest.mark.parametrize("name", LOADED)
def test_a_load_is_what_the_effect_of_a_payload_is(name):
    """For every body, joint by joint and all at once; no load leaves it as it is."""
    rig = load_rig(RIGS / f"{name}.yaml")
    plant = Plant([rig, rig], 0.5, fewest_cells=1)
    before = plant.solver.tiles[0][0].body.copy()
    loads, rng = loads_of(plant), np.random.default_rng(3)
    assert loads.joints == [j for j, (body, field) in joints(rig).items() if field in body.loaded]
    masses = rng.uniform(0.1, 2.0, (len(loads.joints), 2))
    far = rng.uniform(0.05, 0.6, masses.shape)
    every = [rig, rig]
    for n, place in enumerate(loads.joints):
        every = [with_payload(one, place, masses[n, k], far[n, k]) for k, one in enumerate(every)]
        alone = np.zeros_like(masses)
        alone[n] = masses[n]
        loads.set(alone, far)
        one = with_payload(rig, place, masses[n, 0], far[n, 0])
        known = Plant([one], 0.5, fewest_cells=1).solver.tiles[0][0].body[..., 0]
        np.testing.assert_allclose(plant.solver.tiles[0][0].body[..., 0], known, rtol=1e-9)
        assert not np.array_equal(known, before[..., 0])
    loads.set(masses, far)
    for k, one in enumerate(every):
        known = Plant([one], 0.5, fewest_cells=1).solver.tiles[0][0].body[..., 0]
        np.testing.assert_allclose(plant.solver.tiles[0][0].body[..., k], known, rtol=1e-9)
    loads.set(-masses, far)
    np.testing.assert_array_equal(plant.solver.tiles[0][0].body, before)


def test_only_what_turns_has_a_load_some_way_out():
    rig = load_rig(RIGS / "cart_pole.yaml")
    settings = ObserverSettings(load=Drift(std=0.1, time_s=20.0))
    drifts = Drifts(Plant([rig] * 4, 0.5, fewest_cells=1), settings, ())
    told = [u.name for u in drifts.unknowns if u.kind in ("load", "load_at")]
    slide, pole = joints(rig)
    assert told == [f"joints.{slide}: load", f"joints.{pole}: load", f"joints.{pole}: load's place"]


@pytest.mark.parametrize(
    ("mass_kg", "distance_m"),
    [(0.35, 0.12), pytest.param(0.15, 0.3, marks=pytest.mark.long), (0.0, 0.2)],
)
def test_a_load_that_was_taken_up_is_found(mass_kg, distance_m):
    """By the moment that it has about the joint; where there is none, none is."""
    rig = load_rig(RIGS / "kokoro_fitted.yaml")
    plant = Plant([with_payload(rig, "elbow", mass_kg, distance_m)], 0.12)
    rest = ("head_tube", "rod_tube", "forearm.head", "forearm.rod")
    plant.reset(dict.fromkeys(rest, 3.5e5))
    plant.place({"elbow": 0.1})
    used = ("head_port", "rod_port", "elbow")
    load = Drift(std=0.2, time_s=20.0)
    settings = ObserverSettings(dx_m=0.25, fewest_cells=1, members=32, load=load)
    observer, rng = Observer(rig, settings, used), np.random.default_rng(4)
    names, elbow = [*plant.plan.taps, *plant.plan.encoders], plant.joint_names.index("elbow")
    volts, goal = np.array([5.0, 5.0]), 0.3
    for k in range(300):
        goal = rng.uniform(-0.5, 0.5) if k % 25 == 0 else goal
        place, speed = plant.joints()[elbow, :, 0]
        read = dict(zip(names, plant.readings()[:, 0].tolist(), strict=True))
        read |= {tap: read[tap] + 250.0 * rng.standard_normal() for tap in used[:2]}
        read["elbow"] += 1e-3 * rng.standard_normal()
        if k == 0:
            observer.begin(read, dict(zip(plant.plan.commands, volts, strict=True)))
        else:
            observer.advance(np.repeat(volts[:, None], 5, axis=1), 0.002)
        observer.assimilate(read)
        u = float(np.clip(4.0 * (goal - place) - 0.3 * speed, -1.5, 1.5))
        volts = np.array([5.0 + u, 5.0 - u])
        plant.advance(np.repeat(volts[:, None], 5, axis=1)[None], 0.002)
    drifts = observer.drifts
    found = {u.kind: drifts.values[n] for n, u in enumerate(drifts.unknowns) if "load" in u.kind}
    mass = np.maximum(found["load"], 0.0)
    moment = (mass * (settings.load_at_m + found["load_at"])).mean()
    assert moment == pytest.approx(mass_kg * distance_m, abs=0.008)
