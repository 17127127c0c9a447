# SPDX-License-Identifier: Apache-2.0
"""Equations of an arm of two links; see ``pneu_sim.bodies.arm``."""

import math

from pneu_sim.bodies.arm import CRANKS
from pneu_sim.bodies.crank import CRANK_NUMBERS
from pneu_sim.compiling import branching
from pneu_sim.kernel.equations.crank import crank


@branching
def mechanics(par, b, j, q, v, mass, force):
    """Mass matrix, weight and Coriolis forces; equations at the file's top.

    Args:
        par: Numbers of all bodies.
        b: Which body.
        j: Which lane.
        q: (2,) angles, rad.
        v: (2,) velocities, rad/s.
        mass: (2, 2) written.
        force: (2,) written.
    """
    both = par[b, 2, j] * math.cos(q[1])
    turning = par[b, 2, j] * math.sin(q[1])
    upper, fore = v[0], v[0] + v[1]
    mass[1, 1] = par[b, 1, j]
    mass[0, 1] = par[b, 1, j] + both
    mass[1, 0] = par[b, 1, j] + both
    mass[0, 0] = par[b, 0, j] + par[b, 1, j] + 2.0 * both
    on_fore = -turning * upper * upper - par[b, 4, j] * math.cos(q[0] + q[1])
    force[0] = on_fore + turning * fore * fore - par[b, 3, j] * math.cos(q[0])
    force[1] = on_fore


@branching
def levers(par, b, j, q, extension, lever):
    """Extensions by the two cranks; see ``pneu_sim.bodies.crank``.

    Args:
        par: Numbers of all bodies.
        b: Which body.
        j: Which lane.
        q: (2,) angles, rad.
        extension: (2,) written.
        lever: (2, 2) written.
    """
    extension[0], lever[0, 0] = crank(par, b, j, CRANKS, q[0])
    extension[1], lever[1, 1] = crank(par, b, j, CRANKS + CRANK_NUMBERS, q[1])
    lever[0, 1] = 0.0
    lever[1, 0] = 0.0
