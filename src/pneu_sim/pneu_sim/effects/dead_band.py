# SPDX-License-Identifier: Apache-2.0
"""Dead-band: the spool's lands overlap the ports, so small commands open nothing."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.rig.schema import Rig


class DeadBand(Effect):
    """Overlap on each side of null, added to the rig's."""

    name: ClassVar[str] = "dead_band"
    title: ClassVar[str] = "valve overlap (dead-band)"
    where: ClassVar[str] = "valve"
    formula: ClassVar[str] = "x = null + sgn(u - null) max(|u - null| - width_v, 0)"
    source: ClassVar[str] = (
        "Beater, Pneumatic Drives, Springer 2007 (valve overlap); Tao and Kokotovic, Adaptive"
        " Control of Systems with Actuator and Sensor Nonlinearities, Wiley 1996"
    )
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("width_v", "V per side", 0.0, 0.0, 2.5, 0.25, 0.01),
    )
    order: ClassVar[int] = 3
    curved: ClassVar[bool] = True
    next_experiment: ClassVar[str] = (
        "Drive a slow triangle of small amplitude through null at two pressures: an overlap leaves"
        " the same stretch of voltage without flow both ways, hysteresis shifts it with direction."
    )

    def places(self, rig: Rig) -> list[str]:
        return list(rig.valves)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        rig.valves[place].spool.dead_band_v += values["width_v"]
