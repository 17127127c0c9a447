# SPDX-License-Identifier: Apache-2.0
"""Predictive control of a linear plant, where the best plan is known: Riccati, least squares, sums.

The plant has two states and one sample to a period. Costs, limits and improvements are those that
predictive controllers of rigs use.
"""

import math

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are
from scipy.optimize import minimize

from pneu_policy.control.horizon import Horizon
from pneu_policy.control.improve import (
    DAMPING,
    LARGE_V,
    UNTRIED,
    GaussNewton,
    PathIntegral,
    improvement,
)
from pneu_policy.control.predictive_settings import JointPredictiveSettings, PredictiveSettings
from pneu_policy.control.shooting import DIFFERENCES_V, cost, differences, steps_of

A = np.array([[0.9, 0.25], [-0.1, 0.8]])
B = np.array([0.3, 0.7])
C = np.array([2.0e3, -0.7e3])
NULL_V = 4.5
START = np.array([1.5, -0.8])


def settings(holds, **changes):
    plain = {
        "period_s": 0.02, "sample_s": 0.02, "holds": holds, "low_v": -80.0, "high_v": 90.0,
        "null_v": NULL_V, "smooth_pa_per_v": 650.0,
    }  # fmt: skip
    return PredictiveSettings(**{**plain, **changes})


class Linear(Horizon):
    """A linear plant in the place of a rig.

    Attributes:
        rolled: How often plans were tried.
        broken: Lanes whose roll-outs are not finite.
    """

    def __init__(self, s, lanes, gain=1.0):
        self.scale, self.weight = s.scale, s.weight
        self._s, self.lanes, self.knots = s, lanes, len(s.holds)
        self._held = np.repeat(np.arange(self.knots), s.holds)
        self._gain, self.rolled, self.broken = gain, 0, ()

    def roll(self, decided, plans):
        self.rolled += 1
        x = np.repeat(START[:, None], len(plans), axis=1)
        seen = []
        for volts in [*decided, *plans[:, self._held].T]:
            x = A @ x + np.outer(B, np.broadcast_to(volts - NULL_V, len(plans)))
            seen.append(self._gain * (C @ x))
        seen = np.array(seen)
        seen[-1, list(self.broken)] = math.nan
        return seen


def response(s, decided):
    """Readings of the plan that stays at zero volts, and their derivatives by each voltage."""
    periods = s.every + s.periods
    markov = [C @ np.linalg.matrix_power(A, k) @ B for k in range(periods)]
    free = np.array([C @ np.linalg.matrix_power(A, k + 1) @ START for k in range(periods)])
    volts = np.array([*decided, *np.zeros(s.periods)]) - NULL_V
    slope = np.zeros((periods, len(s.holds)))
    owner = [None] * s.every + [k for k, count in enumerate(s.holds) for _ in range(count)]
    for n in range(periods):
        for m in range(n + 1):
            free[n] += markov[n - m] * volts[m]
            if owner[m] is not None:
                slope[n, owner[m]] += markov[n - m]
    return free, slope


def best_plan(s, decided, target):
    """Minimum of all costs by least squares."""
    free, slope = response(s, decided)
    knots = len(s.holds)
    change = np.eye(knots) - np.eye(knots, k=-1)
    first = np.zeros(knots)
    first[0] = decided[-1]
    weight = s.smooth_pa_per_v / 1e3
    matrix = np.vstack([slope / 1e3, weight * change])
    right = np.concatenate([(target - free) / 1e3, weight * first])
    return np.linalg.lstsq(matrix, right, rcond=None)[0]


def converged(s, decided, target):
    way = GaussNewton(s)
    horizon = Linear(s, way.lanes)
    plan = np.full(len(s.holds), NULL_V)
    for _ in range(80):
        plan = way.better(horizon, plan, target, decided)
    return plan


def test_plans_converge_to_the_minimum_of_their_costs():
    s = settings((1, 2, 1, 3), every=2)
    target = np.random.default_rng(2).normal(4e3, 2e3, 9)
    decided = np.array([6.0, 3.2])
    assert converged(s, decided, target) == pytest.approx(best_plan(s, decided, target), abs=1e-6)


