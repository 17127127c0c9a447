# SPDX-License-Identifier: Apache-2.0
"""Wall heat: the line's wall warms and cools the gas more, or less, than the rig says."""

import math
from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.gas import AIR
from pneu_sim.rig.schema import Rig

NUSSELT = 8.0
"""Quasi-steady Nusselt number that one unit of gain adds; belongs to the unsteady kernel."""


class WallHeat(Effect):
    """Gain on steady and frequency-dependent wall heat, added to the rig's.

    Added and not multiplied, so that an adiabatic rig can gain wall heat.
    """

    name: ClassVar[str] = "wall_heat"
    title: ClassVar[str] = "heat exchange with the tube wall"
    where: ClassVar[str] = "pipe"
    formula: ClassVar[str] = (
        "q per length = (Nu_rig + 8 gain) pi k (T_wall - T_r)"
        " + (unsteady_rig + gain) 4 pi k int W dT, T_r = T + Pr^(1/3) u^2 / (2 cp)"
    )
    source: ClassVar[str] = (
        "Bergh and Tijdeman 1965, NLR-TR F.238; Kagawa 1985, heat transfer effects on the frequency"
        " response of a pneumatic nozzle flapper"
    )
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("gain", "1 = Nusselt 8", 0.0, -1.0, 10.0, 0.5, 0.015),
    )
    order: ClassVar[int] = 4
    exchanges: ClassVar[tuple[str, ...]] = ("heat",)
    along_lines: ClassVar[bool] = True
    next_experiment: ClassVar[str] = (
        "Fill fast, close the valve and hold for five settling times: heat lets the pressure sag"
        " and stop after a fill and rise after an exhaust, a leak never stops and has one sign."
    )

    def places(self, rig: Rig) -> list[str]:
        return list(rig.pipes)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        pipe = rig.pipes[place]
        wall, gain = pipe.wall, values["gain"]
        if wall.heat_kappa is None:
            wall.nusselt = max(wall.nusselt + NUSSELT * gain, 0.0)
        else:
            k_gas = float(AIR.conductivity(rig.ambient.temperature_k))
            unit = NUSSELT * math.pi * k_gas / math.sqrt(pipe.area_m2)
            wall.heat_kappa = max(wall.heat_kappa + gain * unit, 0.0)
        wall.heat_unsteady = max(wall.heat_unsteady + gain, 0.0)
