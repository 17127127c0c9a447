# SPDX-License-Identifier: Apache-2.0
"""Equations of all kinds of body by number: one line each; see ``pneu_sim.bodies.kinds``."""

from pneu_sim.compiling import branching, entry
from pneu_sim.kernel.equations.arm import levers as arm_levers
from pneu_sim.kernel.equations.arm import mechanics as arm_mechanics
from pneu_sim.kernel.equations.cart_pole import levers as cart_pole_levers
from pneu_sim.kernel.equations.cart_pole import mechanics as cart_pole_mechanics
from pneu_sim.kernel.equations.dog import levers as dog_levers
from pneu_sim.kernel.equations.dog import mechanics as dog_mechanics
from pneu_sim.kernel.equations.kokoro import levers as kokoro_levers
from pneu_sim.kernel.equations.kokoro import mechanics as kokoro_mechanics
from pneu_sim.kernel.equations.rail import levers as rail_levers
from pneu_sim.kernel.equations.rail import mechanics as rail_mechanics

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
        rail_mechanics(par, b, j, q, v, mass, force)
    elif kind == 1:
        cart_pole_mechanics(par, b, j, q, v, mass, force)
    elif kind == 2:
        arm_mechanics(par, b, j, q, v, mass, force)
    elif kind == 3:
        kokoro_mechanics(par, b, j, q, v, mass, force)
    elif kind == 4:
        dog_mechanics(par, b, j, q, v, mass, force)


@entry
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
        rail_levers(par, b, j, q, extension, lever)
    elif kind == 1:
        cart_pole_levers(par, b, j, q, extension, lever)
    elif kind == 2:
        arm_levers(par, b, j, q, extension, lever)
    elif kind == 3:
        kokoro_levers(par, b, j, q, extension, lever)
    elif kind == 4:
        dog_levers(par, b, j, q, extension, lever)
