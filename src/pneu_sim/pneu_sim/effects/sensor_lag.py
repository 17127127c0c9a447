# SPDX-License-Identifier: Apache-2.0
"""Sensor lag: one pressure sensor answers late and smoothed."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.rig.schema import Rig


class SensorLag(Effect):
    """Time constant of a sensor's first-order lag, added to the rig's."""

    name: ClassVar[str] = "sensor_lag"
    title: ClassVar[str] = "slow pressure sensor"
    where: ClassVar[str] = "tap"
    formula: ClassVar[str] = "lag_s r' + r = p"
    source: ClassVar[str] = "Doebelin, Measurement Systems, 5th ed. 2004 (first-order instruments)"
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("lag_s", "s", 0.0, 0.0, 0.1, 5e-3, 1.5e-4),
    )
    order: ClassVar[int] = 2
    next_experiment: ClassVar[str] = (
        "Swap this sensor with another and repeat a fast step: the lag goes with the sensor, while"
        " a line's lag and a clock offset of the channel stay."
    )

    def places(self, rig: Rig) -> list[str]:
        return list(rig.taps)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        rig.taps[place].lag_s += values["lag_s"]
