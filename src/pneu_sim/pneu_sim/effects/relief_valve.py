# SPDX-License-Identifier: Apache-2.0
"""Relief valve: a line blows off to the room above a pressure."""

import math
from collections.abc import Iterator
from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter, position_along_pipe
from pneu_sim.effects.places import OFTEN, on_pipe, open_to_room, reached_pa
from pneu_sim.rig.schema import PipeRelief, Rig


class ReliefValve(Effect):
    """A relief valve on a pipe: an orifice to the room that opens above a set pressure.

    A line that is open to the room at an end does not reach one.
    """

    name: ClassVar[str] = "relief_valve"
    title: ClassVar[str] = "line blows off above a pressure"
    where: ClassVar[str] = "pipe that is not open to the room, at a position"
    formula: ClassVar[str] = (
        "m = A p / sqrt(R T) psi(p_room / p), A = area_m2 min(max((p - set_pa) / range_pa, 0), 1)"
    )
    source: ClassVar[str] = (
        "opening in proportion to the overpressure: Merritt, Hydraulic Control Systems, 1967;"
        " isentropic orifice: Shapiro, vol. 1, 1953, ch. 4"
    )
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("area_m2", "m^2, effective", 0.0, 0.0, 1e-5, 1e-7, 3e-9),
        position_along_pipe(),
        EffectParameter("set_pa", "Pa, absolute", 4e5, 1e4, 2e7, 4e5, 1e3, fitted=True, scanned=7),
        EffectParameter("range_pa", "Pa", 2e4, 1e3, 1e6, 2e4, 500.0),
    )
    order: ClassVar[int] = 4
    spread_out: ClassVar[bool] = True
    contains: ClassVar[str | None] = "leak"
    exchanges: ClassVar[tuple[str, ...]] = ("gas",)
    next_experiment: ClassVar[str] = (
        "Fill slowly past the suspected pressure, close the valve and let it settle: a relief valve"
        " holds a level that comes back after every fill, a leak goes on losing below it."
    )

    def places(self, rig: Rig) -> list[str]:
        return [name for name in rig.pipes if name not in open_to_room(rig)]

    def limits(self, parameter: EffectParameter, rig: Rig, place: str) -> tuple[float, float]:
        low, high = super().limits(parameter, rig, place)
        return reached_pa(rig, low, high) if parameter.name == "set_pa" else (low, high)

    def sites(self, rig: Rig, spacing_m: float = 0.25) -> Iterator[tuple[str, dict[str, float]]]:
        low, high = reached_pa(rig, 0.0, math.inf)
        for place, shape in super().sites(rig, spacing_m):
            yield place, {**shape, "set_pa": low + OFTEN * (high - low)}

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        pipe = rig.pipes[place]
        pipe.reliefs.append(
            PipeRelief(
                position_m=on_pipe(pipe, values["position_m"]),
                area_m2=values["area_m2"],
                set_pa=values["set_pa"],
                range_pa=values["range_pa"],
            )
        )
