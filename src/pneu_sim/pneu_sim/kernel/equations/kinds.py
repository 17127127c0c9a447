# SPDX-License-Identifier: Apache-2.0
"""Equations of all kinds of body by number: one line each; see ``pneu_sim.bodies.kinds``."""

from pneu_sim.compiling import branching
from pneu_sim.kernel.equations import arm, cart_pole, dog, kokoro, rail

RAIL = 0
"""The kind whose piston moves along with it, and so is a part of its weight."""


@branching
def mechanics(kind, par, b, j, q, v, mass, force):
    """Mass matrix, and the forces but those of cylinders, of a body of any kind.

    Args:
        kind: Its number.
        par: Numbers of all bodies.
        b: Which body.
        j: Which lane.
        q: (joints,) positions.
        v: (joints,) velocities.
        mass: (joints, joints) written.
        force: (joints,) written.
    """
    if kind == RAIL:
        rail.mechanics(par, b, j, q, v, mass, force)
    elif kind == 1:
        cart_pole.mechanics(par, b, j, q, v, mass, force)
    elif kind == 2:
        arm.mechanics(par, b, j, q, v, mass, force)
    elif kind == 3:
        kokoro.mechanics(par, b, j, q, v, mass, force)
    elif kind == 4:
        dog.mechanics(par, b, j, q, v, mass, force)


@branching
def levers(kind, par, b, j, q, extension, lever):
    """Extensions of the cylinders of a body of any kind, and their growth per motion of joints.

    Args:
        kind: Its number.
        par: Numbers of all bodies.
        b: Which body.
        j: Which lane.
        q: (joints,) positions.
        extension: (cylinders,) written, m or rad.
        lever: (cylinders, joints) written.
    """
    if kind == RAIL:
        rail.levers(par, b, j, q, extension, lever)
    elif kind == 1:
        cart_pole.levers(par, b, j, q, extension, lever)
    elif kind == 2:
        arm.levers(par, b, j, q, extension, lever)
    elif kind == 3:
        kokoro.levers(par, b, j, q, extension, lever)
    elif kind == 4:
        dog.levers(par, b, j, q, extension, lever)
