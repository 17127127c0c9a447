# SPDX-License-Identifier: Apache-2.0
"""A controller that sees virtual taps: what an observer says of them, from fewer that are there.

Any controller will do. It is told of every tap what the observer estimates, of those that are there
too, and does not know the difference.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from pneu_common.errors import InputError
from pneu_policy.control.controller import Controller
from pneu_policy.control.identity import OF_LINES, check_same, rig_identity
from pneu_policy.control.late import with_delay
from pneu_policy.control.predictive_settings import ADAPTING
from pneu_sim.observe.observer import Observer
from pneu_sim.observe.settings import ObserverSettings
from pneu_sim.rig.schema import Rig

SAMPLE_S = 2e-3
"""Commands are followed at least this finely within a period."""


class VirtualTaps:
    """Another controller, told what an observer sees.

    Attributes:
        name: What to call it.
        tap: Tap whose pressure it controls.
        taps: Taps that are there.
        preview_s: Times ahead at which it is told the target, s.
        period_s: Time from one step to the next, s.
        controller: The other controller.
        rig: The model.
        observer: What follows the state.
    """

    def __init__(
        self,
        controller: Controller,
        rig: Rig,
        taps: Sequence[str],
        settings: ObserverSettings = ADAPTING,
        delay_s: float = 0.004,
        name: str = "virtual",
    ) -> None:
        """Builds the observer.

        Args:
            controller: The controller that commands.
            rig: The rig, calibrated.
            taps: Taps that are there.
            settings: How the state is followed.
            delay_s: How late commands reach the valve beyond what the rig file knows, s.
            name: What to call it.

        Raises:
            InputError: The rig lacks a tap, or cannot be followed.
        """
        self.name, self.controller, self.rig = name, controller, rig
        self.tap, self.taps = controller.tap, tuple(taps)
        self.preview_s, self.period_s = controller.preview_s, controller.period_s
        for tap in controller.taps:
            if tap not in rig.taps:
                raise InputError(f"taps: {tap!r}: rig {rig.name!r} has {', '.join(rig.taps)}")
        self.observer = Observer(with_delay(rig, delay_s), settings, self.taps)
        self._null_v = next(iter(rig.valves.values())).spool.null_v
        self.reset()

    def check_rig(self, rig: Rig, who: str) -> None:
        """Refuses a rig that it does not observe.

        Args:
            rig: The rig it shall run on.
            who: What to call it.

        Raises:
            InputError: It has other commands, taps or pipes.
        """
        check_same(rig_identity(self.rig), rig_identity(rig), OF_LINES, who, "observes")

    def reset(self) -> None:
        """Forgets the past."""
        self.controller.reset()
        self._held_v = self._null_v
        self._begun = False

    def step(self, taps_pa: Mapping[str, float], targets_pa: Sequence[float]) -> float:
        """Voltage for the next period; see `Controller.step`.

        Args:
            taps_pa: Per tap its newest reading, Pa; one that is not finite is not there.
            targets_pa: Target at the times ahead, Pa.
        """
        command = self.observer.plant.plan.commands[0]
        if self._begun:
            samples = max(1, round(self.period_s / SAMPLE_S))
            held = np.full((1, samples), self._held_v)
            self.observer.advance(held, self.period_s / samples)
        else:
            self.observer.begin(taps_pa, {command: self._held_v})
            self._begun = True
        self.observer.assimilate(taps_pa)
        told = self.observer.estimate().mean
        seen = {tap: told[tap] for tap in self.controller.taps}
        self._held_v = self.controller.step(seen, targets_pa)
        return self._held_v
