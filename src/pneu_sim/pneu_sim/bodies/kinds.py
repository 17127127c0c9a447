# SPDX-License-Identifier: Apache-2.0
"""All kinds of body that a rig file may have: one line each in every table."""

from typing import Annotated

from pydantic import Field

from pneu_sim.bodies.arm import Arm
from pneu_sim.bodies.base import Body
from pneu_sim.bodies.cart_pole import CartPole
from pneu_sim.bodies.dog import Dog
from pneu_sim.bodies.kokoro import Kokoro
from pneu_sim.bodies.rail import Rail

AnyBody = Annotated[Rail | CartPole | Arm | Kokoro | Dog, Field(discriminator="kind")]
"""What a rig file may have."""
NUMBER: dict[type[Body], int] = {Rail: 0, CartPole: 1, Arm: 2, Kokoro: 3, Dog: 4}
"""By which number the kernel knows each; see ``pneu_sim.kernel.equations.kinds``."""
