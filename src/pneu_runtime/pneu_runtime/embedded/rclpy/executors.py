# SPDX-License-Identifier: Apache-2.0
# ruff: noqa: N818  # the names are those of rclpy
"""Executors: they wait for what nodes are interested in and run the callbacks.

An executor keeps the endpoints of its nodes attached to one waiter of the transport and sleeps in
it until an endpoint has something, the next timer is due, or somebody wakes it. Nothing is polled.
"""

import inspect
import os
import threading
import time
import weakref
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from types import CoroutineType, TracebackType
from typing import TYPE_CHECKING, Any

from pneu_runtime import transport
from rclpy.context import Context
from rclpy.task import Future, Task
from rclpy.utilities import get_default_context
from rclpy.waitable import Waitable, WaitSet

if TYPE_CHECKING:
    from rclpy.node import Node

_NS_TO_S = 1e-9


class TimeoutException(Exception):
    """Nothing became ready in time."""


class ShutdownException(Exception):
    """The executor was shut down."""


class ExternalShutdownException(Exception):
    """The context was shut down, by a signal or by another thread."""


class ConditionReachedException(Exception):
    """What was waited for has happened."""


async def await_or_execute(callback: Callable[..., Any], *args: Any) -> Any:
    """Call a function, and await what it returns where it is a coroutine function.

    Args:
        callback: The function.
        *args: Its arguments.

    Returns:
        object: The result.
    """
    if inspect.iscoroutinefunction(callback):
        return await callback(*args)
    return callback(*args)


class _CallbackTask(Task):
    """A coroutine that a callback returned; its callback group is busy until it ends."""

    def __init__(self, coroutine: Any, entity: Any, executor: "Executor") -> None:
        super().__init__(coroutine, executor=executor)
        self._entity = entity
        self._runner = executor

    def _complete_task(self) -> None:
        super()._complete_task()
        self._runner._end(self._entity)


