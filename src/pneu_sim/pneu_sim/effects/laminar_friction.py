# SPDX-License-Identifier: Apache-2.0
"""Laminar friction: drag in proportion to velocity differs from the rig's."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.rig.schema import Rig


class LaminarFriction(Effect):
    """Gain on the laminar drag 8 pi mu u per length, added to the rig's."""

    name: ClassVar[str] = "laminar_friction"
    title: ClassVar[str] = "laminar wall friction"
    where: ClassVar[str] = "pipe"
    formula: ClassVar[str] = "drag per length = (laminar_rig + gain) 8 pi mu u"
    source: ClassVar[str] = "Hagen-Poiseuille flow: White, Viscous Fluid Flow, 3rd ed. 2006"
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("gain", "1 = Poiseuille", 0.0, -1.0, 10.0, 1.0, 0.03),
    )
    order: ClassVar[int] = 3
    next_experiment: ClassVar[str] = (
        "Ramp slowly at low flow (Re below 2000): laminar drag drops pressure in proportion to"
        " flow, turbulent drag and fittings with its square, and neither alters ringing at rest."
    )

    def places(self, rig: Rig) -> list[str]:
        return list(rig.pipes)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        wall = rig.pipes[place].wall
        wall.laminar = max(wall.laminar + values["gain"], 0.0)
