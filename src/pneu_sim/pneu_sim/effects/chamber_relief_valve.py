# SPDX-License-Identifier: Apache-2.0
"""Chamber relief valve: a chamber blows off to the room above a pressure."""

import math
from collections.abc import Iterator
from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.effects.places import OFTEN, reached_pa
from pneu_sim.rig.schema import Relief, Rig


class ChamberReliefValve(Effect):
    """A relief valve on a chamber: an orifice to the room that opens above a set pressure."""

    name: ClassVar[str] = "chamber_relief_valve"
    title: ClassVar[str] = "chamber blows off above a pressure"
    where: ClassVar[str] = "chamber"
    formula: ClassVar[str] = (
        "m = A p / sqrt(R T) psi(p_room / p), A = area_m2 min(max((p - set_pa) / range_pa, 0), 1)"
    )
    source: ClassVar[str] = (
        "opening in proportion to the overpressure: Merritt, Hydraulic Control Systems, 1967;"
        " isentropic orifice: Shapiro, vol. 1, 1953, ch. 4"
    )
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("area_m2", "m^2, effective", 0.0, 0.0, 1e-5, 1e-7, 3e-9),
        EffectParameter("set_pa", "Pa, absolute", 4e5, 1e4, 2e7, 4e5, 1e3, fitted=True, scanned=7),
        EffectParameter("range_pa", "Pa", 2e4, 1e3, 1e6, 2e4, 500.0),
    )
    order: ClassVar[int] = 4
    next_experiment: ClassVar[str] = (
        "Fill the chamber slowly past the suspected pressure and let it settle: a relief valve"
        " holds a level that comes back after every fill, a leak goes on losing below it."
    )

    def places(self, rig: Rig) -> list[str]:
        return list(rig.chambers)

    def limits(self, parameter: EffectParameter, rig: Rig, place: str) -> tuple[float, float]:
        low, high = super().limits(parameter, rig, place)
        return reached_pa(rig, low, high) if parameter.name == "set_pa" else (low, high)

    def sites(self, rig: Rig, spacing_m: float = 0.25) -> Iterator[tuple[str, dict[str, float]]]:
        low, high = reached_pa(rig, 0.0, math.inf)
        for place, shape in super().sites(rig, spacing_m):
            yield place, {**shape, "set_pa": low + OFTEN * (high - low)}

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        rig.chambers[place].reliefs.append(
            Relief(area_m2=values["area_m2"], set_pa=values["set_pa"], range_pa=values["range_pa"])
        )
