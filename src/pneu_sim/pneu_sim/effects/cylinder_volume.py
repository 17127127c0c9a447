# SPDX-License-Identifier: Apache-2.0
"""Cylinder volume: more gas lies behind a piston at its end than the rig says."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.effects.places import cylinder_sides
from pneu_sim.rig.schema import Rig


class CylinderVolume(Effect):
    """Dead volume of one side of a cylinder, added to the rig's."""

    name: ClassVar[str] = "cylinder_volume"
    title: ClassVar[str] = "extra volume at the end of a cylinder"
    where: ClassVar[str] = "side of a cylinder"
    formula: ClassVar[str] = "V = V_rig + volume_m3"
    source: ClassVar[str] = (
        "mass balance of a chamber: Beater, Pneumatic Drives, Springer 2007, ch. 5"
    )
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("volume_m3", "m^3", 0.0, 0.0, 1e-3, 3e-6, 1e-7),
    )
    order: ClassVar[int] = 5
    next_experiment: ClassVar[str] = (
        "Hold the piston at this end and fill that side, then hold it at the other end and"
        " repeat: a dead volume matters most where the piston leaves least."
    )

    def places(self, rig: Rig) -> list[str]:
        return list(cylinder_sides(rig))

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        cylinder_sides(rig)[place].dead_volume_m3 += values["volume_m3"]
