# SPDX-License-Identifier: Apache-2.0
"""Futures, and tasks that an executor runs."""

import inspect
import sys
import threading
import warnings
import weakref
from collections.abc import Callable, Generator
from typing import Any


class Future:
    """A result that comes later. It can be awaited in a coroutine that an executor runs.

    Args:
        executor: Runs the callbacks; without one they run where the result is set.
    """

    def __init__(self, *, executor: Any = None) -> None:
        self._done = False
        self._cancelled = False
        self._result: Any = None
        self._exception: BaseException | None = None
        self._exception_fetched = False
        self._callbacks: list[Callable[[Future], Any]] = []
        # called directly when done, before the callbacks: tasks and threads that wait
        self._waiters: list[Callable[[], None]] = []
        self._lock = threading.Lock()
        self._executor: Callable[[], Any] = _nothing
        self._set_executor(executor)

    def __del__(self) -> None:
        if self._exception is not None and not self._exception_fetched:
            print(
                f"The following exception was never retrieved: {self._exception}", file=sys.stderr
            )

    def __await__(self) -> Generator["Future", None, Any]:
        while not self._done:
            yield self
        return self.result()

    def _pending(self) -> bool:
        return not self._done

    def _is_over(self) -> bool:
        """Whether it is done or cancelled, which stays so."""
        return self._done

    def cancel(self) -> None:
        """Give up waiting for a result, unless there is one."""
        self._finish(cancelled=True)

    def cancelled(self) -> bool:
        """Say whether the future was cancelled.

        Returns:
            bool: Whether it was.
        """
        return self._cancelled

    def done(self) -> bool:
        """Say whether there is a result or an exception. A cancelled future is not done.

        Returns:
            bool: Whether it is done.
        """
        return self._done and not self._cancelled

    def result(self) -> Any:
        """Return the result, or raise the exception.

        Returns:
            object: The result; None where there is none yet, or never will be.
        """
        if self._exception is not None:
            self._exception_fetched = True
            raise self._exception
        return self._result

    def exception(self) -> BaseException | None:
        """Return the exception.

        Returns:
            BaseException | None: The exception, where one was set.
        """
        self._exception_fetched = True
        return self._exception

    def set_result(self, result: Any) -> None:
        """Set the result.

        Args:
            result: The result.
        """
        self._finish(result=result)

    def set_exception(self, exception: BaseException) -> None:
        """Set the exception.

        Args:
            exception: The exception.
        """
        self._finish(exception=exception)

    def _finish(
        self,
        *,
        result: Any = None,
        exception: BaseException | None = None,
        cancelled: bool = False,
    ) -> None:
        with self._lock:
            if cancelled and self._done:
                return
            self._result = result
            self._exception = exception
            self._exception_fetched = False
            self._cancelled = cancelled
            self._done = True
            waiters, self._waiters = self._waiters, []
            callbacks, self._callbacks = self._callbacks, []
        for waiter in waiters:
            waiter()
        for callback in callbacks:
            self._schedule(callback)

    def _schedule(self, callback: Callable[["Future"], Any]) -> None:
        executor = self._executor()
        if executor is not None:
            executor.create_task(callback, self)
            return
        try:
            callback(self)
        except Exception as error:
            # the one who sets a result is not to blame, and there may be more callbacks to call
            warnings.warn(f"Unhandled exception in done callback: {error}", stacklevel=3)

    def _set_executor(self, executor: Any) -> None:
        self._executor = _nothing if executor is None else weakref.ref(executor)

    def add_done_callback(self, callback: Callable[["Future"], Any]) -> None:
        """Have a function called when the future is done, at once where it is.

        Args:
            callback: Called with the future.
        """
        with self._lock:
            if not self._done:
                self._callbacks.append(callback)
                return
        self._schedule(callback)

    def remove_done_callback(self, callback: Callable[["Future"], Any]) -> bool:
        """Take back `add_done_callback`.

        Args:
            callback: The function.

        Returns:
            bool: Whether it was there.
        """
        with self._lock:
            try:
                self._callbacks.remove(callback)
            except ValueError:
                return False
            return True

    def _add_waiter(self, waiter: Callable[[], None]) -> None:
        with self._lock:
            if not self._done:
                self._waiters.append(waiter)
                return
        waiter()

    def _remove_waiter(self, waiter: Callable[[], None]) -> None:
        with self._lock:
            if waiter in self._waiters:
                self._waiters.remove(waiter)

    def _wait_in_thread(self, timeout_sec: float | None) -> bool:
        """Block this thread until the future is done; whether it is."""
        event = threading.Event()
        self._add_waiter(event.set)
        try:
            return event.wait(timeout_sec) or self._done
        finally:
            self._remove_waiter(event.set)


def _nothing() -> None:
    """In place of a weak reference, where there is nothing to refer to."""


class Task(Future):
    """A function or coroutine that an executor runs, and its result.

    A coroutine runs until it awaits a future that is not done; the task goes back to its executor
    when that future is.

    Args:
        handler: The function, coroutine function or coroutine.
        args: Positional arguments.
        kwargs: Keyword arguments.
        executor: The executor that runs the task.
    """

    def __init__(
        self,
        handler: Any,
        args: tuple[Any, ...] | list[Any] | None = None,
        kwargs: dict[str, Any] | None = None,
        executor: Any = None,
    ) -> None:
        super().__init__(executor=executor)
        self._args = () if args is None else args
        self._kwargs = {} if kwargs is None else kwargs
        self._handler: Any = handler
        self._coroutine: Any = None
        if inspect.iscoroutine(handler):
            self._coroutine = handler
        elif inspect.iscoroutinefunction(handler):
            self._coroutine = handler(*self._args, **self._kwargs)
        self._executing = False
        self._task_lock = threading.Lock()

    def __call__(self) -> None:
        """Run, or go on."""
        # Blocks for a moment where the awaited future is done before the step that awaited it has
        # returned in another thread.
        with self._task_lock:
            if self._is_over():
                return
            self._executing = True
            try:
                if self._coroutine is None:
                    self.set_result(self._handler(*self._args, **self._kwargs))
                    self._complete_task()
                else:
                    self._step()
            except Exception as error:
                self.set_exception(error)
                self._complete_task()
            finally:
                self._executing = False

    def _step(self) -> None:
        try:
            awaited = self._coroutine.send(None)
        except StopIteration as stop:
            self.set_result(stop.value)
            self._complete_task()
            return
        if isinstance(awaited, Future):
            awaited._add_waiter(self._resume)
        else:  # a bare yield: others may run first
            self._resume()

    def _resume(self) -> None:
        # Nobody is woken, as in rclpy: what a callback completes is found in the next round, what
        # another thread completes when something else wakes the executor (a done-callback does).
        executor = self._executor()
        if executor is not None:
            executor._tasks.append(self)

    def _complete_task(self) -> None:
        """Let go of what a finished task would otherwise keep alive."""
        self._handler = None
        self._coroutine = None
        self._args = ()
        self._kwargs = {}

    def cancel(self) -> None:
        """Cancel the task; a coroutine that waits is closed."""
        if self._done:
            return
        super().cancel()
        coroutine = self._coroutine
        if coroutine is not None and not self._executing:
            coroutine.close()

    def executing(self) -> bool:
        """Say whether the task is running now.

        Returns:
            bool: Whether it is.
        """
        return self._executing
