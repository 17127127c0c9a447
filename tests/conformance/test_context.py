# SPDX-License-Identifier: Apache-2.0
"""Init, shutdown, contexts and what they do to those who wait."""

import signal
import threading
import time

import pytest
import rclpy
from rclpy.context import Context
from rclpy.exceptions import NotInitializedException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor

pytestmark = pytest.mark.kernel_free


def test_the_default_context_can_be_used_again_after_a_shutdown():
    for _ in range(2):
        assert not rclpy.ok()
        rclpy.init(args=[])
        assert rclpy.ok()
        rclpy.shutdown()
    assert not rclpy.ok()


def test_a_shutdown_puts_back_what_signals_did():
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = [signal.getsignal(number) for number in numbers]
    rclpy.init(args=[])
    rclpy.shutdown()
    assert [signal.getsignal(number) for number in numbers] == before


def test_init_twice_and_shutdown_twice_are_refused():
    rclpy.init(args=[])
    with pytest.raises(RuntimeError):
        rclpy.init(args=[])
    rclpy.shutdown()
    with pytest.raises(RuntimeError):
        rclpy.shutdown()
    rclpy.try_shutdown()


def test_a_context_is_initialised_once():
    context = Context()
    context.init(args=[])
    context.shutdown()
    with pytest.raises(RuntimeError):
        context.init(args=[])


def test_contexts_are_independent(context):
    other = Context()
    rclpy.init(args=[], context=other)
    other.shutdown()
    assert context.ok()
    assert not other.ok()


def test_a_node_needs_an_initialised_context():
    with pytest.raises(NotInitializedException):
        rclpy.create_node("early", context=Context())


def test_the_domain_can_be_given():
    context = Context()
    rclpy.init(args=[], context=context, domain_id=42)
    assert context.get_domain_id() == 42
    context.shutdown()


def test_a_negative_domain_is_refused():
    with pytest.raises(RuntimeError):
        rclpy.init(args=[], context=Context(), domain_id=-1)


@pytest.mark.parametrize(
    "arguments", [["--ros-args", "--unheard-of"], ["--ros-args", "-r", "no_rule"]]
)
def test_bad_ros_arguments_are_refused(arguments):
    with pytest.raises(RuntimeError):
        rclpy.init(args=arguments, context=Context())


def test_other_arguments_are_left_alone():
    context = Context()
    rclpy.init(args=["program", "--mine", "--ros-args", "-r", "a:=b", "--", "x"], context=context)
    context.shutdown()


def test_on_shutdown_is_called_once(context):
    class Listener:
        calls = 0

        def hear(self):  # a method: rclpy keeps weak references to methods
            self.calls += 1

    listener = Listener()
    context.on_shutdown(listener.hear)
    context.shutdown()
    context.try_shutdown()
    assert listener.calls == 1


def test_shutdown_from_another_thread_ends_a_spin(context, node):
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    timer = threading.Timer(0.2, context.shutdown)
    timer.start()
    started_s = time.monotonic()
    # which of the two ways out it takes depends on where the executor is at that moment
    try:
        executor.spin()
    except ExternalShutdownException:
        assert not context.ok()
    assert not context.ok()
    assert time.monotonic() - started_s < 5.0
    timer.join()


def test_spin_once_after_a_shutdown_raises(context, node):
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    context.shutdown()
    # the latter where it is rcl that refuses to wait
    with pytest.raises((ExternalShutdownException, RuntimeError)):
        executor.spin_once(timeout_sec=0.1)
