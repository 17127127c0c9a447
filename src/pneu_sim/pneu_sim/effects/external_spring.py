# SPDX-License-Identifier: Apache-2.0
"""External spring: a spring, a cable or a hose draws a joint to one position."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.effects.places import joint_at, joints
from pneu_sim.rig.schema import Rig


class ExternalSpring(Effect):
    """A linear spring between a joint's link and its parent, beside the rig's."""

    name: ClassVar[str] = "external_spring"
    title: ClassVar[str] = "spring or cable on a joint"
    where: ClassVar[str] = "joint"
    formula: ClassVar[str] = "M = -rate (q - at); N m/rad, or N/m of a slide"
    source: ClassVar[str] = "Hooke's law"
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("rate", "N m/rad or N/m", 0.0, 0.0, 200.0, 0.5, 0.01),
        EffectParameter("at", "rad or m", 0.0, -3.2, 3.2, 0.0, 0.02, fitted=True),
    )
    order: ClassVar[int] = 6
    next_experiment: ClassVar[str] = (
        "Hold the joint at several angles over its whole range, at rest: a spring's torque"
        " grows with the angle, a weight's with its sine."
    )

    def places(self, rig: Rig) -> list[str]:
        return list(joints(rig))

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        joint = joint_at(rig, place)
        if values["rate"] > 0.0:
            whole = joint.spring + values["rate"]
            pull = joint.spring * joint.spring_at + values["rate"] * values["at"]
            joint.spring, joint.spring_at = whole, pull / whole
