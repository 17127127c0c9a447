# SPDX-License-Identifier: Apache-2.0
"""Exact Riemann solver and HLLC flux against tables, jump conditions and 40-digit arithmetic."""

from __future__ import annotations

import itertools
from decimal import Decimal, localcontext

import numpy as np
import pytest
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sim import riemann
from pneu_sim.gas import AIR

GAMMA = 1.4
State = tuple[float, float, float]


def _tube(p_left: float) -> tuple[State, State]:
    """Shock tube with air at rest, 293.15 K, against one atmosphere."""
    rt = 287.05 * 293.15
    return (p_left / rt, 0.0, p_left), (101325.0 / rt, 0.0, 101325.0)


PROBLEMS: dict[str, tuple[State, State]] = {
    "sod": ((1.0, 0.0, 1.0), (0.125, 0.0, 0.1)),
    "toro1": ((1.0, 0.75, 1.0), (0.125, 0.0, 0.1)),
    "toro2": ((1.0, -2.0, 0.4), (1.0, 2.0, 0.4)),
    "toro3": ((1.0, 0.0, 1000.0), (1.0, 0.0, 0.01)),
    "toro3_mirrored": ((1.0, 0.0, 0.01), (1.0, 0.0, 1000.0)),
    "toro4": ((5.99924, 19.5975, 460.894), (5.99242, -6.19633, 46.0950)),
    "toro5": ((1.0, -19.59745, 1000.0), (1.0, -19.59745, 0.01)),
    "toro6": ((1.4, 0.0, 1.0), (1.0, 0.0, 1.0)),
    "toro7": ((1.4, 0.1, 1.0), (1.0, 0.1, 1.0)),
    "lax": ((0.445, 0.698, 3.528), (0.5, 0.0, 0.571)),
    "tube_2bar": _tube(2e5),
    "tube_4bar": _tube(4e5),
    "tube_7bar": _tube(7e5),
    "shock_shock": ((1.2, 300.0, 1e5), (1.1, -350.0, 1.1e5)),
}

# p*, u*, rho*L, rho*R to ten printed digits
STAR_TABLE = {
    "sod": (0.3031301781, 0.9274526200, 0.4263194282, 0.2655737117),
    "toro1": (0.4662935668, 1.360905519, 0.5798666875, 0.3397002349),
    "toro2": (0.001893873420, 0.0, 0.02185211821, 0.02185211821),
    "toro3": (460.8937875, 19.59745139, 0.5750622985, 5.999240705),
    "toro3_mirrored": (460.8937875, -19.59745139, 5.999240705, 0.5750622985),
    "toro4": (1691.646955, 8.689774412, 14.28234995, 31.04260164),
    "toro5": (460.8937875, 1.38872e-6, 0.5750622985, 5.999240705),
    "toro6": (1.0, 0.0, 1.4, 1.0),
    "toro7": (1.0, 0.1, 1.4, 1.0),
    "lax": (2.466097919, 1.528723027, 0.3445684742, 1.304084532),
}

# p* Pa, u* m/s, shock Mach number
TUBE_TABLE = {
    "tube_2bar": (141152.148, 83.34335, 1.156249),
    "tube_4bar": (194257.503, 168.24882, 1.336468),
    "tube_7bar": (247681.799, 236.71075, 1.496022),
}

# left wave's edges, right wave's edges
SPEED_TABLE = {
    "sod": (-1.183216, -0.070273, 1.752156, 1.752156),
    "toro1": (-0.433216, 0.299871, 2.153234, 2.153234),
    "toro2": (-2.748331, -0.348331, 0.348331, 2.748331),
    "toro3": (-37.416574, -13.899632, 23.517537, 23.517537),
    "toro4": (0.789594, 0.789594, 12.250778, 12.250778),
    "toro5": (-57.014024, -33.497082, 3.920087, 3.920087),
    "lax": (-2.633565, -1.636697, 2.479321, 2.479321),
}


