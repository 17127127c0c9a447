# SPDX-License-Identifier: Apache-2.0
"""The analysis of an ensemble filter: members are moved by what was read, one reading at a time.

The serial square-root filter of Whitaker and Hamill 2002 (Monthly Weather Review 130, 1913): the
mean is moved by the gain, the deviations by less of it, so that no reading need be perturbed.
Gains are multiplied by how near a number is to the sensor (localisation).
"""

import math

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def move(
    members: Floats,
    shown: Floats,
    reading: float,
    variance: float,
    nearness: Floats,
    drifts: slice,
) -> None:
    """Moves members by one reading.

    Args:
        members: (numbers, members) changed in place.
        shown: (members,) what the sensor shows by each, as yet.
        reading: What it read.
        variance: Of its noise.
        nearness: (numbers,) share of the gain.
        drifts: Those of the numbers that no distance tells to be unrelated: their gains are
            shrunk by what a correlation of so few members is by chance.
    """
    count = shown.size
    deviation = shown - shown.mean()
    spread = float(deviation @ deviation) / (count - 1)
    if spread <= 0.0:
        return
    innovation = reading - float(shown.mean())
    total = spread + variance
    own = members - members.mean(axis=1, keepdims=True)
    gain = nearness * (own @ deviation) / ((count - 1) * total)
    gain[drifts] *= _sure(own[drifts], deviation)
    less = 1.0 / (1.0 + math.sqrt(variance / total))
    members += gain[:, None] * (innovation - less * deviation)


def _sure(own: Floats, deviation: Floats) -> Floats:
    """(numbers,) share of the squared correlations with a sensor that is not by chance.

    Without any relation the squared correlation of n members is 1 / (n - 1) on the mean.

    Args:
        own: (numbers, members) deviations.
        deviation: (members,) of what the sensor shows.
    """
    square = (own @ deviation) ** 2
    square /= np.maximum((own**2).sum(axis=1) * (deviation @ deviation), 1e-300)
    return np.maximum(1.0 - 1.0 / ((deviation.size - 1) * np.maximum(square, 1e-30)), 0.0)
