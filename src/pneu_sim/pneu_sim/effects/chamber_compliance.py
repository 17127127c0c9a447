# SPDX-License-Identifier: Apache-2.0
"""Chamber compliance: a chamber's walls yield, so that its volume grows with pressure."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.rig.schema import Rig


class ChamberCompliance(Effect):
    """Growth of a chamber's volume per pascal, relative to its volume, added to the rig's.

    A chamber that the rig has yielding may be stiffer than that, down to rigid: then the strength
    is negative.
    """

    name: ClassVar[str] = "chamber_compliance"
    title: ClassVar[str] = "yielding chamber walls"
    where: ClassVar[str] = "chamber"
    formula: ClassVar[str] = (
        "V = V_rig (1 + compliance_per_pa (p - p_room)) + C_rig (p - p_room),"
        " compliance_per_pa >= -C_rig / V_rig"
    )
    source: ClassVar[str] = "elastic vessel: Wylie and Streeter, Fluid Transients in Systems, 1993"
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("compliance_per_pa", "1/Pa", 0.0, -1e-4, 1e-4, 2e-7, 6e-9),
    )
    order: ClassVar[int] = 5
    next_experiment: ClassVar[str] = (
        "Fill through the same opening at several pressures while choked: a yielding chamber fills"
        " ever more slowly, a stiff one at a constant rate."
    )

    def places(self, rig: Rig) -> list[str]:
        return list(rig.chambers)

    def limits(self, parameter: EffectParameter, rig: Rig, place: str) -> tuple[float, float]:
        lower, upper = super().limits(parameter, rig, place)
        chamber = rig.chambers[place]
        return max(lower, -chamber.compliance_m3_per_pa / chamber.volume_m3), upper

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        chamber = rig.chambers[place]
        own = chamber.compliance_m3_per_pa
        chamber.compliance_m3_per_pa = max(
            own + values["compliance_per_pa"] * chamber.volume_m3, 0.0
        )
