# SPDX-License-Identifier: Apache-2.0
"""What a policy that pushes a thing along a path sees and does, the same in training and on arms.

It sees where tips are about the thing, how fast tips and thing move, where the path goes next, for
how long the thing has been off it, and its own last action; it pushes each tip along the plane
(Lowrey et al., SIMPAR 2018, whose arms were driven by torques as well). Tips are held at a height,
and within reach, by springs that it does not know of.
"""

from itertools import pairwise
from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from pneu_common.validation import Listed, Settings

Floats = NDArray[np.float64]

NEAR_M, SLOW_M_S, OFF_M = 0.05, 0.2, 0.02
"""Places, velocities and errors are told in these."""

Positive = Annotated[float, Field(gt=0.0)]


class PushRecipe(Settings):
    """How features are made, and forces of actions.

    Attributes:
        period_s: Control period.
        preview_s: Times ahead at which the path is told; the first is now.
        memory_s: Time constant by which what the thing was off is forgotten.
        force_n: Force of a tip along x or y at an action of one.
        height_m: At which tips are held.
        lift_n_m: Stiffness of that.
        roam_m: Tips that are further from their places at rest, along the plane, are pulled back.
        fence_n_m: Stiffness of that.
    """

    period_s: Positive = 0.02
    preview_s: Annotated[tuple[float, ...], Listed] = (0.0, 0.1, 0.2, 0.4)
    memory_s: Positive = 0.5
    force_n: Positive = 1.6
    height_m: Positive = 0.04
    lift_n_m: Positive = 40.0
    roam_m: Positive = 0.08
    fence_n_m: Positive = 60.0

    @model_validator(mode="after")
    def _makes_sense(self) -> Self:
        ahead = self.preview_s
        rising = all(a < b for a, b in pairwise(ahead))
        if not ahead or ahead[0] != 0.0 or not rising:
            raise ValueError(f"preview_s: found {list(ahead)}, needed are rising times from 0")
        return self

    def size(self, arms: int) -> int:
        """Number of features.

        Args:
            arms: How many arms there are.
        """
        return 7 * arms + 2 * len(self.preview_s) + 6

    def forces(self, action: Floats, tips_m: Floats, home_m: Floats) -> Floats:
        """(plants, arms, 3) forces of tips, N.

        Args:
            action: (plants, 2 arms); beyond -1 and 1 it is cut off.
            tips_m: (plants, arms, 3) where tips are.
            home_m: (arms, 3) where they are at rest.
        """
        out = np.empty_like(tips_m)
        away = tips_m[..., :2] - home_m[:, :2]
        far = np.linalg.norm(away, axis=-1, keepdims=True)
        back = np.maximum(far - self.roam_m, 0.0) / np.maximum(far, 1e-9)
        pushed = np.clip(action, -1.0, 1.0).reshape(*tips_m.shape[:2], 2)
        out[..., :2] = self.force_n * pushed - self.fence_n_m * back * away
        out[..., 2] = self.lift_n_m * (self.height_m - tips_m[..., 2])
        return out


class PushObserver:
    """Makes features of plants side by side, remembering what they need."""

    def __init__(self, recipe: PushRecipe, arms: int, count: int = 1) -> None:
        """Starts without a past.

        Args:
            recipe: How features are made.
            arms: How many arms there are.
            count: Plants side by side.
        """
        self.recipe = recipe
        self.error_m: Floats = np.zeros((count, 2))
        self._before: Floats | None = None
        self._off = np.zeros((count, 2))
        self._acted = np.zeros((count, 2 * arms))

    def reset(self) -> None:
        """Forgets the past: as if the thing had been at rest on its path."""
        self._before = None
        self._off[:] = 0.0
        self._acted[:] = 0.0

    def observe(self, tips_m: Floats, tips_m_s: Floats, thing_m: Floats, path_m: Floats) -> Floats:
        """Features of the present moment, one control period after the last.

        Args:
            tips_m: (count, arms, 3) where tips are.
            tips_m_s: (count, arms, 3) how fast they move.
            thing_m: (count, 2) where the thing is on the plane.
            path_m: (count, previews, 2) where it should be at the recipe's times ahead.

        Returns:
            (count, size).

        Raises:
            ValueError: A value is not finite.
        """
        r = self.recipe
        if not np.isfinite(tips_m.sum() + tips_m_s.sum() + thing_m.sum() + path_m.sum()):
            raise ValueError(f"found tips {tips_m} m, thing {thing_m} m and path {path_m} m")
        count = len(thing_m)
        before = thing_m if self._before is None else self._before
        speed = (thing_m - before) / r.period_s
        self._before = thing_m.copy()
        error = path_m - thing_m[:, None, :]
        self.error_m = error[:, 0]
        share = np.exp(-r.period_s / r.memory_s)
        self._off = share * self._off + (1.0 - share) * error[:, 0]
        about = tips_m[..., :2] - thing_m[:, None, :]
        return np.concatenate(
            [
                (about / NEAR_M).reshape(count, -1),
                (tips_m[..., 2] - r.height_m) / OFF_M,
                (tips_m_s[..., :2] / SLOW_M_S).reshape(count, -1),
                thing_m / NEAR_M,
                speed / SLOW_M_S,
                (error / OFF_M).reshape(count, -1),
                self._off / OFF_M,
                self._acted,
            ],
            axis=1,
        )

    def acted(self, action: Floats) -> None:
        """Remembers what was done.

        Args:
            action: (count, 2 arms).
        """
        self._acted[:] = np.clip(action, -1.0, 1.0)
