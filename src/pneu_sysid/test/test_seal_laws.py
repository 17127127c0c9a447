# SPDX-License-Identifier: Apache-2.0
"""Friction laws and their estimate against the textbook's sums, on pieces made by hand."""

import functools
from dataclasses import astuple, replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pneu_sim.rig.cylinder import Friction
from pneu_sysid.seals.cells import Level, Pieces, Readings
from pneu_sysid.seals.estimate import (
    Scatter,
    Whitened,
    predicted,
    scatter_of,
    smooth,
)
from pneu_sysid.seals.laws import (
    FIELDS,
    SHORT,
    TITLES,
    UNITS,
    Range,
    Term,
    column,
    combinations_of,
    range_of,
    stribeck_speeds,
)

Floats = NDArray[np.float64]

STRIBECK_M_S = 0.02
SCATTER = Scatter(0.4, 0.3, 0.5, 0.2, 0.35, 0.25, 0.15, 0.1)
LAW: tuple[Term, ...] = ("constant", "pressure", "viscous", "breakaway")
STRENGTH: dict[Term, float] = {
    "constant": 6.0,
    "pressure": 3e-5,
    "viscous": 40.0,
    "breakaway": 4.0,
}
GAUGES_PA = (1e5, 2.5e5, 6e5)


def pieces(seed: int = 3, cycles: int = 3, bins: int = 3, readings: int = 3) -> Pieces:
    """Three levels, cycles to and fro, pieces along the bore, readings in each; in mixed order."""
    rng = np.random.default_rng(seed)
    marks = [
        (level, 2 * (level * cycles + cycle) + (way < 0), cycle, way, place)
        for level in range(len(GAUGES_PA))
        for cycle in range(cycles)
        for way in (1.0, -1.0)
        for place in range(bins)
    ]
    level, stroke, cycle, way, place = (np.array(x) for x in zip(*marks, strict=True))
    of = rng.permutation(np.repeat(np.arange(len(marks)), readings))
    pressure = np.array(GAUGES_PA)[level[of]] * rng.uniform(0.45, 0.55, of.size)
    return Pieces(
        [Level(f"l{k}", f"r{k}", g, 0.5 * g, 0.1 + k) for k, g in enumerate(GAUGES_PA)],
        level,
        stroke,
        cycle,
        way,
        place,
        (place + 0.5) / bins - 0.5,
        Readings(
            of,
            np.zeros(of.size),
            4e-4 * pressure + rng.uniform(-3.0, 3.0, of.size),
            pressure,
            rng.uniform(0.004, 0.08, of.size),
            rng.uniform(0.0, 1.0, of.size),
        ),
        [],
    )


def friction_of(made: Pieces, strength: dict[Term, float]) -> Floats:
    """The law of `Friction`, one reading after another."""
    out = []
    for k, piece in enumerate(made.readings.piece):
        v = float(made.readings.speed_m_s[k])
        size = strength.get("constant", 0.0)
        size += strength.get("pressure", 0.0) * float(made.readings.pressure_pa[k])
        size += strength.get("viscous", 0.0) * v
        size += strength.get("breakaway", 0.0) * np.exp(-((v / STRIBECK_M_S) ** 2))
        out.append(size * float(made.way[piece]))
    return np.array(out)


def with_rest(made: Pieces, rest: Floats) -> Pieces:
    return replace(made, readings=replace(made.readings, rest_n=rest))


def drawn(strength: dict[Term, float], noise: float = 0.2, **more: int) -> Pieces:
    """Pieces whose force follows a law, a zero of 1.5 N, a gain error of 0.01, and noise."""
    made = pieces(**more)
    rng = np.random.default_rng(11)
    n, levels = made.level.size, len(made.levels)
    per_piece = rng.normal(0.0, noise, n) + rng.normal(0.0, noise, levels)[made.level] * made.way
    rest = friction_of(made, strength) + 1.5 + 0.01 * made.readings.load_n
    return with_rest(made, rest + per_piece[made.readings.piece])


def mean(made: Pieces, values: Floats) -> Floats:
    return np.array([values[made.readings.piece == k].mean() for k in range(made.level.size)])


@functools.cache
def centred(count: int, length: float) -> Floats:
    """An exponential covariance of places, with the mean of every row and column taken away."""
    e = np.array(
        [[np.exp(-abs(a - b) / count / length) for b in range(count)] for a in range(count)]
    )
    return e - e.mean(axis=0)[None] - e.mean(axis=1)[:, None] + e.mean()


