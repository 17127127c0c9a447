# SPDX-License-Identifier: Apache-2.0
"""Chamber porous leak: a chamber loses air through a seal or a crack, in laminar flow."""

from typing import ClassVar

from pneu_sim.effects.base import EffectParameter
from pneu_sim.effects.porous_leak import PorousLeak
from pneu_sim.rig.schema import Rig


class ChamberPorousLeak(PorousLeak):
    """A porous plug from a chamber to the room, added to the rig's.

    The strength is that of a line's porous leak.
    """

    name: ClassVar[str] = "chamber_porous_leak"
    title: ClassVar[str] = "laminar leak of a chamber to the room"
    where: ClassVar[str] = "chamber"
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("porous_m3", "m^3", 0.0, 0.0, 5e-14, 3e-16, 9e-18),
    )
    exchanges: ClassVar[tuple[str, ...]] = ("gas",)
    next_experiment: ClassVar[str] = (
        "Shut the chamber off at a high and at a low pressure and hold for 30 s each: a porous leak"
        " falls with the square of pressure, a hole in proportion to it."
    )

    def places(self, rig: Rig) -> list[str]:
        return list(rig.chambers)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        rig.chambers[place].leak_porous_m3 += values["porous_m3"]
