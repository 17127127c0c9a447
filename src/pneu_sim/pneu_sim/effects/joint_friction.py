# SPDX-License-Identifier: Apache-2.0
"""Joint friction: the bearing of a joint holds it back, however fast it turns."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.effects.places import joint_at, joints
from pneu_sim.rig.schema import Rig


class JointFriction(Effect):
    """Dry friction of a joint, added to the rig's."""

    name: ClassVar[str] = "joint_friction"
    title: ClassVar[str] = "dry friction of a joint"
    where: ClassVar[str] = "joint"
    formula: ClassVar[str] = "M = torque sign(w); N m, or N of a slide"
    source: ClassVar[str] = (
        "Coulomb's law; Armstrong-Helouvry, Dupont and Canudas de Wit 1994, Automatica 30(7),"
        " doi:10.1016/0005-1098(94)90209-7"
    )
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("torque", "N m or N", 0.0, 0.0, 50.0, 0.2, 5e-3),
    )
    order: ClassVar[int] = 6
    indistinguishable_from: ClassVar[tuple[str, ...]] = ("piston_friction",)
    next_experiment: ClassVar[str] = (
        "Take the cylinder off and swing the joint by hand, or let it swing out: what stops"
        " it, however slow, is its own friction."
    )

    def places(self, rig: Rig) -> list[str]:
        return list(joints(rig))

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        joint_at(rig, place).dry_friction += values["torque"]
