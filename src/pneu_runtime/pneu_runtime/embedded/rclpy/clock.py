# SPDX-License-Identifier: Apache-2.0
"""Clocks: system, steady, and ROS time, which a simulation may set."""

import threading
import time as _time
from collections.abc import Callable
from enum import IntEnum
from types import TracebackType
from typing import Any

from rclpy.clock_type import ClockType
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.exceptions import NotInitializedException
from rclpy.time import Time
from rclpy.utilities import get_default_context

_NS_TO_S = 1e-9
# A thread cannot wait longer than this in one go.
_LONGEST_WAIT_S = 3600.0


class ClockChange(IntEnum):
    """What a time jump changed about where the time comes from."""

    ROS_TIME_NO_CHANGE = 1
    ROS_TIME_ACTIVATED = 2
    ROS_TIME_DEACTIVATED = 3
    SYSTEM_TIME_NO_CHANGE = 4


class JumpThreshold:
    """Which time jumps a callback is called for.

    Args:
        min_forward: Smallest jump forward, positive, or None for no jump forward.
        min_backward: Smallest jump backward, negative, or None for no jump backward.
        on_clock_change: Whether changes between ROS time and system time count.
    """

    def __init__(
        self,
        *,
        min_forward: Duration | None,
        min_backward: Duration | None,
        on_clock_change: bool = True,
    ) -> None:
        if min_forward is not None and min_forward.nanoseconds <= 0:
            raise ValueError("min_forward must be a positive non-zero duration")
        if min_backward is not None and min_backward.nanoseconds >= 0:
            raise ValueError("min_backward must be a negative non-zero duration")
        if min_forward is None and min_backward is None and not on_clock_change:
            raise ValueError("At least one jump threshold must be enabled")
        self.min_forward = min_forward
        self.min_backward = min_backward
        self.on_clock_change = on_clock_change

    def _exceeded(self, change: ClockChange, delta_ns: int) -> bool:
        if change in (ClockChange.ROS_TIME_ACTIVATED, ClockChange.ROS_TIME_DEACTIVATED):
            return self.on_clock_change
        if self.min_forward is not None and delta_ns >= self.min_forward.nanoseconds:
            return True
        return self.min_backward is not None and delta_ns <= self.min_backward.nanoseconds


class TimeJump:
    """A time jump, as the callbacks after it get it.

    Args:
        clock_change: What it changed.
        delta: By how much the time jumped.
    """

    def __init__(self, clock_change: ClockChange, delta: Duration) -> None:
        if not isinstance(clock_change, ClockChange):
            raise TypeError("clock_change must be an instance of rclpy.clock.ClockChange")
        self._clock_change = clock_change
        self._delta = delta

    @property
    def clock_change(self) -> ClockChange:
        """What it changed."""
        return self._clock_change

    @property
    def delta(self) -> Duration:
        """By how much the time jumped."""
        return self._delta


class JumpHandle:
    """Registration of callbacks for time jumps.

    Args:
        clock: The clock.
        threshold: Which jumps count.
        pre_callback: Called before the time is set.
        post_callback: Called with the `TimeJump` after it.
    """

    def __init__(
        self,
        *,
        clock: "Clock",
        threshold: JumpThreshold,
        pre_callback: Callable[[], None] | None,
        post_callback: Callable[[TimeJump], None] | None,
    ) -> None:
        if pre_callback is None and post_callback is None:
            raise ValueError("One of pre_callback or post_callback must be callable")
        if pre_callback is not None and not callable(pre_callback):
            raise ValueError("pre_callback must be callable if given")
        if post_callback is not None and not callable(post_callback):
            raise ValueError("post_callback must be callable if given")
        self._clock: Clock | None = clock
        self._threshold = threshold
        self._pre_callback = pre_callback
        self._post_callback = post_callback
        clock._add_jump_handle(self)

    def unregister(self) -> None:
        """Stop the callbacks."""
        if self._clock is not None:
            self._clock._remove_jump_handle(self)
            self._clock = None

    def __enter__(self) -> "JumpHandle":
        return self

    def __exit__(
        self,
        t: type[BaseException] | None,
        v: BaseException | None,
        tb: TracebackType | None,
    ) -> None:
        self.unregister()


