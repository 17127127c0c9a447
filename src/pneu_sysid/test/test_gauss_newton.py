# SPDX-License-Identifier: Apache-2.0
"""The estimator on problems whose answers linear algebra and statistics give beforehand."""

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from pneu_sysid.gauss_newton import Variable, minimise

Floats = NDArray[np.float64]

CLUSTERS, SAMPLES = 40, 25


def linear(a: Floats, y: Floats):
    """Residuals measured minus ``a x``, (clusters, samples, variables) and (clusters, samples)."""

    def residuals(points: Sequence[Floats]) -> Floats:
        return np.stack([y - a @ x for x in points])

    return residuals


def problem(seed: int, truth: Floats) -> tuple[Floats, Floats]:
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(CLUSTERS, SAMPLES, truth.size))
    return a, a @ truth + rng.normal(size=(CLUSTERS, SAMPLES))


def test_least_squares_and_its_standard_errors() -> None:
    truth = np.array([1.0, -2.0, 0.5])
    a, y = problem(1, truth)
    variables = [Variable(f"x{k}", 0.0, -10.0, 10.0, 1e-3) for k in range(3)]
    found = minimise(linear(a, y), variables)
    flat = a.reshape(-1, 3)
    expected = np.linalg.lstsq(flat, y.ravel(), rcond=None)[0]
    np.testing.assert_allclose(found.values, expected, rtol=1e-4)
    errors = np.sqrt(np.diag(np.linalg.inv(flat.T @ flat)))
    # the cluster estimate may exceed that of white noise, by chance, never fall below it
    assert (found.std_errors > 0.999 * errors).all()
    assert (found.std_errors < 1.4 * errors).all()
    assert found.visible.all() and not found.at_bound.any()


@pytest.mark.parametrize("seen", [0.0, 1e-14, 1e-9])
def test_what_the_data_do_not_show_leaves_the_others_alone(seen: float) -> None:
    """A variable that only rounding moves is not identified; the rest keep their errors."""
    truth = np.array([1.0, -2.0])
    a, y = problem(2, truth)
    blind = seen * np.random.default_rng(3).normal(size=(CLUSTERS, SAMPLES, 1))
    variables = [
        Variable("x", 0.0, -10.0, 10.0, 1e-3),
        Variable("y", 0.0, -10.0, 10.0, 1e-3),
        Variable("blind", 0.3, 0.0, 3.0, 0.05, std=0.5),
    ]
    alone = minimise(linear(a, y), variables[:2])
    found = minimise(linear(np.concatenate([a, blind], axis=-1), y), variables)
    np.testing.assert_allclose(found.values, [*alone.values, 0.3], rtol=1e-6)
    np.testing.assert_allclose(found.std_errors[:2], alone.std_errors, rtol=1e-6)
    assert list(found.visible) == [True, True, False]
    assert found.condition < 10.0
    assert (np.abs(found.correlation) <= 1.0 + 1e-9).all()


def test_bounds_hold_and_are_told() -> None:
    a, y = problem(4, np.array([3.0, 1.0]))
    variables = [Variable("x", 0.0, -1.0, 1.0, 1e-3), Variable("y", 0.0, -5.0, 5.0, 1e-3)]
    found = minimise(linear(a, y), variables)
    assert found.values[0] == pytest.approx(1.0)
    assert list(found.at_bound) == [True, False]


def test_a_prior_weighs_as_its_deviation_says() -> None:
    """Data and prior are two measurements: their mean is weighted by inverse variances."""
    rng = np.random.default_rng(5)
    a = np.ones((CLUSTERS, SAMPLES, 1))
    y = 1.0 + rng.normal(size=(CLUSTERS, SAMPLES))
    n = CLUSTERS * SAMPLES
    std = 1.0 / np.sqrt(n)  # as much as all the data tell
    found = minimise(linear(a, y), [Variable("x", 0.0, -5.0, 5.0, 1e-3, std=std)])
    # the estimator lets a prior meet the data's own scatter, which chance makes 1.0 to 1.3 here
    share = found.values[0] / y.mean()
    assert 0.35 < share < 0.51


def test_outliers_weigh_less_under_the_robust_loss() -> None:
    truth = np.array([2.0])
    a, y = problem(6, truth)
    y[::7, 3] += 60.0
    variables = [Variable("x", 0.0, -10.0, 10.0, 1e-3)]
    plain = minimise(linear(np.abs(a), y), variables).values[0]
    robust = minimise(linear(np.abs(a), y), variables, robust=True, iterations=30).values[0]
    clean = minimise(linear(np.abs(a), np.where(y > 40.0, np.abs(a) @ truth, y)), variables)
    assert abs(robust - clean.values[0]) < 0.3 * abs(plain - clean.values[0])
