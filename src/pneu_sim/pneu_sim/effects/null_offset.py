# SPDX-License-Identifier: Apache-2.0
"""Null offset: the spool closes at another voltage than the rig says."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.rig.schema import Rig


class NullOffset(Effect):
    """Shift of the command at which the spool sits at null, added to the rig's."""

    name: ClassVar[str] = "null_offset"
    title: ClassVar[str] = "shifted valve null"
    where: ClassVar[str] = "valve"
    formula: ClassVar[str] = "x = u - offset_v"
    source: ClassVar[str] = "null shift of a spool: Merritt, Hydraulic Control Systems, Wiley 1967"
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("offset_v", "V", 0.0, -2.0, 2.0, 0.1, 0.004),
    )
    order: ClassVar[int] = 3
    next_experiment: ClassVar[str] = (
        "Step to mirrored voltages about null, small and large: an offset makes filling faster and"
        " exhausting slower by the same voltage at every opening, a flow-gain error by the same"
        " factor."
    )

    def places(self, rig: Rig) -> list[str]:
        return list(rig.valves)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        rig.valves[place].spool.null_offset_v += values["offset_v"]