class Executor:
    """Base of the executors.

    Args:
        context: The context it belongs to; the default one where not given.
    """

    def __init__(self, *, context: Context | None = None) -> None:
        self._context = get_default_context() if context is None else context
        self._lock = threading.RLock()
        self._nodes: set[Node] = set()
        self._waiter = transport.Waiter()
        self._is_shutdown = False
        # Entities and tasks that are ready and wait for their turn.
        self._ready: deque[Any] = deque()
        self._tasks: deque[Task] = deque()
        self._must_rebuild = False
        self._entities: dict[Any, Any] = {}  # by source of the transport
        self._timers: tuple[Any, ...] = ()
        self._guards: tuple[Any, ...] = ()
        self._waitables: tuple[Waitable, ...] = ()  # those that fill a wait set every time
        self._waitable_sources: dict[Any, int] = {}
        # Entities that had something while their callback group was busy; detached meanwhile.
        self._blocked: list[Any] = []
        self._running = 0
        self._running_in: int | None = None
        self._idle = threading.Condition()
        self._waker = _weak_wake(self)
        self._context._add_waker(self._waker)

    def __del__(self) -> None:
        if getattr(self, "_waker", None) is None:  # the constructor failed
            return
        self._context._remove_waker(self._waker)
        self._waiter.close()

    @property
    def context(self) -> Context:
        """The context it belongs to."""
        return self._context

    # Nodes and their entities

    def add_node(self, node: "Node") -> bool:
        """Run the callbacks of a node, which leaves the executor it was in before.

        Args:
            node: The node.

        Returns:
            bool: Whether it was not there yet.
        """
        with self._lock:
            if node in self._nodes:
                return False
            self._nodes.add(node)
        node.executor = self
        self._entities_changed()
        return True

    def remove_node(self, node: "Node") -> None:
        """Stop running the callbacks of a node.

        Args:
            node: The node.
        """
        with self._lock:
            if node not in self._nodes:
                return
            self._nodes.discard(node)
        node._left_executor(self)
        self._entities_changed()

    def get_nodes(self) -> "list[Node]":
        """List the nodes.

        Returns:
            list[Node]: Those whose callbacks this executor runs.
        """
        with self._lock:
            return list(self._nodes)

    def wake(self) -> None:
        """Have a waiting executor look again."""
        self._waiter.wake()

    def _entities_changed(self) -> None:
        self._must_rebuild = True
        self.wake()

    def _forget(self, entity: Any) -> None:
        """Let go of an entity at once, because its endpoints are about to be closed."""
        with self._lock:
            for source in entity._sources or ():
                if self._entities.pop(source, None) is not None:
                    self._waiter.detach(source)
            if entity in self._blocked:
                self._blocked.remove(entity)

    def _rebuild(self) -> None:
        """Attach what the nodes have now, and detach what they no longer have."""
        with self._lock:
            self._must_rebuild = False
            wanted: dict[Any, Any] = {}
            timers: list[Any] = []
            guards: list[Any] = []
            waitables: list[Waitable] = []
            for node in self._nodes:
                for entity in node._entities_with_sources():
                    for source in entity._sources:
                        wanted[source] = entity
                timers.extend(node._timers)
                guards.extend(node._guards)
                waitables.extend(one for one in node._waitables if one._sources is None)
            for source in [one for one in self._entities if one not in wanted]:
                entity = self._entities.pop(source)
                entity._holders.discard(self)
                if entity in self._blocked:
                    self._blocked.remove(entity)
                else:
                    self._waiter.detach(source)
            for source, entity in wanted.items():
                if source not in self._entities:
                    if entity not in self._blocked:
                        self._waiter.attach(source)
                    self._entities[source] = entity
                    entity._holders.add(self)
            for entity in {*self._timers, *self._guards} - {*timers, *guards}:
                entity._remove_waker(self._waker)
            for entity in {*timers, *guards} - {*self._timers, *self._guards}:
                entity._add_waker(self._waker)
            self._timers = tuple(timers)
            self._guards = tuple(guards)
            self._waitables = tuple(waitables)

    # Tasks

    def create_task(self, callback: Callable[..., Any], *args: Any, **kwargs: Any) -> Task:
        """Run a function or coroutine in this executor.

        Args:
            callback: The function, coroutine function or coroutine.
            *args: Its positional arguments.
            **kwargs: Its keyword arguments.

        Returns:
            Task: Its result will be that of the function.
        """
        task = Task(callback, args, kwargs, executor=self)
        self._tasks.append(task)
        self.wake()
        return task

    def create_future(self) -> Future:
        """Make a future whose callbacks run in this executor.

        Returns:
            Future: The future.
        """
        return Future(executor=self)

    # Waiting

    def _next(
        self, timeout_sec: float | None, condition: Callable[[], bool] | None = None
    ) -> tuple[Any, Any]:
        """Wait for the next thing to run, and begin it.

        Returns:
            tuple[object, object]: An entity and what was received for it, or a task and None.
        """
        deadline_s = None
        if timeout_sec is not None and timeout_sec >= 0:
            deadline_s = time.monotonic() + timeout_sec
        remaining_s = timeout_sec if deadline_s is not None else None
        last = False
        while True:
            if self._is_shutdown:
                raise ShutdownException()
            if not self._context._valid:
                raise ExternalShutdownException()
            if condition is not None and condition():
                raise ConditionReachedException()
            while self._ready:
                found = self._begin(self._ready.popleft())
                if found is not None:
                    return found
            if last:
                raise TimeoutException()
            self._collect(remaining_s)
            if deadline_s is not None:
                remaining_s = max(0.0, deadline_s - time.monotonic())
                last = remaining_s == 0.0

    def _begin(self, item: Any) -> tuple[Any, Any] | None:
        if isinstance(item, Task):
            return item, None
        group = item.callback_group
        if group is not None and not group.beginning_execution(item):
            self._block(item)
            return None
        received = item._receive()
        if received is None:
            if group is not None:
                group.ending_execution(item)
            return None
        return item, received

    def _block(self, entity: Any) -> None:
        """Leave an entity alone until its callback group is free."""
        sources = getattr(entity, "_sources", None)
        if not sources:  # timers and guard conditions are looked at in every round
            return
        with self._lock:
            attached = [source for source in sources if source in self._entities]
            if attached and entity not in self._blocked:
                for source in attached:
                    self._waiter.detach(source)
                self._blocked.append(entity)

    def _unblock(self) -> None:
        with self._lock:
            still = []
            for entity in self._blocked:
                if entity.callback_group.can_execute(entity):
                    for source in entity._sources:
                        if source in self._entities:
                            self._waiter.attach(source)
                else:
                    still.append(entity)
            self._blocked = still

    def _end(self, entity: Any) -> None:
        """Let the callback group of an entity go on."""
        group = entity.callback_group
        if group is not None:
            group.ending_execution(entity)
            self.wake()

    def _collect(self, timeout_s: float | None) -> None:
        """Wait until something is ready, at most for a time, and queue all that is."""
        if self._must_rebuild:
            self._rebuild()
        if self._blocked:
            self._unblock()
        wait_set = self._fill_wait_set() if self._waitables else None
        if self._tasks or any(guard._triggered and _free(guard) for guard in self._guards):
            timeout_s = 0.0
        for timer in self._timers:
            remaining_ns = timer._remaining_ns()
            if remaining_ns is not None and _free(timer):
                remaining_s = remaining_ns * _NS_TO_S if remaining_ns > 0 else 0.0
                if timeout_s is None or remaining_s < timeout_s:
                    timeout_s = remaining_s
        sources = self._waiter.wait(timeout_s)
        ready = self._ready
        for timer in self._timers:
            remaining_ns = timer._remaining_ns()
            if remaining_ns is not None and remaining_ns <= 0 and _free(timer):
                ready.append(timer)
        if wait_set is not None:
            self._ask_waitables(wait_set, sources)
        for guard in self._guards:
            if guard._triggered and _free(guard):
                ready.append(guard)
        for source in sources:
            entity = self._entities.get(source)
            if entity is not None:
                ready.append(entity)
        for _ in range(len(self._tasks)):
            ready.append(self._tasks.popleft())

    def _fill_wait_set(self) -> dict[Waitable, WaitSet]:
        """Ask the waitables what they wait for, and attach it."""
        sets = {}
        wanted: dict[Any, int] = {}
        for waitable in self._waitables:
            wait_set = WaitSet()
            waitable.add_to_wait_set(wait_set)
            sets[waitable] = wait_set
            for kind, entities in wait_set.entities.items():
                for entity in entities:
                    if kind == "guard_condition":
                        if self._waker not in entity._wakers:
                            entity._add_waker(self._waker)
                    elif kind != "timer":
                        wanted[getattr(entity, "_end", entity)] = id(entity)
        for source in [one for one in self._waitable_sources if one not in wanted]:
            self._waiter.detach(source)
        for source in wanted:
            if source not in self._waitable_sources:
                self._waiter.attach(source)
        self._waitable_sources = wanted
        return sets

    def _ask_waitables(self, sets: dict[Waitable, WaitSet], sources: list[Any]) -> None:
        """Queue the waitables that say they are ready."""
        woken = {self._waitable_sources[one] for one in sources if one in self._waitable_sources}
        for waitable, wait_set in sets.items():
            for kind, entities in wait_set.entities.items():
                for entity in entities:
                    if kind == "guard_condition":
                        if entity._receive():
                            wait_set.ready.add(id(entity))
                    elif kind == "timer":
                        if entity.is_ready():
                            wait_set.ready.add(id(entity))
                    elif id(entity) in woken:
                        wait_set.ready.add(id(entity))
            if waitable.is_ready(wait_set):
                self._ready.append(waitable)

    # Running

    def _run(self, item: Any, received: Any) -> None:
        """Run what `_next` returned."""
        if isinstance(item, Task):
            self._run_task(item)
            return
        coroutine = None
        try:
            result = item._call(received, self)
            if type(result) is CoroutineType or inspect.isawaitable(result):
                coroutine = result
        finally:
            if coroutine is None:
                group = item.callback_group
                if group is not None:
                    group.ending_execution(item)
                if self._blocked:
                    self.wake()
        if coroutine is not None:
            self._run_task(_CallbackTask(coroutine, item, self))

    def _run_task(self, task: Task) -> None:
        task()
        if task.done():
            error = task.exception()
            if error is not None:
                raise error

    def can_execute(self, entity: Any) -> bool:
        """Say whether a callback of an entity may start now.

        Args:
            entity: The entity.

        Returns:
            bool: Whether it may.
        """
        return entity.callback_group.can_execute(entity)

    def spin(self) -> None:
        """Run callbacks until the executor or its context is shut down."""
        while self._context.ok() and not self._is_shutdown:
            self.spin_once()

    def spin_until_future_complete(self, future: Future, timeout_sec: float | None = None) -> None:
        """Run callbacks until a future is done.

        Args:
            future: The future.
            timeout_sec: How long at most [s]; None or negative for as long as it takes.
        """
        deadline_s = None
        if timeout_sec is not None and timeout_sec >= 0:
            deadline_s = time.monotonic() + timeout_sec
        future._add_waiter(self.wake)
        try:
            remaining_s = None if deadline_s is None else timeout_sec
            while self._context.ok() and not future._is_over() and not self._is_shutdown:
                self.spin_once_until_future_complete(future, remaining_s)
                if deadline_s is not None:
                    remaining_s = deadline_s - time.monotonic()
                    if remaining_s <= 0:
                        return
        finally:
            future._remove_waiter(self.wake)

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Wait for one callback and run it.

        Args:
            timeout_sec: How long to wait at most [s]; None or negative for as long as it takes.
        """
        raise NotImplementedError

    def spin_once_until_future_complete(
        self, future: Future, timeout_sec: float | None = None
    ) -> None:
        """Wait for one callback and run it, unless a future is done first.

        Args:
            future: The future.
            timeout_sec: How long to wait at most [s]; None or negative for as long as it takes.
        """
        raise NotImplementedError

    def wait_for_ready_callbacks(self, *args: Any, **kwargs: Any) -> Any:
        """Refuse: this executor does not hand its callbacks out.

        Args:
            *args: Ignored.
            **kwargs: Ignored.

        Returns:
            object: Never.
        """
        raise NotImplementedError("the embedded runtime has no Executor.wait_for_ready_callbacks")

    def shutdown(self, timeout_sec: float | None = None) -> bool:
        """Stop running callbacks, and wait for those that run.

        Args:
            timeout_sec: How long to wait at most [s]; None or negative for as long as it takes.

        Returns:
            bool: Whether all of them have ended.
        """
        with self._lock:
            if self._is_shutdown:
                return True
            self._is_shutdown = True
        self.wake()
        if timeout_sec is not None and timeout_sec < 0:
            timeout_sec = None
        with self._idle:
            if not self._idle.wait_for(self._is_idle, timeout_sec):
                return False
        for node in self.get_nodes():
            self.remove_node(node)
        self._rebuild()
        for source in self._waitable_sources:
            self._waiter.detach(source)
        self._waitable_sources = {}
        self._context._remove_waker(self._waker)
        # The waiter is closed with the last reference: another thread may still be leaving it.
        return True

    def _is_idle(self) -> bool:
        """Whether no callback runs, other than the one that asks."""
        return self._running == 0 or self._running_in == threading.get_ident()

    def __enter__(self) -> "Executor":
        return self

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc_val: BaseException | None,
        exc_tb: TracebackType | None,
    ) -> None:
        self.shutdown()


def _free(entity: Any) -> bool:
    """Whether the callback group of an entity lets it run."""
    group = entity.callback_group
    return group is None or group.can_execute(entity)


def _weak_wake(executor: Executor) -> Callable[[], None]:
    """A function that wakes an executor, and does not keep it alive."""
    reference = weakref.ref(executor)

    def wake() -> None:
        found = reference()
        if found is not None and not found._is_shutdown:
            found.wake()

    return wake


class SingleThreadedExecutor(Executor):
    """Runs callbacks one after another, in the thread that spins.

    Args:
        context: The context it belongs to; the default one where not given.
    """

    def __init__(self, *, context: Context | None = None) -> None:
        super().__init__(context=context)

    def _spin_once(self, timeout_sec: float | None, condition: Callable[[], bool] | None) -> None:
        try:
            item, received = self._next(timeout_sec, condition)
        except (ShutdownException, TimeoutException, ConditionReachedException):
            return
        outer = self._running_in
        self._running += 1
        self._running_in = threading.get_ident()
        try:
            self._run(item, received)
        finally:
            self._running -= 1
            self._running_in = outer
            if self._is_shutdown:
                with self._idle:
                    self._idle.notify_all()

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Wait for one callback and run it.

        Args:
            timeout_sec: How long to wait at most [s]; None or negative for as long as it takes.
        """
        self._spin_once(timeout_sec, None)

    def spin_once_until_future_complete(
        self, future: Future, timeout_sec: float | None = None
    ) -> None:
        """Wait for one callback and run it, unless a future is done first.

        Args:
            future: The future.
            timeout_sec: How long to wait at most [s]; None or negative for as long as it takes.
        """
        future._add_waiter(self.wake)
        try:
            self._spin_once(timeout_sec, future._is_over)
        finally:
            future._remove_waiter(self.wake)


