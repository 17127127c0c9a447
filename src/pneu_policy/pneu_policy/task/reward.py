# SPDX-License-Identifier: Apache-2.0
"""The reward of following a target (thesis 7.1, 9.2.1)."""

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from pneu_common.validation import Settings

Floats = NDArray[np.float64]


class Reward(Settings):
    """Reward of a control period: -alpha |e| - beta log(max(|e|, floor)) + offset.

    Attributes:
        alpha: Weight of the error's size, in the recipe's span.
        beta: Weight of its logarithm.
        floor: Least error under the logarithm, in the recipe's span.
        offset: What is added, so that a good policy earns more than nothing.
    """

    alpha: Annotated[float, Field(ge=0.0)] = 1.0
    beta: Annotated[float, Field(ge=0.0)] = 0.25
    floor: Annotated[float, Field(gt=0.0)] = 0.01
    offset: float = 0.0

    def of(self, error: Floats) -> Floats:
        """Rewards of some errors.

        Args:
            error: Errors in the recipe's span.
        """
        size = np.abs(error)
        log = np.log(np.maximum(size, self.floor))
        return self.offset - self.alpha * size - self.beta * log
