# SPDX-License-Identifier: Apache-2.0
"""Turbulent friction: fast flow loses more, or less, along a line than the rig says."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.rig.schema import Rig


class TurbulentFriction(Effect):
    """Gain on what turbulence adds to the drag, added to the rig's.

    Added and not multiplied, so that a rig without turbulent friction can gain it.
    """

    name: ClassVar[str] = "turbulent_friction"
    title: ClassVar[str] = "turbulent wall friction"
    where: ClassVar[str] = "pipe"
    formula: ClassVar[str] = (
        "f = (64 / Re) (1 + (turbulent_rig + gain) (f_Haaland Re / 64 - 1)) at high Re"
    )
    source: ClassVar[str] = "Haaland 1983, J. Fluids Eng. 105, 89-90"
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("gain", "1 = Haaland", 0.0, -1.0, 5.0, 0.5, 0.015),
    )
    order: ClassVar[int] = 3
    along_lines: ClassVar[bool] = True
    next_experiment: ClassVar[str] = (
        "Fill with the valve fully open and with taps along the line: wall friction drops pressure"
        " in proportion to length at Re above 4000, a fitting in one place."
    )

    def places(self, rig: Rig) -> list[str]:
        return list(rig.pipes)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        wall = rig.pipes[place].wall
        wall.turbulent = max(wall.turbulent + values["gain"], 0.0)
