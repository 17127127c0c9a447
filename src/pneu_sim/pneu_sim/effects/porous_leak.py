# SPDX-License-Identifier: Apache-2.0
"""Porous leak: a line loses air through a seal, a thread or a crack, in laminar flow."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter, position_along_pipe
from pneu_sim.effects.places import on_pipe
from pneu_sim.rig.schema import Leak as LeakPart
from pneu_sim.rig.schema import Rig


class PorousLeak(Effect):
    """A porous plug from a pipe to the room; it leaks with the square of the pressure.

    The strength is the plug's permeability x area / length, or pi d^4 / (128 l) of a capillary. The
    plug has the room's temperature, and the gas the viscosity that belongs to it.
    """

    name: ClassVar[str] = "porous_leak"
    title: ClassVar[str] = "laminar leak of a line to the room"
    where: ClassVar[str] = "pipe, at a position"
    formula: ClassVar[str] = "m = porous_m3 (p^2 - p_room^2) / (2 mu R T_room)"
    source: ClassVar[str] = (
        "isothermal flow of a gas by Darcy's law: Muskat, The Flow of Homogeneous Fluids through"
        " Porous Media, 1937; by Poiseuille's, for capillaries"
    )
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("porous_m3", "m^3", 0.0, 0.0, 5e-14, 2.5e-16, 7.5e-18),
        position_along_pipe(),
    )
    order: ClassVar[int] = 4
    spread_out: ClassVar[bool] = True
    exchanges: ClassVar[tuple[str, ...]] = ("gas",)
    next_experiment: ClassVar[str] = (
        "Close the valve at a high and at a low pressure and hold for 30 s: a porous leak falls"
        " with the square of pressure, a hole in proportion to it; soapy water shows where."
    )

    def places(self, rig: Rig) -> list[str]:
        return list(rig.pipes)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        pipe = rig.pipes[place]
        at = on_pipe(pipe, values["position_m"])
        pipe.leaks.append(LeakPart(position_m=at, porous_m3=values["porous_m3"]))
