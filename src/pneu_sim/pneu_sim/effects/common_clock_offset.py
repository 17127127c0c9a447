# SPDX-License-Identifier: Apache-2.0
"""Common clock offset: all sensors' streams are stamped late or early together."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.effects.places import TAPS
from pneu_sim.rig.schema import Rig


class CommonClockOffset(Effect):
    """Lateness of the readings of all taps, one for all, added to the rig's.

    A positive one cannot be told from a delay of every valve by pressures alone, and diagnosis
    names the delay first; a negative one can be no delay. Of a rig with one tap, its clock offset
    says the same. Encoders keep their clock.
    """

    name: ClassVar[str] = "common_clock_offset"
    title: ClassVar[str] = "all sensors out of step with the commands"
    where: ClassVar[str] = TAPS
    formula: ClassVar[str] = "r(t) = p(t - offset_s) at every tap"
    source: ClassVar[str] = (
        "offset between unsynchronised clocks: Mills, RFC 5905 (Network Time Protocol), 2010"
    )
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("offset_s", "s", 0.0, -0.05, 0.05, 4e-3, 1e-4),
    )
    order: ClassVar[int] = 3  # after a valve delay, which explains as much
    next_experiment: ClassVar[str] = (
        "Record the valve's spool position, or the commands with the clock of the sensors: by"
        " pressures alone, readings that all come late cannot be told from a delay of every valve."
    )

    def places(self, rig: Rig) -> list[str]:
        return [TAPS] if len(rig.taps) > 1 else []

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        for tap in rig.taps.values():
            tap.offset_s += values["offset_s"]
