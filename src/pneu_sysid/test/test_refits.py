# SPDX-License-Identifier: Apache-2.0
"""Candidates fitted on longer cells, and settled on the rig's own."""

import numpy as np
import pytest
from tests.one_tap import one_tap

from pneu_sim.effects import find_effect
from pneu_sim.rig.schema import AttachedEffect
from pneu_sysid.bench import REFIT_CELLS
from pneu_sysid.candidates import Score, residual_matrix
from pneu_sysid.design.foreseen import foresee
from pneu_sysid.design.waves import STEP_S
from pneu_sysid.problem import make_problem
from pneu_sysid.refits import refit, settled
from pneu_sysid.sites import Site
from pneu_sysid.thresholds import Thresholds

TRUE_M3 = 4e-7


def test_a_candidate_settles_on_the_cells_that_count() -> None:
    """A volume in a line: on longer cells it is found a little wrong, on the own ones it is not."""
    rig = one_tap(0.1)
    extra = AttachedEffect(
        effect="dead_volume", place="tube", parameters={"volume_m3": TRUE_M3, "position_m": 1.2}
    )
    steps = np.random.default_rng(4).uniform(4.0, 6.0, 24)
    volts = {"voltage": np.repeat(steps, round(0.1 / STEP_S))}
    recording = foresee(rig.model_copy(update={"effects": [extra]}), volts, 500.0).recording
    problem = make_problem(rig, recording)
    readings = problem.predict([rig])[0]
    base = residual_matrix(problem, readings)
    site = Site(find_effect("dead_volume"), "tube", {"position_m": 0.9})
    start = Score(site, 0.7 * TRUE_M3, 0.5, 10.0, base, base)
    longer = problem.coarsened(rig, REFIT_CELLS, readings)
    found = refit(longer, rig, base, start, Thresholds())
    there = settled(problem, base, found)

    def squares(on: object) -> float:
        y = problem.predict([on])[0]  # type: ignore[list-item]
        return float(np.sum(residual_matrix(problem, y) ** 2))

    assert squares(there.rig) < 0.5 * squares(found.rig)
    assert float(np.sum(there.residual**2)) == pytest.approx(squares(there.rig), rel=1e-9)
    assert abs(there.strength - TRUE_M3) < 0.5 * abs(found.strength - TRUE_M3)
    assert there.strength == pytest.approx(TRUE_M3, rel=2e-3)
    assert there.rig.effects[-1].parameters["position_m"] == there.site.shape["position_m"]
    used = ~problem.held_out
    share = 1.0 - np.sum(there.residual[used] ** 2) / np.sum(base[used] ** 2)
    assert there.explained == pytest.approx(share)