def test_the_first_move_of_a_long_plan_is_that_of_the_riccati_equation():
    """The state is that of the plant and the last voltage; the input is the change of voltage."""
    s = settings((1,) * 40)
    decided = np.array([6.2])
    plan = converged(s, decided, np.zeros(41))
    both = np.block([[A, B[:, None]], [np.zeros((1, 2)), np.eye(1)]])
    into = np.append(B, 1.0)[:, None]
    shown = np.append(C, 0.0)[None] / 1e3
    r = np.array([[0.65**2]])
    p = solve_discrete_are(both, into, shown.T @ shown, r)
    gain = np.linalg.solve(r + into.T @ p @ into, into.T @ p @ both)[0]
    state = both @ np.append(START, decided[0] - NULL_V)
    wanted = []
    for _ in range(6):
        move = -gain @ state
        state = both @ state + into[:, 0] * move
        wanted.append(NULL_V + state[2])
    assert plan[:6] == pytest.approx(wanted, abs=1e-4)
    assert np.ptp(wanted) > 0.5


@pytest.mark.parametrize("kind", [PredictiveSettings, JointPredictiveSettings])
def test_costs_are_sums_of_squares_with_their_weights(kind):
    joint = kind is JointPredictiveSettings
    s = kind(
        holds=(1, 2, 1),
        sample_s=0.01,
        **({"smooth_per_v": 0.007} if joint else {"smooth_pa_per_v": 300.0}),
    )
    unit = 0.01 if joint else 1e3
    rng = np.random.default_rng(3)
    error, plans = unit * rng.normal(size=(4, 5)), rng.normal(5.0, 2.0, (5, 3))
    found = Linear(s, 5).cost(error, plans, 6.5)
    for lane in range(5):
        squares = sum((float(e) / unit) ** 2 for e in error[:, lane])
        before = 6.5
        for volts in plans[lane]:
            squares += (0.7 if joint else 0.3) ** 2 * (float(volts) - before) ** 2
            before = float(volts)
        assert found[lane] == pytest.approx(squares, rel=1e-12)


def test_plans_are_held_within_range_and_rate():
    s = settings((1, 1, 2), low_v=2.0, high_v=9.0, most_rate_v_s=50.0)  # 1 V per period
    plans = np.array([[5.5, 7.0, 1.0], [-3.0, -3.0, 12.0], [8.0, 8.0, 8.2], [4.4, 4.4, 4.4]])
    wanted = [[5.5, 6.5, 5.5], [4.0, 3.0, 4.0], [6.0, 7.0, 8.0], [4.4, 4.4, 4.4]]
    assert Linear(s, 4).allowed(plans, 5.0) == pytest.approx(np.array(wanted))
    free = settings((1, 1, 2), low_v=2.0, high_v=9.0)
    assert Linear(free, 4).allowed(plans, 5.0) == pytest.approx(np.clip(plans, 2.0, 9.0))


@pytest.mark.parametrize("turn", range(5))
def test_differences_go_the_other_way_where_the_range_ends(turn):
    step = DIFFERENCES_V[turn % 4]
    low, high = 1.0, 8.0
    last = {0.1: 7.9, -0.1: 1.1, 0.3: 7.7, -0.3: 1.3}[step]  # from here it just fits
    plan = np.array([high, 4.0, low, last, last + math.copysign(1e-6, step)])
    plans, signed = differences(plan, turn, 8, low, high)
    assert signed == pytest.approx([-abs(step), step, abs(step), step, -step])
    for lane in range(8):
        moved = plan.copy()
        if 1 <= lane <= 5:
            moved[lane - 1] += signed[lane - 1]
        assert plans[lane] == pytest.approx(moved)


def linear_steps(plan, bounds, dampings):
    rng = np.random.default_rng(8)
    slope, at = rng.normal(size=(6, 3)) * 400.0, rng.normal(size=6) * 700.0
    signed = np.array([0.1, -0.3, 0.1])
    seen = np.column_stack([at, *(at + slope[:, k] * signed[k] for k in range(3)), at + 99.0])
    target = rng.normal(size=6) * 500.0
    found = steps_of(plan, seen, signed, target, 6.1, bounds, 0.35, dampings, 250.0)
    return found, slope / 250.0, (at - target) / 250.0


