# SPDX-License-Identifier: Apache-2.0
"""From a rig to the lumped model that it names."""

from pneu_sim.gas import AIR, Gas
from pneu_sim.lumped import delay_line, thin_plate
from pneu_sim.lumped.model import LumpedModel
from pneu_sim.rig.plan import Plan
from pneu_sim.rig.schema import Rig


def build(rig: Rig, plan: Plan | None = None, gas: Gas = AIR) -> LumpedModel:
    """Reduces a rig to the lumped model that its ``model`` field names.

    Args:
        rig: The rig; its attached effects are applied as far as a lumped model knows them.
        plan: Grid plan of the rig, from which volumes are summed; None makes the rig's own.
        gas: The gas.

    Returns:
        The model; a rig whose ``model`` is ``pde`` gives the thin-plate model.

    Raises:
        InputError: The rig has no such reduction.
    """
    make = delay_line.build if rig.model == "delay_line" else thin_plate.build
    return make(rig, plan, gas)
