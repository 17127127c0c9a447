# SPDX-License-Identifier: Apache-2.0
"""Equations of a cart with a rod that turns on it; see ``pneu_sim.bodies.cart_pole``."""

import math

from pneu_sim.compiling import branching


@branching
def mechanics(par, b, j, q, v, mass, force):
    """Mass matrix, weight and centrifugal force; see ``pneu_sim.bodies.base``.

    Args:
        par: Numbers of all bodies.
        b: Which body.
        j: Which lane.
        q: (2,) positions, m and rad.
        v: (2,) velocities.
        mass: (2, 2) written.
        force: (2,) written.
    """
    c, s = math.cos(q[1]), math.sin(q[1])
    first = par[b, 1, j]
    mass[0, 0] = par[b, 0, j]
    mass[0, 1] = first * c
    mass[1, 0] = first * c
    mass[1, 1] = par[b, 2, j]
    force[0] = first * s * v[1] * v[1]
    force[1] = par[b, 3, j] * s


@branching
def levers(par, b, j, q, extension, lever):
    """The extension is the cart's way; see ``pneu_sim.bodies.base``.

    Args:
        par: Numbers of all bodies.
        b: Which body.
        j: Which lane.
        q: (2,) positions, m and rad.
        extension: (1,) written.
        lever: (1, 2) written.
    """
    extension[0] = q[0] - par[b, 4, j]
    lever[0, 0] = 1.0
    lever[0, 1] = 0.0
