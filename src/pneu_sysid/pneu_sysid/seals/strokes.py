# SPDX-License-Identifier: Apache-2.0
"""Where a dragged piston slides, which way and how fast: turning points, speed, sliding readings.

Turning points are those of a zigzag that ignores whatever is small against the way or the noise.
Speed is the slope of a straight line through the readings around each, over a time that the noise
of the position asks for, never across a gap. Of each stroke the beginning is left out, in which the
seal still shears and the machine takes up its slack.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.signal import medfilt

from pneu_common.errors import InputError
from pneu_sysid.records.stream import LONGEST_STEP
from pneu_sysid.seals.reading import DragTest

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SWING = 0.1
"""A turn counts where the piston then goes back by this share of the whole way ..."""
ABOVE_NOISE = 8.0
"""... and by so many times the noise of the position."""
SETTLED = 0.05
"""This share of a stroke after its turning point is not used: the seal is still being sheared."""
SPEED_ERROR = 0.03
"""Readings are taken together until the speed's standard error is this share of the speed ..."""
LONGEST = 0.06
"""... but over no longer than this share of a stroke's time to either side."""
SLOWEST = 0.05
"""Slower than this share of the usual speed the piston counts as at rest ..."""
SURE = 4.0
"""... and below so many standard errors of the speed."""
WHOLE = 0.3
"""A stroke shorter than this share of the usual one is not used."""
FEWEST = 12
"""Nor is one with fewer sliding readings."""


@dataclass(frozen=True)
class Strokes:
    """The sliding readings of a drag test.

    Attributes:
        index: (m,) which readings of the test they are.
        stroke: (m,) stroke that each belongs to, counted from 0.
        speed_m_s: (m,) speed, without its direction.
        extending: (n_strokes,) whether the piston extends in each.
    """

    index: Ints
    stroke: Ints
    speed_m_s: Floats
    extending: NDArray[np.bool_]


def strokes_of(test: DragTest) -> Strokes:
    """Finds the strokes of a drag test.

    Args:
        test: The test.

    Raises:
        InputError: The piston never slides steadily.
    """
    time = test.time_s
    position = medfilt(test.extension_m, 5)
    position[:2], position[-2:] = position[2], position[-3]
    noise = position_noise(position)
    low, high = np.quantile(position, [0.01, 0.99])
    swing = max(SWING * float(high - low), ABOVE_NOISE * noise)
    turns = turning_points(position, swing)
    if len(turns) < 2:
        raise InputError(
            f"{test.name}: the piston does not slide from one place to another, no stroke goes over"
            f" more than {swing:.3g} m"
        )
    spans = np.diff(time[turns])
    speed, error, half = _speed(time, position, noise, float(np.median(spans)))
    usual = float(np.quantile(np.abs(speed), 0.9))
    sliding = np.abs(speed) >= np.maximum(SLOWEST * usual, SURE * error)
    ways = np.abs(np.diff(position[turns]))
    typical = float(np.median(ways))
    index: list[Ints] = []
    stroke: list[Ints] = []
    extending: list[bool] = []
    for k, (begin, end) in enumerate(pairwise(turns)):
        if ways[k] < WHOLE * typical:
            continue
        sign = np.sign(position[end] - position[begin])
        inside = np.arange(begin, end + 1)
        gone = np.abs(position[inside] - position[begin])
        keep = (gone >= SETTLED * ways[k]) & sliding[inside] & (np.sign(speed[inside]) == sign)
        keep &= (time[inside] - time[begin] >= half) & (time[end] - time[inside] >= half)
        inside = inside[keep]
        if inside.size >= FEWEST:
            index.append(inside)
            stroke.append(np.full(inside.size, len(extending)))
            extending.append(bool(sign > 0.0))
    if not index:
        raise InputError(
            f"{test.name}: no stroke has {FEWEST} readings in which the piston slides steadily"
        )
    of = np.concatenate(index)
    return Strokes(of, np.concatenate(stroke), np.abs(speed[of]), np.array(extending))


def position_noise(position: Floats) -> float:
    """Noise of a position from its third differences, robustly, with its resolution; m.

    Args:
        position: (n,) readings, m.
    """
    third = np.diff(position, 3)
    sigma = 1.4826 * float(np.median(np.abs(third - np.median(third)))) / np.sqrt(20.0)
    steps = np.abs(np.diff(position))
    steps = steps[steps > 0.0]
    resolution = float(np.min(steps)) if steps.size else 0.0
    return max(sigma, resolution / np.sqrt(12.0))


def turning_points(position: Floats, swing: float) -> list[int]:
    """First reading, every turn of at least some size, last reading.

    Args:
        position: (n,) positions, m.
        swing: How far it must go back for a turn, m.
    """
    turns: list[int] = []
    low = high = 0
    way = 0
    for i, x in enumerate(position.tolist()):
        if x > position[high]:
            high = i
        if x < position[low]:
            low = i
        if way >= 0 and x <= position[high] - swing:
            turns.append(high)
            way, low = -1, i
            high = i
        elif way <= 0 and x >= position[low] + swing:
            turns.append(low)
            way, high = 1, i
            low = i
    if not turns:
        return []
    turns.append(high if way > 0 else low)
    return turns


def _speed(
    time: Floats, position: Floats, noise: float, span: float
) -> tuple[Floats, Floats, float]:
    """Slope of lines around each reading, its standard error, and half the time they take."""
    step = float(np.median(np.diff(time)))
    typical = abs(float(np.median(np.abs(np.diff(position)))) / step)
    typical = max(typical, float(np.ptp(position)) / max(float(np.ptp(time)), step))
    half = 3.0 * step
    while half < LONGEST * span:
        n = 2.0 * half / step + 1.0
        if noise * np.sqrt(12.0 / n) / (2.0 * half) < SPEED_ERROR * typical:
            break
        half *= 1.3
    speed = np.zeros(time.size)
    error = np.full(time.size, np.inf)
    edges = np.flatnonzero(np.diff(time) > max(LONGEST_STEP * step, half)) + 1
    for part in np.split(np.arange(time.size), edges):
        if part.size < 5:
            continue
        t, x = time[part] - time[part].mean(), position[part] - position[part].mean()
        first = np.searchsorted(t, t - half * (1.0 + 1e-9))
        last = np.searchsorted(t, t + half * (1.0 + 1e-9))
        n = (last - first).astype(float)

        def total(
            values: Floats, first: Ints = first, last: Ints = last
        ) -> Floats:  # over the window of each reading
            sums = np.concatenate(([0.0], np.cumsum(values)))
            out: Floats = sums[last] - sums[first]
            return out

        spread = total(t * t) - total(t) ** 2 / n
        ok = (n >= 4) & (spread > 0.0)
        slope = (total(t * x) - total(t) * total(x) / n) / np.where(ok, spread, 1.0)
        speed[part] = np.where(ok, slope, 0.0)
        error[part] = np.where(ok, noise / np.sqrt(np.where(ok, spread, 1.0)), np.inf)
    return speed, error, half