def shared(made: Pieces, a: int, b: int) -> list[float]:
    """What two pieces have in common of each part of a scatter, by its definition."""
    ways = float(made.way[a] * made.way[b])
    bore = centred(int(made.bin.max()) + 1, 0.15)[made.bin[a], made.bin[b]]
    level = float(made.level[a] == made.level[b])
    cycles = int(made.cycle[made.level == made.level[a]].max()) + 1
    drift = centred(cycles, 1.0)[made.cycle[a], made.cycle[b]] if level else 0.0
    return [
        level * ways,
        level,
        level * ways * drift,
        float(made.stroke[a] == made.stroke[b]),
        bore * ways,
        bore * (ways > 0.0),
        bore * (ways > 0.0) * level,
        float(a == b),
    ]


def parts_of(made: Pieces) -> Floats:
    n = made.level.size
    return np.array([[shared(made, a, b) for b in range(n)] for a in range(n)])


def columns_of(made: Pieces, law: tuple[Term, ...]) -> Floats:
    """Columns of zero, gain and each term's own strength."""
    own = [mean(made, friction_of(made, {t: 1.0})) for t in law]
    return np.column_stack([np.ones(made.level.size), mean(made, made.readings.load_n), *own])


def textbook(made: Pieces, law: tuple[Term, ...], use: Any = slice(None)) -> tuple[Any, ...]:
    """Strengths, zero, gain, their covariance and the cost, by normal equations."""
    v = (parts_of(made) @ np.array(astuple(SCATTER)) ** 2)[use][:, use]
    x, y = columns_of(made, law)[use], mean(made, made.readings.rest_n)[use]
    inverse = np.linalg.inv(v)
    information = x.T @ inverse @ x
    information[1, 1] += 1.0 / 0.02**2
    beta = np.linalg.solve(information, x.T @ inverse @ y)
    left = y - x @ beta
    cost = float(left @ inverse @ left) + (beta[1] / 0.02) ** 2
    return beta, np.linalg.inv(information), cost


@pytest.mark.parametrize(
    "law",
    [LAW, ("constant",), ("constant", "viscous"), ("constant", "pressure", "breakaway")],
    ids="-".join,
)
@pytest.mark.parametrize("part", [False, True], ids=["all", "part"])
def test_an_estimate_is_generalised_least_squares(law: tuple[Term, ...], part: bool) -> None:
    made = drawn({t: STRENGTH[t] for t in law})
    use = (np.arange(made.level.size) % 4 != 1) if part else np.ones(made.level.size, dtype=bool)
    found = Whitened(made, SCATTER, use if part else None).fit(law, STRIBECK_M_S)
    beta, covariance, cost = textbook(made, law, use)

    assert found.law == law and found.stribeck_m_s == STRIBECK_M_S
    strength = np.array([found.strength[t] for t in law])
    np.testing.assert_allclose(strength, beta[2:], rtol=1e-5)
    assert found.zero_n == pytest.approx(beta[0], rel=1e-6)
    assert found.gain == pytest.approx(beta[1], rel=1e-5)
    assert found.gain_error == pytest.approx(np.sqrt(covariance[1, 1]), rel=1e-6)
    assert found.cost == pytest.approx(cost, rel=1e-6)
    wanted = covariance[2:, 2:] + 0.01**2 * np.outer(strength, strength)
    size = np.sqrt(np.diag(wanted))
    np.testing.assert_allclose(
        found.covariance / np.outer(size, size), wanted / np.outer(size, size), atol=1e-5
    )
    np.testing.assert_allclose([found.std_error[t] for t in law], size, rtol=1e-5)


def test_strengths_are_not_negative() -> None:
    made = drawn({**STRENGTH, "viscous": -80.0})
    found = Whitened(made, SCATTER).fit(("constant", "pressure", "viscous"), STRIBECK_M_S)
    rest: tuple[Term, ...] = ("constant", "pressure")
    beta, covariance, cost = textbook(made, rest)

    assert found.strength["viscous"] == found.std_error["viscous"] == 0.0
    np.testing.assert_allclose([found.strength[t] for t in rest], beta[2:], rtol=1e-5)
    size = np.sqrt(np.diag(covariance)[2:] + (0.01 * beta[2:]) ** 2)
    np.testing.assert_allclose([found.std_error[t] for t in rest], size, rtol=1e-5)
    assert found.gain_error == pytest.approx(np.sqrt(covariance[1, 1]), rel=1e-6)
    assert found.cost == pytest.approx(cost, rel=1e-6)


