# SPDX-License-Identifier: Apache-2.0
"""The estimator on problems whose answers linear algebra and statistics give beforehand."""

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from pneu_sysid import gauss_newton
from pneu_sysid.gauss_newton import minimise
from pneu_sysid.slopes import Residuals, Variable, jacobian, looked_along

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


def test_standard_errors_are_the_scatter_that_correlated_errors_make() -> None:
    """What a model is wrong by lasts a whole cluster: repeated draws scatter as the errors say."""
    clusters, samples, count = 25, 30, 6
    estimates, told = [], []
    for seed in range(150):
        rng = np.random.default_rng([7, seed])
        a = rng.normal(size=(clusters, 1, count)) + 0.3 * rng.normal(
            size=(clusters, samples, count)
        )
        lasting = 2.0 * rng.normal(size=(clusters, 1))
        y = a @ np.ones(count) + rng.normal(size=(clusters, samples)) + lasting
        variables = [Variable(f"x{k}", 0.5, -9.0, 9.0, 1e-3) for k in range(count)]
        found = minimise(linear(a, y), variables, iterations=3)
        estimates.append(found.values)
        told.append(found.std_errors)
    scatter = np.std(np.array(estimates), axis=0)
    mean = np.sqrt(np.mean(np.array(told) ** 2, axis=0))
    # the jackknife errs on the large side; of white noise they would be told five times too small
    assert (mean > 0.9 * scatter).all() and (mean < 1.7 * scatter).all()
    inside = np.abs(np.array(estimates) - 1.0) < 1.645 * np.array(told)
    assert 0.85 < inside.mean() < 0.98


def test_what_only_the_prior_says_is_as_uncertain_as_the_prior() -> None:
    rng = np.random.default_rng(8)
    a = np.concatenate([rng.normal(size=(CLUSTERS, SAMPLES, 1))] * 2, axis=-1)
    y = a @ np.array([0.5, 0.5]) + 3.0 * rng.normal(size=(CLUSTERS, 1))
    variables = [Variable(name, 0.4, -5.0, 5.0, 1e-3, std=0.3) for name in ("x", "y")]
    found = minimise(linear(a, y), variables)
    # the data tell the sum alone, so that each is known to 0.3 over the root of two
    np.testing.assert_allclose(found.std_errors, 0.3 / np.sqrt(2.0), rtol=0.15)


def test_what_is_left_out_is_predicted_by_the_rest() -> None:
    """The residual of a cluster at the estimate from the others, computed by fitting those."""
    truth = np.array([1.0, -2.0, 0.5])
    a, y = problem(9, truth)
    a, y = a[:6], y[:6]
    variables = [Variable(f"x{k}", 0.0, -10.0, 10.0, 1e-3) for k in range(3)]
    found = minimise(linear(a, y), variables)
    for left in range(6):
        rest = [k for k in range(6) if k != left]
        x = np.linalg.lstsq(a[rest].reshape(-1, 3), y[rest].ravel(), rcond=None)[0]
        np.testing.assert_allclose(found.left_out[left], y[left] - a[left] @ x, atol=1e-6)


def curved(points: Sequence[Floats]) -> Floats:
    """A curved valley: measured minus ``(x1 exp(t x2), x1 x2)``, least at (2, -1)."""
    t = np.linspace(0.0, 2.0, SAMPLES)
    y = np.tile(2.0 * np.exp(-t), (4, 1))
    return 100.0 * np.stack([y - x[0] * np.exp(t * x[1]) for x in points])


def test_secants_reach_the_same_with_fewer_jacobians() -> None:
    counts = {}
    for secants in (0, 3):
        asked = []

        def residuals(points: Sequence[Floats], asked: list[bool] = asked) -> Floats:
            apart = np.ptp(points, axis=0)  # a Jacobian's points are one step apart
            asked.append(bool(np.allclose(apart, 1e-6, rtol=1e-3, atol=0.0)))
            return curved(points)

        variables = [Variable("x1", 1.0, 0.1, 9.0, 1e-6), Variable("x2", -0.2, -5.0, 5.0, 1e-6)]
        found = minimise(residuals, variables, iterations=20, tolerance=1e-9, secants=secants)
        np.testing.assert_allclose(found.values, [2.0, -1.0], rtol=1e-4)
        counts[secants] = sum(asked)
    assert counts[3] < counts[0]


def valley(points: Sequence[Floats]) -> Floats:
    """Five decays whose sizes and rates only matter in combination; without noise."""
    t = np.linspace(0.0, 3.0, CLUSTERS * SAMPLES)
    truth = [*np.linspace(1.0, 2.0, 5), *np.log(np.geomspace(0.3, 6.0, 5))]

    def decays(x: Floats) -> Floats:
        return x[:5] @ np.exp(-np.exp(x[5:, None]) * t)

    y = decays(np.array(truth))
    return 1e4 * np.stack([(y - decays(np.asarray(x))).reshape(CLUSTERS, SAMPLES) for x in points])


