# SPDX-License-Identifier: Apache-2.0
"""Loggers: named, with children, and with the filters once, skip_first and throttle."""

import os
import sys
from types import CodeType, FrameType
from typing import Any, NamedTuple

from rclpy.impl.log_output import SEPARATOR, output
from rclpy.impl.logging_severity import LoggingSeverity

# Frames of these files are never the caller of a log function.
_INTERNAL_FILES = {__file__}

# Options of each filter in the order in which filters decide; None marks a required one.
_FILTERS: dict[str, dict[str, Any]] = {
    "throttle": {"throttle_duration_sec": None, "throttle_time_source_type": "clock"},
    "skip_first": {"skip_first": None},
    "once": {"once": None},
}
_OPTIONS = [option for options in _FILTERS.values() for option in options]


class CallerId(NamedTuple):
    """Place a message is logged from; `last_index` tells two calls on one line apart."""

    function_name: str
    file_path: str
    line_number: int
    last_index: int


class _Site:
    """What is remembered of one calling place between its calls."""

    def __init__(self, name: str, severity: LoggingSeverity, filters: list[str]) -> None:
        self.name = name
        self.severity = severity
        self.filters = filters
        self.options: dict[str, Any] = {}
        self.logged_once = False
        self.first_skipped = False
        self.last_logged_ns = 0


def _find_frame() -> FrameType:
    frame = sys._getframe(1)
    while frame.f_code.co_filename in _INTERNAL_FILES and frame.f_back is not None:
        frame = frame.f_back
    return frame


def _filters_of(options: dict[str, Any]) -> list[str]:
    """Names of the filters that the options of a call switch on."""
    for option in options:
        if option not in _OPTIONS:
            raise TypeError(
                f'parameter "{option}" is not one of the recognized logging options "{_OPTIONS}"'
            )
    found = []
    for name, known in _FILTERS.items():
        if not any(options.get(option) for option in known):
            continue
        for option, default in known.items():
            if option not in options and default is None:
                raise TypeError(
                    f'required parameter "{option}" not specified but is required for the '
                    f'logging filter "{name}"'
                )
        found.append(name)
    return found


