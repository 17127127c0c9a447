# SPDX-License-Identifier: Apache-2.0
"""Junction loss: a tee or a manifold costs pressure where the flow divides or joins."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.effects.places import junctions
from pneu_sim.rig.schema import Rig


class JunctionLoss(Effect):
    """Velocity heads lost between a junction and each pipe that meets there, added to the rig's.

    One number stands for the loss coefficients of all branches, each on the velocity head of its
    own pipe, whichever way it flows.
    """

    name: ClassVar[str] = "junction_loss"
    title: ClassVar[str] = "loss at a junction of pipes"
    where: ClassVar[str] = "node that joins three or more pipe ends"
    formula: ClassVar[str] = "dp = K rho u |u| / 2 at the end of every pipe that meets there"
    source: ClassVar[str] = (
        "merging and division of flow streams: Idelchik, Handbook of Hydraulic Resistance, 4th ed."
        " 2007, ch. 7"
    )
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("K", "velocity heads", 0.0, 0.0, 50.0, 1.5, 0.05),
    )
    order: ClassVar[int] = 3
    along_lines: ClassVar[bool] = True
    next_experiment: ClassVar[str] = (
        "Blow through the junction from one branch to each other with a tap in all: a loss at the"
        " junction is met by every flow, a fitting in a branch by the flows through that one."
    )

    def places(self, rig: Rig) -> list[str]:
        return junctions(rig)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        for pipe in rig.pipes.values():
            if pipe.from_node == place:
                pipe.loss_from += values["K"]
            if pipe.to_node == place:
                pipe.loss_to += values["K"]
