# SPDX-License-Identifier: Apache-2.0
"""Sensor gain: one pressure sensor's scale is off."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.rig.schema import Rig


class SensorGain(Effect):
    """Relative error of a sensor's scale, on gauge pressure."""

    name: ClassVar[str] = "sensor_gain"
    title: ClassVar[str] = "sensor scale off"
    where: ClassVar[str] = "tap"
    formula: ClassVar[str] = "r = p_room + gain_rig (1 + error) (p - p_room)"
    source: ClassVar[str] = "span error: IEC 61298-2:2008"
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("error", "relative", 0.0, -0.5, 1.0, 0.02, 8e-4),
    )
    order: ClassVar[int] = 1
    next_experiment: ClassVar[str] = (
        "Equalise everything at three pressures: a wrong scale differs from the other sensors in"
        " proportion to gauge pressure and agrees at the room's."
    )

    def places(self, rig: Rig) -> list[str]:
        return list(rig.taps)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        rig.taps[place].gain *= 1.0 + values["error"]
