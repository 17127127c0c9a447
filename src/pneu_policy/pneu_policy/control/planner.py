# SPDX-License-Identifier: Apache-2.0
"""The high level of a hybrid controller: how to join a target, with which forces (thesis 9.2.4).

From where a joint is and how fast it goes, a critically damped spring and damper lead it to the
target ahead, its acceleration limited; the inverse dynamics of the rig say what the gas must push
with on the way, and where the pistons will then be.
"""

import math
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from pneu_common.errors import InputError
from pneu_common.validation import Settings
from pneu_sim.inverse import InverseDynamics
from pneu_sim.rig.schema import Rig

Floats = NDArray[np.float64]


class PlanSettings(Settings):
    """How a joint is led to its target.

    Attributes:
        joining_hz: Natural frequency of the spring and damper.
        damping: Damping ratio.
        most_rad_s2: Greatest acceleration, rad/s^2 or m/s^2.
        smoothed_s: Speeds and accelerations of the target are means over so long to either side.
        speed_hz: Cut-off of the first-order filter of the measured speed.
    """

    joining_hz: Annotated[float, Field(gt=0.0)] = 3.0
    damping: Annotated[float, Field(gt=0.0)] = 1.0
    most_rad_s2: Annotated[float, Field(gt=0.0)] = 200.0
    smoothed_s: Annotated[float, Field(gt=0.0)] = 0.02
    speed_hz: Annotated[float, Field(gt=0.0)] = 30.0


class Planner:
    """Plans of robots side by side.

    Attributes:
        settings: How they are led.
        steps: Control periods that a plan looks ahead.
        reach: Control periods of target that it is made of, the present one first.
    """

    def __init__(
        self, settings: PlanSettings, rig: Rig, tracked: list[str], period_s: float, ahead_s: float
    ) -> None:
        """Reads the dynamics of the rig.

        Args:
            settings: How joints are led.
            rig: The rig.
            tracked: Encoders that have targets, all on joints that are not held.
            period_s: Control period, s.
            ahead_s: How far a plan looks, s.

        Raises:
            InputError: The rig has no inverse dynamics, or other free joints than tracked.
        """
        self.settings = settings
        self._inverse = InverseDynamics(rig)
        self._period_s = period_s
        self.steps = max(1, math.ceil(ahead_s / period_s - 1e-9))
        self._around = max(1, round(settings.smoothed_s / period_s))
        self.reach = self.steps + 2 * self._around + 1
        on = [rig.encoders[name].on(name) for name in tracked]
        missing = [name for name in on if name not in self._inverse.joints]
        if missing or len(on) != len(self._inverse.cylinders):
            raise InputError(
                f"recipe.tracked: found {', '.join(tracked)}; a plan needs every joint of rig"
                f" {rig.name!r} that moves, once"
            )
        self._on = [self._inverse.joints.index(name) for name in on]
        self._strokes = self._inverse.strokes()
        self._before: Floats | None = None
        self._speed: Floats | None = None

    @property
    def cylinders(self) -> list[str]:
        """Names of the cylinders that plans tell forces of."""
        return self._inverse.cylinders

    def reset(self) -> None:
        """Forgets the past, as if joints had stood still."""
        self._before = self._speed = None

    def speed(self, position: Floats) -> Floats:
        """Speeds by what was measured, one control period after the last.

        Args:
            position: (count, tracked) rad or m.
        """
        if self._before is None or self._speed is None:
            self._speed = np.zeros_like(position)
        else:
            keep = math.exp(-2.0 * math.pi * self.settings.speed_hz * self._period_s)
            raw = (position - self._before) / self._period_s
            self._speed = keep * self._speed + (1.0 - keep) * raw
        self._before = position.copy()
        return self._speed

    def plan(self, position: Floats, targets: Floats) -> tuple[Floats, Floats]:
        """What to push with, from now on.

        Args:
            position: (count, tracked) measured, rad or m.
            targets: (count, tracked, reach) at the present period and those after it; what lies
                further back is taken to have been like the present.

        Returns:
            (count, cylinders, steps + 1) forces, N, now and at every period ahead, and
            (count, cylinders, steps + 1) extensions over their strokes.
        """
        s, h, k = self.settings, self._period_s, self._around
        q, v = position.copy(), self.speed(position).copy()
        count, tracked = q.shape
        # Central differences over a short stretch; at its beginning what there is.
        whole = np.concatenate([np.repeat(targets[:, :, :1], k, axis=2), targets], axis=2)
        rate = (whole[:, :, 2 * k :] - whole[:, :, : -2 * k]) / (2.0 * k * h)
        rate[:, :, :k] = (targets[:, :, k : 2 * k] - targets[:, :, :k]) / (k * h)
        bend = np.gradient(rate, h, axis=2)
        w = 2.0 * math.pi * s.joining_hz
        way = np.zeros((3, count, self.steps + 1, tracked))
        for n in range(self.steps + 1):
            a = (
                bend[:, :, n]
                + 2.0 * s.damping * w * (rate[:, :, n] - v)
                + w * w * (targets[:, :, n] - q)
            )
            a = np.clip(a, -s.most_rad_s2, s.most_rad_s2)
            way[:, :, n] = q, v, a
            q = q + h * v + 0.5 * h * h * a
            v = v + h * a
        joints = np.zeros((3, count * (self.steps + 1), len(self._inverse.joints)))
        joints[:, :, self._on] = way.reshape(3, -1, tracked)
        force, extension = self._inverse.required(*joints)
        shape = (count, self.steps + 1, len(self.cylinders))
        share = np.clip(extension / self._strokes, 0.0, 1.0)
        return (
            force.reshape(shape).transpose(0, 2, 1),
            share.reshape(shape).transpose(0, 2, 1),
        )
