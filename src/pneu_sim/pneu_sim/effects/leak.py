# SPDX-License-Identifier: Apache-2.0
"""Leak: a hole in a line lets air out to the room."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter, position_along_pipe
from pneu_sim.effects.places import on_pipe
from pneu_sim.rig.schema import Leak as LeakPart
from pneu_sim.rig.schema import Rig


class Leak(Effect):
    """An orifice to the room in a pipe's wall."""

    name: ClassVar[str] = "leak"
    title: ClassVar[str] = "leak of a line to the room"
    where: ClassVar[str] = "pipe, at a position"
    formula: ClassVar[str] = (
        "m = A p / sqrt(R T) psi(p_room / p), isentropic orifice; A = flow coefficient x hole area"
    )
    source: ClassVar[str] = (
        "isentropic orifice: Shapiro, The Dynamics and Thermodynamics of Compressible Fluid Flow,"
        " vol. 1, 1953, ch. 4"
    )
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("area_m2", "m^2, effective", 0.0, 0.0, 5e-6, 1.6e-8, 5e-10),
        position_along_pipe(),
    )
    order: ClassVar[int] = 4
    exchanges: ClassVar[tuple[str, ...]] = ("gas",)
    next_experiment: ClassVar[str] = (
        "Close the valve at two pressures and hold for 30 s: a leak keeps falling in proportion to"
        " pressure, wall heat settles; flow through it while filling shows where it sits."
    )

    def places(self, rig: Rig) -> list[str]:
        return list(rig.pipes)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        pipe = rig.pipes[place]
        at = on_pipe(pipe, values["position_m"])
        pipe.leaks.append(LeakPart(position_m=at, area_m2=values["area_m2"]))