class MultiThreadedExecutor(Executor):
    """Runs callbacks in several threads, as far as their callback groups let it.

    Args:
        num_threads: How many; as many as there are processors, at least two, where not given.
        context: The context it belongs to; the default one where not given.
    """

    def __init__(self, num_threads: int | None = None, *, context: Context | None = None) -> None:
        super().__init__(context=context)
        if num_threads is None:
            num_threads = max(2, os.cpu_count() or 2)
        if num_threads < 1:
            raise ValueError(f"num_threads must be at least 1, found {num_threads}")
        self._num_threads = num_threads
        self._pool = ThreadPoolExecutor(num_threads, thread_name_prefix="rclpy executor")
        self._failures: deque[BaseException] = deque()

    def wake(self) -> None:
        """Have a waiting executor look again."""
        super().wake()
        with self._idle:
            self._idle.notify_all()

    def _spin_once(self, timeout_sec: float | None, condition: Callable[[], bool] | None) -> None:
        if timeout_sec is not None and timeout_sec < 0:
            timeout_sec = None
        started_s = time.monotonic()
        # What nobody could run yet is not taken either, or it would pile up in front of the pool.
        with self._idle:
            if self._running >= self._num_threads:
                self._idle.wait_for(lambda: self._may_go_on(condition), timeout_sec)
                if self._running >= self._num_threads and not self._failures:
                    if not self._context.ok():
                        raise ExternalShutdownException()
                    return
        if timeout_sec is not None:
            timeout_sec = max(0.0, timeout_sec - (time.monotonic() - started_s))
        self._raise_failure()
        try:
            item, received = self._next(
                timeout_sec, lambda: bool(self._failures) or (condition and condition()) or False
            )
        except (ShutdownException, TimeoutException, ConditionReachedException):
            self._raise_failure()
            return
        with self._idle:
            self._running += 1
        self._pool.submit(self._run_in_pool, item, received)

    def _may_go_on(self, condition: Callable[[], bool] | None) -> bool:
        return (
            self._running < self._num_threads
            or bool(self._failures)
            or self._is_shutdown
            or not self._context.ok()
            or (condition is not None and condition())
        )

    def _raise_failure(self) -> None:
        if self._failures:
            raise self._failures.popleft()

    def _run_in_pool(self, item: Any, received: Any) -> None:
        try:
            self._run(item, received)
        except BaseException as error:
            # for the thread that spins, which raises it
            self._failures.append(error)
        finally:
            with self._idle:
                self._running -= 1
            self.wake()

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Wait for one callback and hand it to a thread.

        Args:
            timeout_sec: How long to wait at most [s]; None or negative for as long as it takes.
        """
        self._spin_once(timeout_sec, None)

    def spin_once_until_future_complete(
        self, future: Future, timeout_sec: float | None = None
    ) -> None:
        """Wait for one callback and hand it to a thread, unless a future is done first.

        Args:
            future: The future.
            timeout_sec: How long to wait at most [s]; None or negative for as long as it takes.
        """
        future._add_waiter(self.wake)
        try:
            self._spin_once(timeout_sec, future._is_over)
        finally:
            future._remove_waiter(self.wake)

    def shutdown(self, timeout_sec: float | None = None) -> bool:
        """Stop running callbacks, and wait for those that run.

        Args:
            timeout_sec: How long to wait at most [s]; None or negative for as long as it takes.

        Returns:
            bool: Whether all of them have ended.
        """
        success = super().shutdown(timeout_sec)
        self._pool.shutdown(wait=success)
        return success
