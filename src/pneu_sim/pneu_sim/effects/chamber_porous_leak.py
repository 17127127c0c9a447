# SPDX-License-Identifier: Apache-2.0
"""Chamber porous leak: a chamber loses air through a seal or a crack, in laminar flow."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.rig.schema import Rig


class ChamberPorousLeak(Effect):
    """A porous plug from a chamber to the room, added to the rig's.

    The strength is the plug's permeability x area / length, or pi d^4 / (128 l) of a capillary. The
    plug has the room's temperature, and the gas the viscosity that belongs to it.
    """

    name: ClassVar[str] = "chamber_porous_leak"
    title: ClassVar[str] = "laminar leak of a chamber to the room"
    where: ClassVar[str] = "chamber"
    formula: ClassVar[str] = "m = porous_m3 (p^2 - p_room^2) / (2 mu R T_room)"
    source: ClassVar[str] = (
        "isothermal flow of a gas by Darcy's law: Muskat, The Flow of Homogeneous Fluids through"
        " Porous Media, 1937; by Poiseuille's, for capillaries"
    )
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("porous_m3", "m^3", 0.0, 0.0, 5e-14, 3e-16, 9e-18),
    )
    order: ClassVar[int] = 4
    next_experiment: ClassVar[str] = (
        "Shut the chamber off at a high and at a low pressure and hold for 30 s each: a porous leak"
        " falls with the square of pressure, a hole in proportion to it."
    )

    def places(self, rig: Rig) -> list[str]:
        return list(rig.chambers)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        rig.chambers[place].leak_porous_m3 += values["porous_m3"]