class Clock:
    """A clock. One of type ROS_TIME is made as a `ROSClock`.

    Args:
        clock_type: Where the time comes from.
    """

    _clock_type: ClockType
    _override_ns: int | None
    _ros_time_is_active: bool
    _jump_handles: tuple[JumpHandle, ...]
    _jump_lock: Any

    def __new__(cls, *, clock_type: ClockType = ClockType.SYSTEM_TIME) -> "Clock":
        """Make a clock of the class that the type asks for."""
        if not isinstance(clock_type, ClockType):
            raise TypeError("Clock type must be a ClockType enum")
        made = super().__new__(ROSClock if clock_type is ClockType.ROS_TIME else cls)
        made._clock_type = clock_type
        made._override_ns = None
        made._ros_time_is_active = False
        # replaced, never changed in place: walked through without the lock
        made._jump_handles = ()
        made._jump_lock = threading.RLock()
        return made

    def __init__(self, *, clock_type: ClockType = ClockType.SYSTEM_TIME) -> None:
        pass

    @property
    def clock_type(self) -> ClockType:
        """Where the time comes from."""
        return self._clock_type

    def __repr__(self) -> str:
        return f"Clock(clock_type={self._clock_type.name})"

    def _now_ns(self) -> int:
        if self._clock_type is ClockType.STEADY_TIME:
            return _time.monotonic_ns()
        if self._ros_time_is_active:
            return self._override_ns or 0
        return _time.time_ns()

    def now(self) -> Time:
        """Return the time.

        Returns:
            Time: Now.
        """
        return Time(nanoseconds=self._now_ns(), clock_type=self._clock_type)

    def _add_jump_handle(self, handle: JumpHandle) -> None:
        with self._jump_lock:
            self._jump_handles = (*self._jump_handles, handle)

    def _remove_jump_handle(self, handle: JumpHandle) -> None:
        with self._jump_lock:
            self._jump_handles = tuple(one for one in self._jump_handles if one is not handle)

    def create_jump_callback(
        self,
        threshold: JumpThreshold,
        *,
        pre_callback: Callable[[], None] | None = None,
        post_callback: Callable[[TimeJump], None] | None = None,
    ) -> JumpHandle:
        """Have functions called around time jumps. They must not block.

        Args:
            threshold: Which jumps count.
            pre_callback: Called before the time is set.
            post_callback: Called with the `TimeJump` after it.

        Returns:
            JumpHandle: Keep it as long as the callbacks are wanted.
        """
        return JumpHandle(
            clock=self,
            threshold=threshold,
            pre_callback=pre_callback,
            post_callback=post_callback,
        )

    def sleep_until(self, until: Time, context: Context | None = None) -> bool:
        """Sleep until a time on this clock.

        Args:
            until: When to go on.
            context: Its shutdown ends the sleep; the default context where not given.

        Returns:
            bool: False where the sleep was cut short, by a shutdown or because the clock changed
            between ROS time and system time.
        """
        if context is None:
            context = get_default_context()
        if not context.ok():
            raise NotInitializedException()
        if until.clock_type != self._clock_type:
            raise ValueError("until's clock type does not match this clock's type")
        event = threading.Event()
        source_changed = False

        def on_jump(jump: TimeJump) -> None:
            nonlocal source_changed
            if jump.clock_change in (
                ClockChange.ROS_TIME_ACTIVATED,
                ClockChange.ROS_TIME_DEACTIVATED,
            ):
                source_changed = True
            event.set()

        threshold = JumpThreshold(
            min_forward=Duration(nanoseconds=1),
            min_backward=Duration(nanoseconds=-1),
            on_clock_change=True,
        )
        until_ns = until.nanoseconds
        context._add_waker(event.set)
        try:
            with self.create_jump_callback(threshold, post_callback=on_jump):
                while context.ok() and not source_changed:
                    remaining_ns = until_ns - self._now_ns()
                    if remaining_ns <= 0:
                        break
                    event.clear()
                    if not context.ok() or source_changed:
                        break
                    if self._ros_time_is_active:
                        if self._now_ns() < until_ns:
                            event.wait()
                    else:
                        event.wait(min(remaining_ns * _NS_TO_S, _LONGEST_WAIT_S))
        finally:
            context._remove_waker(event.set)
        return context.ok() and not source_changed and self._now_ns() >= until_ns

    def sleep_for(self, rel_time: Duration, context: Context | None = None) -> bool:
        """Sleep for a length of time on this clock.

        Args:
            rel_time: How long.
            context: Its shutdown ends the sleep; the default context where not given.

        Returns:
            bool: False where the sleep was cut short, as by `sleep_until`.
        """
        return self.sleep_until(self.now() + rel_time, context)


class ROSClock(Clock):
    """ROS time: the system's time, or where it is active the time that was last set.

    Args:
        clock_type: ROS_TIME, which is also meant where it is left out.
    """

    def __new__(cls) -> "ROSClock":
        """Make a clock of type ROS_TIME."""
        return super().__new__(Clock, clock_type=ClockType.ROS_TIME)  # type: ignore[return-value]

    def __init__(self, *, clock_type: ClockType = ClockType.ROS_TIME) -> None:
        pass

    @property
    def ros_time_is_active(self) -> bool:
        """Whether the time is the one that was set, rather than the system's."""
        return self._ros_time_is_active

    def _set_ros_time_is_active(self, enabled: bool) -> None:
        """Switch between set time and system time. Only a time source calls this."""
        if enabled == self._ros_time_is_active:
            return
        with self._jump_lock:
            before_ns = self._now_ns()
            change = ClockChange.ROS_TIME_ACTIVATED if enabled else ClockChange.ROS_TIME_DEACTIVATED
            after_ns = (self._override_ns or 0) if enabled else _time.time_ns()
            self._jump(
                change,
                after_ns - before_ns,
                lambda: setattr(self, "_ros_time_is_active", enabled),
            )

    def set_ros_time_override(self, time: Time) -> None:
        """Set the time that holds while ROS time is active.

        Args:
            time: The time.
        """
        if not isinstance(time, Time):
            raise TypeError(
                f"Time must be specified as rclpy.time.Time. Received type: {type(time)}"
            )
        with self._jump_lock:
            new_ns = time.nanoseconds
            if not self._ros_time_is_active:
                self._override_ns = new_ns
                return
            self._jump(
                ClockChange.ROS_TIME_NO_CHANGE,
                new_ns - (self._override_ns or 0),
                lambda: setattr(self, "_override_ns", new_ns),
            )

    def _jump(self, change: ClockChange, delta_ns: int, make: Callable[[], None]) -> None:
        handles = [one for one in self._jump_handles if one._threshold._exceeded(change, delta_ns)]
        for handle in handles:
            if handle._pre_callback is not None:
                handle._pre_callback()
        make()
        if handles:
            jump = TimeJump(change, Duration(nanoseconds=delta_ns))
            for handle in handles:
                if handle._post_callback is not None:
                    handle._post_callback(jump)
