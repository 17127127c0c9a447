# SPDX-License-Identifier: Apache-2.0
"""Cylinder heat: the wall of a cylinder exchanges more heat with its gas than the rig says."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.effects.places import moved_cylinders
from pneu_sim.rig.schema import Rig


class CylinderHeat(Effect):
    """Heat transfer from the wall of a cylinder, added to the rig's.

    Where the cylinder's gas is held in cells, the end covers are left out.
    """

    name: ClassVar[str] = "cylinder_heat"
    title: ClassVar[str] = "heat from the wall of a cylinder"
    where: ClassVar[str] = "cylinder"
    formula: ClassVar[str] = "q = film_w_m2_k A (T_wall - T)"
    source: ClassVar[str] = (
        "Al-Ibrahim and Otis 1992, Proc. 45th Natl. Conf. Fluid Power (10 to 200 W/(m^2 K));"
        " Carneiro and de Almeida 2006, doi:10.1177/09596518JSCE273"
    )
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("film_w_m2_k", "W/(m^2 K)", 0.0, 0.0, 1000.0, 20.0, 0.6),
    )
    order: ClassVar[int] = 4
    exchanges: ClassVar[tuple[str, ...]] = ("heat",)
    next_experiment: ClassVar[str] = (
        "Fill a side quickly, shut its valve and hold for some seconds: pressure that sags"
        " and then stays is heat, pressure that goes on falling a leak."
    )

    def places(self, rig: Rig) -> list[str]:
        return [name for name in moved_cylinders(rig) if rig.cylinders[name].rotary is None]

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        rig.cylinders[place].heat_w_m2_k += values["film_w_m2_k"]
