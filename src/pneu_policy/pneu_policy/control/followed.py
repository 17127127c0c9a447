# SPDX-License-Identifier: Apache-2.0
"""A rig followed by an observer from the taps that are there: what a controller sees through it.

All taps, and the gas of the lines, which no sensor tells (thesis 7.3): by the members' mean.
"""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator

from pneu_common.validation import Listed, Settings
from pneu_policy.control.late import with_delay
from pneu_policy.control.predictive_settings import ADAPTING, as_given
from pneu_sim.observe.observer import Observer
from pneu_sim.observe.settings import ObserverSettings
from pneu_sim.rig.schema import Rig

SAMPLE_S = 2e-3
"""Commands are followed at least this finely within a period."""


class FollowedSettings(Settings):
    """How a rig is followed.

    Attributes:
        taps: Taps that are there.
        delay_s: How late commands reach the valve beyond what the rig file knows, s.
        observer: How the state is followed.
    """

    taps: Annotated[tuple[str, ...], Listed, Field(min_length=1)]
    delay_s: Annotated[float, Field(ge=0.0, le=1.0)] = 0.004
    observer: ObserverSettings = ADAPTING

    @field_validator("observer", mode="before")
    @classmethod
    def _given(cls, value: Any) -> Any:
        return as_given(value, ADAPTING)

    def seeded(self, seed: int) -> Self:
        """The same with other draws.

        Args:
            seed: Of the observer.
        """
        observer = self.observer.model_copy(update={"seed": seed})
        return self.model_copy(update={"observer": observer})


class Followed:
    """A rig, followed period by period.

    Attributes:
        observer: What follows it.
    """

    def __init__(self, rig: Rig, settings: FollowedSettings, period_s: float) -> None:
        """Builds the observer.

        Args:
            rig: The rig, calibrated, of one valve.
            settings: How it is followed.
            period_s: Time from one look to the next, s.

        Raises:
            InputError: The rig lacks a tap, or cannot be followed.
        """
        late = with_delay(rig, settings.delay_s)
        self.observer = Observer(late, settings.observer, settings.taps)
        self._null_v = next(iter(rig.valves.values())).spool.null_v
        self._samples = max(1, round(period_s / SAMPLE_S))
        self._sample_s = period_s / self._samples
        self.reset()

    def reset(self) -> None:
        """Forgets the past: the valve has long been closed."""
        self._held_v = self._null_v
        self._begun = False

    def look(self, taps_pa: Mapping[str, float]) -> Mapping[str, float]:
        """What all taps show now, a period after the last look.

        Args:
            taps_pa: Per tap its newest reading, Pa; one that is not finite is not there.
        """
        if self._begun:
            self.observer.advance(np.full((1, self._samples), self._held_v), self._sample_s)
        else:
            command = self.observer.plant.plan.commands[0]
            self.observer.begin(taps_pa, {command: self._held_v})
            self._begun = True
        self.observer.assimilate(taps_pa)
        return self.observer.estimate().mean

    def line(self, points: Sequence[tuple[str, int]]) -> NDArray[np.float64]:
        """(1, 3 points) gas at evenly spaced points of pipes, as a plant tells it.

        Args:
            points: Pipes with their numbers of points.
        """
        return self.observer.plant.gas_along(points).mean(axis=1)[None]

    def acted(self, volts: float) -> None:
        """Remembers what was commanded.

        Args:
            volts: The voltage until the next look, V.
        """
        self._held_v = volts
