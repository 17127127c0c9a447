# SPDX-License-Identifier: Apache-2.0
"""Spool leakage: a closed port still passes air past the spool's clearance."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.effects.places import valve_ports
from pneu_sim.rig.schema import Rig


class SpoolLeakage(Effect):
    """Opening that remains when the spool closes a port, added to the rig's."""

    name: ClassVar[str] = "spool_leakage"
    title: ClassVar[str] = "leakage past the closed spool"
    where: ClassVar[str] = "valve port"
    formula: ClassVar[str] = "opening = fraction + (1 - fraction) opening_rig(x)"
    source: ClassVar[str] = (
        "internal leakage of underlapped spools: Merritt, Hydraulic Control Systems, 1967;"
        " measured as in ISO 10041-2:2010"
    )
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("fraction", "of the full opening", 0.0, 0.0, 0.1, 2e-3, 8e-5),
    )
    order: ClassVar[int] = 4
    next_experiment: ClassVar[str] = (
        "Hold the valve at null for 10 s from a low and from a high pressure: leakage past the"
        " spool drives both to one level between supply and room, a leak only lets it fall."
    )

    def places(self, rig: Rig) -> list[str]:
        return list(valve_ports(rig))

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        valve_ports(rig)[place].leakage += values["fraction"]