def _star(name: str) -> tuple[float, float, float, float, int]:
    left, right = PROBLEMS[name]
    star: tuple[float, float, float, float, int] = riemann.star_state(
        *left, *right, GAMMA, riemann.REFERENCE_ITERATIONS, riemann.REFERENCE_TOLERANCE
    )
    return star


@pytest.mark.parametrize("name", STAR_TABLE)
def test_star_state_table(name: str) -> None:
    p, u, rho_l, rho_r, iterations = _star(name)
    expected = STAR_TABLE[name]
    assert (p, rho_l, rho_r) == pytest.approx((expected[0], *expected[2:]), rel=1e-9)
    assert u == pytest.approx(expected[1], rel=1e-9, abs=1e-11)
    assert 0 < iterations < 20


@pytest.mark.parametrize("name", TUBE_TABLE)
def test_pneumatic_shock_tube_table(name: str) -> None:
    p, u, _, _, _ = _star(name)
    left, right = PROBLEMS[name]
    mach = riemann.wave_speeds(left, right)[4] / np.sqrt(1.4 * 287.05 * 293.15)
    assert p == pytest.approx(TUBE_TABLE[name][0], abs=6e-4)
    assert u == pytest.approx(TUBE_TABLE[name][1], abs=6e-6)
    assert mach == pytest.approx(TUBE_TABLE[name][2], abs=6e-7)


@pytest.mark.parametrize("name", SPEED_TABLE)
def test_wave_speed_table(name: str) -> None:
    speeds = riemann.wave_speeds(*PROBLEMS[name])
    assert speeds[:2] + speeds[3:] == pytest.approx(SPEED_TABLE[name], abs=6e-7)


def _precise_star(left: State, right: State) -> tuple[Decimal, Decimal, Decimal, Decimal]:
    """Star state by bisection of the pressure function in 40-digit arithmetic."""
    g = Decimal(14) / 10

    def change(p: Decimal, state: tuple[Decimal, Decimal, Decimal]) -> Decimal:
        rho, _, p_k = state
        if p > p_k:
            return (p - p_k) * (2 / (rho * ((g + 1) * p + (g - 1) * p_k))).sqrt()
        power = (p / p_k) ** ((g - 1) / (2 * g))
        return 2 * (g * p_k / rho).sqrt() / (g - 1) * (power - 1)

    def density(p: Decimal, state: tuple[Decimal, Decimal, Decimal]) -> Decimal:
        rho, _, p_k = state
        if p > p_k:
            return rho * ((g + 1) * p + (g - 1) * p_k) / ((g - 1) * p + (g + 1) * p_k)
        return rho * (p / p_k) ** (1 / g)

    with localcontext() as context:
        context.prec = 40
        lhs = (Decimal(left[0]), Decimal(left[1]), Decimal(left[2]))
        rhs = (Decimal(right[0]), Decimal(right[1]), Decimal(right[2]))
        low, high = Decimal("1e-12"), 1000 * max(lhs[2], rhs[2])
        for _ in range(130):
            middle = (low + high) / 2
            if change(middle, lhs) + change(middle, rhs) + rhs[1] - lhs[1] > 0:
                high = middle
            else:
                low = middle
        p = (low + high) / 2
        u = (lhs[1] + rhs[1] + change(p, rhs) - change(p, lhs)) / 2
        return p, u, density(p, lhs), density(p, rhs)


@pytest.mark.parametrize("name", PROBLEMS)
def test_star_state_to_rounding(name: str) -> None:
    """Double precision agrees with 40 digits to 1e-12 (velocity near zero: 1e-15 of the waves)."""
    p, u, rho_l, rho_r, _ = _star(name)
    left, right = PROBLEMS[name]
    precise = [float(x) for x in _precise_star(left, right)]
    assert (p, rho_l, rho_r) == pytest.approx((precise[0], *precise[2:]), rel=1e-12)
    scale = max(abs(speed) for speed in riemann.wave_speeds(left, right))
    assert u == pytest.approx(precise[1], rel=1e-12, abs=1e-15 * scale)


