# SPDX-License-Identifier: Apache-2.0
"""A learned policy as a controller, with the memory that its features need."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from pneu_policy.control.observations import Observer
from pneu_policy.control.policy_file import PolicyFile

Floats = NDArray[np.float64]


class PolicyController:
    """A learned policy with the memory that its features need."""

    def __init__(self, policy: PolicyFile, name: str | None = None) -> None:
        """Starts without a past.

        Args:
            policy: The policy.
            name: What to call it; None is the name of its file.
        """
        recipe = policy.recipe
        self.policy = policy
        self.name = name or (policy.path.stem if policy.path is not None else "policy")
        self.tap, self.taps = recipe.tap, recipe.taps
        self.preview_s, self.period_s = recipe.preview_s, recipe.period_s
        self._observer = Observer(recipe, 1)
        self._taps = np.empty((1, len(self.taps)))
        self._targets = np.empty((1, len(self.preview_s)))
        self._volts = np.empty(1)

    def reset(self) -> None:
        """Forgets the past: as if pressures had not changed and the valve had been closed."""
        self._observer.reset()

    def step(
        self,
        taps_pa: Mapping[str, float],
        targets_pa: Sequence[float],
        line: Floats | None = None,
    ) -> float:
        """Voltage for the next period; see `Controller.step`.

        Args:
            taps_pa: Per tap its newest reading, Pa.
            targets_pa: Target at the times ahead, Pa.
            line: (1, points) gas of the lines, for a policy that sees it in simulation.
        """
        row = self._taps[0]
        for n, tap in enumerate(self.taps):
            row[n] = taps_pa[tap]
        self._targets[0] = targets_pa
        features = self._observer.observe(self._taps, self._targets, line)[0]
        r = self.policy.recipe
        volts = r.null_v + r.half_v * min(max(self.policy.act(features), -1.0), 1.0)
        self._volts[0] = volts
        self._observer.acted(self._volts)
        return volts
