# SPDX-License-Identifier: Apache-2.0
"""A plant's time beside the machine's: step by step, and rather standing still than leaping."""

import time

BEHIND_S = 0.02
"""A plant that is behind the machine's clock by more stands still meanwhile."""


class Pace:
    """When a plant may do its next step.

    Attributes:
        stood_s: For how long it stood still.
    """

    def __init__(self, time_s: float, rate: float = 1.0) -> None:
        """Begins now.

        Args:
            time_s: The plant's time.
            rate: Seconds of the plant in one of the machine's.
        """
        self.stood_s = 0.0
        self._rate = rate
        self._begun_s = time.monotonic() - time_s / rate

    def wait(self, time_s: float) -> float:
        """Waits until a plant may go on.

        Args:
            time_s: The plant's time.

        Returns:
            The steady time.
        """
        while True:
            now_s = time.monotonic()
            behind_s = now_s - self._begun_s - time_s / self._rate
            if behind_s >= 0.0:
                break
            time.sleep(-behind_s)
        if behind_s > BEHIND_S:
            self.stood_s += behind_s
            self._begun_s += behind_s
        return now_s
