# SPDX-License-Identifier: Apache-2.0
"""Supply temperature: the air that is fed in is warmer or colder than the room."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.effects.places import sources
from pneu_sim.rig.schema import Rig


class SupplyTemperature(Effect):
    """Offset of a source's temperature, added to the rig's."""

    name: ClassVar[str] = "supply_temperature"
    title: ClassVar[str] = "warm or cold supply air"
    where: ClassVar[str] = "reservoir other than the room"
    formula: ClassVar[str] = "T_supply = T_rig + offset_k"
    source: ClassVar[str] = "mass flow goes with 1 / sqrt(T): ISO 6358-1:2013"
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("offset_k", "K", 0.0, -80.0, 150.0, 20.0, 0.8),
    )
    order: ClassVar[int] = 6
    next_experiment: ClassVar[str] = (
        "Log a thermocouple in the supply air beside the pressures: a fill with warm air sags more"
        " once the valve has closed."
    )

    def places(self, rig: Rig) -> list[str]:
        return sources(rig)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        if values["offset_k"] == 0.0:
            return
        reservoir = rig.reservoirs[place]
        base = reservoir.temperature_k or rig.ambient.temperature_k
        reservoir.temperature_k = base + values["offset_k"]
