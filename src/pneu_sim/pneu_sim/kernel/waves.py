# SPDX-License-Identifier: Apache-2.0
"""Waves of any strength that run into a pipe from its end, and the powers that they are made of."""

import math

from pneu_sim.compiling import folded, inlined

NEAR = 0.03
"""How near 1 the series of a power is taken."""


@inlined
def power(x, a):
    """``x**a``, by the binomial series near 1, where the gas at most ends is.

    Args:
        x: A positive number.
        a: Exponent, from 0.1 to 12.

    Returns:
        The power; the relative error of the series is below 1e-14.
    """
    e = x - 1.0
    if abs(e) > NEAR:
        return math.exp(a * math.log(x))
    c2 = a * (a - 1.0) * (1.0 / 2.0)
    c3 = c2 * (a - 2.0) * (1.0 / 3.0)
    c4 = c3 * (a - 3.0) * (1.0 / 4.0)
    c5 = c4 * (a - 4.0) * (1.0 / 5.0)
    c6 = c5 * (a - 5.0) * (1.0 / 6.0)
    c7 = c6 * (a - 6.0) * (1.0 / 7.0)
    c8 = c7 * (a - 7.0) * (1.0 / 8.0)
    c9 = c8 * (a - 8.0) * (1.0 / 9.0)
    e2 = e * e  # Estrin's scheme: a sum of ten that waits for few others
    e4 = e2 * e2
    low = (1.0 + a * e) + (c2 + c3 * e) * e2
    high = (c4 + c5 * e) + (c6 + c7 * e) * e2
    return low + e4 * (high + e4 * (c8 + c9 * e))


@folded
def wave_state(d, v, p, out, gamma):
    """State at a pipe's end whose gas is given an outflow velocity, behind the exact wave.

    A shock where the gas is pushed back, a rarefaction where it is drawn out (Toro 2009,
    eq. 4.6-4.9).

    Args:
        d: Density in the pipe's end, kg/m^3.
        v: Velocity there, positive out of the pipe, m/s.
        p: Pressure there, Pa.
        out: Outflow velocity at the end, m/s.
        gamma: Ratio of specific heats.

    Returns:
        Density, pressure, and decrease of the pressure per velocity in kg/(m^2 s).
    """
    c2 = gamma * p / d
    back = v - out
    if back >= 0.0:
        k = 0.25 * (gamma + 1.0) * back
        s = math.sqrt(k * k + c2)
        q = p + d * back * (k + s)
        above, below = gamma + 1.0, gamma - 1.0
        behind = d * (above * q + below * p) / (below * q + above * p)
        return behind, q, d * (2.0 * k + s + k * k / s)
    c = math.sqrt(c2)
    r = max(1.0 + 0.5 * (gamma - 1.0) * back / c, 0.01)
    y = power(r, 2.0 / (gamma - 1.0))
    q = p * y * r * r
    return d * y, q, gamma * q / (c * r)


@folded
def leaving(d, v, p, q, gamma):
    """Outflow velocity and density at a pipe's end of a given pressure; inverse of `wave_state`.

    Args:
        d: Density in the pipe's end, kg/m^3.
        v: Velocity there, positive out of the pipe, m/s.
        p: Pressure there, Pa.
        q: Pressure at the end, Pa.
        gamma: Ratio of specific heats.
    """
    if q >= p:
        above, below = gamma + 1.0, gamma - 1.0
        out = v - (q - p) * math.sqrt(2.0 / (d * (above * q + below * p)))
        return out, d * (above * q + below * p) / (below * q + above * p)
    x = q / p
    r = power(x, 0.5 * (gamma - 1.0) / gamma)
    out = v + 2.0 / (gamma - 1.0) * math.sqrt(gamma * p / d) * (1.0 - r)
    return out, d * x / (r * r)


@folded
def shock_swept_out(d, v, p, q, gamma):
    """Whether outflow is supersonic and carries off the shock that the end's pressure would send.

    That shock is no stronger than the normal shock of the flow, which stands still.

    Args:
        d: Density in the pipe's end, kg/m^3.
        v: Velocity there, positive out of the pipe, m/s.
        p: Pressure there, Pa.
        q: Pressure at the end, Pa.
        gamma: Ratio of specific heats.
    """
    head = d * v * v
    if v <= 0.0 or head <= gamma * p:
        return False
    return q < p + 2.0 / (gamma + 1.0) * (head - gamma * p)


@folded
def choked_velocity(d, v, p, gamma):
    """Highest velocity at which gas leaves a pipe's end: sonic there, or what it has already.

    Args:
        d: Density in the pipe's end, kg/m^3.
        v: Velocity there, positive out of the pipe, m/s.
        p: Pressure there, Pa.
        gamma: Ratio of specific heats.
    """
    c = math.sqrt(gamma * p / d)
    return max((2.0 * c + (gamma - 1.0) * v) / (gamma + 1.0), v)


@folded
def equal_flux_velocity(d, v, p, out, h0, gamma):
    """Interior velocity that inflow is compared with: of the same mass flux at its density.

    In steady flow with friction or heat the density at the end and in the cell's middle differ, and
    so do the velocities, but not the mass flux; their difference is no wave.

    Args:
        d: Density in the pipe's end, kg/m^3.
        v: Velocity there, positive out of the pipe, m/s.
        p: Pressure there, Pa.
        out: Velocity at the end, m/s; negative is of gas that enters.
        h0: Total enthalpy of gas that enters, J/kg.
        gamma: Ratio of specific heats.
    """
    if out >= 0.0 or v >= 0.0:
        return v
    return v * (gamma - 1.0) / gamma * d / p * (h0 - 0.5 * out * out)


@folded
def end_curve(d, v, p, out, h0, gamma):
    """State and mass flux at a pipe's end of a given outflow velocity; negative is inflow.

    Args:
        d: Density in the pipe's end, kg/m^3.
        v: Velocity there, positive out of the pipe, m/s.
        p: Pressure there, Pa.
        out: Velocity at the end, m/s; negative is of gas that enters.
        h0: Total enthalpy of gas that enters, J/kg.
        gamma: Ratio of specific heats.

    Returns:
        Density and pressure at the end, decrease of the pressure per velocity, mass flux in
        kg/(m^2 s), and its increase per velocity, which is zero where the outflow is sonic.
    """
    df, q, z = wave_state(d, v, p, out, gamma)
    if out < 0.0:
        h = h0 - 0.5 * out * out
        df = gamma / (gamma - 1.0) * q / h
        return df, q, z, df * out, df + out * df * (out / h - z / q)
    return df, q, z, df * out, df - out * df / (gamma * q) * z
