# SPDX-License-Identifier: Apache-2.0
"""Limits of spools that are none are given up again, those that are stay."""

import math
from pathlib import Path

import numpy as np
import pytest
from studies.synthetic import synthetic

from pneu_sim.rig import load_rig
from pneu_sim.rig.schema import FitParameter, Rig
from pneu_sysid.gauss_newton import Estimate
from pneu_sysid.parameters import calibrated_parameters, default_parameters, variables_of
from pneu_sysid.problem import Problem, make_problem
from pneu_sysid.records import Recording
from pneu_sysid.spool_starts import limits_missed, try_limits
from pneu_sysid.stages import take

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def rig() -> Rig:
    """Rig A on cheap cells."""
    rig = load_rig(ROOT / "rigs" / "rig_a_fitted.yaml")
    cheap = rig.grid.model_copy(update={"dx_m": 0.25, "memory": False})
    return rig.model_copy(update={"calibration": None, "grid": cheap})


def _estimated(
    rig: Rig, recording: Recording, parameters: list[FitParameter]
) -> tuple[Rig, Problem, Estimate]:
    """The rig after two steps, and what they were taken on."""
    problem = make_problem(rig, recording)
    used = np.ones(problem.stretches, dtype=bool)
    variables = variables_of(rig, parameters)
    centres = {(p.path, p.recording): v.value for p, v in zip(parameters, variables, strict=True)}
    after, estimate, _ = take(rig, problem, parameters, centres, used, 2, False)
    return after, problem, estimate


@pytest.mark.parametrize("reached", [0.85, pytest.param(0.75, marks=pytest.mark.long)])
def test_a_limit_that_is_hardly_reached_stays(rig: Rig, reached: float) -> None:
    """What would be left without it is not made good by moving it."""
    spool = rig.valves["valve"].spool
    assert spool.bandwidth_hz is not None
    spool.max_speed_v_s = None
    largest = 10.0 * (2.0 * math.pi * spool.bandwidth_hz) ** 2  # of a step of 10 V
    spool.max_acceleration_v_s2 = reached * largest
    recording = synthetic(rig, 3.0, 5, "limited")
    parameters = [p for p in calibrated_parameters(rig) if "spool" in p.path]
    assert any(p.path.endswith("max_acceleration_v_s2") for p in parameters)
    limited, problem, estimate = _estimated(rig, recording, parameters)
    used = np.ones(problem.stretches, dtype=bool)
    found, _ = try_limits(limited, problem, used, estimate, parameters)
    assert found.valves["valve"].spool.max_acceleration_v_s2 is not None
    # and one that was given up all the same is missed, one that is never reached is not
    free = limited.model_copy(deep=True)
    free.valves["valve"].spool.max_acceleration_v_s2 = None
    assert limits_missed(limited, free, problem, used)
    assert not limits_missed(free, limited, problem, used)
    wide = limited.model_copy(deep=True)
    wide.valves["valve"].spool.max_acceleration_v_s2 = 10.0 * largest
    assert not limits_missed(wide, free, problem, used)


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
    limited, problem, estimate = _estimated(wrong, recording, parameters)
    assert limited.valves["valve"].spool.max_acceleration_v_s2 is not None
    used = np.ones(problem.stretches, dtype=bool)
    found, changed = try_limits(limited, problem, used, estimate, parameters)
    assert changed
    now = found.valves["valve"].spool
    assert (now.max_acceleration_v_s2, now.max_speed_v_s) == (None, None)
    assert now.bandwidth_hz == pytest.approx(true.bandwidth_hz, rel=0.05)
    assert now.damping == pytest.approx(true.damping, rel=0.05)


@pytest.mark.parametrize("limited", [False, True])
def test_while_much_else_is_wrong_a_limit_has_to_explain_much_of_it(
    rig: Rig, limited: bool
) -> None:
    """One that is none does so a little, and what is fitted with it finds no way back."""
    spool = rig.valves["valve"].spool
    assert spool.bandwidth_hz is not None
    spool.max_speed_v_s = spool.max_acceleration_v_s2 = None
    wrong = rig.model_copy(deep=True)
    wrong.valves["valve"].spool.bandwidth_hz = 1.1 * spool.bandwidth_hz
    for pipe in wrong.pipes.values():
        pipe.area_m2 *= 1.03
    if limited:
        spool.max_speed_v_s = 0.3 * 10.0 * 2.0 * math.pi * spool.bandwidth_hz
    recording = synthetic(rig, 3.0, 5, "much else")
    parameters = [p for p in default_parameters(wrong) if p.path.endswith("spool.damping")]
    estimated, problem, estimate = _estimated(wrong, recording, parameters)
    used = np.ones(problem.stretches, dtype=bool)
    _, changed = try_limits(estimated, problem, used, estimate, parameters)
    assert changed == limited
