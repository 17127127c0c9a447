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
def pushed(d, v, p, out, gamma):
    """Pressure at a pipe's end where its gas leaves with a velocity of its own.

    Exact: behind a shock where the gas is pushed back, in a rarefaction where it is drawn out
    (Toro 2009, eq. 4.6-4.9).

    Args:
        d: Density in the pipe's end, kg/m^3.
        v: Velocity there, positive out of the pipe, m/s.
        p: Pressure there, Pa.
        out: Velocity at the end, m/s.
        gamma: Ratio of specific heats.

    Returns:
        Pressure, and by how much it falls per velocity, kg/(m^2 s).
    """
    c2 = gamma * p / d
    back = v - out
    if back >= 0.0:
        k = 0.25 * (gamma + 1.0) * back
        s = math.sqrt(k * k + c2)
        return p + d * back * (k + s), d * (2.0 * k + s + k * k / s)
    c = math.sqrt(c2)
    r = max(1.0 + 0.5 * (gamma - 1.0) * back / c, 0.05)
    q = p * power(r, 2.0 / (gamma - 1.0)) * r * r
    return q, gamma * q / (c * r)


@folded
def leaving(d, v, p, q, gamma):
    """Velocity and density at a pipe's end on which there is a pressure; turns `pushed` round.

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
    r = power(q / p, 0.5 * (gamma - 1.0) / gamma)
    out = v + 2.0 / (gamma - 1.0) * math.sqrt(gamma * p / d) * (1.0 - r)
    return out, d * power(r, 2.0 / (gamma - 1.0))


@folded
def swept(d, v, p, q, gamma):
    """Whether gas leaves so fast that what a pressure at the end sends into the pipe is swept out.

    It is a shock then that is no stronger than one at rest in that flow.

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
def fastest(d, v, p, gamma):
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
def met(d, v, p, out, h0, gamma):
    """Velocity of the gas that meets what enters a pipe: as fast as its flow makes what enters.

    Along a line that is warmed or drags, gas at its end and in the middle of its cell differ in
    density and velocity, not in flow; a difference of velocities would be taken for a wave.

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
    """State and flow at a pipe's end whose gas leaves with a velocity, or enters.

    Args:
        d: Density in the pipe's end, kg/m^3.
        v: Velocity there, positive out of the pipe, m/s.
        p: Pressure there, Pa.
        out: Velocity at the end, m/s; negative is of gas that enters.
        h0: Total enthalpy of gas that enters, J/kg.
        gamma: Ratio of specific heats.

    Returns:
        Density and pressure at the end, by how much the pressure falls per velocity, the flow per
        area in kg/(m^2 s), and by how much that grows per velocity; it no longer does where the
        gas leaves at its own speed of sound.
    """
    c2 = gamma * p / d
    back = v - out
    if back >= 0.0:  # as in `pushed`, but with the density
        k = 0.25 * (gamma + 1.0) * back
        s = math.sqrt(k * k + c2)
        q, z = p + d * back * (k + s), d * (2.0 * k + s + k * k / s)
        above, below = gamma + 1.0, gamma - 1.0
        df = d * (above * q + below * p) / (below * q + above * p)
    else:
        c = math.sqrt(c2)
        r = max(1.0 + 0.5 * (gamma - 1.0) * back / c, 0.05)
        y = power(r, 2.0 / (gamma - 1.0))
        q = p * y * r * r
        df, z = d * y, gamma * q / (c * r)
    if out < 0.0:
        h = h0 - 0.5 * out * out
        df = gamma / (gamma - 1.0) * q / h
        return df, q, z, df * out, df + out * df * (out / h - z / q)
    return df, q, z, df * out, df - out * df / (gamma * q) * z
