# SPDX-License-Identifier: Apache-2.0
"""A moment on a clock, in whole nanoseconds."""

from typing import overload

import builtin_interfaces.msg

from rclpy.clock_type import ClockType
from rclpy.constants import S64_MAX, S_TO_NS
from rclpy.duration import Duration


class Time:
    """A moment on a clock. Only moments of clocks of the same type compare and subtract.

    Args:
        seconds: Seconds since the clock's zero [s].
        nanoseconds: Added to the seconds [ns].
        clock_type: The kind of clock.
    """

    __slots__ = ("_clock_type", "_nanoseconds")

    def __init__(
        self,
        *,
        seconds: int | float = 0,
        nanoseconds: int | float = 0,
        clock_type: ClockType = ClockType.SYSTEM_TIME,
    ) -> None:
        if not isinstance(clock_type, ClockType):
            raise TypeError("Clock type must be a ClockType enum")
        if seconds < 0:
            raise ValueError("Seconds value must not be negative")
        if nanoseconds < 0:
            raise ValueError("Nanoseconds value must not be negative")
        total = int(seconds * S_TO_NS) + int(nanoseconds)
        if total > S64_MAX:
            raise OverflowError("Total nanoseconds value is too large to store in C time point.")
        self._nanoseconds = total
        self._clock_type = clock_type

    @property
    def nanoseconds(self) -> int:
        """Nanoseconds since the clock's zero."""
        return self._nanoseconds

    def seconds_nanoseconds(self) -> tuple[int, int]:
        """Return the moment in two parts.

        Returns:
            tuple[int, int]: Whole seconds, and the nanoseconds that remain.
        """
        return divmod(self._nanoseconds, S_TO_NS)

    @property
    def clock_type(self) -> ClockType:
        """The kind of clock."""
        return self._clock_type

    def __repr__(self) -> str:
        return f"Time(nanoseconds={self._nanoseconds}, clock_type={self._clock_type.name})"

    def __add__(self, other: Duration) -> "Time":
        if not isinstance(other, Duration):
            return NotImplemented
        total = self._nanoseconds + other.nanoseconds
        if total > S64_MAX:
            raise OverflowError("Addition leads to overflow in C storage.")
        if total < 0:
            raise ValueError("Addition leads to negative time")
        return Time(nanoseconds=total, clock_type=self._clock_type)

    __radd__ = __add__

    @overload
    def __sub__(self, other: Duration) -> "Time": ...

    @overload
    def __sub__(self, other: "Time") -> Duration: ...

    def __sub__(self, other: "Duration | Time") -> "Time | Duration":
        if isinstance(other, Time):
            if self._clock_type != other._clock_type:
                raise TypeError("Can't subtract times with different clock types")
            return Duration(nanoseconds=self._nanoseconds - other._nanoseconds)
        if isinstance(other, Duration):
            total = self._nanoseconds - other.nanoseconds
            if total < 0:
                raise ValueError("Subtraction leads to negative time")
            return Time(nanoseconds=total, clock_type=self._clock_type)
        return NotImplemented

    def _comparable(self, other: "Time") -> None:
        if self._clock_type != other._clock_type:
            raise TypeError("Can't compare times with different clock types")

    def __hash__(self) -> int:
        return hash((self._nanoseconds, self._clock_type))

    def __eq__(self, other: object) -> bool:
        if isinstance(other, Time):
            self._comparable(other)
            return self._nanoseconds == other._nanoseconds
        return NotImplemented

    def __lt__(self, other: object) -> bool:
        if isinstance(other, Time):
            self._comparable(other)
            return self._nanoseconds < other._nanoseconds
        return NotImplemented

    def __le__(self, other: object) -> bool:
        if isinstance(other, Time):
            self._comparable(other)
            return self._nanoseconds <= other._nanoseconds
        return NotImplemented

    def __gt__(self, other: object) -> bool:
        if isinstance(other, Time):
            self._comparable(other)
            return self._nanoseconds > other._nanoseconds
        return NotImplemented

    def __ge__(self, other: object) -> bool:
        if isinstance(other, Time):
            self._comparable(other)
            return self._nanoseconds >= other._nanoseconds
        return NotImplemented

    def to_msg(self) -> builtin_interfaces.msg.Time:
        """Return the message that holds this moment.

        Returns:
            builtin_interfaces.msg.Time: The kind of clock is not part of it.
        """
        seconds, nanoseconds = divmod(self._nanoseconds, S_TO_NS)
        return builtin_interfaces.msg.Time(sec=seconds, nanosec=nanoseconds)

    @classmethod
    def from_msg(
        cls, msg: builtin_interfaces.msg.Time, clock_type: ClockType = ClockType.ROS_TIME
    ) -> "Time":
        """Return the moment that a message holds.

        Args:
            msg: The message.
            clock_type: The kind of clock it was taken from.

        Returns:
            Time: The same moment.
        """
        if not isinstance(msg, builtin_interfaces.msg.Time):
            raise TypeError("Must pass a builtin_interfaces.msg.Time object")
        return cls(seconds=msg.sec, nanoseconds=msg.nanosec, clock_type=clock_type)
