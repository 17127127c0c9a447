# SPDX-License-Identifier: Apache-2.0
"""Numbers of what moves are such that fits find their way among them."""

from pathlib import Path

import numpy as np
import pytest
from studies.experiments import plants
from studies.experiments.calibrations import with_encoders
from tests.fit_jobs import job_of

from pneu_sim.bodies.kokoro import Kokoro
from pneu_sim.rig import load_rig
from pneu_sim.rig.parameters import get_parameter, with_parameters
from pneu_sim.rig.schema import Rig
from pneu_sysid.design.limits import limits_of
from pneu_sysid.fit import parameters_of
from pneu_sysid.fit_step import taken
from pneu_sysid.observed.noise import with_noise
from pneu_sysid.stages import Step

ROOT = Path(__file__).resolve().parents[3]
SLIDER = "bodies.arm.slider"
PIVOT, CRANK, CLOSED = (f"{SLIDER}.{name}_m" for name in ("pivot", "crank", "closed_length"))
GROW = (
    *("pivot_m", "crank_m", "inertia_kg_m2", "mass_kg", "theta.viscous"),
    *("stop_stiffness", "stop_damping", "area_m2", "conductance_m3_s_pa"),
)


def larger(rig: Rig, factor: float) -> Rig:
    """A joint with the same pressures and the same motion, but for friction: all of it is larger.

    Its linkage, what it turns, and all that fills the cylinder and flows grow by the factor. Of the
    cylinder that is so but for what the linkage, at its shortest, is longer than before.
    """
    cylinder, body = rig.cylinders["forearm"], rig.bodies["arm"]
    assert isinstance(body, Kokoro) and body.slider is not None
    closed_m, more = body.slider.closed_length_m, factor - 1.0
    head_m2, rod_m2 = cylinder.areas
    head, rod = cylinder.sides["head"], cylinder.sides["rod"]
    sizes = {
        p.path: factor * get_parameter(rig, p.path)
        for p in parameters_of(rig)
        if p.path.endswith(GROW)
    }
    base = "cylinders.forearm"
    sizes[f"{base}.head.dead_volume_m3"] = factor * head.dead_volume_m3 - head_m2 * closed_m * more
    sizes[f"{base}.rod.dead_volume_m3"] = factor * rod.dead_volume_m3 + rod_m2 * more * (
        closed_m + cylinder.stroke
    )
    return with_parameters(rig, sizes)


@pytest.mark.long
def test_a_joint_that_is_too_large_as_a_whole_comes_back() -> None:
    """What is known of its linkage says so, and its valley is straight enough to go along."""
    known = with_encoders(load_rig(ROOT / "rigs" / "rig_j.yaml"))
    known = with_noise(known, dict.fromkeys(known.taps, 250.0))
    volts = plants.random_volts(known, limits_of(known), 2.0, 1)
    recording = plants.record(known, volts, "short", 1)
    few = [p for p in parameters_of(known) if p.path.endswith((*GROW, "dead_volume_m3"))]
    step = Step("all", known.grid.dx_m, None, 4, along=True)
    job = job_of(known, recording, few, step)
    found = taken(job, larger(known, 1.015), step, few, None)
    errors = dict(zip([p.path for p in few], found.estimate.std_errors, strict=True))
    for path in (PIVOT, CRANK):
        off = np.log(get_parameter(found.rig, path) / get_parameter(known, path))
        assert abs(off) < 0.007  # of the 0.015 that it was off
        assert abs(off) < 3.0 * errors[path]


@pytest.mark.long
def test_a_piston_that_seems_to_meet_its_cover_does_not_bend_the_linkage() -> None:
    """In the file it is 0.3 mm beyond where the joint stops, in truth as much short of that."""
    rig = with_encoders(load_rig(ROOT / "rigs" / "rig_j.yaml"))
    rig = with_noise(rig, dict.fromkeys(rig.taps, 250.0))
    closed_m = get_parameter(rig, CLOSED)
    true = with_parameters(rig, {CLOSED: closed_m + 1.7e-3})
    known = with_parameters(rig, {CLOSED: closed_m + 2.3e-3})
    volts = plants.random_volts(true, limits_of(true), 2.0, 1)
    recording = plants.record(true, volts, "short", 1)
    told = (PIVOT, CRANK, CLOSED, "dead_volume_m3", "mass_kg", "theta_inertia_kg_m2")
    few = [p for p in parameters_of(known) if p.path.endswith(told)]
    step = Step("all", known.grid.dx_m, None, 6, along=True)
    found = taken(job_of(known, recording, few, step), known, step, few, None)
    errors = dict(zip([p.path for p in few], found.estimate.std_errors, strict=True))
    for path in (PIVOT, CRANK, CLOSED):
        off = np.log(get_parameter(found.rig, path) / get_parameter(true, path))
        assert abs(off) < 3.0 * errors[path], path
