# SPDX-License-Identifier: Apache-2.0
"""Random courses of a target: smooth, jagged, held, or all three in turn.

A target is a function of time and a seed alone, so that it can be looked ahead in, run again and
rewound. Smooth targets are sums of sines (thesis 7.5), jagged ones join random points by straight
lines, and holds step between them.
"""

import math
from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pneu_common.errors import InputError

Floats = NDArray[np.float64]
Kind = Literal["smooth", "jagged", "hold", "mixed"]
KINDS: tuple[Kind, ...] = get_args(Kind)

SINES = 5
"""Sines of a smooth target; their periods lie within a factor of three of the one asked for."""


@dataclass(frozen=True)
class Wave:
    """A random number over time.

    Attributes:
        kind: ``smooth``, ``jagged``, ``hold``, or ``mixed``, which takes turns.
        low: Lowest value.
        high: Highest value.
        period_s: Typical time from one extreme or level to the next, s.
        seed: Seed of all randomness.
        turn_s: How long each kind lasts where they take turns, s.
        jitter: Share of the period by which the corners of a jagged target are moved at random.
    """

    kind: Kind
    low: float
    high: float
    period_s: float = 0.5
    seed: int = 0
    turn_s: float = 4.0
    jitter: float = 0.0
    _sines: tuple[Floats, Floats, Floats] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Raises InputError where the numbers make no target."""
        if self.kind not in KINDS:
            raise InputError(f"kind: found {self.kind!r}, allowed are {', '.join(KINDS)}")
        if not (math.isfinite(self.low) and self.low < self.high < math.inf):
            raise InputError(
                f"low, high: found {self.low:g} and {self.high:g}, low is to be the smaller one"
            )
        for name in ("period_s", "turn_s"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise InputError(f"{name}: found {value:g}, it must be positive")
        if not 0.0 <= self.jitter <= 0.9:
            raise InputError(f"jitter: found {self.jitter:g}, allowed are 0 to 0.9")
        if self.seed < 0:
            raise InputError(f"seed: found {self.seed}, it must not be negative")
        rng = np.random.default_rng([self.seed, 0])
        # Half a period of a sine leads from one extreme to the next.
        frequency = 0.5 / self.period_s * np.exp(rng.uniform(-math.log(3), math.log(3), SINES))
        sines = (rng.uniform(0.5, 1.0, SINES), frequency, rng.uniform(0.0, 2.0 * math.pi, SINES))
        object.__setattr__(self, "_sines", sines)

    def at(self, time_s: ArrayLike) -> Floats:
        """The target at some times.

        Args:
            time_s: Times since the start, s; before it the target is that of the start.

        Returns:
            Values of the same shape.
        """
        t = np.maximum(np.atleast_1d(np.asarray(time_s, dtype=np.float64)), 0.0)
        if self.kind == "mixed":
            turn = (t // self.turn_s).astype(np.int64) % 3
            share = np.choose(turn, [self._smooth(t), self._jagged(t), self._held(t)])
        elif self.kind == "smooth":
            share = self._smooth(t)
        else:
            share = self._jagged(t) if self.kind == "jagged" else self._held(t)
        out = self.low + (self.high - self.low) * share
        return out.reshape(np.shape(time_s))

    def _smooth(self, t: Floats) -> Floats:
        amplitude, frequency, phase = self._sines
        angle = 2.0 * math.pi * frequency * t[..., None] + phase
        wave = np.sin(angle) @ amplitude / np.linalg.norm(amplitude)
        # The sum rarely comes near its bound; drawn out so that the range is used, and bent over
        # smoothly at its ends.
        return np.asarray(0.5 + 0.5 * np.tanh(1.2 * wave) / math.tanh(1.2 * math.sqrt(SINES)))

    def _levels(self, index: NDArray[np.int64]) -> Floats:
        """One random number in [0, 1] per index, whichever is asked for first."""
        numbers, inverse = np.unique(index, return_inverse=True)
        drawn = [np.random.default_rng([self.seed, 1, max(int(n), 0)]).uniform() for n in numbers]
        return np.asarray(drawn)[inverse].reshape(index.shape)

    def _corners(self, index: NDArray[np.int64]) -> Floats:
        """Times of the corners in periods: their numbers, moved by up to half the jitter."""
        if self.jitter == 0.0:
            return index.astype(np.float64)
        numbers, inverse = np.unique(index, return_inverse=True)
        moved = [np.random.default_rng([self.seed, 2, int(n) + 1]).uniform() for n in numbers]
        return np.asarray((numbers + self.jitter * (np.asarray(moved) - 0.5))[inverse])

    def _jagged(self, t: Floats) -> Floats:
        x = t.ravel() / self.period_s
        index = np.floor(x).astype(np.int64)
        # A corner is moved by less than half a period: it is this line, the one before or after.
        index -= x < self._corners(index)
        index += x >= self._corners(index + 1)
        begin = self._corners(index)
        part = ((x - begin) / (self._corners(index + 1) - begin)).reshape(t.shape)
        index = index.reshape(t.shape)
        left, right = self._levels(index), self._levels(index + 1)
        return left + (right - left) * part

    def _held(self, t: Floats) -> Floats:
        return self._levels((t // self.period_s).astype(np.int64))
