# SPDX-License-Identifier: Apache-2.0
"""Candidates fitted on longer cells, settled on the rig's own, and placed along a pipe."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.one_tap import one_tap

from pneu_sim.effects import find_effect
from pneu_sim.effects.base import EffectParameter
from pneu_sim.rig import with_parameters
from pneu_sim.rig.schema import AttachedEffect, Rig
from pneu_sysid.along import positions
from pneu_sysid.bench import REFIT_CELLS
from pneu_sysid.candidates import Score, residual_matrix
from pneu_sysid.design.foreseen import foresee
from pneu_sysid.design.waves import STEP_S
from pneu_sysid.evidence import blocks_of
from pneu_sysid.gauss_newton import minimise
from pneu_sysid.problem import make_problem
from pneu_sysid.refits import (
    LADDER,
    Refit,
    _error_of_this_shape,
    _Residuals,
    _stronger,
    refit,
    refit_effects,
    settled,
    well_placed,
)
from pneu_sysid.sites import Site
from pneu_sysid.slopes import Variable
from pneu_sysid.thresholds import Thresholds

Floats = NDArray[np.float64]

TRUE_M3 = 4e-7


@pytest.mark.long
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

    # What is uncertain anyway is taken out of both, and of what is held out nothing is fitted.
    def project(r: Floats) -> Floats:
        return 0.5 * r

    again = settled(problem, base, found, project)
    on = problem.predict([again.rig])[0]
    np.testing.assert_allclose(again.residual, 0.5 * residual_matrix(problem, on), rtol=1e-9)
    np.testing.assert_allclose(again.change, 0.5 * base - again.residual, rtol=1e-9)
    held = problem.held_out
    share = 1.0 - 4.0 * np.sum(again.residual[held] ** 2) / np.sum(base[held] ** 2)
    assert again.held_out == pytest.approx(share)


@pytest.mark.long
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
    # What is uncertain anyway decides nothing.
    same = well_placed(problem, found, blocks, lambda r: 0.0 * r)
    assert same.rig is found.rig
    # and so it is told
    there = settled(problem, base, placed)
    assert there.position_error_m is not None
    assert there.position_error_m >= np.diff(placed.places_m).item() / 2.0
    # what has no place is left alone
    bare = Site(find_effect("sensor_lag"), "end", {})
    slow = Refit(bare, 0.01, 0.0, None, 0.0, 0.0, 9.0, 0.0, off, off, bare.attached(rig, 0.01))
    assert well_placed(problem, slow, blocks) is slow


def test_an_error_with_the_shape_as_found_is_that_of_a_known_shape() -> None:
    """The inverse of the information on the strength alone, as far as the shape is free."""
    rng = np.random.default_rng(8)
    a = rng.normal(size=(12, 30, 4))
    a[..., 1] += 0.9 * a[..., 0]
    a[..., 3] -= 0.5 * a[..., 0]
    y = rng.normal(size=(12, 30))
    variables = [Variable(f"x{k}", 0.1, -9.0, 9.0, 1e-3) for k in range(4)]
    found = minimise(lambda p: np.stack([y - a @ x for x in p]), variables)
    for free, seen, bound in (
        ([1, 2, 3], [], []), ([1, 2], [3], []), ([2], [1], [3]), ([], [1, 2, 3], []),
        ([], [], [1, 2, 3]),
    ):  # fmt: skip
        visible, at_bound = np.ones(4, dtype=bool), np.zeros(4, dtype=bool)
        visible[seen], at_bound[bound] = False, True
        given = replace(found, visible=visible, at_bound=at_bound)
        rest = np.linalg.inv(found.covariance[np.ix_([0, *free], [0, *free])])[0, 0] ** -0.5
        share = rest / float(np.sqrt(found.covariance[0, 0]))
        assert (share < 0.9) == (1 in free)
        assert _error_of_this_shape(given) == pytest.approx(found.std_errors[0] * share)
    # No less than a tenth of it is left, however much both go together.
    together = found.covariance.copy()
    together[0, 1] = together[1, 0] = np.sqrt(together[0, 0] * together[1, 1]) * (1.0 - 1e-9)
    sure = _error_of_this_shape(replace(found, covariance=together))
    assert sure == pytest.approx(0.1 * found.std_errors[0])
    unknown = replace(found, std_errors=np.full(4, np.inf))
    assert _error_of_this_shape(unknown) == np.inf


def test_far_larger_strengths_are_tried_either_way_within_bounds() -> None:
    found = minimise(
        lambda p: np.stack([np.array([[x[0] - 0.5, x[1] + 2.0]]) for x in p]),
        [Variable("strength", 0.3, -9.0, 99.0, 1e-3), Variable("place", 0.0, -9.0, 9.0, 1e-3)],
    )
    strength = EffectParameter("factor", "1", 1.5, 0.0, 99.0, 0.5, 1e-3)
    typical = abs(strength.typical - strength.absent)
    tried: list[list[float]] = []

    def residuals(points: Sequence[Floats]) -> Floats:
        tried.append([x[0] for x in points])
        assert all(x[1] == found.values[1] for x in points)
        return np.stack([np.array([[x[0] - 11.0]]) for x in points])

    limits = Variable("strength", 0.3, strength.absent - 4.0 * typical, 12.0, 1e-3)
    at = _stronger(residuals, found, limits, strength)
    ladder = [strength.absent + sign * f * typical for f in LADDER for sign in (1.0, -1.0)]
    wanted = list(dict.fromkeys(np.clip(ladder, limits.lower, limits.upper).tolist()))
    assert tried == [wanted] and strength.absent not in wanted
    assert at is not None and at[0] == min(wanted, key=lambda x: abs(x - 11.0))
    nowhere = replace(limits, lower=strength.absent, upper=strength.absent)
    assert _stronger(residuals, found, nowhere, strength) is None and len(tried) == 1


def test_a_residual_that_was_not_kept_is_computed_again() -> None:
    """The best four are kept; any other point is simulated once more."""
    rig = one_tap(0.5)
    volts = {"voltage": np.repeat([4.0, 6.0, 5.5, 4.5], round(0.4 / STEP_S))}
    problem = make_problem(rig, foresee(rig, volts, 500.0).recording)
    asked: list[Rig] = []

    def rig_of(x: Floats) -> Rig:
        asked.append(with_parameters(rig, {"taps.end.gain": float(x[0])}))
        return asked[-1]

    def project(r: Floats) -> Floats:
        return r - r.mean()

    residuals = _Residuals(problem, rig_of, project)
    points = [np.array([1.0 + 0.01 * k]) for k in range(7)]
    out = residuals(points)
    used = ~problem.held_out
    for k, known in ((0, True), (3, True), (6, False)):
        asked.clear()
        found = residuals.at(points[k])
        assert bool(asked) != known
        alone = with_parameters(rig, {"taps.end.gain": 1.0 + 0.01 * k})
        wanted = project(residual_matrix(problem, problem.predict([alone])[0]))
        np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(out[k], wanted[used], rtol=1e-9, atol=1e-9)


def test_a_better_place_along_a_pipe_is_found() -> None:
    """A leak that was fitted at the wrong end; there it would be of another strength."""
    rig = one_tap(0.25)
    leak = find_effect("leak")
    true = {"area_m2": 3e-8, "position_m": 0.2}
    steps = np.random.default_rng(4).uniform(4.0, 6.0, 12)
    volts = {"voltage": np.repeat(steps, round(0.1 / STEP_S))}
    plant = rig.model_copy(
        update={"effects": [AttachedEffect(effect="leak", place="tube", parameters=true)]}
    )
    problem = make_problem(rig, foresee(plant, volts, 500.0).recording)
    far = {"area_m2": 1.5e-8, "position_m": 1.4}
    wrong = rig.model_copy(
        update={"effects": [AttachedEffect(effect="leak", place="tube", parameters=far)]}
    )
    blocks = blocks_of(problem, Thresholds().block)
    found = positions(problem, wrong, 0, blocks, None)
    assert found.better is not None and wrong.effects[0].parameters == far
    placed = found.better.effects[0].parameters
    position = next(p for p in leak.fitted(rig, "tube") if p.name == "position_m")
    spots = np.linspace(*leak.limits(position, rig, "tube"), position.scanned)
    assert placed["position_m"] in spots and abs(placed["position_m"] - 0.2) < 0.4
    assert placed["area_m2"] == pytest.approx(3e-8, rel=0.15)
    # Where it is right, nowhere else is better.
    assert positions(problem, plant, 0, blocks, None).better is None
