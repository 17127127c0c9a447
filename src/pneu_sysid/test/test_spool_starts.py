# SPDX-License-Identifier: Apache-2.0
"""Limits of spools that are none are given up again."""

import math
from pathlib import Path

import numpy as np
import pytest
from studies.synthetic import synthetic

from pneu_sim.rig import load_rig
from pneu_sim.rig.schema import FitParameter, Rig
from pneu_sysid.parameters import default_parameters, variables_of
from pneu_sysid.problem import make_problem
from pneu_sysid.spool_starts import try_limits
from pneu_sysid.stages import take

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def rig() -> Rig:
    """Rig A on cheap cells."""
    rig = load_rig(ROOT / "rigs" / "rig_a_fitted.yaml")
    cheap = rig.grid.model_copy(update={"dx_m": 0.25, "memory": False})
    return rig.model_copy(update={"calibration": None, "grid": cheap})


@pytest.mark.long
def test_a_limit_that_is_none_goes_and_the_bandwidth_comes_back(rig: Rig) -> None:
    recording = synthetic(rig, 3.0, 5, "unlimited")
    true = rig.valves["valve"].spool
    assert true.bandwidth_hz is not None
    wrong = rig.model_copy(deep=True)
    spool = wrong.valves["valve"].spool
    spool.bandwidth_hz = 1.5 * true.bandwidth_hz
    spool.max_acceleration_v_s2 = 0.5 * 5.0 * (2.0 * math.pi * spool.bandwidth_hz) ** 2
    parameters = [p for p in default_parameters(wrong) if "spool" in p.path]
    delay = FitParameter(path="valves.valve.spool.delay_s", lower=0.0, upper=0.02, std=1.5e-3)
    parameters.append(delay)
    problem = make_problem(wrong, recording)
    used = np.ones(problem.stretches, dtype=bool)
    variables = variables_of(wrong, parameters)
    centres = {(p.path, p.recording): v.value for p, v in zip(parameters, variables, strict=True)}
    limited, estimate, _ = take(wrong, problem, parameters, centres, used, 2, False)
    assert limited.valves["valve"].spool.max_acceleration_v_s2 is not None
    found, changed = try_limits(limited, problem, used, estimate, parameters)
    assert changed
    now = found.valves["valve"].spool
    assert (now.max_acceleration_v_s2, now.max_speed_v_s) == (None, None)
    assert now.bandwidth_hz == pytest.approx(true.bandwidth_hz, rel=0.05)
    assert now.damping == pytest.approx(true.damping, rel=0.05)
