# SPDX-License-Identifier: Apache-2.0
"""Logging of nodes: loggers by name, and their levels."""

import os
from pathlib import Path

from rclpy.impl.log_output import DEFAULT_LEVEL, output
from rclpy.impl.logging_severity import LoggingSeverity
from rclpy.impl.rcutils_logger import RcutilsLogger

__all__ = [
    "LoggingSeverity",
    "clear_config",
    "get_logger",
    "get_logger_effective_level",
    "get_logger_level",
    "get_logging_directory",
    "get_logging_severity_from_string",
    "initialize",
    "set_logger_level",
    "shutdown",
]

_root_logger = RcutilsLogger()


def get_logger(name: str) -> RcutilsLogger:
    """Return a logger.

    Args:
        name: Full name, its parts separated by dots.
    """
    if not name:
        raise ValueError("Logger name must not be empty.")
    return _root_logger.get_child(name)


def initialize() -> None:
    """Start with the default levels; what is set already stays."""


def shutdown() -> None:
    """Forget all levels."""
    output.clear()


def clear_config() -> None:
    """Clear the configuration of the logging system, e.g. logger levels."""
    shutdown()
    initialize()


def set_logger_level(name: str, level: int | LoggingSeverity, detailed_error: bool = False) -> None:
    """Set the level of a logger.

    Args:
        name: Full name of the logger.
        level: Least severity let through; ValueError where it is none of `LoggingSeverity`.
        detailed_error: Kept for compatibility; errors always say what was wrong.
    """
    output.set_level(name, LoggingSeverity(level))


def get_logger_effective_level(name: str) -> LoggingSeverity:
    """Return the level that decides for a logger: its own, its parent's or the default.

    Args:
        name: Full name of the logger.
    """
    return output.effective_level(name)


def get_logger_level(name: str) -> LoggingSeverity:
    """Return the level set for this logger itself, UNSET where there is none.

    Args:
        name: Full name of the logger.
    """
    return output.level(name)


def get_logging_severity_from_string(log_severity: str) -> LoggingSeverity:
    """Return the severity a word such as "warn" names; RuntimeError for any other word.

    Args:
        log_severity: Name of the severity, in capitals or not.
    """
    try:
        return LoggingSeverity[log_severity.upper()]
    except KeyError:
        known = ", ".join(severity.name for severity in LoggingSeverity)
        message = f"'{log_severity}' is not a log severity; known are {known}"
        raise RuntimeError(message) from None


def get_logging_directory() -> Path:
    """Return the directory of log files: ROS_LOG_DIR, ROS_HOME/log or ~/.ros/log.

    This runtime writes no log files itself; launch tools put theirs there.
    """
    if directory := os.environ.get("ROS_LOG_DIR"):
        return Path(directory).expanduser()
    home = os.environ.get("ROS_HOME") or "~/.ros"
    return Path(home).expanduser() / "log"


def _configure_from_arguments(
    default_level: LoggingSeverity | None,
    levels: dict[str, LoggingSeverity],
    stdout: bool = True,
    rosout: bool = True,
) -> None:
    """Apply the logging arguments of `--ros-args`, which rclpy.init reads."""
    output.set_level("", default_level or DEFAULT_LEVEL)
    for name, level in levels.items():
        output.set_level(name, level)
    output.console_enabled = stdout
    output.rosout_enabled = rosout
