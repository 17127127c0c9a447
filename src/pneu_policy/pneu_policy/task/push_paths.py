# SPDX-License-Identifier: Apache-2.0
"""Paths on a plane along which a thing shall be pushed: round, eight, or wandering by a seed.

All begin at rest in the middle.
"""

from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from pneu_sim.hand.paths import eased

Floats = NDArray[np.float64]

PathKind = Literal["wander", "circle", "eight"]
PATH_KINDS: tuple[PathKind, ...] = get_args(PathKind)

BEGIN_S = 2.5
"""From rest in the middle to full swing."""
WAVES = 3
"""Sines that a wandering path is made of, along each axis."""


class PushPath:
    """A path.

    Attributes:
        kind: Its kind.
    """

    def __init__(self, kind: PathKind, reach_m: float, period_s: float, seed: int = 0) -> None:
        """Draws it.

        Args:
            kind: ``circle``, ``eight`` or ``wander``.
            reach_m: Furthest from the middle.
            period_s: Of a round; of the quickest sine of a wandering path.
            seed: Of a wandering one, and of where a round begins.
        """
        self.kind = kind
        rng = np.random.default_rng([seed, 0x9A7])
        turn = float(rng.uniform(0.0, 2.0 * np.pi))
        way = float(rng.choice([-1.0, 1.0]))
        rate = 2.0 * np.pi / period_s
        if kind == "circle":
            self._rates = np.array([[rate], [rate]])
            self._sizes = np.array([[1.0], [way]])
            self._phases = np.array([[turn + 0.5 * np.pi], [turn]])
        elif kind == "eight":
            self._rates = np.array([[rate], [2.0 * rate]])
            self._sizes = np.array([[1.0], [0.5 * way]])
            self._phases = np.array([[turn], [2.0 * turn]])
        else:
            self._rates = rate * rng.uniform(0.3, 1.0, (2, WAVES))
            self._sizes = rng.uniform(0.3, 1.0, (2, WAVES))
            self._phases = rng.uniform(0.0, 2.0 * np.pi, (2, WAVES))
        swing = self._swing(np.linspace(0.0, 20.0 * period_s, 2000))
        self._sizes = self._sizes * reach_m / np.max(np.linalg.norm(swing, axis=-1))

    def _swing(self, time_s: Floats) -> Floats:
        angle = time_s[..., None, None] * self._rates + self._phases
        return np.asarray(np.sum(self._sizes * np.sin(angle), axis=-1))

    def at(self, time_s: Floats) -> Floats:
        """(..., 2) places, m.

        Args:
            time_s: (...,) since the beginning.
        """
        time_s = np.asarray(time_s, dtype=float)
        share = eased(np.clip(time_s / BEGIN_S, 0.0, 1.0))
        return np.asarray(share[..., None] * self._swing(time_s))
