# SPDX-License-Identifier: Apache-2.0
"""Effects at places: everything that diagnosis tries."""

from collections.abc import Collection
from dataclasses import dataclass

from pneu_sim.effects import Effect, registry
from pneu_sim.effects.base import FREQUENCY, POSITION
from pneu_sim.rig.schema import AttachedEffect, Rig

LEAST_SPACING_M = 0.25
"""Positions are tried no closer than that."""


@dataclass(frozen=True)
class Site:
    """An effect at a place.

    Attributes:
        effect: The effect.
        place: Part of the rig.
        shape: Its parameters but the strength.
    """

    effect: Effect
    place: str
    shape: dict[str, float]

    @property
    def label(self) -> str:
        """``effect@place``, with the position where there is one."""
        if POSITION in self.shape:
            return f"{self.effect.name}@{self.place}:{self.shape[POSITION]:.2f}"
        return f"{self.effect.name}@{self.place}"

    @property
    def part(self) -> tuple[str, str]:
        """Name of the effect and the part of the rig, wherever along it."""
        return self.effect.name, self.place

    def attached(self, rig: Rig, strength: float) -> Rig:
        """Returns the rig with the effect at a strength.

        Args:
            rig: The rig; left as it is.
            strength: Strength in the effect's unit.
        """
        values = {**self.shape, self.effect.strength.name: strength}
        extra = AttachedEffect(effect=self.effect.name, place=self.place, parameters=values)
        return rig.model_copy(update={"effects": [*rig.effects, extra]})


def all_sites(
    rig: Rig,
    positions: int = 3,
    without: Collection[str] = (),
    pulses_hz: float | None = None,
) -> list[Site]:
    """Every effect of the catalogue at every place of a rig.

    Args:
        rig: The rig.
        positions: Intervals between the positions tried along the longest pipe: what a position
            changes of the prediction is smooth along a line, and it is fitted later.
        without: Names of effects that are left out.
        pulses_hz: Frequency at which what is missing pulsates; effects that pulsate are left out
            where it does not.
    """
    longest = max((pipe.length_m for pipe in rig.pipes.values()), default=0.0)
    spacing_m = max(LEAST_SPACING_M, longest / positions)
    out = []
    for effect in registry().values():
        if effect.name in without:
            continue
        pulsates = any(p.name == FREQUENCY for p in effect.parameters)
        if pulsates and pulses_hz is None:
            continue
        for place, shape in effect.sites(rig, spacing_m):
            own = {**shape, FREQUENCY: pulses_hz} if pulsates and pulses_hz else shape
            out.append(Site(effect, place, own))
    return out
