# SPDX-License-Identifier: Apache-2.0
"""Where log messages go: levels by logger name, the console line, and the /rosout publishers.

The settings belong to the process, as those of rcutils do, and are guarded by one lock.
"""

import os
import re
import sys
import threading
import time
from collections.abc import Callable
from datetime import datetime
from typing import TextIO

from rclpy.impl.logging_severity import LoggingSeverity

SEPARATOR = "."
DEFAULT_LEVEL = LoggingSeverity.INFO
DEFAULT_FORMAT = "[{severity}] [{time}] [{name}]: {message}"

_TOKEN = re.compile(r"\{(\w+)\}")
_ESCAPES = {"n": "\n", "t": "\t", "r": "\r", "a": "\a", "b": "\b", "f": "\f", "v": "\v", "\\": "\\"}
_ESCAPE = re.compile(r"\\(x[0-9A-Fa-f]{2}|.)")
_COLOURS = {
    LoggingSeverity.DEBUG: "\033[32m",
    LoggingSeverity.INFO: "\033[0m",
    LoggingSeverity.WARN: "\033[33m",
    LoggingSeverity.ERROR: "\033[31m",
    LoggingSeverity.FATAL: "\033[31m",
}

# level, logger name, message, file, function, line, stamp in nanoseconds
Sink = Callable[[LoggingSeverity, str, str, str, str, int, int], None]


class LogOutput:
    """Levels, console and /rosout sinks of one process."""

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._levels: dict[str, LoggingSeverity] = {}
        self._effective: dict[str, LoggingSeverity] = {}
        self._sinks: dict[str, list[Sink]] = {}
        self.default_level = DEFAULT_LEVEL
        self.console_enabled = True
        self.rosout_enabled = True

    def clear(self) -> None:
        """Forget every level and switch; publishers stay registered."""
        with self._lock:
            self._levels.clear()
            self._effective.clear()
            self.default_level = DEFAULT_LEVEL
            self.console_enabled = True
            self.rosout_enabled = True

    def set_level(self, name: str, level: LoggingSeverity) -> None:
        """Set the level of a logger.

        Args:
            name: Full name; "" is the root, whose level is the default of all others.
            level: Least severe messages let through; UNSET leaves it to the parent.
        """
        with self._lock:
            if name:
                self._levels[name] = level
            else:
                self.default_level = level or DEFAULT_LEVEL
            self._effective.clear()

    def level(self, name: str) -> LoggingSeverity:
        """Return the level set for exactly this logger, or UNSET.

        Args:
            name: Full name; "" is the root.
        """
        with self._lock:
            return self._levels.get(name, LoggingSeverity.UNSET) if name else self.default_level

    def effective_level(self, name: str) -> LoggingSeverity:
        """Return the level that decides for a logger: its own, its nearest parent's or the default.

        Args:
            name: Full name; "" is the root.
        """
        known = self._effective.get(name)
        if known is not None:
            return known
        with self._lock:
            level = self.default_level
            ancestor = name
            while ancestor:
                if self._levels.get(ancestor):
                    level = self._levels[ancestor]
                    break
                ancestor = ancestor.rpartition(SEPARATOR)[0]
            self._effective[name] = level
            return level

    def add_sink(self, name: str, sink: Sink) -> None:
        """Send the messages of one logger also to a publisher.

        Args:
            name: Full name of the logger.
            sink: Called with every message that is let through.
        """
        with self._lock:
            self._sinks.setdefault(name, []).append(sink)

    def remove_sink(self, name: str, sink: Sink) -> None:
        """Undo one `add_sink`; does nothing where there is none left.

        Args:
            name: Full name of the logger.
            sink: The sink given then.
        """
        with self._lock:
            sinks = self._sinks.get(name, [])
            if sink in sinks:
                sinks.remove(sink)
            if not sinks:
                self._sinks.pop(name, None)

    def remove_sink_everywhere(self, sink: Sink) -> None:
        """Remove a sink from all loggers, as when its node goes.

        Args:
            sink: The sink.
        """
        with self._lock:
            for name in list(self._sinks):
                self._sinks[name] = [one for one in self._sinks[name] if one is not sink]
                if not self._sinks[name]:
                    del self._sinks[name]

    def sink_of(self, name: str) -> Sink | None:
        """Return the newest sink of a logger, which its children inherit.

        Args:
            name: Full name of the logger.
        """
        with self._lock:
            sinks = self._sinks.get(name)
            return sinks[-1] if sinks else None

    def write(
        self,
        severity: LoggingSeverity,
        name: str,
        message: str,
        file_path: str,
        function_name: str,
        line_number: int,
    ) -> None:
        """Put out one message, whose severity has been checked.

        Args:
            severity: Its severity.
            name: Full name of the logger.
            message: The text.
            file_path: Source file of the call.
            function_name: Function of the call.
            line_number: Line of the call.
        """
        stamp_ns = time.time_ns()
        if self.console_enabled:
            fields = {
                "severity": severity.name,
                "name": name,
                "message": message,
                "function_name": function_name,
                "file_name": file_path,
                "line_number": str(line_number),
                "time": f"{stamp_ns // 10**9}.{stamp_ns % 10**9:09d}",
                "time_as_nanoseconds": str(stamp_ns),
                "date_time_with_ms": _date_time(stamp_ns),
            }
            print_line(severity, console_line(fields))
        sink = self.sink_of(name) if self.rosout_enabled else None
        if sink is not None:
            sink(severity, name, message, file_path, function_name, line_number, stamp_ns)


def console_line(fields: dict[str, str]) -> str:
    """Return a message in the form RCUTILS_CONSOLE_OUTPUT_FORMAT asks for.

    Args:
        fields: Values of the tokens; an unknown token is left as it stands, as rcutils does.
    """
    template = os.environ.get("RCUTILS_CONSOLE_OUTPUT_FORMAT") or DEFAULT_FORMAT
    if "\\" in template:
        template = _ESCAPE.sub(_unescape, template)
    return _TOKEN.sub(lambda match: fields.get(match[1], match[0]), template)


def print_line(severity: LoggingSeverity, line: str) -> None:
    """Print one line to stderr, or to stdout where RCUTILS_LOGGING_USE_STDOUT=1.

    Args:
        severity: Decides the colour.
        line: Text without its line end.
    """
    stream = sys.stdout if os.environ.get("RCUTILS_LOGGING_USE_STDOUT") == "1" else sys.stderr
    if stream is None:  # an interpreter without a console
        return
    # A line that cannot be encoded would be lost.
    encoding = stream.encoding or "utf-8"
    line = line.encode(encoding, "backslashreplace").decode(encoding)
    if _colourful(stream):
        line = f"{_COLOURS[severity]}{line}\033[0m"
    try:
        stream.write(line + "\n")
        stream.flush()
    except (BrokenPipeError, ValueError):
        # The reader of the console has gone or the stream is closed; the node must go on.
        return


def _colourful(stream: TextIO) -> bool:
    wanted = os.environ.get("RCUTILS_COLORIZED_OUTPUT")
    return wanted == "1" or (wanted != "0" and stream.isatty())


def _unescape(match: re.Match[str]) -> str:
    code = match[1]
    return chr(int(code[1:], 16)) if len(code) == 3 else _ESCAPES.get(code, match[0])


def _date_time(stamp_ns: int) -> str:
    moment = datetime.fromtimestamp(stamp_ns / 1e9)
    return f"{moment:%Y-%m-%d %H:%M:%S}.{moment.microsecond // 1000:03d}"


output = LogOutput()
