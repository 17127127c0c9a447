# SPDX-License-Identifier: Apache-2.0
"""Seal friction: the friction of a piston grows with the pressure that presses on its seals."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.effects.places import moved_cylinders
from pneu_sim.rig.schema import Rig


class SealFriction(Effect):
    """Growth of sliding friction with pressure, added to the rig's."""

    name: ClassVar[str] = "seal_friction"
    title: ClassVar[str] = "seals that the pressure presses on"
    where: ClassVar[str] = "cylinder"
    formula: ClassVar[str] = "F = force_n_per_pa mean gauge pressure of both sides sign(v)"
    source: ClassVar[str] = (
        "lip seals and O-rings: Beater, Pneumatic Drives, Springer 2007, ch. 5; measured"
        " growth of 0.2 to 1.4 N/bar at 25 mm bore"
    )
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("force_n_per_pa", "N/Pa", 0.0, 0.0, 1e-3, 1.2e-5, 3e-7),
    )
    order: ClassVar[int] = 6
    next_experiment: ClassVar[str] = (
        "Move the piston slowly both ways at three levels of the mean pressure: friction that"
        " grows with it is the seals'."
    )

    def places(self, rig: Rig) -> list[str]:
        return moved_cylinders(rig)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        rig.cylinders[place].friction.coulomb_n_per_pa += values["force_n_per_pa"]
