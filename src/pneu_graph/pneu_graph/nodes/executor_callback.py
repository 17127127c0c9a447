# SPDX-License-Identifier: Apache-2.0
"""A callback that any thread triggers and the thread of a node's executor runs.

It stands in for guard conditions, which not every executor of rclpy can wait on (`EventsExecutor`
refuses them): `Executor.create_task` wakes all of them.
"""

from collections.abc import Callable
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

FIRST_RUN_S = 1e-3
"""Delay with which an executor that a triggered node is added to runs the callback, s."""


class ExecutorCallback:
    """Runs a callback in the thread of a node's executor, which has to be single-threaded.

    Triggers coalesce: those that come before the callback begins lead to one call, and one that
    comes during a call leads to another call. A trigger that comes before the node is in an
    executor is kept until it is. An exception of the callback ends the spinning, as that of any
    callback does.
    """

    def __init__(self, node: Node, callback: Callable[[], None]) -> None:
        """Prepares the callback; has to be called in the thread that sets up the node.

        Args:
            node: The node.
            callback: A plain function; no coroutine.
        """
        self._node = node
        self._callback = callback
        self._destroyed = False
        # A timer belongs to the node, so that an executor finds it when the node is added.
        self._timer = node.create_timer(
            FIRST_RUN_S, self._on_timer, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )
        self._timer.cancel()
        # Who has been asked for a run that has not begun: an executor, or the timer. It is set
        # before asking and cleared before the call, so that without a lock no trigger is lost; of
        # two threads that trigger at the same time both may ask, and the second run does nothing.
        self._asked: Any = None

    def trigger(self) -> None:
        """Has the callback called soon; from any thread, and without effect after `destroy`."""
        executor = self._node.executor
        asked = self._timer if executor is None else executor
        if self._destroyed or self._asked is asked:
            return
        self._asked = asked
        try:  # no context manager: this runs with every sample of a device
            if executor is None:
                self._timer.reset()
            else:
                executor.create_task(self._run)
        except (AttributeError, RuntimeError):
            # An executor or a timer that ends at this moment refuses, with an error that depends
            # on the release of rclpy. Whoever triggers, such as the thread that listens for
            # emergency stops, must not end with it.
            pass

    def destroy(self) -> None:
        """Has the callback not called any more; from the thread of the executor, or at its end."""
        self._destroyed = True
        self._asked = None
        self._node.destroy_timer(self._timer)

    def _on_timer(self) -> None:
        self._timer.cancel()
        self._run()

    def _run(self) -> None:
        if self._asked is None:
            return
        self._asked = None
        if not self._destroyed:
            self._callback()
