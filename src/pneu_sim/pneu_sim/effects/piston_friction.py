# SPDX-License-Identifier: Apache-2.0
"""Piston friction: seals hold a piston back with one force, however fast it moves."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.effects.places import moved_cylinders
from pneu_sim.rig.schema import Rig


class PistonFriction(Effect):
    """Sliding friction of a piston, added to the rig's."""

    name: ClassVar[str] = "piston_friction"
    title: ClassVar[str] = "dry friction of a piston"
    where: ClassVar[str] = "cylinder"
    formula: ClassVar[str] = "F = force_n sign(v)"
    source: ClassVar[str] = (
        "Coulomb's law; seals of pneumatic cylinders: Beater, Pneumatic Drives, Springer"
        " 2007, ch. 5"
    )
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("force_n", "N", 0.0, 0.0, 500.0, 4.0, 0.1),
    )
    order: ClassVar[int] = 6
    indistinguishable_from: ClassVar[tuple[str, ...]] = ("joint_friction",)
    next_experiment: ClassVar[str] = (
        "Move the piston slowly both ways, with the load taken off: half the difference of"
        " the two pressure forces is friction, whatever the speed."
    )

    def places(self, rig: Rig) -> list[str]:
        return moved_cylinders(rig)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        rig.cylinders[place].friction.coulomb_n += values["force_n"]
