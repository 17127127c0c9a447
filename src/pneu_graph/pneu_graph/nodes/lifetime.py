# SPDX-License-Identifier: Apache-2.0
"""From init to shutdown of a process with nodes, in the way that ROS 2 Jazzy has it.

There `rclpy.init` returns nothing, and a wait or a publication that a shutdown overtakes ends in
the middleware's own error.
"""

import contextlib
from collections.abc import Iterator

import rclpy
from rclpy.executors import ExternalShutdownException

from pneu_common.errors import InputError


@contextlib.contextmanager
def initialised(args: list[str] | None) -> Iterator[None]:
    """Initialises the default context for the length of a ``with``, and shuts it down.

    Args:
        args: Command line; None is the process's own.

    Raises:
        ExternalShutdownException: The context was shut down by a signal in the middle of something.
        InputError: The arguments after `--ros-args` are wrong.
    """
    try:
        rclpy.init(args=args)
    except Exception as error:  # classes of the native half, which have no public name
        if type(error).__name__ in ("RCLInvalidROSArgsError", "UnknownROSArgsError"):
            raise InputError(str(error)) from error
        raise
    try:
        yield
    except RuntimeError as error:
        # rcl: "the given context is not valid", "publisher's context is invalid"
        if rclpy.ok() or "context is" not in str(error):
            raise
        raise ExternalShutdownException from error
    finally:
        rclpy.try_shutdown()
