# SPDX-License-Identifier: Apache-2.0
"""Search for the least of a function in the unit cube, a generation of points at a time.

Differential evolution, best/1/bin with dither: R. Storn, K. Price, Differential Evolution, Journal
of Global Optimization 11 (1997) 341-359. Of several searches tried on PID gains it got stuck least.
"""

import math

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

FACTOR = (0.4, 0.9)
"""Range from which each generation draws the factor on differences of points."""

CROSSING = 0.8
"""Probability that a coordinate is taken from the mutant."""


class Search:
    """Points that each give way to a better one.

    Attributes:
        best: (size,) the best point so far.
        least: Value there.
    """

    def __init__(self, first: Floats, count: int, rng: np.random.Generator) -> None:
        """Spreads points over the cube: every coordinate's range is divided evenly among them.

        Args:
            first: (size,) a point that is tried in the place of one of these.
            count: Points of a generation, 4 or more.
            rng: Random numbers.
        """
        self._rng = rng
        strata = np.stack([rng.permutation(count) for _ in first], axis=1)
        self._points = (strata + rng.uniform(size=strata.shape)) / count
        self._points[0] = first
        self._values = np.full(count, np.inf)
        self._tried = self._points.copy()
        self.best, self.least = first.copy(), math.inf

    def ask(self) -> Floats:
        """Draws the points of a generation, (count, size)."""
        if math.isfinite(self.least):
            factor = self._rng.uniform(*FACTOR)
            for i in range(len(self._points)):
                self._tried[i] = self._offspring(i, factor)
        return self._tried.copy()

    def tell(self, values: Floats) -> None:
        """Takes those of the points that were asked for which are better.

        Args:
            values: (count,) values.
        """
        better = values < self._values
        self._points[better] = self._tried[better]
        self._values[better] = values[better]
        best = int(np.argmin(self._values))
        self.best, self.least = self._points[best].copy(), float(self._values[best])

    def _offspring(self, i: int, factor: float) -> Floats:
        rng, own = self._rng, self._points[i]
        others = np.delete(np.arange(len(self._points)), i)
        a, b = rng.choice(others, 2, replace=False)
        mutant = self.best + factor * (self._points[a] - self._points[b])
        # Beyond the cube: anywhere between the old point and the face.
        share = rng.uniform(size=own.size)
        mutant = np.where(mutant < 0.0, share * own, mutant)
        mutant = np.where(mutant > 1.0, 1.0 - share * (1.0 - own), mutant)
        cross = rng.uniform(size=own.size) < CROSSING
        cross[rng.integers(own.size)] = True
        return np.where(cross, mutant, own)
