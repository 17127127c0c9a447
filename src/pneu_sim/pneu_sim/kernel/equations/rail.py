# SPDX-License-Identifier: Apache-2.0
"""Equations of a mass on a rail; see ``pneu_sim.bodies.rail``."""

from pneu_sim.compiling import branching


@branching
def mechanics(par, b, j, q, v, mass, force):
    """Mass and weight; see ``pneu_sim.bodies.base``.

    Args:
        par: Numbers of all bodies.
        b: Which body.
        j: Which lane.
        q: (1,) position, m.
        v: (1,) velocity, m/s.
        mass: (1, 1) written.
        force: (1,) written.
    """
    mass[0, 0] = par[b, 0, j]
    force[0] = -par[b, 1, j]


@branching
def levers(par, b, j, q, extension, lever):
    """The extension is the coordinate; see ``pneu_sim.bodies.base``.

    Args:
        par: Numbers of all bodies.
        b: Which body.
        j: Which lane.
        q: (1,) position, m.
        extension: (1,) written.
        lever: (1, 1) written.
    """
    extension[0] = q[0]
    lever[0, 0] = 1.0