@pytest.mark.parametrize("law", [(), ("constant", "pressure")], ids=["none", "of zero"])
def test_without_friction_zero_and_gain_are_left(law: tuple[Term, ...]) -> None:
    made = drawn({"constant": -5.0})
    found = Whitened(made, SCATTER).fit(law, STRIBECK_M_S)
    beta, covariance, cost = textbook(made, ())

    assert set(found.strength.values()) <= {0.0} and set(found.std_error.values()) <= {0.0}
    assert not found.covariance.any() and found.covariance.shape == (len(law), len(law))
    assert (found.zero_n, found.gain) == pytest.approx(tuple(beta), rel=1e-6)
    assert found.gain_error == pytest.approx(np.sqrt(covariance[1, 1]), rel=1e-6)
    assert found.cost == pytest.approx(cost, rel=1e-6)


def test_a_term_that_no_reading_shows_has_no_strength() -> None:
    made = drawn({"constant": 5.0})
    made = replace(made, readings=replace(made.readings, pressure_pa=0.0 * made.readings.load_n))
    found = Whitened(made, SCATTER).fit(("constant", "pressure"), STRIBECK_M_S)
    assert found.strength["pressure"] == 0.0
    assert found.strength["constant"] == pytest.approx(5.0, abs=0.5)


def test_breakaway_is_at_most_twice_the_constant() -> None:
    made = drawn({"constant": 1.0, "breakaway": 9.0})
    found = Whitened(made, SCATTER).fit(("constant", "breakaway"), STRIBECK_M_S)
    assert found.strength["constant"] > 1.0
    assert found.strength["breakaway"] == pytest.approx(2.0 * found.strength["constant"])
    wide = {t: found.std_error[t] / found.strength[t] for t in found.law}
    assert wide["breakaway"] == pytest.approx(wide["constant"])  # they move as one


def test_the_best_stribeck_speed_has_the_least_cost() -> None:
    made = drawn(STRENGTH, noise=0.02)
    speeds = np.array([0.005, 0.012, STRIBECK_M_S, 0.035, 0.06])
    whitened = Whitened(made, SCATTER)
    assert whitened.best(LAW, speeds).stribeck_m_s == STRIBECK_M_S
    assert whitened.best(("constant", "viscous"), speeds).stribeck_m_s == 0.005


def test_what_zero_and_gain_could_make_is_projected_out() -> None:
    made = drawn(STRENGTH)
    whitened = Whitened(made, SCATTER)
    np.testing.assert_allclose(whitened.free(whitened.fixed @ [2.0, -3.0]), 0.0, atol=1e-9)
    free = whitened.free(whitened.rest)
    np.testing.assert_allclose(whitened.fixed.T @ free, 0.0, atol=1e-6)
    np.testing.assert_allclose(whitened.free(free), free, atol=1e-9)


@pytest.mark.parametrize("law", [LAW, ("viscous",), ("constant", "breakaway"), ()], ids="-".join)
def test_a_law_is_that_of_the_simulator(law: tuple[Term, ...]) -> None:
    made = drawn(STRENGTH)
    strength = {t: STRENGTH[t] for t in law}
    found = Whitened(made, SCATTER).fit(law, STRIBECK_M_S)
    np.testing.assert_allclose(
        predicted(made, replace(found, strength=strength)), friction_of(made, strength)
    )
    for term in ("constant", "pressure", "viscous"):
        np.testing.assert_allclose(column(made, term, STRIBECK_M_S), friction_of(made, {term: 1.0}))
    np.testing.assert_allclose(
        column(made, "breakaway", STRIBECK_M_S),
        friction_of(made, {"constant": 1.0, "breakaway": 2.0}),
    )


def test_names_of_terms() -> None:
    assert FIELDS == {
        "constant": "coulomb_n",
        "pressure": "coulomb_n_per_pa",
        "viscous": "viscous_n_s_m",
        "breakaway": "breakaway_n",
    }
    assert set(FIELDS.values()) < set(Friction.model_fields)
    assert UNITS == {"constant": "N", "pressure": "N/Pa", "viscous": "N s/m", "breakaway": "N"}
    words = {"constant": "Coulomb", "pressure": "pressure", "viscous": "viscous"}
    for term, word in (words | {"breakaway": "Stribeck"}).items():
        assert word in TITLES[term]  # type: ignore[index]
    assert [SHORT[t] for t in LAW] == ["constant", "growing with pressure", "viscous", "breakaway"]


