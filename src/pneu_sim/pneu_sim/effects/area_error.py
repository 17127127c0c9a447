# SPDX-License-Identifier: Apache-2.0
"""Area error: a line is wider or narrower than the rig says, all along."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.rig.schema import Rig


class AreaError(Effect):
    """Relative error of a pipe's cross-section."""

    name: ClassVar[str] = "area_error"
    title: ClassVar[str] = "error of a line's cross-section"
    where: ClassVar[str] = "pipe"
    formula: ClassVar[str] = "A = A_rig (1 + error)"
    source: ClassVar[str] = "geometry; tolerances of plastic tube: ISO 14743:2020"
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("error", "relative", 0.0, -0.6, 1.0, 0.08, 3e-3),
    )
    order: ClassVar[int] = 3
    next_experiment: ClassVar[str] = (
        "Weigh a length of the tube full of water and empty; or compare the fill time with the"
        " pressure drop at steady flow, which a wider tube lowers while a dead volume does not."
    )

    def places(self, rig: Rig) -> list[str]:
        return list(rig.pipes)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        factor = 1.0 + values["error"]
        pipe = rig.pipes[place]
        pipe.area_m2 *= factor
        if pipe.area_profile is not None:
            pipe.area_profile = [(x, area * factor) for x, area in pipe.area_profile]
