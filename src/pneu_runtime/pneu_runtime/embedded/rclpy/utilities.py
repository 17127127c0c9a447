# SPDX-License-Identifier: Apache-2.0
"""The default context and small functions about it."""

import sys
import threading

from rclpy._arguments import without_ros_arguments
from rclpy.constants import S_TO_NS
from rclpy.context import Context

_default_context: Context | None = None
_lock = threading.Lock()


def get_default_context(*, shutting_down: bool = False) -> Context:
    """Return the context that is meant where none is given.

    Args:
        shutting_down: Whether the next call is to return a fresh context.

    Returns:
        Context: The default context.
    """
    global _default_context
    with _lock:
        if _default_context is None:
            _default_context = Context()
        context = _default_context
        if shutting_down:
            _default_context = None
        return context


def ok(*, context: Context | None = None) -> bool:
    """Say whether a context is initialised and not shut down.

    Args:
        context: The context; the default one where not given.

    Returns:
        bool: Whether it is.
    """
    return (get_default_context() if context is None else context).ok()


def shutdown(*, context: Context | None = None) -> None:
    """Shut a context down.

    Args:
        context: The context; the default one where not given.
    """
    if context is None:
        context = get_default_context(shutting_down=True)
    context.shutdown()


def try_shutdown(*, context: Context | None = None) -> None:
    """Shut a context down, unless that is done already.

    Args:
        context: The context; the default one where not given.
    """
    global _default_context
    if context is not None:
        context.try_shutdown()
        return
    with _lock:
        context, _default_context = _default_context, None
    if context is not None:
        context.try_shutdown()


def get_rmw_implementation_identifier() -> str:
    """Return the name of what stands in for the middleware.

    Returns:
        str: The middleware that this runtime is compatible with.
    """
    return "rmw_cyclonedds_cpp"


def get_available_rmw_implementations() -> set[str]:
    """Return the names of the middlewares there are.

    Returns:
        set[str]: The only one.
    """
    return {get_rmw_implementation_identifier()}


def remove_ros_args(args: list[str] | None = None) -> list[str]:
    """Return a command line without what is meant for ROS.

    Args:
        args: The command line; that of the process where not given.

    Returns:
        list[str]: What remains, in order.
    """
    return without_ros_arguments(sys.argv if args is None else args)


def timeout_sec_to_nsec(timeout_sec: float | None) -> int:
    """Return a timeout in nanoseconds.

    Args:
        timeout_sec: The timeout [s]; None or negative for none.

    Returns:
        int: The timeout [ns]; -1 for none.
    """
    if timeout_sec is None or timeout_sec < 0:
        return -1
    return int(float(timeout_sec) * S_TO_NS)
