# SPDX-License-Identifier: Apache-2.0
"""Supply ripple: a compressor's strokes or a regulator's hunting make a source pulsate."""

import math
from collections.abc import Iterator
from typing import ClassVar

from pneu_sim.effects.base import FREQUENCY, Effect, EffectParameter
from pneu_sim.effects.places import sources
from pneu_sim.rig.schema import Rig, Ripple


class SupplyRipple(Effect):
    """A sine on a source's pressure, added to the rig's.

    It is on top of what flow makes the source sag. Time counts from the beginning of a simulation,
    and is that of the recording where there is one. Lumped models have it only where pistons move.
    """

    name: ClassVar[str] = "supply_ripple"
    title: ClassVar[str] = "supply pulsates"
    where: ClassVar[str] = "reservoir other than the room"
    formula: ClassVar[str] = "p_supply = p_rig + amplitude_pa sin(2 pi frequency_hz t + phase_rad)"
    source: ClassVar[str] = (
        "pulsation of reciprocating compressors: Beater, Pneumatic Drives, Springer 2007; stability"
        " of regulators: ISO 6953-1:2015"
    )
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("amplitude_pa", "Pa", 0.0, 0.0, 1e5, 5e3, 150.0),
        EffectParameter(FREQUENCY, "Hz", 10.0, 0.01, 500.0, 10.0, 1e-3, fitted=True),
        EffectParameter(
            "phase_rad", "rad", 0.0, -2.0 * math.pi, 2.0 * math.pi, 0.0, 0.05, fitted=True
        ),
    )
    order: ClassVar[int] = 6
    next_experiment: ClassVar[str] = (
        "Hold the valve still and log the tap nearest the supply for 30 s: its spectrum shows the"
        " frequency of a ripple, which goes on whatever the valve does; noise has none."
    )

    def places(self, rig: Rig) -> list[str]:
        return sources(rig)

    def sites(self, rig: Rig, spacing_m: float = 0.25) -> Iterator[tuple[str, dict[str, float]]]:
        for place, shape in super().sites(rig, spacing_m):
            for quarter in range(4):
                yield place, {**shape, "phase_rad": 0.5 * math.pi * (quarter - 1)}

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        rig.reservoirs[place].ripples.append(Ripple(**values))
