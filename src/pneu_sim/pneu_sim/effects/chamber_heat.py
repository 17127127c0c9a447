# SPDX-License-Identifier: Apache-2.0
"""Chamber heat: a chamber's walls warm and cool its gas."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.rig.schema import Rig


class ChamberHeat(Effect):
    """Heat conductance of a chamber's wall, added to the rig's."""

    name: ClassVar[str] = "chamber_heat"
    title: ClassVar[str] = "heat exchange with chamber walls"
    where: ClassVar[str] = "chamber"
    formula: ClassVar[str] = "q = (hS_rig + conductance_w_per_k) (T_room - T)"
    source: ClassVar[str] = (
        "Carneiro and de Almeida 2006, Proc. IMechE Part I 220, 301-314 (chamber models)"
    )
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("conductance_w_per_k", "W/K", 0.0, 0.0, 100.0, 0.2, 5e-3),
    )
    order: ClassVar[int] = 4
    exchanges: ClassVar[tuple[str, ...]] = ("heat",)
    next_experiment: ClassVar[str] = (
        "Fill fast, close the valve and hold for five settling times: heat lets the pressure sag"
        " and stop after a fill and rise after an exhaust, a leak never stops and has one sign."
    )

    def places(self, rig: Rig) -> list[str]:
        return list(rig.chambers)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        rig.chambers[place].heat_w_per_k += values["conductance_w_per_k"]
