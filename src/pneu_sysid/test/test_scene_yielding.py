# SPDX-License-Identifier: Apache-2.0
"""Tips that yield and links that bend: what their compliance would change, and that it is found."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from pneu_common.errors import InputError
from pneu_sysid.contacts.candidates import scored
from pneu_sysid.contacts.diagnose import candidates_of, diagnose_scene
from pneu_sysid.contacts.effects import find_scene_effect
from pneu_sysid.contacts.estimate import Problem, State
from pneu_sysid.contacts.knots import chain_of
from pneu_sysid.contacts.manifold import Floats
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
    load_scene,
    save_scene,
)
from pneu_sysid.contacts.springs import joint_name
from pneu_sysid.contacts.track import Series, Track
from pneu_sysid.contacts.trajectories import begun, smoothed
from pneu_sysid.contacts.yielding import yielding_column

ARM = """<mujoco><option timestep="0.0005" integrator="Euler"/>
<worldbody><body name="upper" pos="0 0 0.5"><joint name="shoulder" axis="0 1 0" damping="0.3"/>
 <geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass=".3" contype="0" conaffinity="0"/>
 <body name="hand" pos=".3 0 0">
  <geom name="ball" type="sphere" size=".03" pos=".1 0 0" mass=".4"/><site name="tip" pos=".1 0 0"/>
 </body></body></worldbody>
<actuator><motor name="drive" joint="shoulder"/></actuator>
<sensor><jointpos name="angle" joint="shoulder"/>
<framepos name="tip" objtype="site" objname="tip"/></sensor></mujoco>"""
"""An arm that holds its hand out: the hand's mount may bend, and its load is known."""

BEND = 0.05
"""rad/(N m)."""


def arm(folder: Path, values: tuple[Value, ...] = ()) -> Loaded:
    (folder / "arm.xml").write_text(ARM)
    scene = Scene(
        name="arm",
        mjcf="arm.xml",
        sensors={
            "angle": SensorSettings(columns=("a",), norm=NormSettings(std=2e-4)),
            "tip": SensorSettings(columns=("x", "y", "z"), norm=NormSettings(std=2e-4)),
        },
        controls={"drive": ControlSettings(column="u")},
        forces={"shoulder": ForceSettings(along=NormSettings(std=0.02))},
        values=values,
        knots=KnotSettings(step_s=0.001),
        segment_s=0.5,
    )
    return Loaded(scene, folder)


def swung(
    loaded: Loaded, values: tuple[Value, ...], seconds: float, seed: int, every: int = 10
) -> Track:
    """The arm driven, with what its sensors tell."""
    model = loaded.setup(values).spec.compile()
    data = mujoco.MjData(model)
    rng = np.random.default_rng(seed)
    n = round(seconds / (every * model.opt.timestep))
    t = np.arange(n) * every * model.opt.timestep
    hold = -0.5 * 0.3 * 0.3 * 9.81 - 0.4 * 0.4 * 9.81
    slow = 2.0 * np.pi * np.array([0.7, 1.3, 2.9])
    phase = rng.uniform(0.0, 6.0, 3)

    def drive(at: Floats) -> Floats:
        return np.asarray(hold + np.sin(np.multiply.outer(at, slow) + phase) @ [0.4, 0.5, 0.3])

    read = np.empty((n, 4))
    for _ in range(4000):  # it sags to where it is held
        data.ctrl[0] = hold
        mujoco.mj_step(model, data)
        data.qvel[:] *= 0.9
    for i in range(n):
        mujoco.mj_forward(model, data)
        read[i] = data.sensordata
        for part in range(every):
            data.ctrl[0] = drive(t[i] + part * model.opt.timestep)
            mujoco.mj_step(model, data)
    read += 1e-4 * rng.normal(size=read.shape)
    sensors = {"angle": Series(t, read[:, :1]), "tip": Series(t, read[:, 1:])}
    return Track("swung", sensors, {"drive": Series(t, drive(t)[:, None])})


def bent(value: float = BEND) -> tuple[Value, ...]:
    return (Value(effect="link_bend", at="hand.y", value=value),)


