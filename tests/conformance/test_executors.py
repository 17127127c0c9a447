# SPDX-License-Identifier: Apache-2.0
"""Executors, callback groups, tasks and futures."""

import threading
import time

import pytest
import rclpy
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.task import Future, Task

pytestmark = pytest.mark.realtime


@pytest.fixture(params=["single", "multi", "events"])
def any_executor(request, context):
    if request.param == "events":
        # not in every release of Jazzy
        EventsExecutor = pytest.importorskip("rclpy.experimental").EventsExecutor
        made = EventsExecutor(context=context)
    elif request.param == "multi":
        made = MultiThreadedExecutor(num_threads=2, context=context)
    else:
        made = SingleThreadedExecutor(context=context)
    yield made
    made.shutdown()


def spin_for(executor, seconds):
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        executor.spin_once(timeout_sec=0.02)


def test_every_executor_runs_callbacks(any_executor, node):
    any_executor.add_node(node)
    done = Future()
    node.create_timer(0.01, lambda: done.set_result("ticked") if not done.done() else None)
    any_executor.spin_until_future_complete(done, timeout_sec=10.0)
    assert done.result() == "ticked"


def test_spin_once_keeps_its_timeout(executor, node):
    executor.add_node(node)
    spin_for(executor, 0.1)
    started_s = time.monotonic()
    executor.spin_once(timeout_sec=0.2)
    assert 0.1 < time.monotonic() - started_s < 2.0
    started_s = time.monotonic()
    executor.spin_once(timeout_sec=0)
    assert time.monotonic() - started_s < 0.5


def test_spin_once_takes_an_executor_by_name_alone(executor, node):
    done = []
    node.create_timer(0.01, lambda: done.append("ticked"))
    rclpy.spin_once(node=node, executor=executor, timeout_sec=10.0)
    assert done == ["ticked"]
    with pytest.raises(TypeError):
        rclpy.spin_once(node, executor)


def test_waiting_for_a_future_keeps_its_timeout(executor, node):
    executor.add_node(node)
    started_s = time.monotonic()
    future = Future()
    executor.spin_until_future_complete(future, timeout_sec=0.2)
    assert 0.15 < time.monotonic() - started_s < 2.0
    assert not future.done()


def test_waiting_costs_no_processor_time(executor, node):
    executor.add_node(node)
    spin_for(executor, 0.2)
    before_s = time.process_time()
    executor.spin_until_future_complete(Future(), timeout_sec=1.0)
    assert time.process_time() - before_s < 0.3


def test_an_error_in_a_callback_reaches_who_spins(any_executor, node):
    any_executor.add_node(node)

    def fail():
        timer.cancel()
        raise KeyError("on purpose")

    timer = node.create_timer(0.01, fail)
    # with several threads the error comes out when the next callback is handed out
    node.create_timer(0.02, lambda: None)
    with pytest.raises(KeyError, match="on purpose"):
        spin_for(any_executor, 5.0)


def test_spin_with_the_executor_of_the_default_context():
    rclpy.init(args=[])
    node = rclpy.create_node("spun")
    done = Future()
    node.create_timer(0.01, lambda: done.set_result(None) if not done.done() else None)
    rclpy.spin_until_future_complete(node, done, timeout_sec=10.0)
    assert done.done()
    rclpy.spin_once(node, timeout_sec=0.1)
    node.destroy_node()
    rclpy.shutdown()


def test_guard_conditions_wake_from_another_thread(executor, node):
    executor.add_node(node)
    done = Future()
    guard = node.create_guard_condition(lambda: done.set_result("woken"))
    trigger = threading.Timer(0.1, guard.trigger)
    trigger.start()
    executor.spin_until_future_complete(done, timeout_sec=10.0)
    assert done.result() == "woken"
    trigger.join()


def test_a_node_added_from_another_thread_is_served(context, make_node):
    executor = SingleThreadedExecutor(context=context)
    thread = threading.Thread(target=executor.spin)
    thread.start()
    called = threading.Event()
    node = make_node()
    node.create_timer(0.01, called.set)
    executor.add_node(node)
    assert called.wait(10.0)
    assert executor.shutdown(timeout_sec=5.0)
    thread.join(10.0)
    assert not thread.is_alive()


class Overlap:
    """Counts how many of its calls run at the same time."""

    def __init__(self):
        self.lock = threading.Lock()
        self.running = 0
        self.most = 0
        self.calls = 0

    def __call__(self):
        with self.lock:
            self.running += 1
            self.calls += 1
            self.most = max(self.most, self.running)
        time.sleep(0.05)
        with self.lock:
            self.running -= 1


def overlap_of_two_timers(context, node, groups):
    overlap = Overlap()
    executor = MultiThreadedExecutor(num_threads=4, context=context)
    executor.add_node(node)
    for group in groups:
        node.create_timer(0.01, overlap, group)
    spin_for(executor, 0.5)
    executor.shutdown()
    assert overlap.calls > 3
    return overlap.most


