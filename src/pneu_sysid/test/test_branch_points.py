# SPDX-License-Identifier: Apache-2.0
"""Piecewise functions at their branch points: value, slope, continuity, and what they add up to."""

import math
from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import quad
from scipy.spatial.transform import Rotation
from tests.pages import check, shown

from pneu_sim.rig.schema import FitParameter
from pneu_sysid import cells, encoder_check, gauss_newton, slopes, watch
from pneu_sysid.contacts import rollouts
from pneu_sysid.contacts.manifold import SMALL, cross_matrix, exponential, logarithm, turned_by
from pneu_sysid.contacts.norms import STEEPEST, Norm
from pneu_sysid.contacts.track import Series
from pneu_sysid.design import tracking, waves
from pneu_sysid.design.limits import Limits, slewed
from pneu_sysid.evidence import lead
from pneu_sysid.gross import ordinary
from pneu_sysid.records import Recording, Signal
from pneu_sysid.regimes import OPENING_EDGES, SHUT, WIDE_OPEN, _opening_sets, frequency_shares
from pneu_sysid.report import quantities
from pneu_sysid.scale import rescaled
from pneu_sysid.shift import FEWEST, estimate_shift

Floats = NDArray[np.float64]
NEAR = 1e-7


def slope(f: Callable[[float], float], at: float, h: float = 1e-5) -> float:
    return (f(at + h) - f(at - h)) / (2.0 * h)


def check_loss(
    cost: Callable[[float], float],
    weight: Callable[[float], float],
    influence: Callable[[float], float],
    branch: float,
    reach: float,
    scale: float = 1.0,
) -> None:
    """Assert that a loss, its weight and its influence are those of one function.

    Args:
        cost: The loss of one residual.
        weight: Its slope over the residual.
        influence: Its slope.
        branch: The residual at which another branch begins.
        reach: How far to look.
        scale: Slope over residual at zero.
    """
    assert cost(0.0) == 0.0
    points = [f * branch for f in (0.3, 0.999, 1.0, 1.001, 1.4)] + [reach]
    last = 0.0
    for r in points:
        for side in (r, -r):
            assert cost(side) == pytest.approx(cost(r), rel=1e-12)
            assert influence(side) == pytest.approx(side * weight(side), rel=1e-9)
            h = 1e-6 * max(1.0, r)
            if abs(r - branch) > 2.0 * h:  # away from where the curvature jumps
                assert slope(cost, side, h) == pytest.approx(influence(side), rel=1e-4)
            edges = [p for p in (branch,) if p < r]
            area = quad(
                influence, 0.0, side, points=[math.copysign(p, side) for p in edges] or None
            )
            assert cost(side) == pytest.approx(area[0], rel=1e-6)
        assert cost(r) > last  # it rises with the residual
        last = cost(r)
    for f in (cost, weight, influence):  # neither value nor slope of the cost jumps
        for side in (branch, -branch):
            inner, outer = f(side * (1.0 - NEAR)), f(side * (1.0 + NEAR))
            assert outer == pytest.approx(inner, rel=1e-4), f"{inner} and {outer} at {side}"
            assert f(side) == pytest.approx(inner, rel=1e-4)
    assert weight(0.1 * branch) == pytest.approx(scale, rel=0.02)


def one(f: Callable[[Floats], Floats]) -> Callable[[float], float]:
    return lambda r: float(np.ravel(f(np.array([r])))[0])


def test_robust_cost_and_weight_of_an_estimate() -> None:
    """The weights are square roots: a residual and its weight make the slope of the cost."""
    weight = one(lambda r: gauss_newton._weights(r, True) ** 2)
    cost = one(lambda r: np.array([gauss_newton._cost(r, True)]))
    width = gauss_newton.HUBER
    check_loss(cost, weight, lambda r: r * weight(r), width, 6.5 * width)
    assert cost(width) == pytest.approx(0.5 * width**2)
    assert cost(width + 4.0) - cost(width + 3.0) == pytest.approx(width)
    r = np.array([0.5, -2.0, 3.0, -7.5, 40.0])
    assert gauss_newton.huber_cost(r) == pytest.approx(sum(cost(float(x)) for x in r))
    assert gauss_newton._cost(r, False) == pytest.approx(0.5 * float(r @ r))
    assert (gauss_newton._weights(r, False) == 1.0).all()


