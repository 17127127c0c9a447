# SPDX-License-Identifier: Apache-2.0
"""Hysteresis: friction and magnetism make the spool remember where it came from."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.rig.schema import Rig


class Hysteresis(Effect):
    """Backlash between command and spool, full width, added to the rig's."""

    name: ClassVar[str] = "hysteresis"
    title: ClassVar[str] = "valve hysteresis (backlash)"
    where: ClassVar[str] = "valve"
    formula: ClassVar[str] = "play operator: x = min(max(x, u - width_v / 2), u + width_v / 2)"
    source: ClassVar[str] = (
        "Brokate and Sprekels, Hysteresis and Phase Transitions, Springer 1996 (play operator);"
        " hysteresis as a valve figure: ISO 10041-1:2010"
    )
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("width_v", "V, full width", 0.0, 0.0, 2.0, 0.2, 0.008),
    )
    order: ClassVar[int] = 3
    curved: ClassVar[bool] = True
    next_experiment: ClassVar[str] = (
        "Run a slow triangle with smaller loops inside it, at two rates: hysteresis splits the"
        " rising and falling branches by the same voltage at both rates, a delay by more volts at"
        " the faster one."
    )

    def places(self, rig: Rig) -> list[str]:
        return list(rig.valves)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        rig.valves[place].spool.hysteresis_v += values["width_v"]