def test_two_iterations_suffice_for_pneumatics() -> None:
    """Random pairs between 0.2 and 12 bar, hot and cold, with flow: p* within 0.1 %."""
    rng = np.random.default_rng(7)
    worst = 0.0
    for _ in range(2000):
        p_l, p_r = np.exp(rng.uniform(np.log(2e4), np.log(1.2e6), 2))
        t_l, t_r = rng.uniform(230.0, 400.0, 2)
        u_l, u_r = rng.uniform(-100.0, 100.0, 2)
        states = (p_l / (287.05 * t_l), u_l, p_l, p_r / (287.05 * t_r), u_r, p_r, GAMMA)
        quick = riemann.star_state(*states, riemann.STEP_ITERATIONS, 0.0)[0]
        exact = riemann.star_state(*states, 100, 1e-15)[0]
        worst = max(worst, abs(quick / exact - 1.0))
    assert worst < 1e-3


def test_jump_conditions_across_every_wave() -> None:
    """Rankine-Hugoniot across shocks and contact, invariants through the fan (Sod)."""
    left, right = PROBLEMS["sod"]
    head, tail, contact, _, shock = riemann.wave_speeds(left, right)
    eps = 1e-9
    for speed in (contact, shock):
        before, after = riemann.solve(left, right, [speed - eps, speed + eps]).T
        jump = AIR.to_conserved(after) - AIR.to_conserved(before)
        np.testing.assert_allclose(AIR.flux(after) - AIR.flux(before), speed * jump, atol=1e-8)
    xi = np.linspace(head, tail, 50)
    rho, u, p = riemann.solve(left, right, xi)
    a = np.sqrt(GAMMA * p / rho)
    np.testing.assert_allclose(u - a, xi, atol=1e-12)
    np.testing.assert_allclose(u + 5.0 * a, 5.0 * np.sqrt(1.4), rtol=1e-13)
    np.testing.assert_allclose(p / rho**1.4, 1.0, rtol=1e-13)


@pytest.mark.parametrize("name", PROBLEMS)
def test_solution_conserves_mass_momentum_energy(name: str) -> None:
    """The integral of the solution over a box equals what the ends feed in."""
    left, right = PROBLEMS[name]
    speeds = riemann.wave_speeds(left, right)
    span = 1.2 * max(abs(s) for s in speeds)
    edges = np.unique([-span, *speeds, span])
    nodes, weights = np.polynomial.legendre.leggauss(40)
    total = np.zeros(3)
    for low, high in itertools.pairwise(edges):
        xi = 0.5 * (high + low) + 0.5 * (high - low) * nodes
        total += 0.5 * (high - low) * AIR.to_conserved(riemann.solve(left, right, xi)) @ weights
    expected = span * (AIR.to_conserved(left) + AIR.to_conserved(right))
    expected += AIR.flux(left) - AIR.flux(right)
    scale = span * (np.abs(AIR.to_conserved(left)) + np.abs(AIR.to_conserved(right)))
    scale[1] = max(scale[1], left[2] + right[2])
    np.testing.assert_allclose(total / scale, expected / scale, atol=1e-11)


@pytest.mark.parametrize("name", PROBLEMS)
def test_mirror_image(name: str) -> None:
    (rho_l, u_l, p_l), (rho_r, u_r, p_r) = PROBLEMS[name]
    here_state = (rho_l, u_l, p_l, rho_r, u_r, p_r, GAMMA)
    there_state = (rho_r, -u_r, p_r, rho_l, -u_l, p_l, GAMMA)
    for here, there in (
        (riemann.exact_flux(*here_state, 50), riemann.exact_flux(*there_state, 50)),
        (riemann.hllc_flux(*here_state), riemann.hllc_flux(*there_state)),
    ):
        np.testing.assert_allclose(
            np.array(there) * [-1, 1, -1], here, rtol=1e-12, atol=1e-12 * p_l
        )


# -- Vacuum -----------------------------------------------------------------------------------


