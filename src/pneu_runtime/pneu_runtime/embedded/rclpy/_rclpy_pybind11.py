# SPDX-License-Identifier: Apache-2.0
# ruff: noqa: N818  # the names are those of rclpy
"""The exceptions that come from below the Python layer, under the name code imports them by.

Nothing else of the compiled layer of rclpy exists here: a name that is asked for and not there
raises, and says that the embedded runtime does not have it.
"""

from typing import NoReturn


class RCLError(RuntimeError):
    """An operation of the layer below the API failed."""


class InvalidHandle(RuntimeError):
    """The object was destroyed and cannot be used any more."""


class NodeNameNonExistentError(RCLError):
    """No node of that name is known in the graph."""


class UnsupportedEventTypeError(RCLError):
    """This kind of event is not available."""


class UnknownROSArgsError(RuntimeError):
    """Arguments after ``--ros-args`` that no part of ROS knows."""


class RCLInvalidROSArgsError(RCLError):
    """An argument after ``--ros-args`` cannot be parsed."""


class TimerCancelledError(RCLError):
    """The timer was cancelled and has no next call."""


def __getattr__(name: str) -> NoReturn:
    raise AttributeError(f"the embedded runtime has no rclpy._rclpy_pybind11.{name}")
