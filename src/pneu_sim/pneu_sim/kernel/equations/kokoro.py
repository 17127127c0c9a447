# SPDX-License-Identifier: Apache-2.0
"""Equations of a link on two joints; see ``pneu_sim.bodies.kokoro``."""

import math

from pneu_sim.bodies.kokoro import CRANK
from pneu_sim.compiling import branching
from pneu_sim.kernel.equations.crank import crank


@branching
def mechanics(par, b, j, q, v, mass, force):
    """Mass matrix, weight and Coriolis forces of equation 9.1.

    Args:
        par: Numbers of all bodies.
        b: Which body.
        j: Which lane.
        q: (2,) angles alpha and theta, rad.
        v: (2,) velocities, rad/s.
        mass: (2, 2) written.
        force: (2,) written.
    """
    c, s = math.cos(q[1]), math.sin(q[1])
    w2, weight = par[b, 1, j], par[b, 2, j]
    mass[0, 0] = par[b, 0, j] + c * c * w2
    mass[0, 1] = 0.0
    mass[1, 0] = 0.0
    mass[1, 1] = w2
    force[0] = 2.0 * v[0] * v[1] * s * c * w2 + c * math.sin(q[0]) * weight
    force[1] = -v[0] * v[0] * c * s * w2 + s * math.cos(q[0]) * weight


@branching
def levers(par, b, j, q, extension, lever):
    """Extension by the slider-crank, and the rotary actuator's angle, which is alpha.

    Args:
        par: Numbers of all bodies.
        b: Which body.
        j: Which lane.
        q: (2,) angles alpha and theta, rad.
        extension: (1,) or, with a rotary actuator, (2,) written.
        lever: (1, 2) or (2, 2) written.
    """
    extension[0], lever[0, 1] = crank(par, b, j, CRANK, q[1])
    lever[0, 0] = 0.0
    if par[b, 3, j] > 0.0:
        extension[1] = q[0]
        lever[1, 0] = 1.0
        lever[1, 1] = 0.0
