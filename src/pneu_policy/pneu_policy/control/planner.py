# SPDX-License-Identifier: Apache-2.0
"""The high level of a hybrid controller: how to join a target, with which forces (thesis 9.2.4).

From where a joint is and how fast it goes, a critically damped spring and damper lead it to the
target ahead, its acceleration limited; the inverse dynamics of the rig say what the gas must push
with on the way, as far as it can, and where the pistons will then be.
"""

import math

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_policy.control.plan_settings import PlanSettings
from pneu_policy.control.robot_recipe import RobotRecipe
from pneu_sim.inverse import InverseDynamics
from pneu_sim.rig.schema import Rig

Floats = NDArray[np.float64]


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
        self.reach = self.steps + self._around + 2
        on = [rig.encoders[name].on(name) for name in tracked]
        missing = [name for name in on if name not in self._inverse.joints]
        if missing or len(on) != len(self._inverse.cylinders):
            raise InputError(
                f"recipe.tracked: found {', '.join(tracked)}; a plan needs every joint of rig"
                f" {rig.name!r} that moves, once"
            )
        self._on = [self._inverse.joints.index(name) for name in on]
        self._strokes = self._inverse.strokes()
        sources = [source.pressure_pa for source in rig.reservoirs.values()]
        low_pa, high_pa = min(*sources, rig.ambient.pressure_pa), max(sources)
        least, most = self._inverse.strongest(high_pa, low_pa)
        self._least, self._most = settings.strength * least, settings.strength * most
        self._before: Floats | None = None
        self._speed: Floats | None = None
        self._pace: Floats | None = None
        self._gone: Floats | None = None

    @classmethod
    def of_recipe(cls, recipe: RobotRecipe, rig: Rig) -> "Planner":
        """The high level that tells a policy which forces are required.

        Args:
            recipe: What the policy sees.
            rig: The rig, as far as it is known.

        Raises:
            InputError: The rig has no inverse dynamics, or previews are no whole periods.
        """
        r = recipe
        for at in r.preview_s:
            if abs(at / r.period_s - round(at / r.period_s)) > 1e-6:
                raise InputError(
                    f"recipe.preview_s: found {at:g}, a plan tells forces at whole control periods"
                    f" of {r.period_s:g} s"
                )
        if r.plan is None:
            raise InputError("recipe.plan: found none, which says what forces are required")
        made = cls(r.plan, rig, list(r.tracked), r.period_s, max(r.preview_s[-1], r.period_s))
        if made.cylinders != list(r.forces):
            raise InputError(
                f"recipe.forces: found {', '.join(r.forces)}, rig {rig.name!r} is moved by"
                f" {', '.join(made.cylinders)}"
            )
        return made

    @property
    def cylinders(self) -> list[str]:
        """Names of the cylinders that plans tell forces of."""
        return self._inverse.cylinders

    def reset(self) -> None:
        """Forgets the past, as if joints had stood still."""
        self._before = self._speed = self._pace = self._gone = None

    def speed(self, position: Floats) -> Floats:
        """Speeds by what was measured, one control period after the last.

        A filter of differences alone is late, and a plan by late speeds overdoes accelerations; so
        the last plan's acceleration carries both the difference, which is of half a period ago, and
        the speed before on to the present.

        Args:
            position: (count, tracked) rad or m.
        """
        h = self._period_s
        if self._before is None or self._speed is None or self._pace is None:
            self._speed = np.zeros_like(position)
        else:
            keep = math.exp(-2.0 * math.pi * self.settings.speed_hz * h)
            raw = (position - self._before) / h + 0.5 * h * self._pace
            self._speed = keep * (self._speed + h * self._pace) + (1.0 - keep) * raw
        self._before = position.copy()
        return self._speed

    def _course(self, targets: Floats) -> tuple[Floats, Floats]:
        """Speeds and accelerations of targets from now on, by central differences.

        Targets that have gone by are remembered; at the first plan they are taken to have come as
        they go on.

        Args:
            targets: (count, tracked, reach).
        """
        h, k = self._period_s, self._around
        if self._gone is None:
            self._gone = 2.0 * targets[:, :, :1] - targets[:, :, k + 1 : 0 : -1]
        whole = np.concatenate([self._gone, targets], axis=2)
        self._gone = whole[:, :, 1 : k + 2].copy()
        rate = (whole[:, :, 2 * k :] - whole[:, :, : -2 * k]) / (2.0 * k * h)
        bend = (rate[:, :, 2:] - rate[:, :, :-2]) / (2.0 * h)
        return rate[:, :, 1:], bend

    def plan(self, position: Floats, targets: Floats) -> tuple[Floats, Floats]:
        """What to push with, from now on.

        Args:
            position: (count, tracked) measured, rad or m.
            targets: (count, tracked, reach) at the present period and those after it.

        Returns:
            (count, cylinders, steps + 1) forces, N, now and at every period ahead, and
            (count, cylinders, steps + 1) extensions over their strokes.
        """
        s, h = self.settings, self._period_s
        q, v = position.copy(), self.speed(position).copy()
        count, tracked = q.shape
        rate, bend = self._course(targets)
        w = 2.0 * math.pi * s.joining_hz
        way = np.zeros((3, count, self.steps + 1, tracked))
        for n in range(self.steps + 1):
            a = (
                bend[:, :, n]
                + 2.0 * s.damping * w * (rate[:, :, n] - v)
                + w * w * (targets[:, :, n] - q)
            )
            a = np.clip(a, -s.most_rad_s2, s.most_rad_s2)
            if n == 0:
                self._pace = a
            way[:, :, n] = q, v, a
            q = q + h * v + 0.5 * h * h * a
            v = v + h * a
        joints = np.zeros((3, count * (self.steps + 1), len(self._inverse.joints)))
        joints[:, :, self._on] = way.reshape(3, -1, tracked)
        force, extension = self._inverse.required(*joints)
        shape = (count, self.steps + 1, len(self.cylinders))
        force = np.clip(force, self._least, self._most)
        share = np.clip(extension / self._strokes, 0.0, 1.0)
        return (
            force.reshape(shape).transpose(0, 2, 1),
            share.reshape(shape).transpose(0, 2, 1),
        )