def test_robust_loss_of_predictions() -> None:
    weight = one(rollouts.huber_weight)
    check_loss(one(rollouts.huber), weight, lambda r: r * weight(r), rollouts.HUBER, 30.0)


@pytest.mark.parametrize(("weight", "width"), [(0.7, 1.6), (3.0, 0.25)])
@pytest.mark.parametrize("kind", ["huber", "barrier", "square"])
def test_norms_of_residuals(kind: str, weight: float, width: float) -> None:
    norm = Norm(weight, kind, width)  # type: ignore[arg-type]
    branch = width * (math.sqrt(STEEPEST) if kind == "barrier" else 1.0)
    pull = one(norm.pull)
    if kind == "barrier":  # near zero it is a square; its weight is not constant up to the branch
        small = 1e-3 * width
        assert one(norm.cost)(small) == pytest.approx(weight * small**2, rel=1e-5)
        scale = pull(0.1 * branch)
    else:
        scale = 2.0 * weight
    check_loss(one(norm.cost), pull, one(norm.slope), branch, 1.8 * branch, scale)
    curvature = one(norm.curvature)
    for r in (0.0, 0.4 * branch, -0.9 * branch, 1.3 * branch, -2.0 * branch):
        assert curvature(r) > 0.0
        if abs(r) < branch:
            assert curvature(r) == pytest.approx(slope(one(norm.slope), r, 1e-6), rel=1e-4)


def test_a_prior_costs_half_a_squared_deviation(monkeypatch: pytest.MonkeyPatch) -> None:
    """With data that say nothing, the cost is that of the priors, on either side of the centre."""
    for value in (-1.2, 0.4, 2.5):
        v = [slopes.Variable("x", value, -5.0, 5.0, 1e-3, std=0.7, centre=0.4)]
        found = gauss_newton.minimise(lambda p: np.zeros((len(p), 2, 3)), v, iterations=1)
        assert found.history[0] == pytest.approx(0.5 * ((value - 0.4) / 0.7) ** 2)


@pytest.mark.parametrize("factor", [1e-3, 0.999, 1.001, 30.0, 3000.0, 15000.0])
def test_rotations_near_zero_and_at_the_branch_are_scipys(factor: float) -> None:
    axis = np.array([2.0, -3.0, 6.0]) / 7.0
    # the logarithm changes its form by the sine of half the angle
    for angle in (factor * SMALL, 2.0 * factor * SMALL):
        phi = angle * axis
        q = exponential(phi)
        wanted = Rotation.from_rotvec(phi).as_quat(scalar_first=True)
        np.testing.assert_allclose(q, wanted * np.sign(wanted[0]) * np.sign(q[0]), rtol=1e-12)
        np.testing.assert_allclose(logarithm(q), phi, rtol=1e-11)
        np.testing.assert_allclose(logarithm(-q), phi, rtol=1e-11)  # the same rotation


@pytest.mark.parametrize("angle", [0.0, 9.99e-3, 1.001e-2, 0.4, 2.9])
def test_turns_upon_turns_have_the_slope_of_scipys(angle: float) -> None:
    phi = angle * np.array([2.0, -3.0, 6.0]) / 7.0
    for k in range(3):
        d = 1e-6 * np.eye(3)[k]
        ends = [(Rotation.from_rotvec(phi) * Rotation.from_rotvec(s * d)).as_rotvec()
                for s in (1.0, -1.0)]  # fmt: skip
        wanted = (ends[0] - ends[1]) / 2e-6
        np.testing.assert_allclose(turned_by(phi)[:, k], wanted, atol=2e-9)


def test_turns_have_no_step_where_their_series_ends() -> None:
    axis = np.array([2.0, -3.0, 6.0]) / 7.0
    ends = (1e-2 * (1 - 1e-9), 1e-2 * (1 + 1e-9))
    inner, outer = (turned_by(angle * axis) for angle in ends)
    np.testing.assert_allclose(inner, outer, atol=1e-10)
    # what the square of the cross product is taken by, which is small beside the rest
    squares = [
        turned_by(angle * axis) - np.eye(3) - 0.5 * cross_matrix(angle * axis) for angle in ends
    ]
    np.testing.assert_allclose(*squares, rtol=1e-7)


