# SPDX-License-Identifier: Apache-2.0
"""Timers and rates."""

import threading
import time

import pytest
from rclpy.clock import Clock, ClockType

pytestmark = pytest.mark.realtime


def test_a_timer_keeps_its_period(node, executor):
    executor.add_node(node)
    calls_s = []
    node.create_timer(0.02, lambda: calls_s.append(time.monotonic()))
    end_s = time.monotonic() + 1.0
    while time.monotonic() < end_s:
        executor.spin_once(timeout_sec=0.1)
    # the first call comes after one period (and the last wait may end after the second); no call
    # is lost or added by drift
    assert 40 <= len(calls_s) <= 51
    steps = (calls_s[-1] - calls_s[0]) / 0.02
    assert abs(steps - round(steps)) < 0.45


@pytest.mark.parametrize(
    "clock_type", [ClockType.STEADY_TIME, ClockType.SYSTEM_TIME, ClockType.ROS_TIME]
)
def test_a_timer_on_any_clock(node, executor, spin_until, clock_type):
    executor.add_node(node)
    calls = []
    timer = node.create_timer(0.01, lambda: calls.append(1), clock=Clock(clock_type=clock_type))
    assert timer.clock.clock_type == clock_type
    assert spin_until(lambda: len(calls) >= 3)


def test_cancel_and_reset(node, executor, spin_until):
    executor.add_node(node)
    calls = []
    timer = node.create_timer(0.01, lambda: calls.append(1))
    assert spin_until(lambda: calls)
    timer.cancel()
    assert timer.is_canceled()
    count = len(calls)
    assert not spin_until(lambda: len(calls) > count, timeout_s=0.1)
    timer.reset()
    assert not timer.is_canceled()
    assert spin_until(lambda: len(calls) > count)


def test_a_timer_that_does_not_start_by_itself(node, executor, spin_until):
    executor.add_node(node)
    calls = []
    timer = node.create_timer(0.01, lambda: calls.append(1), autostart=False)
    assert timer.is_canceled()
    assert not spin_until(lambda: calls, timeout_s=0.1)
    timer.reset()
    assert spin_until(lambda: calls)


def test_times_of_a_timer(node):
    timer = node.create_timer(10.0, lambda: None)
    assert timer.timer_period_ns == 10_000_000_000
    assert not timer.is_ready()
    assert 9e9 < timer.time_until_next_call() <= 10e9
    assert 0 <= timer.time_since_last_call() < 1e9


def test_the_period_can_be_changed(node, executor, spin_until):
    executor.add_node(node)
    calls = []
    timer = node.create_timer(60.0, lambda: calls.append(1))
    timer.timer_period_ns = 10_000_000
    timer.reset()
    assert timer.timer_period_ns == 10_000_000
    assert spin_until(lambda: calls)


def test_a_timer_can_be_reset_from_another_thread(node, executor):
    executor.add_node(node)
    calls = []
    timer = node.create_timer(0.01, lambda: calls.append(1), autostart=False)
    starter = threading.Timer(0.1, timer.reset)
    starter.start()
    executor.spin_once(timeout_sec=10.0)
    if not calls:  # the wake-up may count as one turn
        executor.spin_once(timeout_sec=10.0)
    assert calls
    starter.join()


def test_a_destroyed_timer_is_silent(node, executor, spin_until):
    executor.add_node(node)
    calls = []
    timer = node.create_timer(0.01, lambda: calls.append(1))
    node.destroy_timer(timer)
    assert not spin_until(lambda: calls, timeout_s=0.1)


def test_a_rate_sleeps_whole_periods(node, spinning):
    rate = node.create_rate(50.0)
    rate.sleep()
    started_s = time.monotonic()
    for _ in range(10):
        rate.sleep()
    assert 0.15 < time.monotonic() - started_s < 1.0
    node.destroy_rate(rate)


def test_a_rate_must_be_positive(node):
    with pytest.raises(ValueError):
        node.create_rate(0.0)