class RcutilsLogger:
    """A logger of a given name, which writes to the console and to /rosout."""

    def __init__(self, name: str = "") -> None:
        """Make a logger; use `rclpy.logging.get_logger` or `get_child` instead.

        Args:
            name: Full name; "" is the root.
        """
        self.name = name
        self._inherited_sink: Any = None
        self._sites: dict[tuple[CodeType, int], _Site] = {}

    def __del__(self) -> None:
        if self._inherited_sink is not None:
            output.remove_sink(self.name, self._inherited_sink)

    def get_child(self, name: str) -> "RcutilsLogger":
        """Return a logger named below this one; it publishes to /rosout where this one does.

        Args:
            name: Name of the child, not empty.
        """
        if not name:
            raise ValueError("Child logger name must not be empty.")
        child = RcutilsLogger(self.name + SEPARATOR + name if self.name else name)
        if self.name:
            sink = output.sink_of(self.name)
            if sink is not None:
                output.add_sink(child.name, sink)
                child._inherited_sink = sink
        return child

    def set_level(self, level: LoggingSeverity | int) -> None:
        """Set the least severity of messages that are let through.

        Args:
            level: The severity; UNSET leaves it to the parent.
        """
        output.set_level(self.name, LoggingSeverity(level))

    def get_effective_level(self) -> LoggingSeverity:
        """Return the level that decides: this logger's own, its parent's or the default."""
        return output.effective_level(self.name)

    def is_enabled_for(self, severity: LoggingSeverity | int) -> bool:
        """Return whether messages of a severity are let through.

        Args:
            severity: The severity.
        """
        return LoggingSeverity(severity) >= output.effective_level(self.name)

    def log(self, message: str, severity: LoggingSeverity | int, **kwargs: Any) -> bool:
        """Log a message.

        Filters decide only when the logger is enabled for the severity, and a calling place has to
        keep its severity, name and filters from call to call.

        Args:
            message: The text.
            severity: Its severity.
            **kwargs: `once`, `skip_first`, `throttle_duration_sec` [s] with
                `throttle_time_source_type` (a Clock; system time by default), and `name`.

        Returns:
            bool: whether the message went out.
        """
        severity = LoggingSeverity(severity)
        if severity < output.effective_level(self.name):
            return False
        if not isinstance(message, str):
            raise TypeError(f"a log message has to be a str, not {type(message).__name__}")
        name = kwargs.pop("name", self.name)
        frame = _find_frame()
        if not self._passes(frame, name, severity, kwargs):
            return False
        code = frame.f_code
        file_path = os.path.abspath(code.co_filename)
        output.write(severity, name, message, file_path, code.co_name, frame.f_lineno)
        return True

    def _passes(
        self, frame: FrameType, name: str, severity: LoggingSeverity, options: dict[str, Any]
    ) -> bool:
        filters = _filters_of(options) if options else []
        key = (frame.f_code, frame.f_lasti)
        site = self._sites.get(key)
        if site is None:
            site = _Site(name, severity, filters)
            if filters:
                site.options = self._initial_options(filters, options)
            self._sites[key] = site
        else:
            self._check_unchanged(site, name, severity, filters, options)
        return all([getattr(self, f"_pass_{one}")(site) for one in site.filters])

    @staticmethod
    def _initial_options(filters: list[str], options: dict[str, Any]) -> dict[str, Any]:
        from rclpy.clock import Clock  # not at the top: the clock module may log

        result = dict(options)
        if "throttle" in filters:
            clock = result.setdefault("throttle_time_source_type", None)
            if clock is None:
                clock = result["throttle_time_source_type"] = Clock()
            if not isinstance(clock, Clock):
                raise ValueError(
                    f'Received throttle_time_source_type of "{clock}" is not a clock instance'
                )
        return result

    @staticmethod
    def _check_unchanged(
        site: _Site,
        name: str,
        severity: LoggingSeverity,
        filters: list[str],
        options: dict[str, Any],
    ) -> None:
        if severity != site.severity:
            raise ValueError("Logger severity cannot be changed between calls.")
        if name != site.name:
            raise ValueError("Logger name cannot be changed between calls.")
        if filters != site.filters:
            raise ValueError("Requested logging filters cannot be changed between calls.")
        if any(site.options.get(option) != value for option, value in options.items() if filters):
            raise ValueError("Logging filter parameters cannot be changed between calls.")

    @staticmethod
    def _pass_throttle(site: _Site) -> bool:
        now_ns = site.options["throttle_time_source_type"].now().nanoseconds
        interval_ns = site.options["throttle_duration_sec"] * 1e9
        if now_ns < site.last_logged_ns + interval_ns:
            return False
        site.last_logged_ns = now_ns
        return True

    @staticmethod
    def _pass_skip_first(site: _Site) -> bool:
        skipped, site.first_skipped = site.first_skipped, True
        return skipped

    @staticmethod
    def _pass_once(site: _Site) -> bool:
        logged, site.logged_once = site.logged_once, True
        return not logged

    def debug(self, message: str, **kwargs: Any) -> bool:
        """Log with severity DEBUG; see `log`.

        Args:
            message: The text.
            **kwargs: Filters.
        """
        return self.log(message, LoggingSeverity.DEBUG, **kwargs)

    def info(self, message: str, **kwargs: Any) -> bool:
        """Log with severity INFO; see `log`.

        Args:
            message: The text.
            **kwargs: Filters.
        """
        return self.log(message, LoggingSeverity.INFO, **kwargs)

    def warning(self, message: str, **kwargs: Any) -> bool:
        """Log with severity WARN; see `log`.

        Args:
            message: The text.
            **kwargs: Filters.
        """
        return self.log(message, LoggingSeverity.WARN, **kwargs)

    def warn(self, message: str, **kwargs: Any) -> bool:
        """Log with severity WARN; the older name of `warning`.

        Args:
            message: The text.
            **kwargs: Filters.
        """
        return self.log(message, LoggingSeverity.WARN, **kwargs)

    def error(self, message: str, **kwargs: Any) -> bool:
        """Log with severity ERROR; see `log`.

        Args:
            message: The text.
            **kwargs: Filters.
        """
        return self.log(message, LoggingSeverity.ERROR, **kwargs)

    def fatal(self, message: str, **kwargs: Any) -> bool:
        """Log with severity FATAL; see `log`.

        Args:
            message: The text.
            **kwargs: Filters.
        """
        return self.log(message, LoggingSeverity.FATAL, **kwargs)
