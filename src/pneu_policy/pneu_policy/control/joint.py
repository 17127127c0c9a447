# SPDX-License-Identifier: Apache-2.0
"""Control of a joint that a double-acting cylinder turns, by a valve on either side (thesis 9.2).

One voltage opens one valve as far as it closes the other:

    u = kp e + ki int e dt - kd dq/dt - kf F,   F = p1 A1 - p2 A2 - p0 (A1 - A2)

with e the target's distance from the position q, and F the gas's net force on the piston; the
valves have null + u and null - u. Feeding F back keeps the joint from swinging behind its tubes:
the gas pushes long before the joint shows it. What F holds at rest is left to the integral.
"""

import math
from dataclasses import dataclass

from pneu_common.errors import InputError


@dataclass(frozen=True)
class JointGains:
    """What a controller of a joint is set to; units per rad, or per m of one that slides.

    Attributes:
        kp_v: Proportional gain, V/rad.
        ki_v_s: Integral gain, V/(rad s).
        kd_v_s: Gain of the speed, V s/rad.
        kf_v_n: Gain of the gas's force, V/N.
        derivative_hz: Cut-off of the first-order filter of the speed, Hz.
        integral_v: Limit of the integral term on either side, V.
        most_v: Limit of u on either side, V.
    """

    kp_v: float
    ki_v_s: float = 0.0
    kd_v_s: float = 0.0
    kf_v_n: float = 0.0
    derivative_hz: float = 30.0
    integral_v: float = 1.5
    most_v: float = 5.0

    def __post_init__(self) -> None:
        """Raises InputError where the numbers make no controller."""
        for name, value in vars(self).items():
            if not (math.isfinite(value) and value >= 0.0):
                raise InputError(f"{name}: found {value:g}, it must be finite and not negative")
        for name in ("derivative_hz", "most_v"):
            if getattr(self, name) == 0.0:
                raise InputError(f"{name}: found 0, it must be positive")


class JointPid:
    """A controller with its memory.

    Attributes:
        gains: What it is set to.
        integral_v: Present integral term, V.
    """

    def __init__(self, gains: JointGains) -> None:
        """Starts at rest.

        Args:
            gains: What it is set to.
        """
        self.gains = gains
        self.reset()

    def reset(self) -> None:
        """Forgets the past."""
        self.integral_v = 0.0
        self._speed = 0.0
        self._before: float | None = None

    def step(self, target: float, position: float, force_n: float, dt_s: float) -> float:
        """Returns u, V: positive raises the position.

        Args:
            target: Where the joint is to be, rad.
            position: Where it is, rad.
            force_n: Net force of the gas on the piston, positive where it raises the position, N.
            dt_s: Time since the step before, s; at the first step it counts for nothing.

        Raises:
            ValueError: A number is not finite, or time does not advance.
        """
        if not all(map(math.isfinite, (target, position, force_n))):
            raise ValueError(f"found target {target}, position {position}, force {force_n} N")
        g, error = self.gains, target - position
        more = self.integral_v
        if self._before is not None:
            if not (math.isfinite(dt_s) and dt_s > 0.0):
                raise ValueError(f"found dt_s {dt_s}, time must advance")
            keep = math.exp(-2.0 * math.pi * g.derivative_hz * dt_s)
            speed = (position - self._before) / dt_s
            self._speed = keep * self._speed + (1.0 - keep) * speed
            more = min(max(more + g.ki_v_s * error * dt_s, -g.integral_v), g.integral_v)
        self._before = position
        share = g.kp_v * error - g.kd_v_s * self._speed - g.kf_v_n * force_n
        # Wind-up: while u is at its limit, the integral may only move back from it.
        if abs(share + more) <= g.most_v or abs(more) < abs(self.integral_v):
            self.integral_v = more
        return min(max(share + self.integral_v, -g.most_v), g.most_v)
