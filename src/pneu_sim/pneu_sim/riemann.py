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
from pneu_sim.compiling import compiled, inlined

STEP_ITERATIONS = 2
"""Newton iterations that suffice inside a time step (thesis 4.6.3)."""

REFERENCE_ITERATIONS = 100
"""Upper bound on Newton iterations when the star state is wanted to rounding."""

REFERENCE_TOLERANCE = 1e-15
"""Relative pressure change at which the reference solution counts as converged."""


@compiled
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


@compiled
def _side_density(p_star: float, rho_k: float, p_k: float, gamma: float) -> float:
    """Density between one wave and the contact."""
    ratio = p_star / p_k
    if p_star > p_k:
        g = (gamma - 1.0) / (gamma + 1.0)
        return rho_k * (ratio + g) / (g * ratio + 1.0)
    return rho_k * ratio ** (1.0 / gamma)


@compiled
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


@compiled
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


@compiled
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


@compiled
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


@compiled
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


@inlined
def hllc(
    d1: float,
    v1: float,
    q1: float,
    i1: float,
    d2: float,
    v2: float,
    q2: float,
    i2: float,
    speeds: float,
    gamma: float,
) -> tuple[float, float, float]:
    """HLLC flux with pressure-based wave speeds (Toro 2009, sec. 10.5.2), for few divisions.

    The star flux is ``F + S (U* - U)`` over one common denominator. A contact at rest gives exactly
    (0, p, 0). Densities and pressures must be positive.

    Args:
        d1: Density left, kg/m3.
        v1: Velocity left, m/s.
        q1: Pressure left, absolute Pa.
        i1: Inverse density left, m3/kg.
        d2: Density right, kg/m3.
        v2: Velocity right, m/s.
        q2: Pressure right, absolute Pa.
        i2: Inverse density right, m3/kg.
        speeds: Sum of both sides' speeds of sound, for the estimate of the star pressure, m/s.
        gamma: Ratio of specific heats.

    Returns:
        Fluxes of mass kg/(m2 s), momentum Pa and energy W/m2.
    """
    gm = 1.0 / (gamma - 1.0)
    k = (gamma + 1.0) / (2.0 * gamma)
    q = 0.5 * (q1 + q2) - 0.125 * (v2 - v1) * (d1 + d2) * speeds
    # the sound speed into a rarefaction, also when the estimate is negative
    s1 = v1 - math.sqrt(gamma * i1 * (q1 + k * max(q - q1, 0.0)))
    s2 = v2 + math.sqrt(gamma * i2 * (q2 + k * max(q - q2, 0.0)))
    a1 = d1 * (s1 - v1)  # negative: mass flux through the left wave
    a2 = d2 * (s2 - v2)
    # Speed of the contact s = x / a, with a < 0; for one at rest every product below vanishes
    # exactly. It shares one division with the weight g of the star flux.
    x = (q2 - q1) + (a1 * v1 - a2 * v2)
    a = a1 - a2
    left = x <= 0.0
    sk = s1 if left else s2
    sb = min(s1, 0.0) if left else max(s2, 0.0)
    b = sk * a - x
    y = 1.0 / (a * b)
    s = x * b * y
    g = sb * a * a * y  # = sb / (sk - s): zero where the flow through the face is supersonic
    d = d1 if left else d2
    v = v1 if left else v2
    q = q1 if left else q2
    a = a1 if left else a2
    e = q * gm + 0.5 * d * v * v
    dv = s - v
    m = d * v
    x = q + a * dv
    return (
        m + g * d * dv,
        m * v + q + g * (dv * m + x - q),
        v * (e + q) + g * (dv * e + x * s - q * v),
    )


@inlined
def hllc_flux(
    rho_l: float, u_l: float, p_l: float, rho_r: float, u_r: float, p_r: float, gamma: float
) -> tuple[float, float, float]:
    """`hllc` from two states alone.

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
    i_l = 1.0 / rho_l
    i_r = 1.0 / rho_r
    speeds = math.sqrt(gamma * p_l * i_l) + math.sqrt(gamma * p_r * i_r)
    return hllc(rho_l, u_l, p_l, i_l, rho_r, u_r, p_r, i_r, speeds, gamma)


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
