# SPDX-License-Identifier: Apache-2.0
"""All kinds of body, in a rig file and in the kernel: one line each in every table."""

from typing import Annotated

from pydantic import Field

from pneu_sim.bodies import arm, cart_pole, dog, kokoro, rail
from pneu_sim.bodies.arm import Arm
from pneu_sim.bodies.base import Body
from pneu_sim.bodies.cart_pole import CartPole
from pneu_sim.bodies.dog import Dog
from pneu_sim.bodies.kokoro import Kokoro
from pneu_sim.bodies.rail import Rail
from pneu_sim.compiling import branching

AnyBody = Annotated[Rail | CartPole | Arm | Kokoro | Dog, Field(discriminator="kind")]
"""What a rig file may have."""
NUMBER: dict[type[Body], int] = {Rail: 0, CartPole: 1, Arm: 2, Kokoro: 3, Dog: 4}
"""By which number the kernel knows each."""


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
    if kind == 0:
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
    if kind == 0:
        rail.levers(par, b, j, q, extension, lever)
    elif kind == 1:
        cart_pole.levers(par, b, j, q, extension, lever)
    elif kind == 2:
        arm.levers(par, b, j, q, extension, lever)
    elif kind == 3:
        kokoro.levers(par, b, j, q, extension, lever)
    elif kind == 4:
        dog.levers(par, b, j, q, extension, lever)
