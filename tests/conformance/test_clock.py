# SPDX-License-Identifier: Apache-2.0
"""Times, durations and clocks."""

import threading
import time

import pytest
import rclpy.timer
from builtin_interfaces.msg import Duration as DurationMessage
from builtin_interfaces.msg import Time as TimeMessage
from rclpy.clock import Clock, ClockType, JumpThreshold, ROSClock
from rclpy.duration import Duration
from rclpy.exceptions import NotInitializedException
from rclpy.time import Time

pytestmark = pytest.mark.kernel_free


def test_times_and_durations_compute():
    start = Time(seconds=10, nanoseconds=5)
    assert start.nanoseconds == 10_000_000_005
    assert start.seconds_nanoseconds() == (10, 5)
    assert start + Duration(seconds=1) == Time(seconds=11, nanoseconds=5)
    assert start - Duration(seconds=1) == Time(seconds=9, nanoseconds=5)
    assert (start - Time(seconds=12)).nanoseconds == -1_999_999_995
    assert Time(seconds=1) < Time(seconds=2) <= Time(seconds=2)
    assert Duration(seconds=1) > Duration(nanoseconds=999_999_999)
    assert Duration(seconds=0.5).nanoseconds == 500_000_000


def test_bad_times_are_refused():
    with pytest.raises(ValueError):
        Time(seconds=-1)
    with pytest.raises(OverflowError):
        Time(nanoseconds=2**63)
    with pytest.raises(OverflowError):
        Duration(nanoseconds=2**63)
    with pytest.raises(ValueError):
        _ = Time(seconds=1) - Duration(seconds=2)
    with pytest.raises(TypeError):
        Time(clock_type="SYSTEM_TIME")


def test_times_of_different_clocks_do_not_mix():
    system = Time(seconds=1, clock_type=ClockType.SYSTEM_TIME)
    steady = Time(seconds=1, clock_type=ClockType.STEADY_TIME)
    with pytest.raises(TypeError):
        _ = system < steady
    with pytest.raises(TypeError):
        _ = system - steady


def test_messages_of_times():
    moment = Time(seconds=3, nanoseconds=7, clock_type=ClockType.ROS_TIME)
    assert moment.to_msg() == TimeMessage(sec=3, nanosec=7)
    assert Time.from_msg(moment.to_msg()) == moment
    assert Duration(seconds=-0.5).to_msg() == DurationMessage(sec=-1, nanosec=500_000_000)
    assert Duration.from_msg(DurationMessage(sec=-1, nanosec=500_000_000)) == Duration(seconds=-0.5)
    with pytest.raises(TypeError):
        Time.from_msg(DurationMessage())


def test_clocks_tell_the_time():
    assert isinstance(Clock(clock_type=ClockType.ROS_TIME), ROSClock)
    system = Clock(clock_type=ClockType.SYSTEM_TIME)
    assert abs(system.now().nanoseconds - time.time_ns()) < 1_000_000_000
    steady = Clock(clock_type=ClockType.STEADY_TIME)
    first = steady.now()
    assert steady.now() >= first
    assert first.clock_type == ClockType.STEADY_TIME


def test_a_node_has_a_ros_clock(node):
    assert node.get_clock().clock_type == ClockType.ROS_TIME
    assert node.get_clock().ros_time_is_active is False


def set_clock(clock, seconds):
    clock.set_ros_time_override(Time(seconds=seconds, clock_type=ClockType.ROS_TIME))


def test_ros_time_follows_what_is_set():
    clock = ROSClock()
    set_clock(clock, 5)
    assert clock.now().nanoseconds > 1e18
    clock._set_ros_time_is_active(True)
    assert clock.ros_time_is_active
    assert clock.now() == Time(seconds=5, clock_type=ClockType.ROS_TIME)
    set_clock(clock, 4)
    assert clock.now() == Time(seconds=4, clock_type=ClockType.ROS_TIME)
    clock._set_ros_time_is_active(False)
    assert clock.now().nanoseconds > 1e18


def test_jump_callbacks():
    clock = ROSClock()
    set_clock(clock, 10)
    clock._set_ros_time_is_active(True)
    events = []
    threshold = JumpThreshold(
        min_forward=Duration(seconds=2), min_backward=Duration(seconds=-1), on_clock_change=False
    )
    handle = clock.create_jump_callback(
        threshold,
        pre_callback=lambda: events.append("before"),
        post_callback=lambda jump: events.append(jump.delta.nanoseconds),
    )
    set_clock(clock, 11)
    assert events == []
    set_clock(clock, 14)
    assert events == ["before", 3_000_000_000]
    set_clock(clock, 12)
    assert events[2:] == ["before", -2_000_000_000]
    events.clear()
    set_clock(clock, 11.5)  # half of what counts backward
    set_clock(clock, 13.25)  # and less than what counts forward
    assert events == []
    set_clock(clock, 15.25)  # as much as counts
    set_clock(clock, 14.25)
    assert events == ["before", 2_000_000_000, "before", -1_000_000_000]
    clock._set_ros_time_is_active(False)
    clock._set_ros_time_is_active(True)
    handle.unregister()
    set_clock(clock, 50)
    assert len(events) == 4


