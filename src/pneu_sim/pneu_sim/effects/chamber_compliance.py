# SPDX-License-Identifier: Apache-2.0
"""Chamber compliance: a chamber's walls yield, so that its volume grows with pressure."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.rig.schema import Rig


class ChamberCompliance(Effect):
    """Growth of a chamber's volume per pascal, relative to its volume, added to the rig's."""

    name: ClassVar[str] = "chamber_compliance"
    title: ClassVar[str] = "yielding chamber walls"
    where: ClassVar[str] = "chamber"
    formula: ClassVar[str] = "V = V_rig (1 + compliance_per_pa (p - p_room))"
    source: ClassVar[str] = "elastic vessel: Wylie and Streeter, Fluid Transients in Systems, 1993"
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("compliance_per_pa", "1/Pa", 0.0, 0.0, 1e-4, 2e-7, 6e-9),
    )
    order: ClassVar[int] = 5
    next_experiment: ClassVar[str] = (
        "Fill through the same opening at several pressures while choked: a yielding chamber fills"
        " ever more slowly, a stiff one at a constant rate."
    )

    def places(self, rig: Rig) -> list[str]:
        return list(rig.chambers)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        chamber = rig.chambers[place]
        chamber.compliance_m3_per_pa += values["compliance_per_pa"] * chamber.volume_m3
