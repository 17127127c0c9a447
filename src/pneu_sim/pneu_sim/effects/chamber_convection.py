# SPDX-License-Identifier: Apache-2.0
"""Chamber convection: gas rises or sinks along a chamber's wall, and a jet that enters stirs it."""

from typing import ClassVar

from pneu_sim import layout as L
from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.rig.model import Model
from pneu_sim.rig.schema import Rig


class ChamberConvection(Effect):
    """Convection at a chamber's wall, added to the rig's. Lumped models have none.

    Its conductance grows with the gas's density, with the difference of temperatures, and with what
    enters. Height of the gas and diameter of the inlet are the rig's (`height_m`, `inlet_m` of the
    chamber); where it has no inlet, the effect's is taken, and stirs what the effect adds.
    """

    name: ClassVar[str] = "chamber_convection"
    title: ClassVar[str] = "convection at chamber walls"
    where: ClassVar[str] = "chamber"
    formula: ClassVar[str] = (
        "q = (A_rig + area_m2) Nu k / H (T_room - T), Nu = 0.56 Re_d^0.67 + 0.104 Ra_H^0.352,"
        " Re_d = 4 m_in / (pi d mu) of the jet that enters through d = inlet_m, H the height of the"
        " gas; mu, k and Ra at (T + T_room) / 2"
    )
    source: ClassVar[str] = (
        "vessels being charged: Woodfield, Monde and Mitsutake 2007, J. Therm. Sci. Technol. 2(2),"
        " 180, as quoted in the manual of HydDown (Andreasen 2021, J. Open Source Softw. 6(66),"
        " 3695; docs/MANUAL.md), which the coefficients are from"
    )
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("area_m2", "m^2", 0.0, 0.0, 5.0, 2e-2, 5e-4),
        EffectParameter("inlet_m", "m", 5e-3, 1e-4, 1.0, 5e-3, 1e-4),
    )
    order: ClassVar[int] = 4
    exchanges: ClassVar[tuple[str, ...]] = ("heat",)
    next_experiment: ClassVar[str] = (
        "Empty the chamber from two pressures, and record the gas's temperature with a thin"
        " thermocouple: a conductance that is constant warms dense and thin gas alike."
    )

    def places(self, rig: Rig) -> list[str]:
        return list(rig.chambers)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        rig.chambers[place].convection_m2 += values["area_m2"]

    def on_model(self, model: Model, rig: Rig, place: str, values: dict[str, float]) -> None:
        row = model.chamber[model.plan.chambers.index(place)]
        if rig.chambers[place].inlet_m is None and values["area_m2"] > 0.0:
            row[L.C_INLET] = values["inlet_m"]
            row[L.C_STIRRED] += values["area_m2"] / row[L.C_CONVECTION]