@pytest.mark.skipif(
    not hasattr(rclpy.timer, "TimerInfo"), reason="timers of this rclpy tell nothing of a call"
)
def test_a_timer_tells_when_its_call_was_due(node, executor, spin_until):
    """On the grid from its start, however late the call; calls that were missed are left out."""
    executor.add_node(node)
    clock = ROSClock()
    set_clock(clock, 100.5)
    clock._set_ros_time_is_active(True)
    infos = []
    timer = node.create_timer(2.0, lambda info: infos.append(info), clock=clock)
    for now_s, due_s, next_s in ((103, 102.5, 104.5), (104.5, 104.5, 106.5), (111, 106.5, 112.5)):
        count = len(infos)
        set_clock(clock, now_s)
        assert spin_until(lambda count=count: len(infos) > count)
        assert not spin_until(lambda count=count: len(infos) > count + 1, timeout_s=0.05)
        info = infos[-1]
        assert info.expected_call_time == Time(seconds=due_s, clock_type=ClockType.ROS_TIME)
        assert info.actual_call_time == Time(seconds=now_s, clock_type=ClockType.ROS_TIME)
        assert timer.time_until_next_call() == round((next_s - now_s) * 1e9)
        assert timer.time_since_last_call() == 0
    set_clock(clock, 111.75)
    assert timer.time_since_last_call() == 750_000_000
    assert timer.time_until_next_call() == 750_000_000


def test_time_already_waited_counts_where_simulated_time_begins(node):
    clock = ROSClock()
    set_clock(clock, 50)
    timer = node.create_timer(1000.0, lambda: None, clock=clock)
    time.sleep(0.05)
    clock._set_ros_time_is_active(True)
    left_ns = timer.time_until_next_call()
    assert 0 < left_ns <= 1000_000_000_000 - 50_000_000
    set_clock(clock, 50 + left_ns // 10**9)
    assert not timer.is_ready()
    set_clock(clock, 51 + left_ns // 10**9)
    assert timer.is_ready()


def test_thresholds_are_checked():
    with pytest.raises(ValueError):
        JumpThreshold(min_forward=Duration(seconds=-1), min_backward=None)
    with pytest.raises(ValueError):
        JumpThreshold(min_forward=None, min_backward=Duration(seconds=1))
    with pytest.raises(ValueError):
        JumpThreshold(min_forward=None, min_backward=None, on_clock_change=False)


@pytest.mark.parametrize("clock_type", [ClockType.SYSTEM_TIME, ClockType.STEADY_TIME])
def test_sleeping(context, clock_type):
    clock = Clock(clock_type=clock_type)
    started = clock.now()
    assert clock.sleep_for(Duration(seconds=0.05), context=context) is True
    assert Duration(seconds=0.05) <= clock.now() - started < Duration(seconds=2)
    assert clock.sleep_until(started, context=context) is True


def test_sleeping_in_ros_time(context):
    clock = ROSClock()
    set_clock(clock, 1)
    clock._set_ros_time_is_active(True)
    results = []
    until = Time(seconds=3, clock_type=ClockType.ROS_TIME)
    sleeper = threading.Thread(
        target=lambda: results.append(clock.sleep_until(until, context=context))
    )
    sleeper.start()
    time.sleep(0.1)
    set_clock(clock, 2)
    time.sleep(0.1)
    assert not results
    set_clock(clock, 3)
    sleeper.join(5.0)
    assert results == [True]


def test_a_shutdown_ends_a_sleep(context):
    clock = Clock(clock_type=ClockType.STEADY_TIME)
    timer = threading.Timer(0.1, context.shutdown)
    timer.start()
    started_s = time.monotonic()
    assert clock.sleep_for(Duration(seconds=30), context=context) is False
    assert time.monotonic() - started_s < 5.0
    timer.join()
    with pytest.raises(NotInitializedException):
        clock.sleep_for(Duration(seconds=1), context=context)


def test_sleeping_by_the_wrong_clock(context):
    with pytest.raises(ValueError):
        Clock().sleep_until(Time(clock_type=ClockType.STEADY_TIME), context=context)


def test_a_timer_follows_simulated_time(node, executor, spin_until):
    executor.add_node(node)
    clock = ROSClock()
    set_clock(clock, 100)
    clock._set_ros_time_is_active(True)
    calls = []
    node.create_timer(1.0, lambda: calls.append(clock.now().nanoseconds), clock=clock)
    assert not spin_until(lambda: calls, timeout_s=0.1)
    set_clock(clock, 101)
    assert spin_until(lambda: calls)
    assert calls == [101_000_000_000]
    # back in time: the timer waits one period from there
    set_clock(clock, 50)
    assert not spin_until(lambda: len(calls) > 1, timeout_s=0.1)
    set_clock(clock, 51)
    assert spin_until(lambda: len(calls) == 2)
