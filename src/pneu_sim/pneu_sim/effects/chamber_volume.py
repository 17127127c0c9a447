# SPDX-License-Identifier: Apache-2.0
"""Chamber volume: a chamber is larger or smaller than the rig says."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.rig.schema import Rig


class ChamberVolume(Effect):
    """Relative error of a chamber's volume."""

    name: ClassVar[str] = "chamber_volume"
    title: ClassVar[str] = "error of a chamber's volume"
    where: ClassVar[str] = "chamber"
    formula: ClassVar[str] = "V = V_rig (1 + error)"
    source: ClassVar[str] = "mass balance of a chamber: Beater, Pneumatic Drives, Springer 2007"
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("error", "relative", 0.0, -0.8, 3.0, 0.1, 4e-3),
    )
    order: ClassVar[int] = 5
    stage: ClassVar[int] = 1  # after what is measured by the volume that the rig has
    next_experiment: ClassVar[str] = (
        "Repeat a fill with a known volume added to the chamber: the two rates give the volume"
        " apart from the flow gain."
    )

    def places(self, rig: Rig) -> list[str]:
        return list(rig.chambers)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        rig.chambers[place].volume_m3 *= 1.0 + values["error"]
