# SPDX-License-Identifier: Apache-2.0
"""Roughness: a rough wall loses more than a smooth one, the more so the faster the flow."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.rig.schema import Rig


class Roughness(Effect):
    """Height of the wall's roughness, added to the rig's.

    It acts with a power of 1.11 of the height: a very small one less than in proportion.
    """

    name: ClassVar[str] = "roughness"
    title: ClassVar[str] = "rough tube wall"
    where: ClassVar[str] = "pipe"
    formula: ClassVar[str] = "1 / sqrt(f) = -1.8 log10(6.9 / Re + (height_m / (3.7 D))^1.11)"
    source: ClassVar[str] = "Haaland 1983, J. Fluids Eng. 105, 89-90"
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("height_m", "m", 0.0, 0.0, 5e-4, 2e-5, 6e-7),
    )
    order: ClassVar[int] = 3
    curved: ClassVar[bool] = True
    along_lines: ClassVar[bool] = True
    next_experiment: ClassVar[str] = (
        "Blow through at several Reynolds numbers: on a rough wall the friction factor levels off"
        " as the flow grows, a plain friction error keeps its ratio."
    )

    def places(self, rig: Rig) -> list[str]:
        return list(rig.pipes)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        rig.pipes[place].wall.roughness_m += values["height_m"]
