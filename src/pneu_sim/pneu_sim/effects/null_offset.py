# SPDX-License-Identifier: Apache-2.0
"""Null offset: the spool closes at another voltage than the rig says."""

import math
from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.rig.schema import Rig

MOST = 0.4
"""Largest null shift, as a share of the travel from null to the end of the stroke."""


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

    def limits(self, parameter: EffectParameter, rig: Rig, place: str) -> tuple[float, float]:
        """Bounds relative to the stroke: a command may be volts, or a duty from 0 to 1.

        Args:
            parameter: One of ``parameters``.
            rig: The rig.
            place: One of ``places``.
        """
        low, high = super().limits(parameter, rig, place)
        valve = rig.valves[place]
        away = [
            abs(v - valve.spool.null_v)
            for port in valve.ports.values()
            for v in port.opening.voltage_v
        ]
        most = MOST * max(away, default=math.inf)
        return max(low, -most), min(high, most)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        rig.valves[place].spool.null_offset_v += values["offset_v"]
