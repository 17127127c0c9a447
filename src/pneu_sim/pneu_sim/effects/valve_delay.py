# SPDX-License-Identifier: Apache-2.0
"""Valve delay: the valve acts later than it is told."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.rig.schema import Rig


class ValveDelay(Effect):
    """Transport delay between the command and the spool, added to the rig's."""

    name: ClassVar[str] = "valve_delay"
    title: ClassVar[str] = "valve transport delay"
    where: ClassVar[str] = "valve"
    formula: ClassVar[str] = "u_spool(t) = u(t - delay_s)"
    source: ClassVar[str] = (
        "ISO 12238:2001 (switching times of directional valves); Richer and Hurmuzlu 2000,"
        " J. Dyn. Sys. Meas. Control 122, 416-425"
    )
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("delay_s", "s", 0.0, 0.0, 0.05, 2.5e-3, 1e-4),
    )
    order: ClassVar[int] = 2
    next_experiment: ClassVar[str] = (
        "Step the valve both ways at two amplitudes and log all taps on one clock: a delay shifts"
        " every tap by the same time whatever the amplitude, a slow spool does not."
    )

    def places(self, rig: Rig) -> list[str]:
        return list(rig.valves)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        spool = rig.valves[place].spool
        spool.delay_s += values["delay_s"]
        if spool.closing_delay_s is not None:
            spool.closing_delay_s += values["delay_s"]