def test_smooth_covariance() -> None:
    np.testing.assert_allclose(smooth(np.array([2, 0, 1, 4]), 0.3), centred(5, 0.3), atol=1e-12)
    half = 0.5 * (1.0 - np.exp(-0.5 / 0.4))  # of two places, in closed form
    np.testing.assert_allclose(smooth(np.array([1]), 0.4), [[half, -half], [-half, half]])
    np.testing.assert_allclose(smooth(np.array([0]), 0.4), 0.0, atol=1e-12)


def usual_of(made: Pieces) -> float:
    """Expected variance of the recordings' friction: the median of those within, or 1 %."""
    rest = mean(made, made.readings.rest_n)
    halves = [
        [
            0.5 * (rest[of & (made.way > 0)].mean() - rest[of & (made.way < 0)].mean())
            for c in np.unique(made.cycle)
            if (of := (made.level == k) & (made.cycle == c)).any()
        ]
        for k in range(len(made.levels))
    ]
    within = [np.var(h, ddof=1) for h in halves if len(h) > 1]
    return float(
        max(
            np.median(within) if within else 0.0,
            (0.01 * np.mean([np.mean(h) for h in halves])) ** 2,
            (1e-4 * np.std(rest)) ** 2,
        )
    )


class Restricted:
    """Negative logarithm of the restricted likelihood, with the priors of the first two."""

    def __init__(self, made: Pieces, law: tuple[Term, ...]):
        own = [mean(made, column(made, t, STRIBECK_M_S)) for t in law]
        x = np.column_stack([columns_of(made, ()), *own])
        self.size = np.linalg.norm(x, axis=0)
        self.x, self.y = x / self.size, mean(made, made.readings.rest_n)
        self.parts = parts_of(made)
        self.usual = usual_of(made)

    def __call__(self, variances: Floats) -> float:
        x, y = self.x, self.y
        v = self.parts @ variances
        inverse = np.linalg.inv(v)
        information = x.T @ inverse @ x + 1e-12 * np.eye(self.size.size)
        information[1, 1] += 1.0 / (0.02 * self.size[1]) ** 2
        weighted = inverse @ x
        projector = inverse - weighted @ np.linalg.inv(information) @ weighted.T
        prior = 3.0 * (np.log(variances[0]) + self.usual / variances[0])
        prior += np.log(variances[1]) + max(np.var(y), self.usual) / variances[1]
        parts = np.linalg.slogdet(v)[1], np.linalg.slogdet(information)[1], y @ projector @ y
        return 0.5 * float(sum(parts) + prior)


@pytest.mark.parametrize(
    ("constant", "cycles", "noise", "apart"),
    [
        (6.0, 2, 0.3, 0.0),
        (6.0, 1, 0.0, 0.0),
        (6.0, 1, 0.4, 0.0),
        (6.0, 2, 0.1, 0.5),
        (0.0, 1, 0.0, 0.0),
    ],
    ids=["cycles", "exact", "single", "cycles apart", "nothing"],
)
def test_scatter_maximises_the_restricted_likelihood(
    constant: float, cycles: int, noise: float, apart: float
) -> None:
    law: tuple[Term, ...] = ("constant", "pressure")
    made = drawn({"constant": constant, "pressure": 5e-6 * constant}, noise=noise, cycles=cycles)
    # Cycles differ by another amount in each level, of which the median counts.
    own = apart * made.cycle * made.way * np.array([0.3, 2.0, 1.0])[made.level]
    made = with_rest(made, made.readings.rest_n + own[made.readings.piece])
    found, value = scatter_of(made, law, STRIBECK_M_S)
    cost = Restricted(made, law)
    variances = np.array(astuple(found)) ** 2
    assert np.all(variances > 0.0)
    assert value == pytest.approx(cost(variances), rel=1e-4, abs=1e-3)
    most, floor = 9.0 * cost.usual, 1e-8 * np.var(mean(made, made.readings.rest_n))
    assert variances[0] <= most * (1.0 + 1e-9) and variances[-1] >= floor
    for k in range(variances.size):
        for factor in (0.7, 1.4):
            other = variances.copy()
            other[k] *= factor
            if other[0] <= most and other[-1] >= floor:
                assert cost(other) > value - 0.02, (k, factor)


def test_the_scatter_of_recordings_is_bounded() -> None:
    made = drawn({"constant": 6.0}, noise=0.2, cycles=2)
    jump = np.array([0.0, 0.3, -0.3])[made.level] * made.way
    made = with_rest(made, made.readings.rest_n + jump[made.readings.piece])
    found, _ = scatter_of(made, ("constant",), STRIBECK_M_S)
    assert found.friction == pytest.approx(3.0 * np.sqrt(usual_of(made)))