def test_series_at_their_own_times_between_them_and_beyond() -> None:
    time = np.array([0.5, 1.0, 2.5, 3.0])
    values = np.array([[1.0, -2.0], [4.0, 0.5], [-1.0, 7.0], [2.5, 3.0]])
    series = Series(time, values)
    np.testing.assert_allclose(series.at(time), values)
    np.testing.assert_allclose(series.at(np.array([0.0, 9.0])), values[[0, -1]])
    np.testing.assert_allclose(series.at(np.array([1.75])), [[1.5, 3.75]])
    for k in range(4):
        for side in (-NEAR, NEAR):
            np.testing.assert_allclose(series.at(time[[k]] + side), values[[k]], atol=1e-5)
    turns = Rotation.from_rotvec([[0.1, 0.2, -0.3], [1.0, -0.4, 0.2], [2.0, 0.1, 0.0]])
    spun = Series(time[:3], turns.as_quat(scalar_first=True))
    back = Rotation.from_quat(spun.at(np.array([0.0, 0.5, 1.0, 2.5, 4.0]), True), scalar_first=True)
    wanted = turns[[0, 0, 1, 2, 2]]
    assert np.max((back.inv() * wanted).magnitude()) < 1e-12
    half = Rotation.from_quat(spun.at(np.array([0.75]), True), scalar_first=True)[0]
    whole = (turns[0].inv() * turns[1]).as_rotvec()
    np.testing.assert_allclose((turns[0].inv() * half).as_rotvec(), 0.5 * whole, atol=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_sweeps_and_targets_have_no_steps(seed: int) -> None:
    rng = np.random.default_rng(seed)
    samples = 4000
    sweep = waves._sweep(samples, rng)
    # up within at least two fifths of the piece, back by four fifths of the way
    assert np.max(np.abs(np.diff(sweep))) < 2.0 / (0.4 * (samples - 1)) * 1.001 or (
        np.sum(np.abs(np.diff(sweep)) > 2.0 / (0.4 * (samples - 1))) < 0.2 * samples
    )
    turn = int(np.argmax(np.abs(np.diff(np.sign(np.diff(sweep))))))
    assert abs(sweep[turn + 1] - sweep[turn]) < 0.1
    assert np.ptp(sweep[: turn + 1]) == pytest.approx(2.0 * np.max(np.abs(sweep)), rel=0.01)
    low, high = 1.5e5, 4.5e5
    for _ in range(6):
        target = tracking._target(samples, low, high, rng)
        assert low <= target.min() and target.max() <= high
        shortest = 0.5 * tracking.PERIOD_S[0]
        steepest = 0.5 * math.pi * (high - low) / shortest * waves.STEP_S
        assert np.max(np.abs(np.diff(target))) < 1.01 * steepest


def test_commands_change_no_faster_than_they_may() -> None:
    limits = Limits({"v": 0.0}, {"v": 10.0}, 50.0, 6e5, 0.0, {}, math.inf)
    asked = np.array([5.0, 5.05, 5.1, 9.0, 9.0, 9.0, 2.0, 2.0])
    out = slewed(asked, 0.002, limits)
    np.testing.assert_allclose(out, [5.0, 5.05, 5.1, 5.2, 5.3, 5.4, 5.3, 5.2])
    np.testing.assert_array_equal(slewed(out, 0.002, limits), out)
    just = np.array([1.0, 1.1, 1.0])
    np.testing.assert_allclose(slewed(just, 0.002, limits), just)
    np.testing.assert_allclose(slewed(np.array([1.0, 1.101, 1.0]), 0.002, limits), [1.0, 1.1, 1.0])


def test_a_kink_counts_by_its_lesser_slope_from_half_on() -> None:
    one_side = np.array([3.0, 4.0])
    for share, kinked in ((0.33, True), (0.34, False), (1.0, False), (-0.1, True)):
        # the mean is (1 + share) / 2 of the one, and a half of that is the threshold: one third
        found = slopes.slope_of_both(one_side, share * one_side)
        wanted = share * one_side if kinked else 0.5 * (1.0 + share) * one_side
        np.testing.assert_allclose(found, wanted)
        np.testing.assert_allclose(slopes.slope_of_both(share * one_side, one_side), wanted)
    np.testing.assert_array_equal(slopes.slope_of_both(one_side), one_side)


def test_a_cluster_left_out_counts_by_no_more_than_twice_the_usual() -> None:
    fitted = np.array([[3.0, 4.0], [0.6, 0.8], [0.0, 5.0]])
    usual = math.sqrt((25.0 + 1.0 + 25.0) / 3.0)
    most = gauss_newton.MOST_FORECAST * usual
    way = np.array([0.6, -0.8])
    for length in (0.5 * most, most * (1 - NEAR), most, most * (1 + NEAR), 9.0 * most):
        left = np.array([length * way, length * way, length * way])
        found = np.linalg.norm(gauss_newton._left_out(fitted, left), axis=1)
        np.testing.assert_allclose(found, min(length, most), rtol=1e-6)
    # one that is off by more where it was fitted keeps that
    wide = np.array([[300.0, 400.0], [0.6, 0.8], [0.0, 5.0], [1.0, 0.0], [1.0, 0.0]])
    found = gauss_newton._left_out(wide, 1e4 * np.tile(way, (5, 1)))
    assert np.linalg.norm(found[0]) == pytest.approx(500.0)


def test_a_bent_step_is_bent_by_no_more_than_it_may() -> None:
    matrix = np.array([[2.0, 0.3], [0.0, 1.5], [1.0, -1.0], [0.4, 0.2]])
    linear = gauss_newton._Linear.of(matrix, np.array([1.0, -2.0, 0.5, 0.3]), 4)
    step = np.array([0.4, -0.7])
    most = 0.5 * gauss_newton.MOST_BENT * float(np.linalg.norm(step * linear.size))
    bend = np.array([[0.3, 0.1, -0.2, 0.4]])
    # half the second derivative is taken away by a least-squares step
    plain = np.linalg.lstsq(matrix, -0.5 * bend.ravel(), rcond=None)[0]
    length = float(np.linalg.norm(plain * linear.size))
    for part in (0.5, 1 - NEAR, 1 + NEAR, 20.0):
        found = linear.bent(step, part * most / length * bend, 1e-14)
        wanted = min(part, 1.0) * most / length * plain
        np.testing.assert_allclose(found, wanted, rtol=1e-5)


def test_what_cells_get_wrong_saturates_without_a_step() -> None:
    """As an amount of it grows, its square is taken in full up to the bound, then linearly."""
    doubt = np.random.default_rng(3).normal(size=(4, 50, 1))
    total = float(np.sum(doubt**2))
    share = total / (1.0 + total)

    def error(amount: float) -> float:
        return float(cells.error_of_cells(amount / share * doubt, doubt)[0])

    m, n = cells.MOST, total / share**2
    for amount in (0.5, -1.2, m * (1 - NEAR), -m * (1 + NEAR), 1.5 * m, -4.0 * m):
        a = abs(amount)
        found = min(a, m) * share  # of an amount so much is taken off
        assert error(amount) == pytest.approx(n * (a**2 - (a - found) ** 2), rel=1e-5)
    assert error(0.0) == 0.0


def test_a_lead_has_no_step_where_two_models_are_equal() -> None:
    rng = np.random.default_rng(5)
    blocks = np.arange(200).reshape(2, 100) // 20
    a, b = rng.normal(size=(2, 2, 100))
    b *= np.linalg.norm(a) / np.linalg.norm(b)
    for part in (1e-6, -1e-6):
        assert lead((1.0 + part) * a, b, blocks) == pytest.approx(0.0, abs=1e-4)
        assert np.sign(lead((1.0 + part) * a, b, blocks)) == -np.sign(part)


@pytest.mark.parametrize("together", [-0.3, 0.1, 0.8])
def test_chance_is_by_what_the_better_model_leaves(together: float) -> None:
    """How its residual goes along with the difference, block by block, or as noise would."""
    rng = np.random.default_rng(6)
    blocks = np.arange(200).reshape(2, 100) // 20
    apart = rng.normal(size=(2, 100))
    left = rng.normal(size=(2, 100)) + together * apart
    gain = float(np.sum((left + apart) ** 2) - np.sum(left**2))
    along = [float(np.sum((left * apart)[blocks == b])) for b in range(10)]
    chance = 2.0 * math.sqrt(max(sum(x**2 for x in along), float(np.sum(apart**2))))
    assert gain > 0.0
    assert lead(left, left + apart, blocks) == pytest.approx(gain / chance)
    assert lead(left + apart, left, blocks) == pytest.approx(-gain / chance)
    doubtful = 0.5 * apart
    more = math.hypot(chance, 2.0 * float(np.sum(doubtful * apart)))
    assert lead(left, left + apart, blocks, doubtful) == pytest.approx(gain / more)


def test_readings_that_are_lost_count_alike_on_both_sides() -> None:
    """What is saturated keeps its sign: else a residual that falls would jump to its opposite."""
    wild = np.array([10.0, 3.0])
    left = np.array([[-1e9, -2.9], [-10.0 - NEAR, -3.0], [-10.0 + NEAR, 3.0], [9.0, 3.0 + NEAR]])
    found = ordinary.saturated(left, wild)
    np.testing.assert_allclose(
        found, [[-10.0, -2.9], [-10.0, -3.0], [-10.0, 3.0], [9.0, 3.0]], atol=2e-7
    )
    lost = ordinary.saturated(np.array([[math.nan, math.inf], [-math.inf, 1.0]]), wild)
    np.testing.assert_allclose(lost, [[10.0, 3.0], [-10.0, 1.0]])


@pytest.mark.parametrize(
    ("opening", "label"),
    [
        (0.0, "closed"), (SHUT - NEAR, "closed"), (SHUT + NEAR, "below 10 % open"),
        (0.1 - NEAR, "below 10 % open"), (0.1 + NEAR, "10-50 % open"), (0.5 - NEAR, "10-50 % open"),
        (0.5 + NEAR, WIDE_OPEN), (1.0, WIDE_OPEN),
    ],
)  # fmt: skip
def test_openings_are_in_one_band_each(opening: float, label: str) -> None:
    plan = SimpleNamespace(valves=["a", "b"], port_valve=[0, 1, 1])
    opened = [np.array([[0.7, 0.02, opening], [0.0, opening, 0.0]])]
    sets = [s for s in _opening_sets(plan, opened) if s.of == "b"]  # type: ignore[arg-type]
    # the widest port of a valve counts
    first = max(opening, 0.02)
    words = {s.label: s.masks[0].tolist() for s in sets}
    assert [label for label, mask in words.items() if mask[1]] == [f"b {label}"]
    assert sum(mask[0] for mask in words.values()) == 1
    inside = next(s for s in sets if s.masks[0][0])
    assert (inside.lower or 0.0) <= first <= (inside.upper or 1.0)
    edges = [edge for edge, _ in OPENING_EDGES]
    assert [s.lower for s in sets] == [0.0, *edges] and [s.upper for s in sets] == [*edges, None]


@pytest.mark.parametrize(
    ("hertz", "label"),
    [(2.0, "below 5 Hz"), (11.0, "5-20 Hz"), (41.0, "20-60 Hz"), (97.0, "60-150 Hz"),
     (210.0, "above 150 Hz")],
)  # fmt: skip
def test_a_wave_is_in_its_own_band_of_frequencies(hertz: float, label: str) -> None:
    time = np.arange(2000) / 500.0
    error = (3.0 * np.sin(2.0 * np.pi * hertz * time + 0.4))[None]
    bands = {b.label: b for b in frequency_shares(error, time[None])}
    assert bands[label].share > 0.95
    assert sum(b.share for b in bands.values()) == pytest.approx(1.0)
    assert sum(b.white for b in bands.values()) == pytest.approx(1.0)
    ends = [(b.low_hz, b.high_hz) for b in bands.values()]
    assert [low for low, _ in ends[1:]] == [high for _, high in ends[:-1]] and ends[-1][1] is None
    # white noise has a band's share of the width
    assert bands["20-60 Hz"].white == pytest.approx(40.0 / 250.0, abs=0.01)


def test_an_error_in_no_or_in_one_band_of_frequencies() -> None:
    """Too few readings have none; slow ones have a single one; no error has no share anywhere."""
    time = np.arange(2000) / 500.0
    lost = np.where(np.arange(2000) < 5, 1.0, np.nan)
    assert frequency_shares(lost[None], time[None]) == []
    slow = np.arange(40) / 8.0
    (band,) = frequency_shares(np.sin(2.0 * np.pi * 1.5 * slow)[None], slow[None])
    assert (band.label, band.low_hz, band.high_hz) == ("all frequencies", 0.0, None)
    assert (band.share, band.white) == (pytest.approx(1.0), pytest.approx(1.0))
    still = frequency_shares(np.zeros((1, 2000)), time[None])
    assert {b.share for b in still} == {0.0}
    assert sum(b.white for b in still) == pytest.approx(1.0)


@pytest.mark.parametrize("lag", [-0.0473, -0.0021, 0.0, 0.0137, 0.0486])
def test_a_shift_is_found_up_to_its_reach_with_its_sign(lag: float) -> None:
    ticks = np.arange(0.0, 4.0, 0.002)

    def wave(t: Floats) -> Floats:
        return np.asarray(2e4 * np.sin(5.0 * t) + 9e3 * np.sin(17.0 * t + 1.0))

    time = np.linspace(0.3, 3.5, 400)[None]
    noise = 20.0 * np.random.default_rng(1).normal(size=time.shape)
    measured = 5e4 + 1.3 * wave(time - lag) + noise
    none = np.zeros(1, dtype=np.int64)
    found = estimate_shift(measured, time, [(ticks, wave(ticks))], none)
    assert found is not None
    assert found.lag_s == pytest.approx(lag, abs=5.0 * found.std_error_s + 1e-6)
    assert found.gain == pytest.approx(1.3, rel=1e-3)


@pytest.mark.parametrize("readings", [FEWEST, FEWEST + 1])
def test_of_a_few_readings_no_shift_is_estimated(readings: int) -> None:
    ticks = np.arange(0.0, 4.0, 0.002)
    time = np.linspace(0.3, 3.5, readings)[None]
    none = np.zeros(1, dtype=np.int64)
    found = estimate_shift(np.sin(5.0 * time), time, [(ticks, np.sin(5.0 * ticks))], none)
    assert (found is not None) is (readings > FEWEST)


@pytest.mark.parametrize("lag", [-0.06, 0.056])
def test_a_shift_beyond_its_reach_is_none(lag: float) -> None:
    ticks = np.arange(0.0, 4.0, 0.002)
    time = np.linspace(0.3, 3.5, 400)[None]
    measured = np.sin(5.0 * (time - lag)) + np.sin(17.0 * (time - lag))
    given = [(ticks, np.sin(5.0 * ticks) + np.sin(17.0 * ticks))]
    assert estimate_shift(measured, time, given, np.zeros(1, dtype=np.int64)) is None


def test_no_shift_is_told_where_nothing_moves() -> None:
    """Too few readings, a prediction that stands still, or one that goes the other way."""
    ticks = np.arange(0.0, 4.0, 0.002)
    time = np.linspace(0.3, 3.5, 400)[None]
    none = np.zeros(1, dtype=np.int64)
    wave = np.sin(5.0 * ticks)
    measured = np.sin(5.0 * (time - 0.01))
    assert estimate_shift(measured, time, [(ticks, wave)], none) is not None
    few = np.where(np.arange(400) % 50 == 3, measured, np.nan)
    assert np.isfinite(few).sum() == 8
    assert estimate_shift(few, time, [(ticks, wave)], none) is None
    assert estimate_shift(measured, time, [(ticks, 0.0 * wave)], none) is None
    rising = 3.0 + 0.5 * time
    assert estimate_shift(rising, time, [(ticks, -0.5 * ticks)], none) is None


@pytest.mark.parametrize("step", [1, -1])
@pytest.mark.parametrize(("off", "jumps"), [(-0.99, 1), (-1.01, 0), (0.99, 1), (1.01, 0)])
def test_a_jump_of_about_a_turn_is_one(off: float, step: int, jumps: int) -> None:
    assert encoder_check.JUMP_RAD == 1.0
    values = np.array([0.3, 0.3, 0.3 + step * (encoder_check.TURN + off), 0.4])
    values[3] = values[2] + 0.1
    signal = Signal(np.arange(4) * 0.01, values)
    recording = Recording("run", {}, {}, encoders={"elbow": signal})
    found = encoder_check._unwrapped(recording, "elbow", signal, None)
    assert len(recording.report) == jumps
    change = np.diff(found.values)[1]
    wanted = step * off if jumps else step * (encoder_check.TURN + off)
    assert change == pytest.approx(wanted)


def test_a_level_changes_just_above_its_threshold_and_by_the_median() -> None:
    def window(times: float) -> watch.Window:
        none = np.zeros(1)
        return watch.Window(0.0, 1.0, ["end"], none, np.array([times]), none + 1.0, none + 1.0)

    for times, level in (
        (1.0, 0),
        (1.999, 0),
        (2.0, 0),
        (2.001, 1),
        (4.999, 1),
        (5.0, 1),
        (5.001, 2),
    ):
        verdict = watch.Verdict(2.0, 5.0, patience=3)
        for k, one_of in enumerate((times, times, times)):
            assert verdict.level == -1
            assert math.isnan(verdict.times_expected) == (k == 0)
            verdict.add(window(one_of))
        assert verdict.level == level, times
        # one window that is odd changes nothing, two do
        verdict.add(window(90.0))
        assert verdict.level == level
        verdict.add(window(math.nan))
        assert verdict.level == level
        verdict.add(window(90.0))
        assert verdict.level == 2


def test_a_rig_is_rescaled_within_its_bounds() -> None:
    fitted = [
        FitParameter(path="pipes.a.area_m2", lower=1e-6, upper=1e-4, log=True),
        FitParameter(path="chambers.c.volume_m3", lower=1e-4, upper=3e-4),
        FitParameter(path="reservoirs.s.droop_pa_s_per_kg", lower=1.0, upper=1e9, log=True),
        FitParameter(path="pipes.a.friction_gain", lower=0.1, upper=9.0, log=True),
    ]
    values = np.array([math.log(2e-5), 2e-4, math.log(3e4), math.log(2.0)])
    for shift in (-0.3, 0.0, 0.3):
        found = rescaled(fitted, values, shift)
        wanted = [math.log(2e-5) - shift, 2e-4 * math.exp(-shift), math.log(3e4) + shift,
                  math.log(2.0)]  # fmt: skip
        np.testing.assert_allclose(found, wanted)
    for shift, at in ((3.0, [1e-6, 1e-4]), (-3.0, [1e-4, 3e-4])):
        found = rescaled(fitted, values, shift)
        np.testing.assert_allclose([math.exp(found[0]), found[1]], at)


BRANCHES = [
    (quantities.number, (1e-3, 1e5, 9.995, 0.9995, 99.95), 1.0, 0.006),
    (quantities.percent, (0.0995, 0.1, 1.0), 100.0, 0.06),
    (quantities.times, (9.995, 99.95, 1.0), 1.0, 0.06),
    (quantities.kilopascal, (9999.5, 99995.0, 1000.0), 1e-3, 0.006),
    (quantities.milliseconds, (0.1, 0.0101), 1e3, 0.006),
]


@pytest.mark.parametrize(("write", "branches", "scale", "coarsest"), BRANCHES)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_numbers_are_written_right_on_both_sides_of_each_branch(
    write: Callable[[float], str],
    branches: tuple[float, ...],
    scale: float,
    coarsest: float,
    sign: float,
) -> None:
    for branch in branches:
        for side in (0.5, 1 - 1e-3, 1 - 1e-6, 1.0, 1 + 1e-6, 1 + 1e-3, 2.0):
            value = sign * branch * side
            check(write(value), scale * value, coarsest)
    assert shown(write(0.0))[0] == 0.0 and "−" not in write(0.0)
    assert write(None) == quantities.NONE  # type: ignore[arg-type]


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("side", [0.999, 1.0, 1.001])
def test_times_are_in_milliseconds_below_a_tenth_of_a_second(side: float, sign: float) -> None:
    value = sign * 0.1 * side
    text = quantities.with_error(value, 0.004, "s")
    scale = 1e3 if side < 1.0 else 1.0
    assert text.endswith(" ms" if side < 1.0 else " s")
    first, _, second = text.partition("±")
    check(first, scale * value)
    check(second, scale * 0.004)
