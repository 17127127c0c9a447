# SPDX-License-Identifier: Apache-2.0
"""All kinds of body, in a rig file and in the kernel: one line each in every table."""

from typing import Annotated

from pydantic import Field

from pneu_sim.bodies import rail
from pneu_sim.bodies.base import Body
from pneu_sim.bodies.rail import Rail
from pneu_sim.compiling import branching

AnyBody = Annotated[Rail, Field(discriminator="kind")]
"""What a rig file may have."""
NUMBER: dict[type[Body], int] = {Rail: 0}
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