def test_vacuum_opens_between_receding_gases() -> None:
    left, right = (1.0, -6.0, 0.4), (1.0, 6.0, 0.4)
    sound = np.sqrt(1.4 * 0.4)
    assert riemann.star_state(*left, *right, GAMMA, 20, 1e-12) == (0.0, 0.0, 0.0, 0.0, 0)
    speeds = riemann.wave_speeds(left, right)
    front = 6.0 - 5.0 * sound
    assert speeds == pytest.approx((-6.0 - sound, -front, 0.0, front, 6.0 + sound))
    rho, _, p = riemann.solve(left, right, [-0.9 * front, 0.0, 0.9 * front])
    assert np.all(rho == 0.0) and np.all(p == 0.0)
    assert riemann.exact_flux(*left, *right, GAMMA, 2) == (0.0, 0.0, 0.0)


def test_expansion_into_vacuum() -> None:
    """Choked outflow into nothing: the fan is sonic at the origin, on either side."""
    gas, nothing = (1.0, 0.0, 1.0), (0.0, 0.0, 0.0)
    sound = np.sqrt(1.4)
    assert riemann.star_state(*gas, *nothing, GAMMA, 20, 1e-12)[1] == pytest.approx(5.0 * sound)
    rho, u, p = riemann.solve(gas, nothing, 0.0)
    assert u == pytest.approx(np.sqrt(1.4 * p / rho)) == pytest.approx(sound / 1.2)
    assert rho == pytest.approx((1.0 / 1.2) ** 5)
    mirrored = riemann.solve(nothing, gas, 0.0)
    np.testing.assert_allclose(mirrored, [rho, -u, p])


def test_strong_rarefaction_stays_positive_at_every_iteration() -> None:
    for iterations in range(6):
        p, _, rho_l, rho_r, _ = riemann.star_state(
            1.0, -3.7, 0.4, 0.5, 3.7, 0.9, GAMMA, iterations, 0.0
        )
        assert p > 0.0 and rho_l > 0.0 and rho_r > 0.0


@pytest.mark.parametrize(
    ("left", "word"),
    [((1.0, 0.0), "three"), ((1.0, np.nan, 1.0), "finite"), ((-1.0, 0.0, 1.0), "negative")],
)
def test_bad_state_is_named(left: State, word: str) -> None:
    with pytest.raises(InputError, match=f"left state.*{word}"):
        riemann.solve(left, (1.0, 0.0, 1.0), 0.0)


# -- Fluxes -----------------------------------------------------------------------------------


@pytest.mark.parametrize("velocity", [0.0, 40.0, -250.0, 400.0, -600.0])
def test_flux_of_equal_states_is_the_physical_flux(velocity: float) -> None:
    state = (1.2, velocity, 101325.0)
    expected = AIR.flux(state)
    scale = np.array([1.2 * 340.0, 101325.0, 3.5 * 101325.0 * 340.0])
    for found in (
        riemann.hllc_flux(*state, *state, GAMMA),
        riemann.exact_flux(*state, *state, GAMMA, 2),
    ):
        np.testing.assert_allclose(np.array(found) / scale, expected / scale, atol=1e-14)


@pytest.mark.parametrize("pressure", [1.0, 101325.0, 0.1 + 0.2])
def test_contact_at_rest_is_exact(pressure: float) -> None:
    for rho_l, rho_r in ((1.4, 1.0), (1.0, 1000.0), (7.3, 1.7)):
        states = (rho_l, 0.0, pressure, rho_r, 0.0, pressure, GAMMA)
        assert riemann.hllc_flux(*states) == (0.0, pressure, 0.0)
        assert riemann.exact_flux(*states, 2) == (0.0, pressure, 0.0)


def test_moving_contact_and_single_shock_are_resolved() -> None:
    """An isolated wave in the data is one that HLLC must let pass unchanged."""
    left, right = PROBLEMS["toro7"]
    np.testing.assert_allclose(riemann.hllc_flux(*left, *right, GAMMA), AIR.flux(left), rtol=1e-14)
    p, u, _, rho_r, _ = _star("tube_7bar")
    _, room = PROBLEMS["tube_7bar"]
    shocked = (rho_r, u, p)
    np.testing.assert_allclose(
        riemann.exact_flux(*shocked, *room, GAMMA, 20), AIR.flux(shocked), rtol=1e-12
    )


