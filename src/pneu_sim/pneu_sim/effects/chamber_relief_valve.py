# SPDX-License-Identifier: Apache-2.0
"""Chamber relief valve: a chamber blows off to the room above a pressure."""

from typing import ClassVar

from pneu_sim.effects.base import POSITION, EffectParameter
from pneu_sim.effects.relief_valve import ReliefValve
from pneu_sim.rig.schema import Relief, Rig


class ChamberReliefValve(ReliefValve):
    """A relief valve on a chamber: an orifice to the room that opens above a set pressure."""

    name: ClassVar[str] = "chamber_relief_valve"
    title: ClassVar[str] = "chamber blows off above a pressure"
    where: ClassVar[str] = "chamber"
    contains: ClassVar[str | None] = "chamber_leak"
    parameters: ClassVar[tuple[EffectParameter, ...]] = tuple(
        p for p in ReliefValve.parameters if p.name != POSITION
    )
    exchanges: ClassVar[tuple[str, ...]] = ("gas",)
    next_experiment: ClassVar[str] = (
        "Fill the chamber slowly past the suspected pressure and let it settle: a relief valve"
        " holds a level that comes back after every fill, a leak goes on losing below it."
    )

    def places(self, rig: Rig) -> list[str]:
        return list(rig.chambers)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        rig.chambers[place].reliefs.append(Relief(**values))
