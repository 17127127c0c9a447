# SPDX-License-Identifier: Apache-2.0
"""What a rig file may say of a drag test: which cylinder a machine drags, and its channels."""

from typing import Literal

from pneu_sim.channels import Channel
from pneu_sim.parts import Part


class Drag(Part):
    """A machine that drags a cylinder to and fro and reads the force, for ``pneu friction``.

    Attributes:
        cylinder: The cylinder that is dragged.
        side: Side whose pressure is measured; the other is open to the room unless it has a
            channel, too.
        pressure: Its absolute pressure, Pa.
        other_pressure: Absolute pressure of the other side, Pa, where it is measured.
        force: Force with which the machine holds the rod against the gas, N: positive where it
            presses the rod in.
        position: Extension of the piston, m, from wherever its sensor counts.
    """

    cylinder: str
    side: Literal["head", "rod"] = "head"
    pressure: Channel
    other_pressure: Channel | None = None
    force: Channel
    position: Channel
