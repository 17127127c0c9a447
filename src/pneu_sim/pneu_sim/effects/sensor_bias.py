# SPDX-License-Identifier: Apache-2.0
"""Sensor bias: one pressure sensor reads a constant too much or too little."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.rig.schema import Rig


class SensorBias(Effect):
    """Offset of a sensor's reading, added to the rig's."""

    name: ClassVar[str] = "sensor_bias"
    title: ClassVar[str] = "sensor zero shifted"
    where: ClassVar[str] = "tap"
    formula: ClassVar[str] = "r = p + bias_pa"
    source: ClassVar[str] = "zero error: IEC 61298-2:2008; JCGM 200:2012 (VIM), 4.28"
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("bias_pa", "Pa", 0.0, -1e5, 1e5, 2000.0, 80.0),
    )
    order: ClassVar[int] = 1
    next_experiment: ClassVar[str] = (
        "Vent everything to the room, then equalise everything at supply pressure: a biased sensor"
        " differs from the others by the same amount both times, one with a wrong gain does not."
    )

    def places(self, rig: Rig) -> list[str]:
        return list(rig.taps)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        rig.taps[place].bias_pa += values["bias_pa"]