def range_made(
    speeds: tuple[list[float], list[float]], gauges: tuple[float, ...] = GAUGES_PA
) -> Range:
    """The range of readings with given speeds in and out, and levels with given mean pressures."""
    both = [*speeds[0], *speeds[1]]
    piece = np.array([0] * len(speeds[0]) + [1] * len(speeds[1]))
    made = pieces(cycles=1, bins=1)
    one = np.ones(len(both))
    levels = [Level("l", "r", 7.0 * g, g, 0.1) for g in gauges]
    readings = Readings(piece, one, one, one, np.array(both), one)
    return range_of(replace(made, levels=levels, readings=readings))


def test_range_of_speeds() -> None:
    some = np.linspace(0.0, 1.0, 101)
    found = range_made(([*(0.02 + 0.01 * some)], [*(0.05 + 0.04 * some)]))
    assert found.speed_m_s == pytest.approx(
        tuple(np.quantile([*(0.02 + 0.01 * some), *(0.05 + 0.04 * some)], [0.05, 0.95]))
    )
    assert 0.02 < found.speed_m_s[0] < 0.022 < 0.085 < found.speed_m_s[1] < 0.088


@pytest.mark.parametrize(
    ("into", "out", "told"),
    [
        ((0.25, 0.375), (0.25, 0.25), True),  # at the limit, one way or the other
        ((0.25, 0.25), (0.5, 0.75), True),
        ((0.25, 0.374), (0.5, 0.74), False),
        ((0.25, 0.25), (0.75, 0.75), False),  # ways alone differ by the zero as well
        ((0.25, 0.9), (0.5, 0.9), True),
    ],
)
def test_speeds_tell_their_terms_where_one_way_varies(
    into: tuple[float, float], out: tuple[float, float], told: bool
) -> None:
    found = range_made(([v for v in into for _ in range(20)], [v for v in out for _ in range(20)]))
    assert found.speeds is told
    # A twentieth of the readings at either end does not count.
    lone = [0.25] * 50 + [0.01, 5.0]
    assert not range_made((lone, lone)).speeds


@pytest.mark.parametrize(
    ("gauges", "told"),
    [
        ((5e4, 4e4, 4.5e4), True),  # at both limits
        ((4.9999e4, 4e4), False),
        ((1e4, 0.0), True),
        ((0.9999e4, 0.0), False),
        ((1.25e5, 1e5), True),
        ((1.2499e5, 1e5), False),
        ((2e5, -3e4), True),
        ((5e3, -5e3), True),
        ((2e5,), False),
        ((1e5, 1e5), False),
    ],
)
def test_pressures_tell_their_term_where_they_differ(gauges: tuple[float, ...], told: bool) -> None:
    found = range_made(([0.1] * 9, [0.1] * 9), gauges)
    assert found.pressures is told
    assert found.pressure_pa == (min(gauges), max(gauges))


def test_laws_that_strokes_can_judge() -> None:
    def laws(speeds: bool, pressures: bool) -> set[tuple[Term, ...]]:
        found = combinations_of(Range((0.1, 0.2), (1e5, 2e5), speeds, pressures))
        assert found[0] == () and len(set(found)) == len(found)
        assert [len(law) for law in found] == sorted(len(law) for law in found)
        return set(found)

    none, c, p, v = (), ("constant",), ("pressure",), ("viscous",)
    assert laws(False, False) == {none, c}
    assert laws(False, True) == {none, c, p, c + p}
    b: tuple[Term, ...] = ("breakaway",)
    fast = {none, c, v, c + v, c + b, c + v + b}
    assert laws(True, False) == fast
    more = {p, c + p, p + v, c + p + v, c + p + b, c + p + v + b}
    assert laws(True, True) == fast | more


@pytest.mark.parametrize(("slow", "first"), [(0.01, 0.005), (2.0e-5, 1.0e-5), (4e-6, 1.0e-5)])
def test_stribeck_speeds_lie_within_those_seen(slow: float, first: float) -> None:
    found = stribeck_speeds(Range((slow, 0.2), (0.0, 0.0), True, True))
    assert found.size == 16
    assert found[0] == pytest.approx(first) and found[-1] == pytest.approx(0.14)
    np.testing.assert_allclose(found[1:] / found[:-1], (0.14 / first) ** (1.0 / 15.0))
