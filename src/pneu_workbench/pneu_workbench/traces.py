# SPDX-License-Identifier: Apache-2.0
"""Signals thinned to what a screen can show of a range: least and most of every column.

A pyramid of least and most values is made once; a range is then a matter of so many columns,
however many readings lie in it, and no peak is lost.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Shown = NDArray[np.float32]

STEP = 8
"""Readings, or entries of the level below, to one of a level."""
FINEST = 3
"""Columns have at least so many entries of the level that they are made from, or the level below
is taken."""


@dataclass(frozen=True)
class Level:
    """Readings taken together, so many at a time.

    Attributes:
        size: How many to an entry.
        least: (n,) the least of each.
        most: (n,) the most of each.
    """

    size: int
    least: Shown
    most: Shown


class Pyramid:
    """One signal at its own times, to be shown at any zoom."""

    def __init__(self, time_s: Floats, values: Floats) -> None:
        """Builds the levels.

        Args:
            time_s: (n,) rising.
            values: (n,); NaN is a gap.
        """
        self._time = np.asarray(time_s, dtype=np.float64)
        self._values = np.asarray(values, dtype=np.float32)
        self._levels: list[Level] = []
        least = most = self._values
        size = 1
        while least.size >= 4 * STEP:
            n = least.size // STEP
            with np.errstate(invalid="ignore"):
                least = np.fmin.reduce(least[: n * STEP].reshape(n, STEP), axis=1)
                most = np.fmax.reduce(most[: n * STEP].reshape(n, STEP), axis=1)
            size *= STEP
            self._levels.append(Level(size, least, most))

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last time, s."""
        return (float(self._time[0]), float(self._time[-1])) if self._time.size else (0.0, 0.0)

    def shown(self, begin_s: float, end_s: float, columns: int) -> tuple[Floats, Shown]:
        """What a screen shows of a range, with one reading beyond either end.

        Args:
            begin_s: Where it begins, s.
            end_s: Where it ends, s.
            columns: How many columns the screen has.

        Returns:
            Times and values: the readings themselves where there are no more than two to a column,
            else the least and the most of each column, in the order in which they come.
        """
        first = max(int(np.searchsorted(self._time, begin_s)) - 1, 0)
        last = min(int(np.searchsorted(self._time, end_s, side="right")) + 1, self._time.size)
        count = last - first
        columns = max(columns, 1)
        if count <= 2 * columns:
            return self._time[first:last], self._values[first:last]
        per = count / columns
        level = None
        for one in self._levels:
            if one.size * FINEST <= per:
                level = one
        size = 1 if level is None else level.size
        least, most = (self._values,) * 2 if level is None else (level.least, level.most)
        low, high = first // size, min(-(-last // size), least.size)
        edges = np.unique(np.linspace(low, high, columns + 1).astype(np.int64))[:-1]
        with np.errstate(invalid="ignore"):
            down = np.fmin.reduceat(least[:high], edges)
            up = np.fmax.reduceat(most[:high], edges)
        at = self._time[np.minimum(edges * size, self._time.size - 1)]
        following = np.append(at[1:], self._time[min(high * size, self._time.size) - 1])
        times = np.stack([at, 0.5 * (at + following)], axis=1).ravel()
        # rising where the column rises, so that a slope is not drawn as teeth
        ends = np.append(edges[1:], high) - 1
        rising = (least[ends] + most[ends]) >= (least[edges] + most[edges])
        pairs = np.where(rising[:, None], np.stack([down, up], 1), np.stack([up, down], 1))
        return times, pairs.ravel().astype(np.float32)


def packed(parts: list[tuple[Floats, Shown]], begin_s: float) -> bytes:
    """Signals as bytes: a count, then offsets of times from the begin and values, float32 each.

    Args:
        parts: Times and values of each signal.
        begin_s: What times are told from, s; a float32 would not tell readings an hour on apart.
    """
    out = [np.array([len(parts)], dtype=np.uint32).tobytes()]
    for times, values in parts:
        out.append(np.array([times.size], dtype=np.uint32).tobytes())
        out.append((times - begin_s).astype(np.float32).tobytes())
        out.append(np.asarray(values, dtype=np.float32).tobytes())
    return b"".join(out)