def test_a_bend_is_its_compliance_times_the_moment(tmp_path: Path) -> None:
    """Where the arm lies still: the hand's weight at 0.1 m from its mount, by hand."""
    loaded = arm(tmp_path)
    model = loaded.setup().spec.compile()
    n = 12
    t = np.arange(n) * 0.005
    still = np.zeros((n, 1))
    tip = np.tile([0.4, 0.0, 0.5], (n, 1))
    track = Track("still", {"angle": Series(t, still), "tip": Series(t, tip)}, {})
    chain = chain_of(loaded, track, model, 0.005)
    effect = find_scene_effect("link_bend")
    _, read = yielding_column(chain, still, loaded.setup(), effect, "hand.y", Physics(1))
    moment = 0.4 * 9.81 * 0.1
    assert read[3, 1:] == pytest.approx([0.0, 0.0, -0.1 * moment], rel=1e-4, abs=1e-7)
    sag, _ = yielding_column(chain, still, loaded.setup(), effect, "hand.y", Physics(1))
    # and the shoulder: the weight of the hand has less of a lever by its sag, to first order none
    assert abs(sag[3, 0]) < 1e-3 * moment
    tip_effect = find_scene_effect("springy_tip")
    _, read = yielding_column(chain, still, loaded.setup(), tip_effect, "hand.z", Physics(1))
    assert read[3, 1:] == pytest.approx([0.0, 0.0, -0.4 * 9.81], rel=1e-4, abs=1e-7)


@pytest.mark.long
def test_a_link_that_bends_scores_first(tmp_path: Path) -> None:
    loaded = arm(tmp_path)
    tracks = [swung(loaded, bent(), 1.0, seed) for seed in range(4)]
    physics = Physics()
    chains, q = begun(loaded, tracks, (), physics)
    chains, q, _ = smoothed(loaded, chains, (), q, physics)
    problem = Problem(loaded, chains, (), [], physics)
    state = State(q, np.zeros(0))
    scores = scored(problem, state, candidates_of(loaded, (), []))
    best = scores.scores[0]
    assert best.parameter.label == "link_bend@hand.y"
    assert best.step == pytest.approx(BEND, rel=0.03)


@pytest.mark.long
def test_a_link_that_bends_is_named_and_sized(tmp_path: Path) -> None:
    loaded = arm(tmp_path)
    tracks = [swung(loaded, bent(), 1.0, seed) for seed in range(4)]
    found = diagnose_scene(loaded, tracks, finalists=3)
    bend = found.finalists[0]
    assert found.verdict == "effect"
    assert bend.label == "link_bend@hand.y"
    assert bend.strength == pytest.approx(BEND, rel=0.03)
    save_scene(loaded, bend.fit.values, tmp_path / "found.yaml")
    again = load_scene(tmp_path / "found.yaml")
    name = joint_name("link_bend", "hand", 1)
    joint = again.setup(again.scene.values).spec.joint(name)
    assert float(joint.stiffness[0]) == pytest.approx(1.0 / bend.strength)


@pytest.mark.long
def test_where_nothing_bends_none_is_named(tmp_path: Path) -> None:
    loaded = arm(tmp_path)
    tracks = [swung(loaded, (), 1.0, seed) for seed in range(4, 8)]
    found = diagnose_scene(loaded, tracks, finalists=2)
    assert found.verdict == "nothing_missing"


@pytest.mark.long
def test_a_lag_of_a_sensor_faster_than_the_knots_is_named_and_sized(tmp_path: Path) -> None:
    loaded = arm(tmp_path)
    late = []
    for seed in range(4):
        track = swung(loaded, (), 1.0, seed, every=1)
        tip = track.sensors["tip"]
        late.append(
            replace(track, sensors=track.sensors | {"tip": Series(tip.time_s + 0.004, tip.values)})
        )
    found = diagnose_scene(loaded, late, finalists=3)
    best = found.finalists[0]
    assert found.verdict in ("effect", "ambiguous")
    assert best.label == "sensor_lag@tip"
    assert best.strength == pytest.approx(0.004, rel=0.05)


def test_a_compliance_to_fit_needs_a_start(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"link_bend@hand\.y: value is missing"):
        arm(tmp_path, (Value(effect="link_bend", at="hand.y"),))


def test_a_joint_that_is_added_is_weighed_as_the_scene_weighs_its_own(tmp_path: Path) -> None:
    """A bend like the shoulder, a tip that slides like its moment at a tenth of a metre."""
    for effect, share in (("link_bend", 1.0), ("springy_tip", 0.01)):
        loaded = arm(tmp_path, (Value(effect=effect, at="hand.y", value=1e-3),))
        model = loaded.setup(loaded.scene.values).spec.compile()
        added = model.joint(joint_name(effect, "hand", 1)).id
        theirs = loaded.scene.forces["shoulder"].along
        norm = loaded.forces_of(model, added).along
        assert theirs is not None and norm is not None
        assert norm.norm().weight == pytest.approx(share * theirs.norm().weight)
