# SPDX-License-Identifier: Apache-2.0
"""Candidates fitted on longer cells, settled on the rig's own, and placed along a pipe."""

import numpy as np
import pytest
from tests.one_tap import one_tap

from pneu_sim.effects import find_effect
from pneu_sim.rig.schema import AttachedEffect, Rig
from pneu_sysid.bench import REFIT_CELLS
from pneu_sysid.candidates import Score, residual_matrix
from pneu_sysid.design.foreseen import foresee
from pneu_sysid.design.waves import STEP_S
from pneu_sysid.evidence import blocks_of
from pneu_sysid.problem import make_problem
from pneu_sysid.refits import Refit, refit, refit_effects, settled, well_placed
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
    # What is drawn of a candidate is how the readings change.
    for one in (found, there):
        on = longer if one is found else problem
        with_it, without = on.predict([one.rig, rig])
        change_pa = one.change.reshape(problem.measured.shape) * problem.noise_pa
        seen = np.isfinite(problem.measured)
        np.testing.assert_allclose(change_pa[seen], (with_it - without)[seen], atol=1.0)
    # An effect of a rig file may leave out what has a default; it is fitted and written all the
    # same, into another rig.
    short = AttachedEffect(effect="dead_volume", place="tube", parameters={"position_m": 0.9})
    given = rig.model_copy(update={"effects": [short]})
    fitted, estimate = refit_effects(problem, given, [0])
    found_there = fitted.effects[0].parameters
    assert [found_there[k] for k in ("volume_m3", "position_m")] == list(estimate.values)
    assert short.parameters == {"position_m": 0.9}
    assert squares(fitted) < 0.5 * squares(given)


def test_a_candidate_is_placed_without_what_its_cells_make_of_it() -> None:
    """Cells half as long, no noise: the place is that of the volume, or explains as much."""
    rig = one_tap(0.1)
    extra = AttachedEffect(
        effect="dead_volume", place="tube", parameters={"volume_m3": TRUE_M3, "position_m": 0.75}
    )
    grid = rig.grid.model_copy(update={"dx_m": 0.05})
    plant = rig.model_copy(update={"effects": [extra], "grid": grid})
    steps = np.random.default_rng(4).uniform(4.0, 6.0, 24)
    volts = {"voltage": np.repeat(steps, round(0.1 / STEP_S))}
    problem = make_problem(rig, foresee(plant, volts, 500.0).recording)
    base = residual_matrix(problem, problem.predict([rig])[0])
    effect = find_effect("dead_volume")
    site = Site(effect, "tube", {"position_m": 1.5})
    there = site.attached(rig, TRUE_M3)
    off = residual_matrix(problem, problem.predict([there])[0])
    found = Refit(site, TRUE_M3, 0.0, 0.0, 0.0, 0.0, 9.0, 0.0, off, base - off, there)
    blocks = blocks_of(problem, Thresholds().block)
    placed = well_placed(problem, found, blocks)

    def left(on: Rig) -> float:
        readings, wrong = problem.wrong_of_cells([on])
        return float(np.sum(residual_matrix(problem, (readings + wrong)[0]) ** 2))

    at = placed.rig.effects[-1].parameters["position_m"]
    assert at != 1.5 and left(placed.rig) < 0.5 * left(there)
    assert left(placed.rig) < 1.05 * left(rig.model_copy(update={"effects": [extra]}))
    # anywhere but near the ends it would do nearly as well
    assert placed.places_m is not None
    assert placed.places_m[0] <= min(at, 0.75) and placed.places_m[1] >= max(at, 0.75)
    # and so it is told
    there = settled(problem, base, placed)
    assert there.position_error_m == pytest.approx(np.diff(placed.places_m).item() / 2.0)
    # what has no place is left alone
    bare = Site(find_effect("sensor_lag"), "end", {})
    slow = Refit(bare, 0.01, 0.0, None, 0.0, 0.0, 9.0, 0.0, off, off, bare.attached(rig, 0.01))
    assert well_placed(problem, slow, blocks) is slow
