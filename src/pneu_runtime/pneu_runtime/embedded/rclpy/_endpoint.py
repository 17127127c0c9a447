# SPDX-License-Identifier: Apache-2.0
"""What publishers, subscriptions, clients and services have in common."""

import threading
import weakref
from types import TracebackType
from typing import Any

from rclpy._rclpy_pybind11 import InvalidHandle


class Endpoint:
    """Part of a node that has an endpoint in the transport.

    `Node` makes the endpoint of the transport, then the object, and then binds the two to itself.
    """

    _end: Any
    _context: Any = None
    _full_name: str = ""
    _logger_name: str = ""

    def _start(self, end: Any) -> None:
        self._end = end
        self._destroyed = False
        # The transport's endpoint must not be closed while another thread takes from it.
        self._lock = threading.Lock()
        # Executors that wait for the transport's endpoint.
        self._holders: weakref.WeakSet[Any] = weakref.WeakSet()

    @property
    def _sources(self) -> tuple[Any, ...]:
        return (self._end,)

    def _bind(self, context: Any, full_name: str, logger_name: str) -> None:
        self._context = context
        self._full_name = full_name
        self._logger_name = logger_name
        for handler in getattr(self, "event_handlers", ()):
            handler.logger_name = logger_name

    def _check(self) -> None:
        if self._destroyed:
            raise InvalidHandle("cannot use Destroyable because destruction was requested")

    @property
    def handle(self) -> Any:
        """The endpoint of the transport."""
        return self._end

    @property
    def logger_name(self) -> str:
        """Name of the logger of the node."""
        return self._logger_name

    def destroy(self) -> None:
        """Leave the graph. Users call the method of `Node` for it."""
        with self._lock:
            if self._destroyed:
                return
            self._destroyed = True
        for handler in getattr(self, "event_handlers", ()):
            for executor in list(handler._holders):
                executor._forget(handler)
            handler.destroy()
        for executor in list(self._holders):
            executor._forget(self)
        self._end.close()

    def __enter__(self) -> Any:
        return self

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc_val: BaseException | None,
        exc_tb: TracebackType | None,
    ) -> None:
        self.destroy()
