# SPDX-License-Identifier: Apache-2.0
"""Equations of the ground under feet; see ``pneu_sim.bodies.ground``."""

from pneu_sim.compiling import folded


@folded
def contact(par, b, j, at, z, u, w):
    """Force of the ground on a point.

    Args:
        par: Numbers of all bodies.
        b: Which body.
        j: Which lane.
        at: Where the ground's numbers begin.
        z: Height of the point, m.
        u: Its speed along the ground, m/s.
        w: Its speed upwards, m/s.

    Returns:
        Force along the ground and upwards, N.
    """
    normal = par[b, at, j] * max(-z, 0.0) * max(1.0 - par[b, at + 1, j] * w, 0.0)
    most = par[b, at + 2, j] * normal
    slip = 0.5 * u / (par[b, at + 3, j] + most / par[b, at + 4, j])
    slip = min(max(slip, -1.0), 1.0)
    return -most * slip * (2.0 - abs(slip)), normal
