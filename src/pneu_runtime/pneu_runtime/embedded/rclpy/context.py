# SPDX-License-Identifier: Apache-2.0
"""Contexts: between init and shutdown, nodes can be made and run."""

import atexit
import os
import threading
import warnings
import weakref
from collections.abc import Callable
from types import MethodType, TracebackType
from typing import TYPE_CHECKING, Any

from pneu_runtime import transport
from rclpy import logging
from rclpy._arguments import RosArguments, parse_arguments
from rclpy._rclpy_pybind11 import RCLError

if TYPE_CHECKING:
    from rclpy.node import Node

# Contexts that a signal shuts down. Replaced, never changed in place: signal handlers read it.
_valid_contexts: tuple["weakref.ref[Context]", ...] = ()
_valid_lock = threading.Lock()


def _enter_valid(context: "Context") -> None:
    global _valid_contexts
    with _valid_lock:
        _valid_contexts = (*_valid_contexts, weakref.ref(context))


def _leave_valid(context: "Context") -> None:
    global _valid_contexts
    with _valid_lock:
        _valid_contexts = tuple(
            one for one in _valid_contexts if one() is not None and one() is not context
        )


def _contexts_to_shut() -> "list[Context]":
    """The contexts that a signal is to shut down."""
    found = (reference() for reference in _valid_contexts)
    return [context for context in found if context is not None]


class Context:
    """What nodes need in common: the arguments, the participant in the graph, and whether to go on.

    A context is initialised once and shut down once.
    """

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._initialized = False
        self._valid = False
        self._callbacks: list[Callable[[], Callable[[], None] | None]] = []
        self._wakers: tuple[Callable[[], None], ...] = ()
        self._arguments = RosArguments()
        self._domain_id: int | None = None
        self._session: transport.Session | None = None
        self._session_users = 0
        self._nodes: weakref.WeakSet[Node] = weakref.WeakSet()

    @property
    def handle(self) -> "Context":
        """The context itself; it has no other handle here."""
        return self

    def init(
        self,
        args: list[str] | None = None,
        *,
        initialize_logging: bool = True,
        domain_id: int | None = None,
    ) -> None:
        """Initialise the context.

        Args:
            args: Command line, of which the part after ``--ros-args`` counts; that of the process
                where not given.
            initialize_logging: Whether the log levels in the arguments are applied.
            domain_id: Domain of the graph; that of ROS_DOMAIN_ID where not given.
        """
        if domain_id is not None and domain_id < 0:
            raise RuntimeError(f"Domain id ({domain_id}) should not be lower than zero.")
        with self._lock:
            if self._initialized:
                raise RuntimeError("Context.init() must only be called once")
            arguments = parse_arguments(args)
            self._arguments = arguments
            self._domain_id = domain_id
            if initialize_logging:
                logging._configure_from_arguments(
                    arguments.default_log_level,
                    arguments.log_levels,
                    stdout=arguments.stdout_logs,
                    rosout=arguments.rosout_logs,
                )
            self._initialized = True
            self._valid = True
        _enter_valid(self)

    def track_node(self, node: "Node") -> None:
        """Remember a node that was made with this context.

        Args:
            node: The node.
        """
        self._nodes.add(node)

    def untrack_node(self, node: "Node") -> None:
        """Forget a node.

        Args:
            node: The node.
        """
        self._nodes.discard(node)

    def ok(self) -> bool:
        """Say whether the context is initialised and not shut down.

        Returns:
            bool: Whether it is.
        """
        return self._valid

    def shutdown(self) -> None:
        """Shut the context down. RCLError where it was shut down before."""
        with self._lock:
            if not self._initialized:
                raise RuntimeError("Context must be initialized before it can be shutdown")
            if not self._valid:
                raise RCLError(
                    "failed to shutdown: rcl_shutdown already called on the given context"
                )
            self._valid = False
        self._after_shutdown()
        self._call_on_shutdown_callbacks()

    def try_shutdown(self) -> None:
        """Shut the context down, unless that is done already."""
        with self._lock:
            if not self._valid:
                return
            self._valid = False
        self._after_shutdown()
        self._call_on_shutdown_callbacks()

    def _shutdown_by_signal(self) -> None:
        """Shut down without the user's callbacks, which must not run on the thread of signals."""
        self._valid = False
        self._after_shutdown()

    def _after_shutdown(self) -> None:
        _leave_valid(self)
        for waker in self._wakers:
            waker()
        self._close_session_if_unused()

    def _add_waker(self, waker: Callable[[], None]) -> None:
        """Have a function called at shutdown, also by a signal. It must be short and not block."""
        with self._lock:
            self._wakers = (*self._wakers, waker)

    def _remove_waker(self, waker: Callable[[], None]) -> None:
        with self._lock:
            self._wakers = tuple(one for one in self._wakers if one != waker)

    def on_shutdown(self, callback: Callable[[], None]) -> None:
        """Have a function called when `shutdown` or `try_shutdown` shuts the context down.

        As in rclpy, a shutdown by a signal does not call it.

        Args:
            callback: The function; a bound method is held weakly.
        """
        if not callable(callback):
            raise TypeError("callback should be a callable")
        with self._lock:
            if isinstance(callback, MethodType):
                self._callbacks.append(weakref.WeakMethod(callback))
            else:
                self._callbacks.append(lambda: callback)

    def _call_on_shutdown_callbacks(self) -> None:
        with self._lock:
            callbacks, self._callbacks = self._callbacks, []
        for reference in callbacks:
            callback = reference()
            if callback is not None:
                callback()

    def get_domain_id(self) -> int:
        """Return the domain of the graph.

        Returns:
            int: The domain.
        """
        if not self._valid:
            raise RCLError("failed to get domain id: the context is not initialized")
        if self._domain_id is None:
            self._domain_id = int(os.environ.get("ROS_DOMAIN_ID") or 0)
        return self._domain_id

    @property
    def session(self) -> transport.Session:
        """The participant in the graph; there is one while there are nodes."""
        if self._session is None:
            raise RCLError("the context has no participant in the graph: it has no node")
        return self._session

    def _acquire_session(self) -> transport.Session:
        """Return the participant for one more node, which gives it back with `_release_session`."""
        with self._lock:
            if self._session is None:
                self._session = transport.Session(
                    self.get_domain_id(), enclave=self._arguments.enclave
                )
                _open_sessions.add(self._session)
            self._session_users += 1
            return self._session

    def _release_session(self) -> None:
        with self._lock:
            self._session_users -= 1
        self._close_session_if_unused()

    def _close_session_if_unused(self) -> None:
        with self._lock:
            if self._session_users or self._session is None:
                return
            session, self._session = self._session, None
        _open_sessions.discard(session)
        session.close()

    def destroy(self) -> None:
        """Shut the context down where it is not, and leave the graph."""
        self.try_shutdown()

    def __enter__(self) -> "Context":
        if not self._initialized:
            self.init()
        return self

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc_val: BaseException | None,
        exc_tb: TracebackType | None,
    ) -> None:
        self.try_shutdown()


_open_sessions: set[Any] = set()


def _close_sessions() -> None:
    """Say goodbye to the graph at the end of the process, for nodes that were never destroyed."""
    for session in list(_open_sessions):
        _open_sessions.discard(session)
        try:
            session.close()
        except Exception as error:  # the others are to be closed too
            warnings.warn(f"closing a participant failed: {error}", stacklevel=1)


atexit.register(_close_sessions)
