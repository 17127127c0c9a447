# SPDX-License-Identifier: Apache-2.0
"""Rod leak: gas of the rod side leaves along the rod."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.effects.places import moved_cylinders
from pneu_sim.rig.schema import Rig


class RodLeak(Effect):
    """An orifice from the rod side to the room, added to the rig's."""

    name: ClassVar[str] = "rod_leak"
    title: ClassVar[str] = "leak of a rod seal"
    where: ClassVar[str] = "cylinder"
    formula: ClassVar[str] = "m = A p / sqrt(R T) psi(p_room / p) from the rod side; A effective"
    source: ClassVar[str] = (
        "isentropic orifice: Shapiro, The Dynamics and Thermodynamics of Compressible Fluid"
        " Flow, vol. 1, 1953, ch. 4"
    )
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("area_m2", "m^2, effective", 0.0, 0.0, 5e-6, 3e-8, 1e-9),
    )
    order: ClassVar[int] = 4
    exchanges: ClassVar[tuple[str, ...]] = ("gas",)
    next_experiment: ClassVar[str] = (
        "Hold the piston at an end, fill the rod side, shut both valves for 30 s: its"
        " pressure alone falls, and the other's stays."
    )

    def places(self, rig: Rig) -> list[str]:
        return [name for name in moved_cylinders(rig) if rig.cylinders[name].rod is not None]

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        rig.cylinders[place].rod_leak_m2 += values["area_m2"]
