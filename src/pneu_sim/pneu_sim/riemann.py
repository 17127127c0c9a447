# SPDX-License-Identifier: Apache-2.0
"""Riemann problem of the one-dimensional Euler equations: exact solution and interface fluxes.

Two gases at constant state meet at ``x = 0``. The solution depends on ``x / t`` only: a left
wave (shock or fan), a contact, a right wave; between the waves pressure ``p_star`` and velocity
``u_star`` are constant (thesis 4.6.3, fig. 4.3; E. F. Toro, Riemann Solvers and Numerical Methods
for Fluid Dynamics, 3rd ed., chapters 4, 9 and 10).

The kernels take and return scalars, so that they inline into a loop over cells, and hold no
Python object. States are (rho, u, p): density kg/m3, velocity m/s, absolute pressure Pa; the
ratio of specific heats ``gamma`` is constant. `solve` and `wave_speeds` are for people.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pneu_common.errors import InputError
from pneu_sim.compiling import njit

STEP_ITERATIONS = 2
"""Newton iterations that suffice inside a time step (thesis 4.6.3)."""

REFERENCE_ITERATIONS = 100
"""Upper bound on Newton iterations when the star state is wanted to rounding."""

REFERENCE_TOLERANCE = 1e-15
"""Relative pressure change at which the reference solution counts as converged."""


@njit(cache=True, error_model="numpy")
def _side(p: float, rho_k: float, p_k: float, a_k: float, gamma: float) -> tuple[float, float]:
    """Velocity change across one wave that ends at pressure `p`, and its slope (Toro 4.2.1)."""
    if p > p_k:  # shock, Rankine-Hugoniot
        a = 2.0 / ((gamma + 1.0) * rho_k)
        b = (gamma - 1.0) / (gamma + 1.0) * p_k
        root = math.sqrt(a / (p + b))
        return (p - p_k) * root, root * (1.0 - 0.5 * (p - p_k) / (p + b))
    # rarefaction, isentropic
    ratio = p / p_k
    power = ratio ** ((gamma - 1.0) / (2.0 * gamma))
    return 2.0 * a_k / (gamma - 1.0) * (power - 1.0), power / (ratio * rho_k * a_k)


@njit(cache=True, error_model="numpy")
def _side_density(p_star: float, rho_k: float, p_k: float, gamma: float) -> float:
    """Density between one wave and the contact."""
    ratio = p_star / p_k
    if p_star > p_k:
        g = (gamma - 1.0) / (gamma + 1.0)
        return rho_k * (ratio + g) / (g * ratio + 1.0)
    return rho_k * ratio ** (1.0 / gamma)


@njit(cache=True, error_model="numpy")
def _pressure_guess(
    rho_l: float,
    u_l: float,
    p_l: float,
    a_l: float,
    rho_r: float,
    u_r: float,
    p_r: float,
    a_r: float,
    gamma: float,
) -> float:
    """First guess of p_star: linearised, two-rarefaction or two-shock (Toro 9.5.2)."""
    p_min = min(p_l, p_r)
    p_max = max(p_l, p_r)
    p_lin = 0.5 * (p_l + p_r) - 0.125 * (u_r - u_l) * (rho_l + rho_r) * (a_l + a_r)
    if p_max <= 2.0 * p_min and p_min <= p_lin <= p_max:
        return p_lin
    if p_lin < p_min:
        z = (gamma - 1.0) / (2.0 * gamma)
        pressure_ratio = (p_l / p_r) ** z
        u_star = (pressure_ratio * u_l / a_l + u_r / a_r) + 2.0 * (pressure_ratio - 1.0) / (
            gamma - 1.0
        )
        u_star /= pressure_ratio / a_l + 1.0 / a_r
        left = 1.0 + 0.5 * (gamma - 1.0) * (u_l - u_star) / a_l
        right = 1.0 + 0.5 * (gamma - 1.0) * (u_star - u_r) / a_r
        # No vacuum here, so both brackets are positive up to rounding.
        left = max(left, 1e-12)
        right = max(right, 1e-12)
        return 0.5 * (p_l * left ** (1.0 / z) + p_r * right ** (1.0 / z))
    g_l = math.sqrt(2.0 / ((gamma + 1.0) * rho_l) / (p_lin + (gamma - 1.0) / (gamma + 1.0) * p_l))
    g_r = math.sqrt(2.0 / ((gamma + 1.0) * rho_r) / (p_lin + (gamma - 1.0) / (gamma + 1.0) * p_r))
    p_two_shock = (g_l * p_l + g_r * p_r - (u_r - u_l)) / (g_l + g_r)
    # The velocity difference can drive the estimate below zero or below the weaker side, where
    # Newton on the concave pressure function would still converge, but slowly.
    return max(p_two_shock, p_min)


@njit(cache=True, error_model="numpy")
def star_state(
    rho_l: float,
    u_l: float,
    p_l: float,
    rho_r: float,
    u_r: float,
    p_r: float,
    gamma: float,
    max_iter: int,
    tol: float,
) -> tuple[float, float, float, float, int]:
    """Finds the state between the two outer waves (Toro 4.2-4.3, 4.6).

    Newton's method on the pressure function; a step that would make the pressure negative is
    replaced by a hundredfold reduction, so every iterate is positive. A vacuum, on one side or
    opening between two receding gases, is recognised before iterating.

    Args:
        rho_l: Density left, kg/m3 (0 for vacuum).
        u_l: Velocity left, m/s.
        p_l: Pressure left, absolute Pa.
        rho_r: Density right, kg/m3 (0 for vacuum).
        u_r: Velocity right, m/s.
        p_r: Pressure right, absolute Pa.
        gamma: Ratio of specific heats.
        max_iter: Newton iterations allowed; `STEP_ITERATIONS` inside a time step.
        tol: Relative change of pressure at which to stop before `max_iter`.

    Returns:
        ``(p_star, u_star, rho_star_l, rho_star_r, iterations)``. With vacuum, pressure and
        densities are 0, `iterations` is 0 and `u_star` is the front's speed (one-sided vacuum)
        or the mean of the two fronts' speeds.
    """
    vacuum_l = rho_l <= 0.0 or p_l <= 0.0
    vacuum_r = rho_r <= 0.0 or p_r <= 0.0
    a_l = 0.0 if vacuum_l else math.sqrt(gamma * p_l / rho_l)
    a_r = 0.0 if vacuum_r else math.sqrt(gamma * p_r / rho_r)
    front_l = u_l + 2.0 * a_l / (gamma - 1.0)
    front_r = u_r - 2.0 * a_r / (gamma - 1.0)
    if vacuum_l and vacuum_r:
        return 0.0, 0.5 * (u_l + u_r), 0.0, 0.0, 0
    if vacuum_l:
        return 0.0, front_r, 0.0, 0.0, 0
    if vacuum_r:
        return 0.0, front_l, 0.0, 0.0, 0
    if front_l <= front_r:
        return 0.0, 0.5 * (front_l + front_r), 0.0, 0.0, 0

    p = _pressure_guess(rho_l, u_l, p_l, a_l, rho_r, u_r, p_r, a_r, gamma)
    iterations = 0
    while iterations < max_iter:
        f_l, slope_l = _side(p, rho_l, p_l, a_l, gamma)
        f_r, slope_r = _side(p, rho_r, p_r, a_r, gamma)
        p_next = p - (f_l + f_r + u_r - u_l) / (slope_l + slope_r)
        if p_next <= 0.0:
            p_next = 0.01 * p
        change = 2.0 * abs(p_next - p) / (p_next + p)
        p = p_next
        iterations += 1
        if change <= tol:
            break
    f_l, slope_l = _side(p, rho_l, p_l, a_l, gamma)
    f_r, slope_r = _side(p, rho_r, p_r, a_r, gamma)
    u_star = 0.5 * (u_l + u_r) + 0.5 * (f_r - f_l)
    return (
        p,
        u_star,
        _side_density(p, rho_l, p_l, gamma),
        _side_density(p, rho_r, p_r, gamma),
        iterations,
    )


@njit(cache=True, error_model="numpy")
def _sample_left(
    rho: float, u: float, p: float, p_star: float, u_star: float, gamma: float, xi: float
) -> tuple[float, float, float]:
    """State at ``xi <= u_star``; the right half is its mirror image."""
    if rho <= 0.0 or p <= 0.0:
        return 0.0, u_star, 0.0
    a = math.sqrt(gamma * p / rho)
    if p_star > p:
        mach = math.sqrt((gamma + 1.0) / (2.0 * gamma) * (p_star / p - 1.0) + 1.0)
        if xi <= u - a * mach:
            return rho, u, p
        return _side_density(p_star, rho, p, gamma), u_star, p_star
    if xi <= u - a:
        return rho, u, p
    if p_star > 0.0:
        a_star = a * (p_star / p) ** ((gamma - 1.0) / (2.0 * gamma))
        if xi >= u_star - a_star:
            return _side_density(p_star, rho, p, gamma), u_star, p_star
    elif xi >= u + 2.0 * a / (gamma - 1.0):
        return 0.0, u_star, 0.0
    u_fan = 2.0 / (gamma + 1.0) * (a + 0.5 * (gamma - 1.0) * u + xi)
    a_ratio = (u_fan - xi) / a
    return (
        rho * a_ratio ** (2.0 / (gamma - 1.0)),
        u_fan,
        p * a_ratio ** (2.0 * gamma / (gamma - 1.0)),
    )


@njit(cache=True, error_model="numpy")
def sample(
    rho_l: float,
    u_l: float,
    p_l: float,
    rho_r: float,
    u_r: float,
    p_r: float,
    p_star: float,
    u_star: float,
    gamma: float,
    xi: float,
) -> tuple[float, float, float]:
    """Evaluates the self-similar solution at ``xi = x / t`` (Toro 4.5, 4.6).

    Args:
        rho_l: Density left, kg/m3.
        u_l: Velocity left, m/s.
        p_l: Pressure left, absolute Pa.
        rho_r: Density right, kg/m3.
        u_r: Velocity right, m/s.
        p_r: Pressure right, absolute Pa.
        p_star: Pressure between the waves, Pa, from `star_state` (0: vacuum).
        u_star: Velocity of the contact, m/s, from `star_state`.
        gamma: Ratio of specific heats.
        xi: Where to look, ``x / t``, m/s.

    Returns:
        ``(rho, u, p)`` there. On the contact itself, the left side's density.
    """
    if xi <= u_star:
        return _sample_left(rho_l, u_l, p_l, p_star, u_star, gamma, xi)
    rho, u, p = _sample_left(rho_r, -u_r, p_r, p_star, -u_star, gamma, -xi)
    return rho, -u, p


@njit(cache=True, error_model="numpy")
def exact_flux(
    rho_l: float,
    u_l: float,
    p_l: float,
    rho_r: float,
    u_r: float,
    p_r: float,
    gamma: float,
    iterations: int,
) -> tuple[float, float, float]:
    """Godunov's flux: that of the exact solution at ``x = 0`` (thesis eq. 4.22, corrected).

    Args:
        rho_l: Density left, kg/m3.
        u_l: Velocity left, m/s.
        p_l: Pressure left, absolute Pa.
        rho_r: Density right, kg/m3.
        u_r: Velocity right, m/s.
        p_r: Pressure right, absolute Pa.
        gamma: Ratio of specific heats.
        iterations: Newton iterations at most, e.g. `STEP_ITERATIONS`.

    Returns:
        Fluxes of mass kg/(m2 s), momentum Pa and energy W/m2.
    """
    p_star, u_star, _, _, _ = star_state(rho_l, u_l, p_l, rho_r, u_r, p_r, gamma, iterations, 1e-15)
    rho, u, p = sample(rho_l, u_l, p_l, rho_r, u_r, p_r, p_star, u_star, gamma, 0.0)
    mass = rho * u
    return mass, mass * u + p, u * (0.5 * mass * u + p * gamma / (gamma - 1.0))


# Inlined by force: a loop over faces only vectorises (5 times faster) with no call inside.
@njit(cache=True, error_model="numpy", forceinline=True)
def hllc_flux(
    rho_l: float, u_l: float, p_l: float, rho_r: float, u_r: float, p_r: float, gamma: float
) -> tuple[float, float, float]:
    """HLLC flux with pressure-based wave speeds (Toro 10.4-10.6).

    Uses the form ``(rho* S*, rho* S*^2 + p*, S* (E* + p*))`` of the star flux: equal to
    ``F + S (U* - U)`` by the jump conditions, but free of its cancellation, so that a contact at
    rest gives exactly (0, p, 0). Both densities and pressures must be positive.

    Args:
        rho_l: Density left, kg/m3.
        u_l: Velocity left, m/s.
        p_l: Pressure left, absolute Pa.
        rho_r: Density right, kg/m3.
        u_r: Velocity right, m/s.
        p_r: Pressure right, absolute Pa.
        gamma: Ratio of specific heats.

    Returns:
        Fluxes of mass kg/(m2 s), momentum Pa and energy W/m2.
    """
    # No branches and few divisions: the compiler can then do several interfaces at once.
    k_l = gamma / rho_l
    k_r = gamma / rho_r
    a_sum = math.sqrt(k_l * p_l) + math.sqrt(k_r * p_r)
    p_est = 0.5 * (p_l + p_r) - 0.125 * (u_r - u_l) * (rho_l + rho_r) * a_sum
    shock = 0.5 * (gamma + 1.0) / gamma
    # a_k sqrt(1 + shock (p_est / p_k - 1)) into a shock; the sound speed into a rarefaction, also
    # when the estimate is negative.
    s_l = u_l - math.sqrt(k_l * (p_l + shock * (p_est - p_l if p_est > p_l else 0.0)))
    s_r = u_r + math.sqrt(k_r * (p_r + shock * (p_est - p_r if p_est > p_r else 0.0)))
    m_l = rho_l * (s_l - u_l)  # negative: mass flux through the left wave
    m_r = rho_r * (s_r - u_r)
    s_star = (p_r - p_l + u_l * m_l - u_r * m_r) / (m_l - m_r)

    left = s_star >= 0.0
    rho = rho_l if left else rho_r
    u = u_l if left else u_r
    p = p_l if left else p_r
    s = s_l if left else s_r
    m = m_l if left else m_r
    energy = 0.5 * rho * u * u + p * (1.0 / (gamma - 1.0))
    scale = s_star / (s - s_star)
    p_star = p + m * (s_star - u)
    mass_star = m * scale
    energy_star = scale * ((s - u) * energy - p * u + p_star * s)
    supersonic = s_l >= 0.0 or s_r <= 0.0  # one side decides
    mass = rho * u if supersonic else mass_star
    momentum = rho * u * u + p if supersonic else mass_star * s_star + p_star
    power = u * (energy + p) if supersonic else energy_star
    return mass, momentum, power


def solve(
    left: Sequence[float],
    right: Sequence[float],
    xi: ArrayLike,
    gamma: float = 1.4,
) -> NDArray[np.float64]:
    """Evaluates the exact solution of a Riemann problem, as a reference for schemes.

    Args:
        left: Density, velocity and pressure left of ``x = 0``.
        right: Density, velocity and pressure right of it.
        xi: Positions over time, ``x / t``, m/s, any shape.
        gamma: Ratio of specific heats.

    Returns:
        Density, velocity and pressure at each position, shape (3, *xi.shape).

    Raises:
        InputError: A state is not three finite numbers or has negative density or pressure.
    """
    left_state, right_state = _checked("left", left), _checked("right", right)
    p_star, u_star, _, _, _ = star_state(
        *left_state, *right_state, gamma, REFERENCE_ITERATIONS, REFERENCE_TOLERANCE
    )
    positions = np.asarray(xi, dtype=float)
    points = [
        sample(*left_state, *right_state, p_star, u_star, gamma, float(x))
        for x in positions.ravel()
    ]
    return np.array(points, dtype=float).reshape(-1, 3).T.reshape(3, *positions.shape)


def wave_speeds(
    left: Sequence[float], right: Sequence[float], gamma: float = 1.4
) -> tuple[float, float, float, float, float]:
    """Returns the speeds (m/s) that bound the regions of the exact solution, left to right.

    Args:
        left: Density, velocity and pressure left of ``x = 0``.
        right: Density, velocity and pressure right of it.
        gamma: Ratio of specific heats.

    Returns:
        Left wave's first and last edge, contact, right wave's first and last edge. A shock's two
        edges coincide; next to a vacuum the fan's inner edge is the front.

    Raises:
        InputError: As for `solve`.
    """
    left_state, right_state = _checked("left", left), _checked("right", right)
    p_star, u_star, _, _, _ = star_state(
        *left_state, *right_state, gamma, REFERENCE_ITERATIONS, REFERENCE_TOLERANCE
    )

    def edges(rho: float, u: float, p: float, contact: float) -> tuple[float, float]:
        """Outer and inner edge of the wave that runs to the left into (rho, u, p)."""
        if rho <= 0.0 or p <= 0.0:
            return contact, contact
        a = math.sqrt(gamma * p / rho)
        if p_star > p:
            mach = math.sqrt(1.0 + (gamma + 1.0) / (2.0 * gamma) * (p_star / p - 1.0))
            return u - a * mach, u - a * mach
        if p_star <= 0.0:
            return u - a, u + 2.0 * a / (gamma - 1.0)
        return u - a, contact - a * (p_star / p) ** ((gamma - 1.0) / (2.0 * gamma))

    head_l, tail_l = edges(*left_state, u_star)
    rho_r, u_r, p_r = right_state
    head_r, tail_r = edges(rho_r, -u_r, p_r, -u_star)
    return head_l, tail_l, float(u_star), -tail_r, -head_r


def _checked(side: str, state: Sequence[float]) -> tuple[float, float, float]:
    """Returns a state as three floats, or says what is wrong with it."""
    values = tuple(float(value) for value in state)
    if len(values) != 3 or not all(math.isfinite(value) for value in values):
        raise InputError(f"{side} state: found {values}, three finite numbers (rho, u, p) needed")
    if values[0] < 0.0 or values[2] < 0.0:
        raise InputError(f"{side} state: found {values}, density and pressure must not be negative")
    return values[0], values[1], values[2]
