# SPDX-License-Identifier: Apache-2.0
"""What all controllers of a pressure have in common."""

from collections.abc import Mapping, Sequence
from typing import Protocol


class Controller(Protocol):
    """What all controllers have in common.

    Attributes:
        name: What to call it.
        tap: Tap whose pressure it controls.
        taps: Taps it must be told, the controlled one among them.
        preview_s: Times ahead at which it must be told the target, s, rising from 0.
        period_s: Time from one step to the next, s.
    """

    name: str
    tap: str
    taps: tuple[str, ...]
    preview_s: tuple[float, ...]
    period_s: float

    def reset(self) -> None:
        """Forgets the past."""

    def step(self, taps_pa: Mapping[str, float], targets_pa: Sequence[float]) -> float:
        """Voltage for the next period.

        Args:
            taps_pa: Per tap its newest reading, Pa.
            targets_pa: Target at the times ahead, Pa.

        Returns:
            The voltage, V.

        Raises:
            ValueError: A number is not finite.
        """
