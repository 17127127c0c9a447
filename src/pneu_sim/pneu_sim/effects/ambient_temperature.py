# SPDX-License-Identifier: Apache-2.0
"""Ambient temperature: the room, and the walls in it, are warmer or colder than the rig says."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.effects.places import ROOM
from pneu_sim.rig.schema import Rig


class AmbientTemperature(Effect):
    """Offset of the room's temperature, and of every source without one of its own."""

    name: ClassVar[str] = "ambient_temperature"
    title: ClassVar[str] = "room warmer or colder"
    where: ClassVar[str] = ROOM
    formula: ClassVar[str] = "T_room = T_rig + offset_k"
    source: ClassVar[str] = "mass flow goes with 1 / sqrt(T): ISO 6358-1:2013"
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("offset_k", "K", 0.0, -80.0, 80.0, 10.0, 0.4),
    )
    order: ClassVar[int] = 6
    stage: ClassVar[int] = -1  # what has no temperature of its own has the room's
    next_experiment: ClassVar[str] = (
        "Read a thermometer beside the rig; or repeat the same command hours apart: temperature"
        " scales all flows and wave speeds together by its square root."
    )

    def places(self, rig: Rig) -> list[str]:
        return [ROOM]

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        rig.ambient.temperature_k += values["offset_k"]
