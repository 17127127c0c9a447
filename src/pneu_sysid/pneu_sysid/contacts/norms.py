# SPDX-License-Identifier: Apache-2.0
"""Norms of residuals: square, Huber, and the barrier of thesis table 2.1.

Each is about ``weight * r**2`` near zero, so that a weight means the same whatever the norm; a
standard deviation ``s`` stands for the weight ``1 / (2 s**2)``, and a cost of a half per reading.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

STEEPEST = 20.0
"""Beyond this many squared widths the barrier goes on as a straight line in ``r**2``: a start may
be anywhere, and e**700 is no number."""


@dataclass(frozen=True)
class Norm:
    """A convex function of a residual.

    Attributes:
        weight: Its weight, one over the residual's unit squared.
        kind: ``square``; ``huber``, linear beyond the width; ``barrier``, exponential beyond it:
            ``weight * width**2 * (exp(r**2 / width**2) - 1)``.
        width: Its width, in the residual's unit.
    """

    weight: float
    kind: Literal["square", "huber", "barrier"] = "square"
    width: float = np.inf

    def cost(self, r: Floats) -> Floats:
        """Its value, the same shape as the residuals.

        Args:
            r: Residuals.
        """
        if self.kind == "huber":
            beyond = np.abs(r) > self.width
            linear = self.width * (2.0 * np.abs(r) - self.width)
            return self.weight * np.where(beyond, linear, r**2)
        if self.kind == "barrier":
            x = (r / self.width) ** 2
            steep = np.exp(np.minimum(x, STEEPEST))
            rest = np.maximum(x - STEEPEST, 0.0)
            return np.asarray(self.weight * self.width**2 * (steep * (1.0 + rest) - 1.0))
        return np.asarray(self.weight * r**2)

    def slope(self, r: Floats) -> Floats:
        """Its derivative, the same shape as the residuals.

        Args:
            r: Residuals.
        """
        return self.pull(r) * r

    def pull(self, r: Floats) -> Floats:
        """Its derivative over the residual: what the residual is weighed by where it is.

        Args:
            r: Residuals.
        """
        if self.kind == "huber":
            return np.asarray(
                2.0 * self.weight * np.minimum(1.0, self.width / np.maximum(np.abs(r), 1e-300))
            )
        if self.kind == "barrier":
            x = (r / self.width) ** 2
            return np.asarray(2.0 * self.weight * np.exp(np.minimum(x, STEEPEST)))
        return np.full_like(r, 2.0 * self.weight)

    def curvature(self, r: Floats) -> Floats:
        """What stands for its second derivative in the Gauss-Newton Hessian; positive.

        For Huber's norm, whose second derivative is zero where it is linear, it is `pull`.

        Args:
            r: Residuals.
        """
        if self.kind == "barrier":
            x = (r / self.width) ** 2
            return self.pull(r) * (1.0 + 2.0 * np.where(x < STEEPEST, x, 0.0))
        return self.pull(r)
