# SPDX-License-Identifier: Apache-2.0
"""Closing delay: the valve takes another time to close than to open."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.rig.schema import Rig, Spool


class ClosingDelay(Effect):
    """Transport delay of commands that close the valve, added to the rig's.

    It may be negative, where the rig's own delay of closing leaves room for it: no valve acts
    before it is told.
    """

    name: ClassVar[str] = "closing_delay"
    title: ClassVar[str] = "valve closes later than it opens"
    where: ClassVar[str] = "valve"
    formula: ClassVar[str] = (
        "u_spool(t) = u(t - closing), closing = closing_rig + extra_s >= 0, for changes towards"
        " null"
    )
    source: ClassVar[str] = (
        "ISO 12238:2001 (times to switch on and off are stated apart: the solenoid's field decays"
        " more slowly than it builds up)"
    )
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("extra_s", "s", 0.0, -0.05, 0.05, 8e-3, 2e-4),
    )
    order: ClassVar[int] = 2
    next_experiment: ClassVar[str] = (
        "Open and close the valve in single steps with rests between: what opens and what closes"
        " arrive after different times, a delay of the valve or a clock shifts both alike."
    )

    def places(self, rig: Rig) -> list[str]:
        return list(rig.valves)

    def limits(self, parameter: EffectParameter, rig: Rig, place: str) -> tuple[float, float]:
        lower, upper = super().limits(parameter, rig, place)
        return max(lower, -_closing_s(rig.valves[place].spool)), upper

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        if values["extra_s"] == 0.0:
            return
        spool = rig.valves[place].spool
        spool.closing_delay_s = max(_closing_s(spool) + values["extra_s"], 0.0)


def _closing_s(spool: Spool) -> float:
    """Delay of closing of a spool, which is that of opening where the rig names no other."""
    return spool.delay_s if spool.closing_delay_s is None else spool.closing_delay_s
