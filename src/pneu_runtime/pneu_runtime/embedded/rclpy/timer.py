# SPDX-License-Identifier: Apache-2.0
"""Timers, whose calls lie on a fixed grid of times, and rates to sleep by."""

import inspect
import threading
import weakref
from collections.abc import Callable
from types import TracebackType
from typing import Any

from rclpy._rclpy_pybind11 import InvalidHandle
from rclpy._wake import Wakeable
from rclpy.callback_groups import CallbackGroup
from rclpy.clock import Clock, ClockChange, JumpHandle, JumpThreshold, TimeJump
from rclpy.clock_type import ClockType
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.exceptions import ROSInterruptException
from rclpy.time import Time
from rclpy.utilities import get_default_context


class TimerInfo:
    """When a call of a timer was due and when it was made.

    Args:
        expected_call_time: When it was due [ns on the timer's clock].
        actual_call_time: When it was made [ns on the timer's clock].
        clock_type: The kind of clock.
    """

    def __init__(
        self, *, expected_call_time: int, actual_call_time: int, clock_type: ClockType
    ) -> None:
        self._expected_call_time = Time(nanoseconds=expected_call_time, clock_type=clock_type)
        self._actual_call_time = Time(nanoseconds=actual_call_time, clock_type=clock_type)

    @property
    def expected_call_time(self) -> Time:
        """When the call was due."""
        return self._expected_call_time

    @property
    def actual_call_time(self) -> Time:
        """When the call was made."""
        return self._actual_call_time


class Timer(Wakeable):
    """Calls a function with a fixed period. Made by `Node.create_timer`.

    The times of the calls are whole periods apart from the first, whatever the callbacks take;
    times that have passed by are left out.

    Args:
        callback: Called without arguments or with a `TimerInfo`; may be a coroutine function.
        callback_group: The callback group it runs in.
        timer_period_ns: The period [ns].
        clock: The clock that tells when.
        context: The context it belongs to; the default one where not given.
        autostart: Whether it runs from the start, rather than from `reset` on.
    """

    def __init__(
        self,
        callback: Callable[..., Any] | None,
        callback_group: CallbackGroup | None,
        timer_period_ns: int,
        clock: Clock,
        *,
        context: Context | None = None,
        autostart: bool = True,
    ) -> None:
        super().__init__()
        if timer_period_ns < 0:
            raise ValueError(f"timer period must be non-negative, found {timer_period_ns} ns")
        self._context = get_default_context() if context is None else context
        self._clock = clock
        self._period_ns = int(timer_period_ns)
        self._lock = threading.Lock()
        now_ns = clock._now_ns()
        self._last_call_ns = now_ns
        self._next_call_ns = now_ns + self._period_ns
        self._time_credit_ns = 0
        self._canceled = not autostart
        self._destroyed = False
        self._jump_handle: JumpHandle | None = None
        if clock.clock_type is ClockType.ROS_TIME:
            self._jump_handle = _follow_jumps(self)
        self._wants_info = False
        self.callback = callback
        self.callback_group = callback_group
        self._executor_event = False

    @property
    def handle(self) -> "Timer":
        """What a wait set takes."""
        return self

    @property
    def callback(self) -> Callable[..., Any] | None:
        """What is called."""
        return self._callback

    @callback.setter
    def callback(self, value: Callable[..., Any] | None) -> None:
        self._callback = value
        self._wants_info = value is not None and _takes_one_argument(value)

    @property
    def clock(self) -> Clock:
        """The clock that tells when."""
        return self._clock

    @property
    def timer_period_ns(self) -> int:
        """The period [ns]. A new one holds from the next call on."""
        self._check()
        return self._period_ns

    @timer_period_ns.setter
    def timer_period_ns(self, value: int) -> None:
        self._check()
        if value < 0:
            raise ValueError(f"timer period must be non-negative, found {value} ns")
        self._period_ns = int(value)
        self._wake()

    def is_ready(self) -> bool:
        """Say whether a call is due.

        Returns:
            bool: Whether it is.
        """
        self._check()
        return not self._canceled and self._clock._now_ns() >= self._next_call_ns

    def is_canceled(self) -> bool:
        """Say whether the timer stands still.

        Returns:
            bool: Whether it does.
        """
        self._check()
        return self._canceled

    def cancel(self) -> None:
        """Make the timer stand still until `reset`."""
        self._check()
        self._canceled = True
        self._wake()

    def reset(self) -> None:
        """Start the timer anew: the next call is one period from now."""
        self._check()
        with self._lock:
            self._next_call_ns = self._clock._now_ns() + self._period_ns
            self._canceled = False
        self._wake()

    def time_since_last_call(self) -> int:
        """Return how long ago the last call was, or the timer was made.

        Returns:
            int: Time [ns].
        """
        self._check()
        return self._clock._now_ns() - self._last_call_ns

    def time_until_next_call(self) -> int | None:
        """Return how long it is to the next call.

        Returns:
            int | None: Time [ns], negative where the call is overdue; None for a cancelled timer.
        """
        self._check()
        if self._canceled:
            return None
        return self._next_call_ns - self._clock._now_ns()

    def _check(self) -> None:
        if self._destroyed:
            raise InvalidHandle("cannot use Destroyable because destruction was requested")

    def _remaining_ns(self) -> int | None:
        """Time until a call is due, at most 0 where one is; None where only a wake can tell."""
        if self._canceled or self._destroyed:
            return None
        clock = self._clock
        remaining_ns = self._next_call_ns - clock._now_ns()
        if remaining_ns > 0 and clock._ros_time_is_active:
            return None
        return remaining_ns

    def _receive(self) -> tuple[Any, ...] | None:
        """Count a call that is due, and return the callback's arguments; None where none is."""
        with self._lock:
            now_ns = self._clock._now_ns()
            due_ns = self._next_call_ns
            if self._canceled or self._destroyed or now_ns < due_ns:
                return None
            self._last_call_ns = now_ns
            period_ns = self._period_ns
            next_ns = due_ns + period_ns
            if next_ns < now_ns:
                if period_ns == 0:
                    next_ns = now_ns
                else:
                    next_ns += (1 + (now_ns - next_ns - 1) // period_ns) * period_ns
            self._next_call_ns = next_ns
        if not self._wants_info:
            return ()
        return (
            TimerInfo(
                expected_call_time=due_ns,
                actual_call_time=now_ns,
                clock_type=self._clock.clock_type,
            ),
        )

    def _call(self, arguments: tuple[Any, ...], executor: Any) -> Any:
        """Call the callback; what it returns."""
        if self._callback is not None:
            return self._callback(*arguments)
        return None

    def _before_jump(self) -> None:
        # time already waited for counts when the source of the time changes
        self._time_credit_ns = self._next_call_ns - self._clock._now_ns()

    def _after_jump(self, jump: TimeJump) -> None:
        now_ns = self._clock._now_ns()
        with self._lock:
            if jump.clock_change in (
                ClockChange.ROS_TIME_ACTIVATED,
                ClockChange.ROS_TIME_DEACTIVATED,
            ):
                # ROS time that was never set reads zero: the first time set is then a jump back
                # from the last call, which starts a whole period.
                if now_ns == 0:
                    return
                left_ns = min(max(self._time_credit_ns, 0), self._period_ns)
                self._next_call_ns = now_ns + left_ns
                self._last_call_ns = now_ns + left_ns - self._period_ns
            elif now_ns < self._last_call_ns:
                # a jump back: whole periods count from the new time
                self._next_call_ns = now_ns + self._period_ns
                self._last_call_ns = now_ns
        self._wake()

    def destroy(self) -> None:
        """Make the timer unusable. Users call `Node.destroy_timer`."""
        self._destroyed = True
        if self._jump_handle is not None:
            self._jump_handle.unregister()
            self._jump_handle = None

    def __enter__(self) -> "Timer":
        return self

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc_val: BaseException | None,
        exc_tb: TracebackType | None,
    ) -> None:
        self.destroy()