def squares(step, plan, slope, error, damping):
    """Costs after a step, and the damping term."""
    size = np.mean(np.sum(slope**2, axis=0))
    moved = np.diff(plan + step, prepend=6.1)
    return (
        np.sum((error + slope @ step) ** 2)
        + 0.35**2 * np.sum(moved**2)
        + damping * size * np.sum(step**2)
    )


@pytest.mark.parametrize("bounds", [(-90.0, 90.0), (4.0, 90.0), (-90.0, 4.9)])
def test_steps_are_damped_minima_within_their_bounds(bounds):
    plan, dampings = np.array([4.8, 5.6, 4.1]), (1e-4, 0.3, 2.0)
    (error, steps), slope, wanted_error = linear_steps(plan, bounds, dampings)
    assert error == pytest.approx(wanted_error)
    met = np.zeros(2, bool)
    for damping, step in zip(dampings, steps, strict=True):
        least = minimize(
            squares, np.zeros(3), (plan, slope, error, damping), method="L-BFGS-B",
            bounds=[(bounds[0] - p, bounds[1] - p) for p in plan],
            options={"ftol": 1e-15, "gtol": 1e-10},
        )  # fmt: skip
        assert step == pytest.approx(least.x, abs=2e-5)
        met |= [np.isclose(plan + step, bound).any() for bound in bounds]
    assert met.tolist() == [bounds[0] == 4.0, bounds[1] == 4.9]
    assert not np.allclose(steps[0], steps[1], atol=5e-3)


@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize(
    ("from_null", "threshold"), [(0.03, 0.1), (0.4, 0.4), (-0.4, 0.4), (3.0, LARGE_V)]
)
def test_a_step_beyond_what_a_linear_model_may_hold_is_tried(from_null, threshold, way):
    """A plan of one voltage: its step is a quotient."""
    s = settings((1,), smooth_pa_per_v=0.0)
    decided, plan = np.array([NULL_V]), np.array([NULL_V + from_null])
    free, slope = response(s, decided)
    at = free + slope[:, 0] * plan[0]
    for share, rolls in ((0.999, 1), (1.001, 2)):
        step = way * share * threshold
        improve = GaussNewton(s)
        horizon = Linear(s, improve.lanes)
        target = at + np.array([0.0, step * (1.0 + UNTRIED) * slope[1, 0]])
        found = improve.better(horizon, plan, target, decided)
        assert horizon.rolled == rolls
        # tried, the least damped step wins; untried, the one step is taken
        damped = step if rolls == 1 else step * (1.0 + UNTRIED) / (1.0 + DAMPING[0])
        assert found - plan == pytest.approx([damped], rel=1e-6)


def test_a_plan_stays_where_no_step_is_better():
    """Readings that fall where differences said they rise."""
    s = settings((1, 1), smooth_pa_per_v=10.0)
    improve = GaussNewton(s)

    class Kinked(Linear):
        def roll(self, decided, plans):
            seen = super().roll(decided, plans)
            return seen if self.rolled == 1 else seen + 1e6

    horizon, plan = Kinked(s, improve.lanes), np.array([5.0, 5.5])
    assert improve.better(horizon, plan, np.full(3, 3e4), np.array([5.0])) is plan
    assert horizon.rolled == 2
    horizon = Linear(s, improve.lanes)
    horizon.broken = (3,)
    assert improve.better(horizon, plan, np.full(3, 3e4), np.array([5.0])) is plan


