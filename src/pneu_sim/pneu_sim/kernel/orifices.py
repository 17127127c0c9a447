# SPDX-License-Identifier: Apache-2.0
"""Flow through orifices: ISO 6358 between two lines, and the isentropic orifice."""

import math

from pneu_sim.compiling import folded

ANR_DENSITY = 1.185  # kg/m^3, ISO 6358 reference state
ANR_TEMPERATURE = 293.15  # K


@folded
def iso6358_flow(p_a, z_a, t_a, p_b, z_b, t_b, conductance, ratio, laminar=1.0, share=1.0):
    """Mass flow a to b through an ISO 6358 port between two lines, in closed form.

    The pressures at the port follow the flow along the characteristics that reach it,
    p1 = p_a - z_a m and p2 = p_b + z_b m with z = c / A (zero for a chamber or reservoir), so the
    flow is implicit and needs no laminar patch where the pressures meet.

    Args:
        p_a: Pressure of side a with no flow, Pa.
        z_a: Impedance of side a, by how much its pressure falls per flow, 1/(m s).
        t_a: Temperature of side a, K.
        p_b: Pressure of side b with no flow, Pa.
        z_b: Impedance of side b, 1/(m s).
        t_b: Temperature of side b, K.
        conductance: Sonic conductance C times opening, m^3/(s Pa).
        ratio: Critical pressure ratio b.
        laminar: Pressure ratio above which the flow is linear in the pressure drop; 1 is never.
        share: Flow where that range ends, of what ISO 6358 gives there; below 1 it jumps.

    Returns:
        Mass flow in kg/s, positive from a to b.
    """
    if conductance <= 0.0:
        return 0.0
    sign = 1.0
    if p_b > p_a:
        p_a, p_b = p_b, p_a
        z_a, z_b = z_b, z_a
        t_a = t_b
        sign = -1.0
    k = conductance * ANR_DENSITY * math.sqrt(ANR_TEMPERATURE / t_a)
    z = z_a + z_b
    d = p_a - p_b
    above = 1.0 - ratio
    if laminar < 1.0:
        # slope s = k_lin / over of the flow, in the equation m = s (d - z m)
        over = above * (1.0 - laminar)
        k_lin = share * k * math.sqrt(above * above - (laminar - ratio) ** 2)
        m = k_lin * d / (over + k_lin * z)
        if p_b + z_b * m > laminar * (p_a - z_a * m):
            return sign * m
    wide = 1.0 + k * z_a
    if p_b * wide + z_b * k * p_a <= ratio * p_a:
        return sign * (k * p_a / wide)
    e = (1.0 - 2.0 * ratio) * p_a + p_b
    g = (1.0 - 2.0 * ratio) * z_a - z_b
    b1 = k * (z * e + d * g)
    disc = b1 * b1 + 4.0 * (above * above - k * k * z * g) * d * e
    root, squared = math.sqrt(max(disc, 0.0)), above * above - k * k * z * g
    if b1 >= 0.0 or squared <= 0.0:
        m = 2.0 * k * d * e / (b1 + root + 1e-300)
    else:  # the same root without its cancellation
        m = k * (root - b1) / (2.0 * squared)
    if share < 1.0 and laminar < 1.0 and p_b + z_b * m > laminar * (p_a - z_a * m):
        # what the lines let through lies within the jump, where the pressures' ratio stands
        m = (laminar * p_a - p_b) / max(z_b + laminar * z_a, 1e-300)
    return sign * m


@folded
def orifice_flow(p_a, t_a, p_b, area, gamma, r_gas):
    """Isentropic orifice (thesis eq. 3.15-3.17): mass flow in kg/s from a to b, p_a >= p_b.

    Args:
        p_a: Upstream pressure, Pa.
        t_a: Upstream temperature, K.
        p_b: Downstream pressure, Pa.
        area: Effective area, m2.
        gamma: Ratio of specific heats.
        r_gas: Specific gas constant, J/(kg K).
    """
    x = max(p_b / p_a, (2.0 / (gamma + 1.0)) ** (gamma / (gamma - 1.0)))
    s = x ** (2.0 / gamma) - x ** ((gamma + 1.0) / gamma)
    return (
        area * p_a / math.sqrt(r_gas * t_a) * math.sqrt(max(2.0 * gamma / (gamma - 1.0) * s, 0.0))
    )
