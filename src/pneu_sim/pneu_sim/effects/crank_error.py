# SPDX-License-Identifier: Apache-2.0
"""Crank error: the pin of a crank is farther from its joint than the rig says, or nearer."""

from typing import Any, ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.effects.places import joints
from pneu_sim.rig.schema import Rig


class CrankError(Effect):
    """Relative error of the distance from joint to pin."""

    name: ClassVar[str] = "crank_error"
    title: ClassVar[str] = "crank that is longer or shorter"
    where: ClassVar[str] = "joint with a crank"
    formula: ClassVar[str] = "r = r_rig (1 + error)"
    source: ClassVar[str] = "geometry of the linkage: thesis 7.1 and 9.2.1"
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("error", "relative", 0.0, -0.5, 0.5, 0.03, 1e-3),
    )
    order: ClassVar[int] = 5
    next_experiment: ClassVar[str] = (
        "Move the joint slowly from stop to stop and measure the piston's way: it tells the"
        " crank's length."
    )

    def places(self, rig: Rig) -> list[str]:
        return [name for name, (body, field) in joints(rig).items() if field in body.cranks]

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        body, field = joints(rig)[place]
        part: Any = body
        for step in body.cranks[field].split("."):
            part = getattr(part, step)
        part.lengthen(values["error"])
