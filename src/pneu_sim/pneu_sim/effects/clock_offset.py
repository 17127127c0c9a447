# SPDX-License-Identifier: Apache-2.0
"""Clock offset: one sensor's stream is stamped late or early."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.rig.schema import Rig


class ClockOffset(Effect):
    """Lateness of the readings of one tap or encoder, added to the rig's.

    A lateness that all taps share is the common clock offset.
    """

    name: ClassVar[str] = "clock_offset"
    title: ClassVar[str] = "sensor stream out of step"
    where: ClassVar[str] = "tap or encoder"
    formula: ClassVar[str] = "r(t) = p(t - offset_s)"
    source: ClassVar[str] = (
        "offset between unsynchronised clocks: Mills, RFC 5905 (Network Time Protocol), 2010"
    )
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("offset_s", "s", 0.0, -0.05, 0.05, 4e-3, 1e-4),
    )
    order: ClassVar[int] = 2
    next_experiment: ClassVar[str] = (
        "Put this sensor on the same fitting as another and step the pressure: a clock offset keeps"
        " the shape and only shifts it, a sensor's lag smooths it."
    )

    def places(self, rig: Rig) -> list[str]:
        return [*rig.taps, *rig.encoders]

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        sensor = rig.taps[place] if place in rig.taps else rig.encoders[place]
        sensor.offset_s += values["offset_s"]