def test_bent_steps_lead_down_a_valley_that_straight_ones_leave(monkeypatch) -> None:
    """Geodesic acceleration, against the same steps without it."""
    rng = np.random.default_rng(12)
    centre = np.array([*np.linspace(1.0, 2.0, 5), *np.log(np.geomspace(0.3, 6.0, 5))])
    start = centre + 0.3 * rng.normal(size=10)
    variables = [Variable(f"x{k}", x, x - 4.0, x + 4.0, 1e-6) for k, x in enumerate(start)]
    bent = minimise(valley, variables, iterations=6)
    monkeypatch.setattr(gauss_newton, "MOST_BENT", 0.0)
    straight = minimise(valley, variables, iterations=6)
    assert bent.cost < 0.1 * straight.cost


def test_what_is_yet_to_be_gained_is_told() -> None:
    truth = np.array([1.0, 2.0, 0.5])
    a, y = problem(10, truth)
    at_bound = Variable("z", 0.0, -9.0, 0.2, 1e-3)
    variables = [*(Variable(name, 0.0, -9.0, 9.0, 1e-3) for name in "xy"), at_bound]
    found = minimise(linear(a, y), variables, iterations=5)
    # the bound holds it up, and what lies beyond is not to be gained
    assert found.at_bound.tolist() == [False, False, True]
    assert found.ahead < 1e-6 * found.history[0]
    # a valley after one step: no less than the next step then gains
    start = [Variable("x1", 1.0, 0.1, 9.0, 1e-6), Variable("x2", -0.2, -5.0, 5.0, 1e-6)]
    once, twice = (minimise(curved, start, iterations=n, tolerance=0.0) for n in (1, 2))
    assert once.ahead > 0.2 * (once.cost - twice.cost) > 0.0


@pytest.mark.parametrize("stays", [(), (1,), (0, 2), (0, 1, 2)])
def test_variables_that_stay_leave_the_rest_to_the_others(stays: Sequence[int]) -> None:
    truth = np.array([1.0, -2.0, 0.5])
    a, y = problem(14, truth)
    a[..., 2] += 0.8 * a[..., 1]  # two that are much alike
    found = minimise(linear(a, y), [Variable(f"x{k}", 0.0, -10.0, 10.0, 1e-3) for k in range(3)])
    r = found.residual + a @ np.array([0.1, -0.3, 0.2])
    held = np.isin(np.arange(3), stays)
    expected = np.zeros(3)
    expected[~held] = np.linalg.lstsq(a.reshape(-1, 3)[:, ~held], r.ravel(), rcond=None)[0]
    np.testing.assert_allclose(-found.amounts(r[None], held)[0], expected, rtol=1e-6, atol=1e-9)


def test_a_jacobian_that_is_known_is_not_computed() -> None:
    a, y = problem(10, np.array([1.0, 2.0]))
    variables = [Variable(name, 0.0, -9.0, 9.0, 1e-3) for name in ("x", "y")]
    asked = []

    def residuals(points: Sequence[Floats]) -> Floats:
        asked.append(len(points))
        return linear(a, y)(points)

    known = minimise(residuals, variables, iterations=1, slope=-a)
    assert asked == [1, 2]
    np.testing.assert_allclose(known.values, minimise(linear(a, y), variables).values, rtol=1e-4)
    assert known.gained > 0.5


def test_what_is_known_at_a_point_is_not_computed_again() -> None:
    a, y = problem(11, np.array([1.0, 2.0]))
    variables = [Variable(name, 0.0, -9.0, 9.0, 1e-3) for name in ("x", "y")]
    asked = []

    def residuals(points: Sequence[Floats]) -> Floats:
        asked.append(len(points))
        return linear(a, y)(points)

    at = np.array([0.5, -0.5])
    r, slope = jacobian(residuals, at, variables)
    again, same = jacobian(residuals, at, variables, r)
    assert asked == [3, 2]
    np.testing.assert_array_equal(again, r)
    np.testing.assert_array_equal(same, slope)


SIZES = 12


def ratios(seed: int, step: float = 0.02) -> tuple[Residuals, list[Variable]]:
    """Readings that only ratios of sizes show, and sizes that begin a third too large, all of them.

    Differences are over steps so long that columns are wrong by as much.
    """
    rng = np.random.default_rng(seed)
    signal = rng.normal(size=(CLUSTERS, SAMPLES, SIZES)) * 1000.0
    noise = rng.normal(size=(CLUSTERS, SAMPLES))

    def predicted(x: Floats) -> Floats:
        return np.asarray(signal @ np.exp(x - np.roll(x, 1)))

    def residuals(points: Sequence[Floats]) -> Floats:
        return np.stack([predicted(np.zeros(SIZES)) + noise - predicted(x) for x in points])

    std = np.where(np.arange(SIZES) < 2, 0.02, 0.2)
    return residuals, [
        Variable(f"size{k}", 0.3, -2.0, 2.0, step, std=s, centre=0.0) for k, s in enumerate(std)
    ]


