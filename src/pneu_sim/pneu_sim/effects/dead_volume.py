# SPDX-License-Identifier: Apache-2.0
"""Dead volume: a fitting, a sensor's cavity or a side branch adds volume to a line."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter, position_along_pipe
from pneu_sim.effects.places import on_pipe
from pneu_sim.rig.schema import DeadVolume as VolumePart
from pneu_sim.rig.schema import Rig


class DeadVolume(Effect):
    """A volume that hangs on a pipe."""

    name: ClassVar[str] = "dead_volume"
    title: ClassVar[str] = "extra volume on a line"
    where: ClassVar[str] = "pipe, at a position"
    formula: ClassVar[str] = "V dp/dt = gamma R T m: a side of volume_m3 at position_m takes up m"
    source: ClassVar[str] = (
        "lumped side volume in a line: Bergh and Tijdeman 1965, NLR-TR F.238; Beater, Pneumatic"
        " Drives, Springer 2007"
    )
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("volume_m3", "m^3", 0.0, 0.0, 2e-4, 1.5e-6, 4e-8),
        position_along_pipe(),
    )
    order: ClassVar[int] = 5
    next_experiment: ClassVar[str] = (
        "Repeat a fill with a known volume attached at the same place, and send a sharp pulse: the"
        " rate gives the volume apart from flow gain, the reflection gives its place."
    )

    def places(self, rig: Rig) -> list[str]:
        return list(rig.pipes)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        pipe = rig.pipes[place]
        at = on_pipe(pipe, values["position_m"])
        pipe.volumes.append(VolumePart(position_m=at, volume_m3=values["volume_m3"]))
