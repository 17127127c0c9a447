# SPDX-License-Identifier: Apache-2.0
"""Supply level: the regulator is set to another pressure than the rig says."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.effects.places import sources
from pneu_sim.rig.schema import Rig

LOWEST_PA = 1e3
"""A source is never set below this, so that the gas stays a gas."""


class SupplyLevel(Effect):
    """Offset of a source's pressure, added to the rig's."""

    name: ClassVar[str] = "supply_level"
    title: ClassVar[str] = "supply set to another pressure"
    where: ClassVar[str] = "reservoir other than the room"
    formula: ClassVar[str] = "p_set = p_rig + offset_pa"
    source: ClassVar[str] = "setting and repeatability of regulators: ISO 6953-1:2015"
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("offset_pa", "Pa", 0.0, -5e5, 5e5, 1e4, 400.0),
    )
    order: ClassVar[int] = 6
    next_experiment: ClassVar[str] = (
        "Let everything settle with the supply port open and read all taps: a wrong set pressure"
        " shows at every tap, a sensor's bias at one."
    )

    def places(self, rig: Rig) -> list[str]:
        return sources(rig)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        reservoir = rig.reservoirs[place]
        reservoir.pressure_pa = max(reservoir.pressure_pa + values["offset_pa"], LOWEST_PA)
