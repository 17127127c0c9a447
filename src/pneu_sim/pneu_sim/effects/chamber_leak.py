# SPDX-License-Identifier: Apache-2.0
"""Chamber leak: a chamber loses air to the room."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.rig.schema import Rig


class ChamberLeak(Effect):
    """An orifice from a chamber to the room, added to the rig's."""

    name: ClassVar[str] = "chamber_leak"
    title: ClassVar[str] = "leak of a chamber to the room"
    where: ClassVar[str] = "chamber"
    formula: ClassVar[str] = (
        "m = A p / sqrt(R T) psi(p_room / p), isentropic orifice; A = flow coefficient x hole area"
    )
    source: ClassVar[str] = (
        "isentropic orifice: Shapiro, The Dynamics and Thermodynamics of Compressible Fluid Flow,"
        " vol. 1, 1953, ch. 4"
    )
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("area_m2", "m^2, effective", 0.0, 0.0, 5e-6, 2e-8, 5e-10),
    )
    order: ClassVar[int] = 4
    exchanges: ClassVar[tuple[str, ...]] = ("gas",)
    next_experiment: ClassVar[str] = (
        "Shut the chamber off at two pressures and hold for 30 s after the temperature has settled:"
        " a leak keeps falling in proportion to pressure."
    )

    def places(self, rig: Rig) -> list[str]:
        return list(rig.chambers)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        rig.chambers[place].leak_area_m2 += values["area_m2"]
