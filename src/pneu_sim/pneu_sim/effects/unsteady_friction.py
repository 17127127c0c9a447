# SPDX-License-Identifier: Apache-2.0
"""Unsteady friction: accelerated flow drags more on the wall than steady flow of the same speed."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.rig.schema import Rig


class UnsteadyFriction(Effect):
    """Gain on frequency-dependent friction, added to the rig's.

    On a rig whose walls have no memory it gives one to this pipe and leaves the others without.
    """

    name: ClassVar[str] = "unsteady_friction"
    title: ClassVar[str] = "frequency-dependent wall friction"
    where: ClassVar[str] = "pipe"
    formula: ClassVar[str] = (
        "drag += (unsteady_rig + gain) 4 pi mu int W(nu (t - s) / R^2) du/ds ds"
    )
    source: ClassVar[str] = (
        "Zielke 1968, J. Basic Eng. 90, 109-115; Kagawa et al. 1983, Trans. JSME B 49, 2638-2644"
    )
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("gain", "1 = Zielke", 0.0, -1.0, 5.0, 1.0, 0.03),
    )
    order: ClassVar[int] = 5
    stage: ClassVar[int] = -1  # it has walls remember, of which others then change more
    along_lines: ClassVar[bool] = True
    next_experiment: ClassVar[str] = (
        "Excite the closed line with small fast steps or a 5-300 Hz chirp at two mean pressures:"
        " unsteady friction damps high modes most and weakens as pressure rises."
    )

    def places(self, rig: Rig) -> list[str]:
        return list(rig.pipes)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        if values["gain"] == 0.0:
            return
        if not rig.grid.memory:
            rig.grid.memory = True
            for pipe in rig.pipes.values():
                pipe.wall.unsteady = pipe.wall.heat_unsteady = 0.0
        wall = rig.pipes[place].wall
        wall.unsteady = max(wall.unsteady + values["gain"], 0.0)