@pytest.mark.parametrize(("left_u", "expected"), [(700.0, "left"), (-700.0, "right")])
def test_supersonic_flux_is_upwind(left_u: float, expected: str) -> None:
    left, right = (1.2, left_u, 1e5), (1.1, 1.01 * left_u, 0.95e5)
    upwind = AIR.flux(left if expected == "left" else right)
    np.testing.assert_allclose(riemann.hllc_flux(*left, *right, GAMMA), upwind, rtol=1e-14)
    np.testing.assert_allclose(riemann.exact_flux(*left, *right, GAMMA, 20), upwind, rtol=1e-14)


def _first_order(name: str, flux: str, origin: float, end: float) -> NDArray[np.float64]:
    """Godunov's method on [0, 1], 100 cells, CFL 0.9, open ends; returns (rho, u, p)."""
    left, right = PROBLEMS[name]
    cells, dx = 100, 0.01
    centres = (np.arange(cells) + 0.5) * dx
    state = np.where(centres < origin, np.array(left)[:, None], np.array(right)[:, None])
    conserved, time = AIR.to_conserved(state), 0.0
    while time < end:
        rho, u, p = state
        dt = min(0.9 * dx / np.max(np.abs(u) + np.sqrt(GAMMA * p / rho)), end - time)
        padded = np.pad(state, ((0, 0), (1, 1)), mode="edge")
        faces = np.empty((3, cells + 1))
        for i in range(cells + 1):
            rho_l, u_l, p_l = padded[:, i]
            rho_r, u_r, p_r = padded[:, i + 1]
            if flux == "hllc":
                faces[:, i] = riemann.hllc_flux(rho_l, u_l, p_l, rho_r, u_r, p_r, GAMMA)
            else:
                faces[:, i] = riemann.exact_flux(
                    rho_l, u_l, p_l, rho_r, u_r, p_r, GAMMA, riemann.STEP_ITERATIONS
                )
        conserved = conserved - dt / dx * np.diff(faces, axis=1)
        state = AIR.to_primitive(conserved)
        assert np.all(state[0] > 0.0) and np.all(state[2] > 0.0)
        time += dt
    return np.asarray(state)


# origin, end time, L1(rho) relative to the mean: first order on 100 cells, so percents
@pytest.mark.parametrize("flux", ["hllc", "exact"])
@pytest.mark.parametrize(
    ("name", "origin", "end", "bound"),
    [
        ("toro1", 0.3, 0.2, 0.03),
        ("toro2", 0.5, 0.15, 0.05),
        ("toro3", 0.5, 0.012, 0.25),
        ("toro4", 0.4, 0.035, 0.09),
        ("toro5", 0.8, 0.012, 0.04),
    ],
)
def test_first_order_runs_stay_positive_and_near_the_solution(
    flux: str, name: str, origin: float, end: float, bound: float
) -> None:
    rho = _first_order(name, flux, origin, end)[0]
    xi = ((np.arange(100) + 0.5) * 0.01 - origin) / end
    exact = riemann.solve(*PROBLEMS[name], xi)[0]
    assert np.mean(np.abs(rho - exact)) < bound * np.mean(exact)


@pytest.mark.parametrize("flux", ["hllc", "exact"])
def test_contact_at_rest_never_moves(flux: str) -> None:
    state = _first_order("toro6", flux, 0.5, 2.0)
    centres = (np.arange(100) + 0.5) * 0.01
    np.testing.assert_allclose(state[0], np.where(centres < 0.5, 1.4, 1.0), rtol=0, atol=0)
    assert np.all(state[1] == 0.0)
    np.testing.assert_allclose(state[2], 1.0, rtol=1e-15)


@pytest.mark.parametrize("flux", ["hllc", "exact"])
def test_moving_contact_keeps_pressure_and_velocity(flux: str) -> None:
    state = _first_order("toro7", flux, 0.5, 2.0)
    np.testing.assert_allclose(state[1], 0.1, rtol=1e-11)
    np.testing.assert_allclose(state[2], 1.0, rtol=1e-12)
