# SPDX-License-Identifier: Apache-2.0
"""Signals: the samples of one channel, or of all joints, at the times they were taken."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

SAME_S = 1e-9
"""Times this close are one: a nanosecond, the resolution of stamps."""


@dataclass(frozen=True)
class Signal:
    """Samples of one channel at the times they were taken; nothing is resampled.

    Attributes:
        time_s: (n,) increasing times, s after the start of the recording.
        values: (n,) finite values in SI units. A command holds from its time on until the next.
    """

    time_s: Floats
    values: Floats

    def __len__(self) -> int:
        """Return the number of samples."""
        return int(self.time_s.size)

    @property
    def period_s(self) -> float:
        """Median time between samples, s; infinite for a single one."""
        return float(np.median(np.diff(self.time_s))) if self.time_s.size > 1 else float("inf")

    def held(self, time_s: ArrayLike) -> Floats:
        """Values in force at given times; the first also holds before its time.

        Args:
            time_s: Times, s.
        """
        index = np.searchsorted(self.time_s, np.asarray(time_s, dtype=float) + SAME_S, "right") - 1
        return np.asarray(self.values[np.maximum(index, 0)])

    def mean_between(self, edges_s: Floats) -> Floats:
        """Mean of the held values between successive times; the first also holds before its time.

        Args:
            edges_s: (K + 1,) increasing times, s.

        Returns:
            (K,) means.
        """
        integral = np.concatenate(([0.0], np.cumsum(self.values[:-1] * np.diff(self.time_s))))
        at = np.interp(edges_s, self.time_s, integral)  # linear between the samples, hence exact
        at += self.values[0] * np.minimum(edges_s - self.time_s[0], 0.0)
        at += self.values[-1] * np.maximum(edges_s - self.time_s[-1], 0.0)
        return np.asarray(np.diff(at) / np.diff(edges_s))

    def within(self, begin_s: float, end_s: float) -> "Signal":
        """Samples in a stretch of time, both ends included.

        Args:
            begin_s: Its start, s.
            end_s: Its end, s.
        """
        keep = (self.time_s >= begin_s - SAME_S) & (self.time_s <= end_s + SAME_S)
        return Signal(self.time_s[keep], self.values[keep])


def velocity_of(joint: str) -> str:
    """What the velocity of a joint is called beside its position, which has the joint's name.

    Args:
        joint: Name of the joint.
    """
    return f"{joint}_velocity"


@dataclass(frozen=True)
class Motion:
    """Positions and velocities of joints at common times.

    Attributes:
        time_s: (n,) increasing times, s after the start of the recording.
        positions: Per joint (n,) positions, rad or m.
        speeds: Per joint of those its (n,) velocities, rad/s or m/s; or empty, where none is known.
    """

    time_s: Floats
    positions: Mapping[str, Floats]
    speeds: Mapping[str, Floats]
