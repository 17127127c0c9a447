# SPDX-License-Identifier: Apache-2.0
"""Ambient pressure: the barometer stands higher or lower than the rig says."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.effects.places import ROOM
from pneu_sim.rig.schema import Rig


class AmbientPressure(Effect):
    """Offset of the room's pressure, and of the reservoirs that are the room."""

    name: ClassVar[str] = "ambient_pressure"
    title: ClassVar[str] = "barometric pressure off"
    where: ClassVar[str] = ROOM
    formula: ClassVar[str] = "p_room = p_rig + offset_pa"
    source: ClassVar[str] = "U.S. Standard Atmosphere 1976 (12.0 Pa per metre of height)"
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("offset_pa", "Pa", 0.0, -4e4, 1e4, 2000.0, 80.0),
    )
    order: ClassVar[int] = 6
    next_experiment: ClassVar[str] = (
        "Open the exhaust until everything is at rest and compare all taps with a barometer: the"
        " room's pressure shifts them all, a sensor's bias one."
    )

    def places(self, rig: Rig) -> list[str]:
        return [ROOM]

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        rig.ambient.pressure_pa += values["offset_pa"]
        for reservoir in rig.reservoirs.values():
            if reservoir.room:
                reservoir.pressure_pa += values["offset_pa"]
