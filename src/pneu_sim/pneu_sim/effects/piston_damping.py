# SPDX-License-Identifier: Apache-2.0
"""Piston damping: a piston is held back in proportion to its speed."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.effects.places import moved_cylinders
from pneu_sim.rig.schema import Rig


class PistonDamping(Effect):
    """Viscous friction of a piston, added to the rig's."""

    name: ClassVar[str] = "piston_damping"
    title: ClassVar[str] = "viscous friction of a piston"
    where: ClassVar[str] = "cylinder"
    formula: ClassVar[str] = "F = rate_n_s_m v"
    source: ClassVar[str] = (
        "viscous friction of lubricated seals: Beater, Pneumatic Drives, Springer 2007, ch."
        " 5; Armstrong-Helouvry, Dupont and Canudas de Wit 1994, Automatica 30(7),"
        " doi:10.1016/0005-1098(94)90209-7"
    )
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("rate_n_s_m", "N s/m", 0.0, 0.0, 2000.0, 20.0, 0.5),
    )
    order: ClassVar[int] = 6
    indistinguishable_from: ClassVar[tuple[str, ...]] = ("joint_damping",)
    next_experiment: ClassVar[str] = (
        "Move the piston at several speeds: friction in proportion to speed is viscous."
    )

    def places(self, rig: Rig) -> list[str]:
        return moved_cylinders(rig)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        rig.cylinders[place].friction.viscous_n_s_m += values["rate_n_s_m"]
