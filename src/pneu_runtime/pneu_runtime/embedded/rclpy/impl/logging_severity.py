# SPDX-License-Identifier: Apache-2.0
"""Severities of log messages, with the numbers of rcl_interfaces/msg/Log."""

from enum import IntEnum


class LoggingSeverity(IntEnum):
    """Severity of a log message; UNSET means that the parent logger decides."""

    UNSET = 0
    DEBUG = 10
    INFO = 20
    WARN = 30
    ERROR = 40
    FATAL = 50
