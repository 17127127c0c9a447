# SPDX-License-Identifier: Apache-2.0
"""What a device that is driven by torques is, whoever makes it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from pneu_common.errors import InputError


class DeviceGoneError(Exception):
    """The device cannot be reached any more; says why."""


class DeviceMissingError(InputError):
    """There is no such device, or what drives it is not installed."""


@dataclass(frozen=True)
class Frame:
    """What a device read.

    Attributes:
        counts: Of its encoders.
        device_ns: When, of the time of day by the device's own clock; None where it has none.
        fault: What the device says is wrong; empty where nothing is.
    """

    counts: tuple[int, int, int]
    device_ns: int | None
    fault: str = ""


Tick = Callable[[Frame | None], Sequence[float] | None]
"""Called at every tick with what is new, if anything is; returns torques, N m, and None to end."""


class Device(Protocol):
    """A device."""

    def open(self) -> None:
        """Opens it, motors without torque.

        Raises:
            DeviceMissingError: There is none.
        """

    def run(self, tick: Tick, rate_hz: float) -> None:
        """Runs the loop until it is told to end; leaves motors without torque.

        Args:
            tick: What is done at each tick.
            rate_hz: Ticks per second.

        Raises:
            DeviceGoneError: It cannot be reached any more.
        """

    def close(self) -> None:
        """Takes torque from the motors and closes it; may be called at any time."""
