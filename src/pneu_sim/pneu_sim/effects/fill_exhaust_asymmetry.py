# SPDX-License-Identifier: Apache-2.0
"""Fill/exhaust asymmetry: the valve fills more easily than it exhausts, or the reverse."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.effects.places import fill_and_exhaust
from pneu_sim.rig.schema import Rig


class FillExhaustAsymmetry(Effect):
    """Difference of the flow gains of a valve's filling and exhausting ports."""

    name: ClassVar[str] = "fill_exhaust_asymmetry"
    title: ClassVar[str] = "filling and exhausting gains differ"
    where: ClassVar[str] = "valve"
    formula: ClassVar[str] = "C_fill (1 + difference / 2), C_exhaust (1 - difference / 2)"
    source: ClassVar[str] = (
        "flow paths differ per direction: ISO 6358-1:2013; Beater, Pneumatic Drives, Springer 2007"
    )
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("difference", "relative", 0.0, -1.5, 1.5, 0.2, 8e-3),
    )
    order: ClassVar[int] = 3
    next_experiment: ClassVar[str] = (
        "Step between the same two pressures up and down with mirrored openings: asymmetry gives"
        " rates off by opposite factors, a flow-gain error by the same factor."
    )

    def places(self, rig: Rig) -> list[str]:
        return [name for name in rig.valves if all(fill_and_exhaust(rig, name))]

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        fill, exhaust = fill_and_exhaust(rig, place)
        half = 0.5 * values["difference"]
        for ports, factor in ((fill, 1.0 + half), (exhaust, 1.0 - half)):
            for port in ports:
                port.conductance_m3_s_pa *= factor
                port.area_m2 *= factor
