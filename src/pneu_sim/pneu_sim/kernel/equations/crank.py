# SPDX-License-Identifier: Apache-2.0
"""Equations of cylinders on cranks; see ``pneu_sim.bodies.crank``."""

import math

from pneu_sim.bodies.crank import SHORTEST_M
from pneu_sim.compiling import folded


@folded
def crank(par, b, j, at, q):
    """Extension of a cylinder, and its growth per turn of the joint; equations at the file's top.

    Args:
        par: Numbers of all bodies.
        b: Which body.
        j: Which lane.
        at: Where the crank's numbers begin.
        q: Angle of the joint, rad.

    Returns:
        Extension, m, and its derivative by the angle, m/rad.
    """
    c, s = math.cos(q), math.sin(q)
    a, e = par[b, at + 1, j], par[b, at + 2, j]
    # Rounding may take the square below zero, but only where pivot and pin meet.
    length = math.sqrt(max(par[b, at, j] - a * c - e * s, SHORTEST_M * SHORTEST_M))
    return length - par[b, at + 3, j], 0.5 * (a * s - e * c) / length
