# SPDX-License-Identifier: Apache-2.0
"""The search that gains are tuned by: differential evolution in their logarithms.

Best/1/bin with dither (Storn and Price, Journal of Global Optimization 11 (1997) 341-359): of
several searches tried it got stuck least. The same seed gives the same gains.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import differential_evolution
from scipy.stats.qmc import LatinHypercube

Floats = NDArray[np.float64]

FACTOR = (0.4, 0.9)
"""Range from which each generation draws the factor on differences of candidates."""
CROSSING = 0.8
"""Probability that a knob is taken from the mutant."""


@dataclass(frozen=True)
class Knob:
    """A number that is tuned.

    Attributes:
        name: What it sets.
        low: Least value.
        high: Greatest value.
        begin: Value of the first candidate.
        log: Whether it is sought in its logarithm.
    """

    name: str
    low: float
    high: float
    begin: float
    log: bool = True

    def value(self, share: float) -> float:
        """The value at a share of the range.

        Args:
            share: 0 to 1.
        """
        if self.log:
            return float(self.low * (self.high / self.low) ** share)
        return self.low + (self.high - self.low) * share

    def share(self) -> float:
        """Where in the range it begins."""
        if self.log:
            return math.log(self.begin / self.low) / math.log(self.high / self.low)
        return (self.begin - self.low) / (self.high - self.low)


def seek(
    of_generation: Callable[[Floats], Floats],
    knobs: Sequence[Knob],
    candidates: int,
    generations: int,
    rng: np.random.Generator,
) -> None:
    """Seeks the knobs with the least value; whoever judges a generation keeps what was best.

    Args:
        of_generation: Values of a (knobs, candidates) generation of shares, (candidates,).
        knobs: What is tuned.
        candidates: How many to a generation.
        generations: How many.
        rng: Where the draws come from.
    """
    differential_evolution(
        of_generation,
        [(0.0, 1.0)] * len(knobs),
        strategy="best1bin",
        mutation=FACTOR,
        recombination=CROSSING,
        init=LatinHypercube(len(knobs), seed=rng).random(candidates),
        x0=np.array([knob.share() for knob in knobs]),
        maxiter=generations - 1,
        tol=0.0,  # as many generations as were asked for
        polish=False,
        updating="deferred",
        vectorized=True,
        seed=rng,
    )
