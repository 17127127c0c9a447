# SPDX-License-Identifier: Apache-2.0
"""Whether the model still is that of the rig: innovations that stay improbable, and what drifts.

Innovations of a right model are white and of the size that the ensemble expects. Sensors that are
out do not count; see `pneu_sim.observe.trust`.
"""

import math
from collections.abc import Mapping, Sequence

from pneu_sim.observe.drifts import Unknown
from pneu_sim.observe.settings import ObserverSettings


class Watch:
    """Looks at innovations and drifts over a sliding while.

    Attributes:
        square: By sensor the recent mean square of its innovations, in variances.
        mean: Likewise their mean, in standard deviations, single ones no larger than the gate.
        wrong: What is improbable now, in words; empty while the model holds.
    """

    def __init__(self, settings: ObserverSettings) -> None:
        """Has seen nothing.

        Args:
            settings: How long it looks, and what is improbable.
        """
        self._s = settings
        self.reset()

    def reset(self) -> None:
        """Forgets all."""
        self.square: dict[str, float] = {}
        self.mean: dict[str, float] = {}
        self.wrong: list[str] = []
        self._since_s = 0.0

    def see(
        self,
        interval_s: float,
        z: Mapping[str, float],
        unknowns: Sequence[Unknown],
        drifted: Sequence[float],
    ) -> None:
        """Takes the newest innovations.

        Args:
            interval_s: Since the last, s.
            z: Innovations in standard deviations, of sensors that are believed.
            unknowns: What drifts.
            drifted: By how much each has, in standard deviations of its drift.
        """
        s = self._s
        self._since_s += interval_s
        keep = math.exp(-interval_s / s.watch_s)
        for name, value in z.items():
            before = self.square.get(name, 1.0)
            self.square[name] = keep * before + (1.0 - keep) * value * value
            held = min(max(value, -s.gate), s.gate)
            self.mean[name] = keep * self.mean.get(name, 0.0) + (1.0 - keep) * held
        if self._since_s < s.settle_s:
            return
        wrong = [
            f"innovations of {name} are {math.sqrt(square):.3g} times as large as expected"
            for name, square in self.square.items()
            if name in z and square > s.improbable**2
        ]
        wrong += [
            f"innovations of {name} are {mean:.2g} standard deviations on the mean"
            for name, mean in self.mean.items()
            if name in z and abs(mean) > s.improbable_mean
        ]
        wrong += [
            f"{unknown.name} has drifted by {value:.3g} standard deviations"
            for unknown, value in zip(unknowns, drifted, strict=True)
            if unknown.time_s >= s.slow_s and abs(value) > s.most_drift
        ]
        self.wrong = wrong