def drawn_plan(s, rng, variance, plan, target, decided, broken, adapts):
    """Path integral written out: draws, mirror images, weights, mean, and variances learnt."""
    knots, weight = len(plan), s.smooth_pa_per_v / 1e3
    half = rng.standard_normal((s.plans // 2, knots))
    draws = [np.zeros(knots), *(half * np.sqrt(variance)), *(-half * np.sqrt(variance))][: s.plans]
    free, slope = response(s, decided)
    plans = [np.clip(plan + one, s.low_v, s.high_v) for one in draws]
    costs = []
    for one in plans:
        error = (free + slope @ one - target) / 1e3
        moved = np.diff(one, prepend=decided[-1])
        costs.append(float(error @ error + weight**2 * (moved @ moved)))
    kept = [n for n in range(s.plans) if n not in broken]
    width = s.temperature * np.std([costs[n] for n in kept])
    least = min(costs[n] for n in kept)
    weights = [math.exp(-(costs[n] - least) / width) for n in kept]
    total = sum(weights)
    mean = sum(w / total * plans[n] for w, n in zip(weights, kept, strict=True))
    if adapts:
        learnt = sum(w / total * (plans[n] - plan) ** 2 for w, n in zip(weights, kept, strict=True))
        variance = np.clip(
            0.9 * variance + 0.1 * learnt, (0.4 * s.spread_v) ** 2, (2.0 * s.spread_v) ** 2
        )
    return mean, variance


@pytest.mark.parametrize("method", ["mppi", "adaptive"])
@pytest.mark.parametrize(("plans", "broken", "high_v"), [(17, (), 6.0), (16, (5, 9), 900.0)])
def test_path_integrals_are_means_weighted_by_costs(method, plans, broken, high_v):
    """A target far away for a while, which widens the draws, then one that is near."""
    s = settings(
        (1, 2, 1), method=method, plans=plans, spread_v=0.7, temperature=0.3, high_v=high_v, every=2
    )
    way = improvement(s)
    assert isinstance(way, PathIntegral) and way.lanes == s.plans
    horizon = Linear(s, way.lanes)
    horizon.broken = broken
    decided, begun = np.array([7.9, 5.1]), np.array([4.4, 5.9, 5.0])
    near = np.array([2e3, 3e3, 1e3, 4e3, 2.5e3, 3e3])
    for _ in range(2):
        rng = np.random.default_rng([s.observer.seed, 9])
        variance, plan, wanted, widths = np.full(3, 0.49), begun, begun, []
        for n in range(110):
            target = near + 1e6 if n < 25 else near
            wanted, variance = drawn_plan(
                s, rng, variance, wanted, target, decided, broken, method == "adaptive"
            )
            plan = way.better(horizon, plan, target, decided)
            assert plan == pytest.approx(wanted, abs=1e-9)
            widths.append(np.sqrt(variance))
        way.reset()
    if method == "adaptive":
        assert np.min(widths) == pytest.approx(0.4 * 0.7)
        if high_v == 900.0:
            assert np.max(widths) == pytest.approx(2.0 * 0.7)
    horizon.broken = (0,)  # the plan itself
    assert way.better(horizon, plan, target, decided) is plan


def test_differences_take_turns():
    """Forth and back, near and far, and from the first on after a reset."""
    s = settings((1, 1))
    improve = GaussNewton(s)
    steps = []

    class Recording(Linear):
        def roll(self, decided, plans):
            if np.ptp(plans[3:]) == 0.0 and (plans[3] == plans[0]).all():
                steps.append(float(plans[1, 0] - plans[0, 0]))
            return super().roll(decided, plans)

    horizon, plan = Recording(s, improve.lanes), np.array([4.5, 4.5])
    for n in range(8):
        if n == 5:
            improve.reset()
        improve.better(horizon, plan, np.zeros(3), np.array([4.5]))
    assert steps == pytest.approx([*DIFFERENCES_V, *DIFFERENCES_V[:1], *DIFFERENCES_V[:3]])


def test_costs_of_shooting_are_those_of_the_horizon():
    error, plans = np.array([[1.0, -2.0], [0.5, 3.0]]), np.array([[4.0, 6.0], [7.0, 5.5]])
    wanted = [1.25 + 0.16 * (1.0 + 4.0), 13.0 + 0.16 * (4.0 + 2.25)]
    assert cost(error, plans, 5.0, 0.4) == pytest.approx(wanted)