def _takes_one_argument(callback: Callable[..., Any]) -> bool:
    try:
        signature = inspect.signature(callback)
    except ValueError:  # a function written in C that does not say
        return False
    try:
        signature.bind()
        return False
    except TypeError:
        pass
    try:
        signature.bind(object())
    except TypeError:
        raise RuntimeError(
            "Timer callback should be callable with no arguments or with one, a TimerInfo"
        ) from None
    return True


def _follow_jumps(timer: Timer) -> JumpHandle:
    """Tell a timer of the jumps of its clock for as long as somebody holds the timer."""
    reference = weakref.ref(timer)

    def before() -> None:
        followed = reference()
        if followed is not None:
            followed._before_jump()

    def after(jump: TimeJump) -> None:
        followed = reference()
        if followed is not None:
            followed._after_jump(jump)
        else:
            handle.unregister()

    threshold = JumpThreshold(
        min_forward=Duration(nanoseconds=1),
        min_backward=Duration(nanoseconds=-1),
        on_clock_change=True,
    )
    handle = timer.clock.create_jump_callback(threshold, pre_callback=before, post_callback=after)
    return handle


class Rate:
    """Sleeps in a fixed rhythm. Made by `Node.create_rate`; an executor must run elsewhere.

    Args:
        timer: The timer that gives the rhythm.
        context: Its shutdown ends the sleep.
    """

    def __init__(self, timer: Timer, *, context: Context) -> None:
        self._context = context
        self._timer = timer
        self._is_shutdown = False
        self._is_destroyed = False
        self._condition = threading.Condition()
        self._ticks = 0
        timer.callback = self._tick
        context._add_waker(self._on_shutdown)

    def _tick(self) -> None:
        with self._condition:
            self._ticks += 1
            self._condition.notify_all()

    def _on_shutdown(self) -> None:
        self._is_shutdown = True
        with self._condition:
            self._condition.notify_all()

    def destroy(self) -> None:
        """Make the rate unusable; a sleeper is woken and told. Users call `Node.destroy_rate`."""
        self._is_destroyed = True
        self._context._remove_waker(self._on_shutdown)
        with self._condition:
            self._condition.notify_all()

    def _check(self) -> None:
        if self._is_shutdown:
            raise ROSInterruptException()
        if self._is_destroyed:
            raise RuntimeError("Rate cannot sleep because it has been destroyed")

    def sleep(self) -> None:
        """Sleep until the next tick. Do not call this in a callback: the tick could not come."""
        with self._condition:
            self._check()
            before = self._ticks
            while self._ticks == before:
                self._condition.wait()
                if self._ticks == before:
                    self._check()