def test_a_mutually_exclusive_group_runs_one_callback_at_a_time(context, node):
    group = MutuallyExclusiveCallbackGroup()
    assert overlap_of_two_timers(context, node, [group, group]) == 1


def test_two_groups_run_side_by_side(context, node):
    groups = [MutuallyExclusiveCallbackGroup(), MutuallyExclusiveCallbackGroup()]
    assert overlap_of_two_timers(context, node, groups) == 2


def test_a_reentrant_group_runs_callbacks_side_by_side(context, node):
    group = ReentrantCallbackGroup()
    assert overlap_of_two_timers(context, node, [group, group]) >= 2


def test_what_runs_ends_after_a_shutdown(context, node):
    """Whether `shutdown` waits for it differs between releases."""
    executor = MultiThreadedExecutor(num_threads=2, context=context)
    executor.add_node(node)
    started, ended = threading.Event(), threading.Event()

    def work():
        started.set()
        time.sleep(0.3)
        ended.set()

    node.create_timer(0.01, work)
    thread = threading.Thread(target=executor.spin)
    thread.start()
    assert started.wait(10.0)
    assert executor.shutdown()
    assert ended.wait(5.0)
    thread.join(10.0)
    assert not thread.is_alive()


def test_futures():
    future = Future()
    calls = []
    future.add_done_callback(calls.append)
    assert not future.done() and future.result() is None
    future.set_result(3)
    assert future.done() and future.result() == 3 and calls == [future]
    future.add_done_callback(calls.append)
    assert calls == [future, future]

    failed = Future()
    failed.set_exception(ValueError("bad"))
    with pytest.raises(ValueError, match="bad"):
        failed.result()
    assert isinstance(failed.exception(), ValueError)

    cancelled = Future()
    cancelled.cancel()
    assert cancelled.cancelled()


def test_tasks_without_an_executor():
    task = Task(lambda a, b=0: a + b, (1,), {"b": 2})
    task()
    assert task.done() and task.result() == 3

    async def work():
        return "done"

    task = Task(work)
    task()
    assert task.result() == "done"


def test_tasks_run_in_the_executor(executor):
    task = executor.create_task(lambda value: value * 2, 21)
    executor.spin_until_future_complete(task, timeout_sec=5.0)
    assert task.result() == 42


def test_a_task_awaits_a_future_that_another_thread_completes(executor):
    future = Future()

    async def work():
        return await future + 1

    task = executor.create_task(work)
    executor.spin_once(timeout_sec=0)
    assert not task.done()
    timer = threading.Timer(0.1, lambda: (future.set_result(1), executor.wake()))
    timer.start()
    executor.spin_until_future_complete(task, timeout_sec=5.0)
    assert task.result() == 2
    timer.join()


def test_completing_a_future_in_another_thread_wakes_nobody(executor):
    """The task goes on when something else wakes the executor."""
    future, reached, over = Future(executor=executor), threading.Event(), threading.Event()

    async def work():
        reached.set()
        await future
        over.set()

    executor.create_task(work)
    thread = threading.Thread(target=executor.spin)
    thread.start()
    try:
        assert reached.wait(5.0)
        time.sleep(0.1)  # until it awaits
        future.set_result(1)
        assert not over.wait(0.5)
        executor.wake()
        assert over.wait(5.0)
    finally:
        executor.shutdown()
        thread.join(10.0)
    assert not thread.is_alive()


def test_a_done_callback_of_that_future_does(executor):
    future = Future(executor=executor)
    future.add_done_callback(lambda _: None)

    async def work():
        return await future + 1

    task = executor.create_task(work)
    executor.spin_once(timeout_sec=0)
    timer = threading.Timer(0.1, future.set_result, [1])
    timer.start()
    executor.spin_until_future_complete(task, timeout_sec=5.0)
    assert task.result() == 2
    timer.join()


def test_coroutines_as_callbacks(any_executor, node):
    any_executor.add_node(node)
    gate = Future(executor=any_executor)
    done = Future(executor=any_executor)
    group = ReentrantCallbackGroup()

    async def wait_for_gate():
        waiting.cancel()
        done.set_result(await gate)

    waiting = node.create_timer(0.01, wait_for_gate, group)
    node.create_timer(0.1, lambda: gate.set_result("open") if not gate.done() else None, group)
    any_executor.spin_until_future_complete(done, timeout_sec=10.0)
    assert done.result() == "open"


def test_an_awaiting_callback_keeps_its_group_busy(executor, node):
    executor.add_node(node)
    gate = Future(executor=executor)
    calls = []

    async def hold():
        holder.cancel()
        calls.append("hold")
        await gate
        calls.append("released")

    holder = node.create_timer(0.01, hold)
    spin_for(executor, 0.1)
    node.create_timer(0.01, lambda: calls.append("other"))
    spin_for(executor, 0.1)
    assert calls == ["hold"]
    gate.set_result(None)
    spin_for(executor, 0.2)
    assert calls[:2] == ["hold", "released"]
    assert "other" in calls
