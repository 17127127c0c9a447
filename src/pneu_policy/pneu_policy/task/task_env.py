# SPDX-License-Identifier: Apache-2.0
"""What a training asks of a task: plants side by side whose episodes end together."""

from abc import abstractmethod
from typing import Any

import gymnasium


class TaskEnv(gymnasium.vector.VectorEnv):
    """Plants side by side; ``reset(seed=...)`` decides their episodes, which all end at a horizon.

    The ``info`` of a step holds ``error`` (num_envs,), the tracking error at its end, SI.

    Attributes:
        unit: What errors are told in, and how much one of it is.
        mark: Error at which the task is called learned, in that unit.
    """

    unit: tuple[str, float]
    mark: float

    @property
    @abstractmethod
    def period_s(self) -> float:
        """Control period, s."""

    @abstractmethod
    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> Any:
        """Begins new episodes.

        Args:
            seed: Decides all that is drawn; None goes on from the last.
            options: Not used.

        Returns:
            Observations and ``info``.
        """