@pytest.mark.parametrize("along", [True, False])
def test_a_valley_is_gone_along_and_its_width_told(along: bool) -> None:
    """What is known beforehand of all sizes together holds them, as nothing else does."""
    residuals, variables = ratios(5)
    found = minimise(residuals, variables, secants=2, along=along)
    width = float(np.sum([v.std**-2 for v in variables]) ** -0.5)
    together = float(np.mean(found.values))
    error = float(np.sqrt(np.mean(found.covariance)))
    assert (abs(together) < 0.1 * width) == along
    assert (0.8 * width < error < 1.3 * width) == along


@pytest.mark.parametrize("seed", range(5, 15))
@pytest.mark.parametrize("step", [0.05, 0.08, 0.1])
def test_a_valley_is_gone_along_where_columns_are_wrong_by_up_to_a_tenth(
    step: float, seed: int
) -> None:
    """Taken for shown it was not gone along at all: all sizes stayed 21 widths off."""
    residuals, variables = ratios(seed, step)
    found = minimise(residuals, variables, secants=2, along=True)
    width = float(np.sum([v.std**-2 for v in variables]) ** -0.5)
    error = float(np.sqrt(np.mean(found.covariance)))
    assert abs(float(np.mean(found.values))) < 0.1 * width
    assert 0.95 * width < error < 1.05 * width


def test_what_is_shown_is_not_looked_along() -> None:
    """Where nothing cancels the Jacobian is as it was, and costs no more."""
    a, y = problem(6, np.array([1.0, -2.0, 0.5]))
    variables = [Variable(f"x{k}", 0.0, -10.0, 10.0, 1e-3, std=1.0) for k in range(3)]
    x = np.zeros(3)

    def never(points: Sequence[Floats]) -> Floats:
        raise AssertionError(f"{len(points)} runs")

    r, j = jacobian(linear(a, y), x, variables)
    assert looked_along(never, x, r, j, variables) is j


@pytest.mark.parametrize("seed", [0, 1, 2, 3])
def test_a_kink_does_not_hold_up_what_is_hardly_shown(seed: int) -> None:
    """Every damped step pays for it more than it gains; a part of the undamped one does not."""
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(CLUSTERS, SAMPLES, 10))
    a[..., 1] = a[..., 0] + 0.002 * rng.normal(size=(CLUSTERS, SAMPLES))  # their difference hides
    kink, noise = rng.normal(size=(2, CLUSTERS, SAMPLES))
    flat = np.concatenate([a, kink[..., None]], axis=-1).reshape(-1, 11)
    noise -= (flat @ np.linalg.lstsq(flat, noise.ravel(), rcond=None)[0]).reshape(noise.shape)

    def residuals(points: Sequence[Floats]) -> Floats:
        # on either side of the kink the last variable does worse; the slope says that one does not
        return np.stack([noise - 0.04 * kink - a @ x[:10] - abs(x[10]) * kink for x in points])

    off = np.array([8.0, -8.0, *np.zeros(9)])
    std = [4.0, 4.0, *[np.inf] * 9]
    variables = [
        Variable(f"x{k}", o, -10.0, 10.0, 1e-3, std=s, centre=0.0)
        for k, (o, s) in enumerate(zip(off, std, strict=True))
    ]
    found = minimise(residuals, variables, iterations=8, along=True)
    assert np.abs(found.values[:2]).max() < 0.1  # of the 8 that they were off
    assert abs(found.values[10]) < 0.001


def test_beside_a_kink_the_lesser_slope_counts_and_elsewhere_the_mean() -> None:
    """What lies beyond a kink says nothing of the way back from it."""

    def residuals(points: Sequence[Floats]) -> Floats:
        return np.array([[[1e3 * max(x[0], 0.0) + x[0], x[1] ** 2, x[0] - x[1]]] for x in points])

    variables = [Variable(name, 0.0, -1.0, 1.0, 1e-3) for name in ("stop", "bent")]
    _, j = jacobian(residuals, np.zeros(2), variables, both=True)
    assert j[0] == pytest.approx(np.array([[1.0, 0.0], [0.0, 0.0], [1.0, -1.0]]))
    _, j = jacobian(residuals, np.array([0.0, 1.0]), variables, both=True)  # at its bound
    assert j[0, 1, 1] == pytest.approx(2.0, abs=2e-3)


def test_a_secant_agrees_with_the_last_step_and_changes_nothing_across_it() -> None:
    """Broyden's condition, in variables whose spans differ."""
    rng = np.random.default_rng(6)
    j, change = rng.normal(size=(4, 7, 3)), rng.normal(size=(4, 7))
    span, step = np.array([0.5, 20.0, 3e-4]), np.array([0.3, -0.1, 0.7])
    across = np.cross(step, [1.0, 2.0, 3.0])
    found = gauss_newton._secant(j, change, step, span)
    np.testing.assert_allclose((found * span) @ step, change, rtol=1e-12)
    np.testing.assert_allclose((found * span) @ across, (j * span) @ across, rtol=1e-9)
