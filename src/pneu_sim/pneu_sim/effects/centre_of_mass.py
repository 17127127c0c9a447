# SPDX-License-Identifier: Apache-2.0
"""Centre of mass: the weight of a link acts farther from its joint than the rig says, or nearer."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.effects.places import joints
from pneu_sim.rig.schema import Rig


class CentreOfMass(Effect):
    """Offset of the centre of mass of all that a link has, its inertia about that kept."""

    name: ClassVar[str] = "centre_of_mass"
    title: ClassVar[str] = "centre of mass elsewhere"
    where: ClassVar[str] = "joint"
    formula: ClassVar[str] = "l = l_rig + offset_m, I = I_rig + M (l^2 - l_rig^2) about the joint"
    source: ClassVar[str] = "statics of a link"
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("offset_m", "m", 0.0, -0.5, 1.0, 0.02, 5e-4),
    )
    order: ClassVar[int] = 6
    stage: ClassVar[int] = -1  # of the link itself; what it carries comes after
    next_experiment: ClassVar[str] = (
        "Hold the joint at several angles on both sides of the vertical, at rest: the"
        " pressures that hold it tell mass times centre."
    )

    def places(self, rig: Rig) -> list[str]:
        return [name for name, (body, field) in joints(rig).items() if field in body.off_centre]

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        body, field = joints(rig)[place]
        body.shift_centre(field, values["offset_m"])
