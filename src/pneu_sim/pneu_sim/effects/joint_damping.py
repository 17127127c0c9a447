# SPDX-License-Identifier: Apache-2.0
"""Joint damping: the bearing of a joint holds it back in proportion to its speed."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.effects.places import joint_at, joints
from pneu_sim.rig.schema import Rig


class JointDamping(Effect):
    """Viscous friction of a joint, added to the rig's."""

    name: ClassVar[str] = "joint_damping"
    title: ClassVar[str] = "viscous friction of a joint"
    where: ClassVar[str] = "joint"
    formula: ClassVar[str] = "M = rate w; N m s/rad, or N s/m of a slide"
    source: ClassVar[str] = (
        "viscous friction of bearings; Armstrong-Helouvry, Dupont and Canudas de Wit 1994,"
        " Automatica 30(7), doi:10.1016/0005-1098(94)90209-7"
    )
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("rate", "N m s/rad or N s/m", 0.0, 0.0, 20.0, 0.04, 1e-3),
    )
    order: ClassVar[int] = 6
    indistinguishable_from: ClassVar[tuple[str, ...]] = ("piston_damping",)
    next_experiment: ClassVar[str] = (
        "Take the cylinder off and let the joint swing out: each swing is smaller by the same"
        " part of it."
    )

    def places(self, rig: Rig) -> list[str]:
        return list(joints(rig))

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        joint_at(rig, place).viscous += values["rate"]
