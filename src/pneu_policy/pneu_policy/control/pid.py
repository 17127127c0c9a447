# SPDX-License-Identifier: Apache-2.0
"""PID control of the pressure at a tap by a proportional valve (thesis 8.1.1).

The voltage leaves the valve's null by proportional, integral and filtered derivative terms of the
error: u = u0 + kp e + I + kd s/(1 + s T) (c r - y), e = r - y. A positive step opens the supply.
"""

import math
from dataclasses import dataclass

from pneu_common.errors import InputError


@dataclass(frozen=True)
class Gains:
    """What a controller is set to.

    Attributes:
        kp_v_per_pa: Proportional gain, V/Pa.
        ki_v_per_pa_s: Integral gain, V/(Pa s).
        kd_v_s_per_pa: Derivative gain, V s/Pa.
        derivative_hz: Cut-off of the derivative's first-order filter, Hz.
        target_weight: Share c of the target in the derivative: 0 takes that of the pressure alone,
            so that steps of the target do not kick the valve.
        null_v: Voltage at which the valve closes, V.
        low_v: Lowest voltage, V.
        high_v: Highest voltage, V.
        integral_v: Limit of the integral term on either side, V.
    """

    kp_v_per_pa: float
    ki_v_per_pa_s: float = 0.0
    kd_v_s_per_pa: float = 0.0
    derivative_hz: float = 50.0
    target_weight: float = 1.0
    null_v: float = 5.0
    low_v: float = 0.0
    high_v: float = 10.0
    integral_v: float = 1.0

    def __post_init__(self) -> None:
        """Raises InputError where the numbers make no controller."""
        for name, value in vars(self).items():
            if not math.isfinite(value):
                raise InputError(f"{name}: found {value}, it must be finite")
        for name in ("kp_v_per_pa", "ki_v_per_pa_s", "kd_v_s_per_pa", "integral_v"):
            if getattr(self, name) < 0.0:
                raise InputError(f"{name}: found {getattr(self, name):g}, it must not be negative")
        if self.derivative_hz <= 0.0:
            raise InputError(f"derivative_hz: found {self.derivative_hz:g}, it must be positive")
        if not self.low_v <= self.null_v <= self.high_v or self.low_v == self.high_v:
            raise InputError(
                f"null_v: found {self.null_v:g}, it must lie between low_v ({self.low_v:g}) and"
                f" high_v ({self.high_v:g})"
            )


class Pid:
    """A controller with its memory.

    Attributes:
        gains: What it is set to; may be exchanged between steps.
        integral_v: Present integral term, V.
        error_pa: Latest error, target minus pressure, Pa.
    """

    def __init__(self, gains: Gains) -> None:
        """Starts at rest.

        Args:
            gains: What it is set to.
        """
        self.gains = gains
        self.reset()

    def reset(self) -> None:
        """Forgets the past."""
        self.integral_v = 0.0
        self.error_pa = 0.0
        self._derivative = 0.0
        self._before: float | None = None

    def step(self, target_pa: float, pressure_pa: float, dt_s: float, more_v: float = 0.0) -> float:
        """Voltage for the next period.

        Args:
            target_pa: Where the pressure shall be, Pa.
            pressure_pa: Where it is, Pa.
            dt_s: Time since the pressure of the step before, s; ignored at the first step.
            more_v: Voltage that is added, as a feed-forward knows it, V.

        Returns:
            The voltage, within its limits, V.

        Raises:
            ValueError: A number is not finite, or time did not advance.
        """
        if not (math.isfinite(target_pa) and math.isfinite(pressure_pa)):
            raise ValueError(f"found target {target_pa} Pa and pressure {pressure_pa} Pa")
        g = self.gains
        error = target_pa - pressure_pa
        slope_of = g.target_weight * target_pa - pressure_pa
        first = self._before is None
        if not first:
            if not (math.isfinite(dt_s) and dt_s > 0.0):
                raise ValueError(f"found dt_s {dt_s}, time must advance")
            keep = math.exp(-2.0 * math.pi * g.derivative_hz * dt_s)
            raw = (slope_of - (self._before or 0.0)) / dt_s
            self._derivative = keep * self._derivative + (1.0 - keep) * raw
        self._before = slope_of
        self.error_pa = error
        share = g.null_v + more_v + g.kp_v_per_pa * error + g.kd_v_s_per_pa * self._derivative
        if not first:
            # The trapezoid would need the error before; at control rates the rectangle does.
            more = self.integral_v + g.ki_v_per_pa_s * error * dt_s
            more = min(max(more, -g.integral_v), g.integral_v)
            wanted = share + more
            # Wind-up: while the valve is at its limit, the integral may only move back from it.
            inward = abs(more) < abs(self.integral_v)
            if g.low_v <= wanted <= g.high_v or inward or (wanted > g.high_v) != (error > 0.0):
                self.integral_v = more
        return min(max(share + self.integral_v, g.low_v), g.high_v)
