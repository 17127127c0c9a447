# SPDX-License-Identifier: Apache-2.0
"""Callbacks that other threads trigger, on each executor; needs nothing of ROS but rclpy."""

import importlib.util
import os
import threading
from collections import deque

import pytest
from tests.domains import own_domain_id
from tests.measured import PATIENCE_S

if importlib.util.find_spec("rclpy") is None or "PNEU_RCLPY" in os.environ:
    from pneu_runtime import hook

    hook.install()

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.experimental.events_executor import EventsExecutor

from pneu_graph.nodes.executor_callback import ExecutorCallback

os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"


class Spun:
    """A node, and an executor that a thread spins from `start` on."""

    def __init__(self, make):
        self.context = rclpy.Context()
        rclpy.init(args=[], context=self.context, domain_id=own_domain_id())
        self.node = rclpy.create_node("triggered", context=self.context)
        self.executor = make(context=self.context)
        self.failure, self.over = None, False
        self.thread = threading.Thread(target=self._spin)

    def start(self):
        self.executor.add_node(self.node)
        self.thread.start()
        return self

    def _spin(self):
        # With a limit, though longer than any wait here: the EventsExecutor of the wheels of rclpy
        # 7.1.6 blocks whoever creates a task while it waits without one.
        try:
            while not self.over:
                self.executor.spin_once(timeout_sec=10.0 * PATIENCE_S)
        except ExternalShutdownException:
            return
        except Exception as error:
            self.failure = error

    def settle(self):
        """Waits until the executor has run everything that was asked of it before."""
        for _ in range(2):  # tasks of one round need not run in order
            event = threading.Event()
            self.executor.create_task(event.set)
            assert event.wait(PATIENCE_S)

    def end(self):
        """Ends the spinning, then the executor."""
        self.over = True
        if self.thread.is_alive():
            self.executor.create_task(lambda: None)
            self.thread.join(PATIENCE_S)
            assert not self.thread.is_alive()
        self.executor.shutdown()

    def close(self):
        self.end()
        self.node.destroy_node()
        self.context.try_shutdown()


@pytest.fixture(params=[SingleThreadedExecutor, EventsExecutor])
def spun(request):
    made = Spun(request.param)
    yield made
    made.close()


class Calls:
    """A callback that counts its calls, and can be held in one."""

    def __init__(self):
        self.count = 0
        self.threads = set()
        self.begun, self.let_go = threading.Event(), threading.Event()
        self.let_go.set()

    def __call__(self):
        self.count += 1
        self.threads.add(threading.current_thread())
        self.begun.set()
        assert self.let_go.wait(PATIENCE_S)


def test_it_runs_in_the_thread_of_the_executor(spun):
    calls = Calls()
    callback = ExecutorCallback(spun.node, calls)
    spun.start()
    callback.trigger()
    assert calls.begun.wait(PATIENCE_S)
    spun.settle()
    assert (calls.count, calls.threads) == (1, {spun.thread})


def test_it_wakes_an_executor_that_has_nothing_else_to_do(spun):
    calls = Calls()
    callback = ExecutorCallback(spun.node, calls)
    spun.start()
    spun.settle()
    for expected in range(1, 6):
        calls.begun.clear()
        callback.trigger()
        assert calls.begun.wait(PATIENCE_S)
        assert calls.count == expected


def test_triggers_that_wait_are_one(spun):
    calls = Calls()
    callback = ExecutorCallback(spun.node, calls)
    spun.start()
    calls.let_go.clear()
    callback.trigger()
    assert calls.begun.wait(PATIENCE_S)
    threads = [
        threading.Thread(target=lambda: [callback.trigger() for _ in range(100)]) for _ in range(4)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    calls.let_go.set()
    spun.settle()
    assert calls.count == 2


def test_nothing_that_is_handed_over_stays_behind(spun):
    """The last trigger of several threads always leads to a call that begins after it."""
    waiting, taken = deque(), []
    everything = threading.Event()

    def take():
        while waiting:
            taken.append(waiting.popleft())
        if len(taken) == 4000:
            everything.set()

    callback = ExecutorCallback(spun.node, take)
    spun.start()

    def give():
        for number in range(1000):
            waiting.append(number)
            callback.trigger()

    threads = [threading.Thread(target=give) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert everything.wait(PATIENCE_S)


def test_a_call_may_trigger_the_next(spun):
    calls, enough = [], threading.Event()

    def again():
        calls.append(None)
        if len(calls) < 3:
            callback.trigger()
        else:
            enough.set()

    callback = ExecutorCallback(spun.node, again)
    spun.start()
    callback.trigger()
    assert enough.wait(PATIENCE_S)
    spun.settle()
    assert len(calls) == 3


def test_a_trigger_before_there_is_an_executor_is_kept(spun):
    ticked, calls = threading.Event(), Calls()
    spun.node.create_timer(0.001, ticked.set)
    callback = ExecutorCallback(spun.node, calls)
    for _ in range(3):
        callback.trigger()
    spun.start()
    if not ticked.wait(PATIENCE_S):
        pytest.skip("timers do not run in this executor (rclpy 7.1.6)")
    assert calls.begun.wait(PATIENCE_S)
    spun.settle()
    assert (calls.count, calls.threads) == (1, {spun.thread})
    callback.trigger()
    spun.settle()
    assert calls.count == 2


def test_what_is_destroyed_is_not_called_any_more(spun):
    hold, calls = Calls(), Calls()
    holding, callback = ExecutorCallback(spun.node, hold), ExecutorCallback(spun.node, calls)
    spun.start()
    hold.let_go.clear()
    holding.trigger()
    assert hold.begun.wait(PATIENCE_S)
    callback.trigger()
    callback.destroy()
    hold.let_go.set()
    callback.trigger()
    spun.settle()
    assert calls.count == 0


def test_a_trigger_after_the_end_is_no_error(spun):
    calls = Calls()
    callback = ExecutorCallback(spun.node, calls)
    early = ExecutorCallback(spun.node, calls)
    spun.start()
    spun.settle()
    spun.end()
    callback.trigger()
    spun.node.destroy_node()
    spun.context.try_shutdown()
    early.trigger()
    assert calls.count == 0


def test_an_exception_ends_the_spinning(spun):
    # (EventsExecutor itself is a function there)
    if type(spun.executor).__name__ == "EventsExecutor" and "embedded" not in rclpy.__file__:
        pytest.skip("a task that fails crashes the interpreter there (seen with rclpy 7.1.6)")

    def fail():
        raise ValueError("as the test has it")

    callback = ExecutorCallback(spun.node, fail)
    spun.start()
    callback.trigger()
    spun.thread.join(PATIENCE_S)
    assert not spun.thread.is_alive()
    assert isinstance(spun.failure, ValueError)
