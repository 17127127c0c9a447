# SPDX-License-Identifier: Apache-2.0
"""How sure it is that recordings kept aside are better explained: falls of costs, means, sums."""

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm
from scipy.stats.mstats import trimmed_mean, trimmed_stde

from pneu_sysid.contacts.chain import LEAST

Floats = NDArray[np.float64]

DRAWS = 4000
"""Of recordings at random, by which it is told how sure a sum over them is."""
TRIMMED = 0.2
"""Share of recordings on either side that a mean leaves out: a roll-out that tips over by a little
tells nothing of what is missing."""


def falls_of(before: Floats, after: Floats) -> Floats:
    """(recordings, kinds) falls of the logarithm of costs per knot.

    How wrong a model is of each kind of motion is not known, and with a scale of its own for each
    the likelihood is a sum of logarithms (variance components). What shows in flight is then not
    drowned by what contacts get wrong, nor by a body that lies still for long.

    Args:
        before: (recordings, kinds) costs per knot.
        after: Likewise.
    """
    return np.asarray(np.log(np.maximum(before, LEAST)) - np.log(np.maximum(after, LEAST)))


def trimmed(values: Floats) -> tuple[float, float]:
    """Mean over recordings, a fifth at either end left out, and its standard error.

    A recording that went another way would else outweigh all others.

    Args:
        values: (recordings,).
    """
    if len(values) < 2:
        return float(np.mean(values)), np.inf
    return (
        float(trimmed_mean(values, (TRIMMED, TRIMMED))),
        float(trimmed_stde(values, (TRIMMED, TRIMMED))),
    )


def lead_of(values: Floats) -> float:
    """How sure it is that values lie above nothing, in standard errors.

    By the trimmed mean and its error, or by how often recordings drawn at random from these add up
    to nothing or less (bootstrap), whichever is surer: what shows strongly in some recordings and
    hardly in others, as where only some touch, has a mean that is unsure and a sum that is not. One
    recording alone is left out of a third of all draws, and decides nothing. Two fewer are drawn
    than there are, so that few are no surer of nothing than by their mean.

    Args:
        values: (recordings,).
    """
    mean, spread = trimmed(values)
    by_mean = mean / spread if spread > 0.0 else 0.0
    fewer = len(values) - 2
    if fewer < 1 or not np.any(values):
        return by_mean
    drawn = np.random.default_rng(0).integers(len(values), size=(DRAWS, fewer))
    chance = float(np.mean(values[drawn].sum(axis=1) <= 0.0))
    return max(by_mean, float(norm.isf(max(chance, 0.5**fewer, 1.0 / DRAWS))))


def per_knot(costs: Floats) -> float:
    """Cost per knot, the geometric mean over recordings and kinds of motion.

    Args:
        costs: (recordings, kinds).
    """
    return float(np.exp(np.nanmean(np.log(np.maximum(costs, LEAST)))))
