# SPDX-License-Identifier: Apache-2.0
"""Backlash: a joint has play between what drives it and itself."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.effects.places import driven_joints, joint_at, joints
from pneu_sim.rig.schema import Rig


class Backlash(Effect):
    """Width of the play, added to the rig's, and the mass of what is loose in it.

    That mass, of piston, rod and clevis, is part of the joint's inertia while both touch. Of a
    joint that has play already it is the mean of the rig's and the effect's, weighted by their
    plays.
    """

    name: ClassVar[str] = "backlash"
    title: ClassVar[str] = "play of a joint"
    where: ClassVar[str] = "joint"
    formula: ClassVar[str] = (
        "the joint moves by up to width without what drives it; both meet without rebound"
    )
    source: ClassVar[str] = (
        "Nordin and Gutman 2002, Automatica 38(10), doi:10.1016/S0005-1098(02)00047-X (dead"
        " zone without a mass between)"
    )
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("width", "rad or m", 0.0, 0.0, 0.5, 0.01, 3e-4),
        EffectParameter("loose_kg", "kg", 0.3, 0.02, 20.0, 0.3, 0.05, fitted=True),
    )
    order: ClassVar[int] = 6
    curved: ClassVar[bool] = True
    next_experiment: ClassVar[str] = (
        "Hold the pressures, push the link to and fro by hand within its play and read the"
        " encoder; or reverse slowly at low load: the angle stands still while the piston"
        " moves."
    )

    def places(self, rig: Rig) -> list[str]:
        return driven_joints(rig)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        if values["width"] <= 0.0:
            return
        joint = joint_at(rig, place)
        share = values["width"] / (joint.play + values["width"])
        joint.play += values["width"]
        body, _ = joints(rig)[place]
        for name in body.driven_by:
            if rig.cylinders[name].rotary is None:
                own = rig.cylinders[name].loose_kg
                rig.cylinders[name].loose_kg = own + share * (values["loose_kg"] - own)
