# SPDX-License-Identifier: Apache-2.0
"""A fit of the scene as it is in a bad valley: no candidate is credited with leaving it."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from pneu_sysid.contacts import diagnose
from pneu_sysid.contacts.diagnose import diagnose_scene
from pneu_sysid.contacts.judge import Aside, Judge
from pneu_sysid.contacts.scene import (
    ForceSettings,
    KnotSettings,
    Loaded,
    NormSettings,
    Scene,
    SensorSettings,
    Value,
)
from pneu_sysid.contacts.together import SceneFit
from pneu_sysid.contacts.track import Series, Track
from pneu_sysid.contacts.trajectories import begun, smoothed

PENDULUM = """<mujoco><option timestep="0.0002" integrator="implicitfast"/>
<worldbody><body name="bob" pos="0 0 0.5"><joint name="hinge" axis="0 1 0" damping="0.05"/>
 <geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass=".5"/></body></worldbody>
<sensor><jointpos name="angle" joint="hinge"/></sensor></mujoco>"""
DAMPING = 0.05
"""N m s/rad, as the file has it."""
FAR = 0.005
"""Where the base is held, as by a valley it does not leave by itself."""


def pendulum(folder: Path) -> Loaded:
    (folder / "pendulum.xml").write_text(PENDULUM)
    scene = Scene(
        name="pendulum",
        mjcf="pendulum.xml",
        sensors={"angle": SensorSettings(columns=("a",), norm=NormSettings(std=1e-3))},
        forces={"hinge": ForceSettings(along=NormSettings(std=0.01))},
        values=(Value(effect="joint_damping", at="hinge"),),
        knots=KnotSettings(step_s=0.001),
        segment_s=0.5,
    )
    return Loaded(scene, folder)


def swung(loaded: Loaded, seed: int, seconds: float = 0.8, every: int = 20) -> Track:
    model = loaded.setup().spec.compile()
    data = mujoco.MjData(model)
    rng = np.random.default_rng(seed)
    data.qpos[0], data.qvel[0] = rng.uniform(0.4, 1.2), rng.uniform(-3.0, 3.0)
    n = round(seconds / (every * model.opt.timestep))
    read = np.empty((n, 1))
    for i in range(n):
        mujoco.mj_forward(model, data)
        read[i] = data.sensordata
        for _ in range(every):
            mujoco.mj_step(model, data)
    read += 1e-3 * rng.normal(size=read.shape)
    return Track(
        f"swing {seed}", {"angle": Series(np.arange(n) * every * model.opt.timestep, read)}, {}
    )


def _stuck(judge: Judge) -> tuple[SceneFit, Aside]:
    """The base held where its damping is a tenth of what it should be."""
    values = (Value(effect="joint_damping", at="hinge", value=FAR),)
    chains, q = begun(judge.loaded, judge.used, values, judge.physics)
    fit = judge._fitted(chains, q, values)
    chains, q, found = smoothed(judge.loaded, chains, values, q, judge.physics)
    x = np.array([fit.parameters[0].coordinate(FAR)])
    held = replace(fit, values=values, x=x, chains=chains, q=q, estimated=found)
    return held, judge.left(held)


@pytest.mark.long
def test_a_candidate_is_not_credited_with_leaving_a_bad_valley(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    loaded = pendulum(tmp_path)
    tracks = [swung(loaded, seed) for seed in range(8)]
    monkeypatch.setattr(Judge, "base", _stuck)
    found = diagnose_scene(loaded, tracks, finalists=2)
    assert found.verdict == "nothing_missing"
    assert found.base.told(0)[0] == pytest.approx(DAMPING, rel=0.05)
    monkeypatch.setattr(diagnose, "VALLEYS", 0)
    credited = diagnose_scene(loaded, tracks, finalists=1)
    assert credited.verdict == "effect"  # as it would be without another look
