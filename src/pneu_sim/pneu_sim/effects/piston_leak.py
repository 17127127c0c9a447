# SPDX-License-Identifier: Apache-2.0
"""Piston leak: gas passes the piston from one side to the other."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.effects.places import moved_cylinders
from pneu_sim.rig.schema import Rig


class PistonLeak(Effect):
    """An orifice between the two sides of a piston, added to the rig's."""

    name: ClassVar[str] = "piston_leak"
    title: ClassVar[str] = "leak past a piston"
    where: ClassVar[str] = "cylinder"
    formula: ClassVar[str] = (
        "m = A p / sqrt(R T) psi(p' / p) from the side of the higher pressure to the other; A"
        " effective"
    )
    source: ClassVar[str] = (
        "isentropic orifice: Shapiro, The Dynamics and Thermodynamics of Compressible Fluid"
        " Flow, vol. 1, 1953, ch. 4"
    )
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("area_m2", "m^2, effective", 0.0, 0.0, 5e-6, 3e-8, 1e-9),
    )
    order: ClassVar[int] = 4
    next_experiment: ClassVar[str] = (
        "Hold the piston at an end, fill one side, shut both valves, and watch both"
        " pressures: what one side loses the other gains."
    )

    def places(self, rig: Rig) -> list[str]:
        return [name for name in moved_cylinders(rig) if len(rig.cylinders[name].sides) == 2]

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        rig.cylinders[place].piston_leak_m2 += values["area_m2"]
