# SPDX-License-Identifier: Apache-2.0
"""How soon the valves are safe at the device, at worst, by what goes wrong.

Known beforehand are the settings; how long a write takes is measured while the bridge runs. What
nobody has set is not promised: a device without a watchdog keeps its outputs for ever once nobody
writes to it.
"""

import math
from dataclasses import dataclass

from pneu_common.errors import InputError
from pneu_hw_bridge.registers.schema import RegisterMap
from pneu_hw_bridge.safety.limits import Limits

STALE_PERIODS = 1.5
"""A good reading is at most so many periods old."""


@dataclass(frozen=True)
class Bound:
    """Longest times from a fault to safe valves, s; infinite where nothing brings that about.

    Attributes:
        silent_s: The controller falls silent.
        told_s: An emergency stop, or a reading that is too high.
        stale_s: Readings stop, while the device still takes commands.
        dead_s: Nothing gets through any more, or the bridge is killed.
    """

    silent_s: float
    told_s: float
    stale_s: float
    dead_s: float

    def by_event(self) -> dict[str, float]:
        """Returns the times by what goes wrong."""
        return {
            "a silent controller": self.silent_s,
            "a bad reading or a stop": self.told_s,
            "the last reading": self.stale_s,
            "a dead line or bridge": self.dead_s,
        }

    def __str__(self) -> str:
        """For people."""
        dead = "NEVER" if math.isinf(self.dead_s) else f"{self.dead_s:.3f} s"
        return (
            f"valves are safe {self.silent_s:.3f} s after the last command, {self.told_s:.3f} s"
            f" after a reading or a stop that calls for it, {self.stale_s:.3f} s after the last"
            f" reading, and after the line is cut or the bridge killed: {dead}"
        )


def bound(
    registers: RegisterMap, limits: Limits, period_s: float, write_s: float, watchdog_s: float
) -> Bound:
    """Returns the longest times.

    Args:
        registers: The device.
        limits: What the bridge goes by.
        period_s: Longest interval of readings, which is more than their period where replies are
            slow.
        write_s: From a decision until all outputs are written.
        watchdog_s: How long a command is followed now.
    """
    dead_s = registers.device.watchdog_s
    return Bound(
        silent_s=watchdog_s + write_s,
        told_s=period_s + write_s,
        stale_s=limits.sensor_timeout_s + write_s,
        dead_s=math.inf if dead_s is None else dead_s,
    )


def check(registers: RegisterMap, limits: Limits, period_s: float, timeout_s: float) -> None:
    """Refuses settings with which valves cannot be safe in time, however quick the device is.

    Args:
        registers: The device.
        limits: What the bridge goes by.
        period_s: Interval of readings.
        timeout_s: Longest wait for an answer.

    Raises:
        InputError: They cannot.
    """
    allowed = f"allowed is {limits.safe_within_s:g} s (safe_within_s: raise it knowingly)"
    for name, seconds, why in (
        ("timeout_s", timeout_s, "a device may be silent for so long before it counts as lost"),
        ("sensor_timeout_s", limits.sensor_timeout_s, "readings may be missing for so long"),
        ("rate_hz", period_s, "a pressure is looked at once in that time"),
        (
            "device.watchdog_s",
            registers.device.watchdog_s or 0.0,
            "a cut line or a killed bridge leaves valves open for so long",
        ),
        *(
            (
                f"encoders.{name}.frozen.after_s",
                one.frozen.after_s,
                "an encoder may keep its reading for so long while the gas pushes",
            )
            for name, one in limits.encoders.items()
            if one.frozen is not None
        ),
    ):
        if seconds > limits.safe_within_s:
            shown = f"{1.0 / seconds:g}/s, that is {seconds:g} s" if name == "rate_hz" else seconds
            unit = "" if name == "rate_hz" else " s"
            raise InputError(f"{name}: found {shown}{unit}: {why}; {allowed}")
    if limits.sensor_timeout_s < STALE_PERIODS * period_s:
        raise InputError(
            f"sensor_timeout_s: found {limits.sensor_timeout_s:g} s; at rate_hz"
            f" {1.0 / period_s:g} good readings are up to {STALE_PERIODS * period_s:g} s old"
        )
