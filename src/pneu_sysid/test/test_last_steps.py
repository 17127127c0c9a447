# SPDX-License-Identifier: Apache-2.0
"""The last steps of a calibration lead out of where the steps before have ended by chance."""

from pathlib import Path

import numpy as np
import pytest
from studies.experiments import plants
from tests.fit_jobs import job_of

from pneu_sim.rig import load_rig
from pneu_sim.rig.parameters import get_parameter, with_parameters
from pneu_sysid.design.limits import limits_of
from pneu_sysid.fit import parameters_of
from pneu_sysid.fit_step import taken
from pneu_sysid.last_steps import FAR, ended
from pneu_sysid.observed.noise import with_noise
from pneu_sysid.stages import Step

ROOT = Path(__file__).resolve().parents[3]
VOLUME = "pipes.exhaust_tube.volume_from_m3"
PLACE = "taps.exhaust.position_m"
EXHAUST = "valves.valve.ports.exhaust.conductance_m3_s_pa"
VALLEY = {VOLUME: 4.7e-6, PLACE: 0.053, EXHAUST: 7e-9}
"""Where a fit of rig B's datasheet once ended: a volume that the port does not have looks like a
tap that is elsewhere."""


@pytest.mark.parametrize("there", [False, pytest.param(True, marks=pytest.mark.long)])
def test_what_is_far_off_is_looked_at_anew_from_where_it_was_known_to_be(there: bool) -> None:
    """It ends there if that is better; what really is far from what was known stays."""
    known = load_rig(ROOT / "rigs" / "rig_b.yaml")
    known.grid.dx_m, known.grid.memory = 0.25, False
    known = with_noise(known, dict.fromkeys(known.taps, 250.0))
    plant = with_parameters(known, VALLEY) if there else known
    volts = plants.random_volts(known, limits_of(known), 2.0, 52)
    recording = plants.record(plant, volts, "short", 1)
    few = [p for p in parameters_of(known) if p.path in VALLEY]
    (far,) = [p for p in few if p.path == VOLUME]
    assert far.std is not None
    step = Step("all", known.grid.dx_m, None, 4)
    job = job_of(known, recording, few, step)
    last = taken(job, with_parameters(known, VALLEY), step, few, None)
    assert get_parameter(last.rig, VOLUME) > FAR * far.std  # from where steps do not lead out
    end = ended(job, last, few)
    ends = get_parameter(last.rig, VOLUME) if there else 0.0
    assert get_parameter(end.rig, VOLUME) == pytest.approx(ends, abs=0.3 * far.std)
    true = get_parameter(plant, EXHAUST)
    assert get_parameter(end.rig, EXHAUST) == pytest.approx(true, rel=0.02)
    assert np.sum(end.estimate.residual**2) <= np.sum(last.estimate.residual**2)
