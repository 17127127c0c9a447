# SPDX-License-Identifier: Apache-2.0
"""Regulator droop: the supply sags while air is drawn from it."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.effects.places import sources
from pneu_sim.rig.schema import Rig


class RegulatorDroop(Effect):
    """Sag of a source's pressure per mass flow drawn, added to the rig's."""

    name: ClassVar[str] = "regulator_droop"
    title: ClassVar[str] = "supply sags under flow"
    where: ClassVar[str] = "reservoir other than the room"
    formula: ClassVar[str] = "p_supply = p_set - droop_pa_s_per_kg (sum of all m drawn)"
    source: ClassVar[str] = "flow characteristics of pressure regulators: ISO 6953-2:2015"
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("droop_pa_s_per_kg", "Pa s/kg", 0.0, 0.0, 2e8, 1.2e7, 2.5e5),
    )
    order: ClassVar[int] = 6
    next_experiment: ClassVar[str] = (
        "Put a tap at the regulator and fill at several openings: droop lowers it in proportion to"
        " the flow, and it recovers when the flow stops; a wrong set pressure stays."
    )

    def places(self, rig: Rig) -> list[str]:
        return sources(rig)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        rig.reservoirs[place].droop_pa_s_per_kg += values["droop_pa_s_per_kg"]
