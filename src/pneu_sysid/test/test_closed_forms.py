# SPDX-License-Identifier: Apache-2.0
"""Estimates, covariances, priors and transforms against closed forms and scipy's solver."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares

from pneu_sim.rig import load_rig
from pneu_sim.rig.schema import FitParameter
from pneu_sysid.gauss_newton import Estimate, minimise
from pneu_sysid.nuisance import Nuisance
from pneu_sysid.parameters import (
    STEP_FRACTION,
    joined,
    one_each,
    rig_at,
    std_inside,
    value_of,
    variables_of,
)
from pneu_sysid.problem import Problem
from pneu_sysid.records import Recording
from pneu_sysid.slopes import Variable, jacobian
from pneu_sysid.uncertainty import known_of

Floats = NDArray[np.float64]
HOUSE = Path(__file__).parents[3]
CLUSTERS, SAMPLES, SIZE = 7, 30, 4
SEEDS = range(6)


class Linear:
    """A random linear problem with weights, priors and ties, all of different sizes.

    The noise is less than its unit, so that priors count as they stand.
    """

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng([11, seed])
        self.weight = rng.uniform(0.5, 2.5, size=(CLUSTERS, SAMPLES, 1))
        self.a = self.weight * rng.normal(size=(CLUSTERS, SAMPLES, SIZE))
        self.truth = np.array([1.3, -0.7, 4.0, -2.5])
        noise = 0.4 * self.weight[..., 0] * rng.normal(size=(CLUSTERS, SAMPLES))
        self.y = self.a @ self.truth + 0.1 * noise
        self.std = np.array([0.02, 0.5, math.inf, 0.03])
        self.centre = self.truth + np.array([0.05, -0.6, 9.0, -0.04])
        self.ties = (
            np.array([[30.0, 20.0, 0.0, 0.0], [0.0, 10.0, -15.0, 5.0]]),
            np.array([25.5, -79.0]),
        )
        self.variables = [
            Variable(f"x{k}", 0.5 * k, -20.0, 30.0 + k, 1e-3, std=float(s), centre=float(c))
            for k, (s, c) in enumerate(zip(self.std, self.centre, strict=True))
        ]

    def residuals(self, points: Sequence[Floats]) -> Floats:
        return np.stack([self.y - self.a @ x for x in points])

    @property
    def prior(self) -> Floats:
        return np.asarray(np.diag(self.std**-2.0) + self.ties[0].T @ self.ties[0])

    def solved(self, clusters: Sequence[int]) -> Floats:
        """The minimum over some clusters, by the normal equations."""
        a, y = self.a[clusters].reshape(-1, SIZE), self.y[clusters].ravel()
        tied, right = self.ties
        pull = np.where(np.isfinite(self.std), self.centre / self.std**2, 0.0)
        return np.linalg.solve(a.T @ a + self.prior, a.T @ y + pull + tied.T @ right)


def found_by(problem: Linear) -> Estimate:
    return minimise(
        problem.residuals, problem.variables, iterations=20, tolerance=1e-12, ties=problem.ties
    )


@pytest.mark.parametrize("seed", SEEDS)
def test_a_weighted_problem_with_priors_and_ties(seed: int) -> None:
    problem = Linear(seed)
    found = found_by(problem)
    whole = range(CLUSTERS)
    x = problem.solved(list(whole))
    assert found.weight == 1.0
    # priors and ties move every estimate by much more than the tolerance
    flat = problem.a.reshape(-1, SIZE)
    free = np.linalg.lstsq(flat, problem.y.ravel(), rcond=None)[0]
    assert (np.abs(x - free) > 1e-4).all()
    np.testing.assert_allclose(found.values, x, rtol=1e-7)
    r = problem.y - problem.a @ x
    np.testing.assert_allclose(found.residual, r, atol=1e-7)
    np.testing.assert_allclose(found.jacobian, -problem.a, atol=1e-5)
    apart = np.where(np.isfinite(problem.std), (x - problem.centre) / problem.std, 0.0)
    tied = problem.ties[0] @ x - problem.ties[1]
    cost = 0.5 * (float(np.sum(r**2)) + float(apart @ apart) + float(tied @ tied))
    assert found.cost == pytest.approx(cost, rel=1e-8)
    assert found.history[-1] == found.cost and found.history == sorted(found.history)[::-1]
    hessian = flat.T @ flat + problem.prior
    inverse = np.linalg.inv(hessian)
    np.testing.assert_allclose(found.gain, inverse, rtol=1e-6)
    scale = np.sqrt(np.diag(inverse))
    np.testing.assert_allclose(found.correlation, inverse / np.outer(scale, scale), atol=1e-6)
    size = np.sqrt(np.diag(hessian))
    values = np.linalg.eigvalsh(hessian / np.outer(size, size))
    assert found.condition == pytest.approx(math.sqrt(values[-1] / values[0]), rel=1e-6)
    assert found.visible.all() and not found.at_bound.any()
    start = problem.y - problem.a @ np.array([v.value for v in problem.variables])
    assert found.gained == pytest.approx(1.0 - float(np.sum(r**2) / np.sum(start**2)), abs=1e-9)
    # a cluster that is left out is predicted by a fit to the others, with the same priors
    moves = []
    for one in whole:
        other = problem.solved([k for k in whole if k != one])
        moves.append(other - x)
        left = problem.y[one] - problem.a[one] @ other
        limit = 2.0 * math.sqrt(float(np.mean(np.sum(r**2, axis=1))))
        if float(np.linalg.norm(left)) < limit:
            np.testing.assert_allclose(found.left_out[one], left, atol=1e-6)
    share = (CLUSTERS - 1) / CLUSTERS
    wanted = share * np.array(moves).T @ np.array(moves) + inverse @ problem.prior @ inverse
    np.testing.assert_allclose(found.covariance, wanted, rtol=1e-4, atol=1e-12)
    white = np.maximum(np.diag(wanted), np.diag(inverse))
    np.testing.assert_allclose(found.std_errors, np.sqrt(white), rtol=1e-4)


@pytest.mark.parametrize("seed", SEEDS)
def test_standard_errors_follow_the_noise(seed: int) -> None:
    """Of white noise of unit size they are those of the inverse of the normal equations."""
    rng = np.random.default_rng([12, seed])
    clusters = 60
    sizes = np.array([0.2, 1.0, 5.0])
    a = rng.normal(size=(clusters, 40, 3)) * sizes
    y = a @ np.array([2.0, -1.0, 0.3]) + rng.normal(size=(clusters, 40))
    variables = [Variable(f"x{k}", 0.0, -50.0, 50.0, 1e-3) for k in range(3)]
    found = minimise(lambda p: np.stack([y - a @ x for x in p]), variables, tolerance=1e-12)
    flat = a.reshape(-1, 3)
    errors = np.sqrt(np.diag(np.linalg.inv(flat.T @ flat)))
    np.testing.assert_allclose(found.std_errors, errors, rtol=0.35)
    assert (found.std_errors > 0.999 * errors).all()
    # with three times the noise, and as much of the data, three times the errors
    three = 3.0 * y - 2.0 * (a @ found.values)
    loud = minimise(lambda p: np.stack([three - a @ x for x in p]), variables, tolerance=1e-12)
    np.testing.assert_allclose(loud.values, found.values, rtol=1e-5)
    np.testing.assert_allclose(np.diag(loud.covariance), 9.0 * np.diag(found.covariance), rtol=1e-4)


def test_a_prior_weighs_less_than_data_that_scatter_more_than_noise() -> None:
    """Its weight is the scatter of the scores over that of white noise, the median over both."""
    rng = np.random.default_rng(3)
    clusters = 40
    a = rng.normal(size=(clusters, 1, 2)) * np.array([1.0, 3.0]) * np.ones((1, 25, 1))
    y = (
        a @ np.array([1.0, -2.0])
        + rng.normal(size=(clusters, 25))
        + 3.0 * rng.normal(size=(clusters, 1))
    )
    std = np.array([0.05, 0.02])
    variables = [Variable(f"x{k}", 0.0, -9.0, 9.0, 1e-3, std=float(std[k])) for k in range(2)]
    found = minimise(lambda p: np.stack([y - a @ x for x in p]), variables, tolerance=1e-12)
    flat = a.reshape(-1, 2)
    # what a step with the plain prior would leave
    first = np.linalg.solve(flat.T @ flat + np.diag(std**-2), flat.T @ y.ravel())
    r = y - a @ first
    scores = np.einsum("smp,sm->sp", a, r)
    scatter = np.sum((scores - scores.mean(axis=0)) ** 2, axis=0)
    wanted = math.sqrt(float(np.median(scatter / np.einsum("smp,smp->p", a, a))))
    assert wanted > 3.0
    assert found.weight == pytest.approx(wanted, rel=1e-3)
    prior = np.diag((wanted / std) ** 2)
    x = np.linalg.solve(flat.T @ flat + prior, flat.T @ y.ravel())
    np.testing.assert_allclose(found.values, x, rtol=1e-3)
    # errors that last are told by what leaving out clusters does, not by white noise
    assert (np.diag(found.covariance) > 2.0 * np.diag(found.gain)).all()
    np.testing.assert_allclose(found.std_errors, np.sqrt(np.diag(found.covariance)))


@pytest.mark.parametrize("robust", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_bounded_curved_problems_end_where_scipys_do(seed: int, robust: bool) -> None:
    rng = np.random.default_rng([13, seed])
    t = np.linspace(0.0, 3.0, 160).reshape(8, 20)
    truth = np.array([2.0, 0.8, -0.5])

    def model(x: Floats) -> Floats:
        return np.asarray(x[0] * np.exp(-x[1] * t) + x[2] * t)

    y = 20.0 * model(truth) + rng.normal(size=t.shape)
    if robust:
        y[::3, 4] += rng.uniform(8.0, 30.0) * rng.choice([-1.0, 1.0])

    def residual(x: Floats) -> Floats:
        return np.asarray(y - 20.0 * model(x))

    low, high = np.array([0.1, 0.1, -0.45]), np.array([9.0, 5.0, 1.0])
    variables = [
        Variable(f"x{k}", s, a, b, 1e-6)
        for k, (s, a, b) in enumerate(zip((1.0, 0.5, 0.1), low, high, strict=True))
    ]
    found = minimise(
        lambda p: np.stack([residual(x) for x in p]), variables, iterations=60, tolerance=1e-13,
        robust=robust,
    )  # fmt: skip
    best = least_squares(
        lambda x: residual(x).ravel(), [1.0, 0.5, 0.1], bounds=(low, high), xtol=1e-14, ftol=1e-14,
        gtol=1e-12, loss="huber" if robust else "linear", f_scale=3.0,
    )  # fmt: skip
    assert found.cost == pytest.approx(best.cost, rel=1e-6)
    np.testing.assert_allclose(found.values, best.x, rtol=2e-3)
    np.testing.assert_array_equal(found.at_bound, np.abs(best.x - low) < 1e-6)


def test_differences_stay_within_bounds_and_are_slopes() -> None:
    variables = [
        Variable("up", 0.5, 0.0, 1.0, 1e-4),
        Variable("at the top", 2.0, 0.0, 2.0, 2e-4),
        Variable("at the bottom", -1.0, -1.0, 5.0, 3e-4),
    ]
    x = np.array([v.value for v in variables])
    asked: list[Floats] = []

    def residuals(points: Sequence[Floats]) -> Floats:
        asked.extend(points)
        return np.stack([[[p[0] ** 2 * p[1], p[2] ** 3, p[0] - 4.0 * p[1]]] for p in points])

    wanted = np.array([[2.0 * 0.5 * 2.0, 0.25, 0.0], [0.0, 0.0, 3.0], [1.0, -4.0, 0.0]])
    for both, accuracy in ((False, 2e-3), (True, 1e-3)):
        asked.clear()
        r, j = jacobian(residuals, x, variables, both=both)
        np.testing.assert_allclose(r, [[0.5, -1.0, -7.5]])
        np.testing.assert_allclose(j[0], wanted, atol=accuracy)
        for point in asked:
            assert all(v.lower <= p <= v.upper for p, v in zip(point, variables, strict=True))
        assert len(asked) == (5 if both else 4)
    # to both sides the slope of a square is exact
    assert j[0, 0, 0] == pytest.approx(2.0, abs=1e-9)


def test_nuisance_is_taken_out_by_ridge_regression_learnt_on_what_is_used() -> None:
    rng = np.random.default_rng(5)
    change = rng.normal(size=(6, 20, 3)) * np.array([0.3, 2.0, 9.0])
    used = np.array([True, True, False, True, False, True])
    r = rng.normal(size=(6, 20)) + change @ np.array([2.0, -1.0, 0.4])
    found = Nuisance(change).without(used)(r)
    a, y = change[used].reshape(-1, 3), r[used].ravel()
    rows = np.vstack([a, np.eye(3)])
    amount = np.linalg.lstsq(rows, np.concatenate([y, np.zeros(3)]), rcond=None)[0]
    np.testing.assert_allclose(found, r - change @ amount, atol=1e-10)


# ---- Parameters as they are estimated


PARAMETERS = [
    FitParameter(path="pipes.tube.area_m2", lower=1e-6, upper=1e-4, std=3e-6, log=True),
    FitParameter(path="ambient.temperature_k", lower=250.0, upper=350.0, std=2.5),
    FitParameter(path="reservoirs.supply.pressure_pa", lower=1e5, upper=2e6, each=True, std=7e3),
    FitParameter(path="chambers.bottle.volume_m3", lower=1e-5, upper=1e-2, log=True),
]


def test_parameters_are_estimated_as_their_logarithms_where_they_are_logarithmic() -> None:
    rig = load_rig(HOUSE / "rigs" / "rig_a.yaml")
    known = [p for p in PARAMETERS if not p.path.startswith("chambers")]
    parameters = one_each(known, ["first", "second"])
    assert [p.recording for p in parameters] == [None, None, "first", "second"]
    variables = variables_of(rig, parameters)
    for p, v in zip(parameters, variables, strict=True):
        value = value_of(rig, p)
        own = math.log if p.log else float
        assert v.value == pytest.approx(own(value))
        assert (v.lower, v.upper) == pytest.approx((own(p.lower), own(p.upper)))
        assert p.std is not None
        # the deviation of a logarithm is relative
        assert v.std == pytest.approx(p.std / value if p.log else p.std)
        width = 1.0 if p.log else p.upper - p.lower
        assert v.step == pytest.approx(STEP_FRACTION * width)
    x = np.array([math.log(3.3e-5), 288.5, 6.2e5, 7.4e5])
    moved = rig_at(rig, parameters, x)
    assert moved.pipes["tube"].area_m2 == pytest.approx(3.3e-5)
    assert moved.ambient.temperature_k == pytest.approx(288.5)
    supply = "reservoirs.supply.pressure_pa"
    assert moved.recordings["first"][supply] == pytest.approx(6.2e5)
    assert moved.recordings["second"][supply] == pytest.approx(7.4e5)
    # a recording that was not fitted has the mean of those that were
    assert moved.reservoirs["supply"].pressure_pa == pytest.approx(6.8e5)
    again = [v.value for v in variables_of(moved, parameters)]
    np.testing.assert_allclose(again, x)
    assert rig.pipes["tube"].area_m2 != moved.pipes["tube"].area_m2


def test_a_start_beyond_its_bounds_is_brought_to_them() -> None:
    rig = load_rig(HOUSE / "rigs" / "rig_a.yaml")
    value = rig.pipes["tube"].area_m2
    for low, high, wanted in ((2.0, 5.0, 2.0), (0.1, 0.5, 0.5)):
        for log in (False, True):
            p = FitParameter(
                path="pipes.tube.area_m2", lower=low * value, upper=high * value, log=log
            )
            (v,) = variables_of(rig, [p])
            found = math.exp(v.value) if log else v.value
            assert found == pytest.approx(wanted * value)
    assert std_inside(PARAMETERS[3], -5.0) == math.inf


def test_parameters_of_several_recordings_are_listed_once_with_the_largest_error() -> None:
    fitted = one_each(PARAMETERS[2:3], ["a", "b", "c"])
    errors = (120.0, None, 410.0)
    fitted = [p.model_copy(update={"std_error": e}) for p, e in zip(fitted, errors, strict=True)]
    fitted.append(PARAMETERS[0].model_copy(update={"std_error": 2e-7}))
    supply, area = joined(fitted)
    assert (supply.recording, supply.std_error) == (None, 410.0)
    assert area.std_error == 2e-7


def test_errors_of_parameters_in_their_own_units() -> None:
    """Relative errors of logarithms times the value; what is held adds its own doubt."""
    problem = Linear(3)
    found = found_by(problem)
    paths = ("a", "b", "c", "d")
    fitted = [
        FitParameter(path=path, lower=1e-3, upper=1e9, log=k in (0, 2))
        for k, path in enumerate(paths)
    ]
    extra = FitParameter(path="held", lower=0.0, upper=1.0)
    measured = FitParameter(path="spool", lower=0.0, upper=1.0)
    blind = FitParameter(path="blind", lower=0.0, upper=1.0)
    every = [extra, *fitted[::-1], measured, blind]
    change = np.random.default_rng(4).normal(size=(2, CLUSTERS, SAMPLES)) * np.array(
        [0.2, 3.0]
    ).reshape(2, 1, 1)
    known = known_of(every, fitted, found, ["held"], change, {"spool": 0.013, "blind": None})
    moved = [found.gain @ np.einsum("smp,sm->p", found.jacobian, c) for c in change]
    variance = found.std_errors**2 + moved[0] ** 2 + moved[1] ** 2
    assert (np.abs(moved[1]) > 0.05 * found.std_errors).all()
    for k, path in enumerate(paths):
        at = [p.path for p in every].index(path)
        value = math.exp(found.values[k]) if k in (0, 2) else 1.0
        assert known.std_errors[at] == pytest.approx(value * math.sqrt(variance[k]))
        assert known.seen[at] and not known.held[at]
        for j, other in enumerate(paths):
            there = [p.path for p in every].index(other)
            assert known.correlation[at, there] == pytest.approx(found.correlation[k, j])
    assert known.held.tolist() == [True, *[False] * 6]
    assert known.std_errors[5] == 0.013 and known.std_errors[6] == math.inf
    assert known.seen.tolist() == [False, True, True, True, True, True, True]


# ---- What is held out


def problem_of(stretches: int, recordings: int = 1) -> Problem:
    return Problem(
        recordings=[Recording(f"run {k}", {}, {}) for k in range(recordings)],
        taps=["end"],
        time_s=np.zeros((stretches, 5, 1)),
        measured=np.zeros((stretches, 5, 1)),
        noise_pa=np.ones(1),
        noise_words={},
        of=np.arange(stretches) * recordings // stretches,
        span_s=np.zeros((stretches, 2)),
        pull_s=None,
    )


def test_every_third_stretch_is_held_out_or_every_third_recording() -> None:
    assert np.flatnonzero(problem_of(8).held_out).tolist() == [2, 5]
    assert np.flatnonzero(problem_of(8, 2).held_out).tolist() == [2, 5]
    several = problem_of(12, 6)
    assert np.flatnonzero(several.held_out).tolist() == [4, 5, 10, 11]
    assert several.of[several.held_out].tolist() == [2, 2, 5, 5]


def test_of_three_stretches_the_middle_one_by_its_error_is_held_out() -> None:
    problem = problem_of(7)
    problem.measured[3, 2:] = np.nan  # errors are means over what was read
    sizes = np.array([5.0, 1.0, 8.0, 3.0, 9.0, 2.0, 4.0])
    r = np.tile(sizes[:, None], (1, 5))
    r[3] = [sizes[3], sizes[3], 0.0, 0.0, 0.0]
    # in order: 9 8 5 | 4 3 2 | 1
    assert np.flatnonzero(problem.keeping_alike(r).held_out).tolist() == [2, 3]
    chosen = np.array([True, False, False, False, False, False, True])
    problem.aside = chosen
    assert problem.keeping_alike(r).held_out is chosen
    groups = problem_of(8, 4)
    r = np.repeat(np.array([2.0, 9.0, 5.0, 1.0]), 2)[:, None] * np.ones((8, 5))
    found = groups.keeping_alike(r)
    assert sorted(set(found.of[found.held_out].tolist())) == [2]
