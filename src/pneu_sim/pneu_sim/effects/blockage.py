# SPDX-License-Identifier: Apache-2.0
"""Blockage: a kink, a clamp or dirt takes part of a line's area over a short stretch."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter, position_along_pipe
from pneu_sim.effects.places import on_pipe
from pneu_sim.rig.schema import Narrowing, Rig


class Blockage(Effect):
    """A stretch of reduced area, centred at a position."""

    name: ClassVar[str] = "blockage"
    title: ClassVar[str] = "line narrowed at a place"
    where: ClassVar[str] = "pipe, at a position"
    formula: ClassVar[str] = "A(x) = A_rig(x) (1 - fraction) for |x - position_m| < length_m / 2"
    source: ClassVar[str] = (
        "quasi-one-dimensional flow in a duct of varying area: Toro, Riemann Solvers and Numerical"
        " Methods for Fluid Dynamics, 3rd ed. 2009; loss at the widening: Borda-Carnot; at the"
        " entrance, as of a sharp edge: Idelchik, Handbook of Hydraulic Resistance, 4th ed. 2007"
    )
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("fraction", "of the area lost", 0.0, 0.0, 0.95, 0.3, 0.006),
        position_along_pipe(),
        EffectParameter("length_m", "m", 0.1, 0.01, 1.0, 0.1, 0.005),
    )
    order: ClassVar[int] = 3
    curved: ClassVar[bool] = True
    next_experiment: ClassVar[str] = (
        "Send one sharp pulse with a tap on either side: a narrowing reflects part of it, and the"
        " time until the reflection returns to the valve gives its place."
    )

    def places(self, rig: Rig) -> list[str]:
        return list(rig.pipes)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        pipe = rig.pipes[place]
        at = on_pipe(pipe, values["position_m"])
        if values["fraction"] > 0.0:
            pipe.narrowings.append(
                Narrowing(position_m=at, length_m=values["length_m"], fraction=values["fraction"])
            )
