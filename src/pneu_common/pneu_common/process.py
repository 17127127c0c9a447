# SPDX-License-Identifier: Apache-2.0
"""The process of a command: how SIGINT and SIGTERM end it, and what its output can represent.

Until a command begins its work it has started no process and written no file, so a signal ends the
process at once. From then on a signal raises an exception in the main thread, which removes
temporary files and ends child processes on its way out. It is raised later where it would be lost:
the import system drops some exceptions and takes others for a missing module, and an exception in a
finaliser is only printed.

This file imports little, because it is the first that the `pneu` command runs.
"""

import codecs
import os
import signal
import sys
from types import FrameType
from typing import Any

INTERRUPTED = 128 + signal.SIGINT
TERMINATED = 128 + signal.SIGTERM
"""Exit statuses, as shells report these signals."""

_RETRY_S = 0.02
_ASCII = {"±": "+-", "°": " deg", "≥": ">=", "≤": "<="}
"""Substitutes; other characters become escapes."""
_IMPORT_SYSTEM = "<frozen importlib._bootstrap>"

_working = False
_received = 0


class TerminatedError(KeyboardInterrupt):
    """SIGTERM arrived; code that handles an interrupt handles this as well."""


def prepare() -> None:
    """Installs the handlers of signals, and has output represent what its encoding lacks.

    A signal that is ignored, as by nohup, or handled already is left alone.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
            signal.signal(number, _on_signal)
    if sys.platform != "win32":
        signal.signal(signal.SIGALRM, lambda number, frame: signal.raise_signal(_received))
    sys.unraisablehook = _on_unraisable
    represent_all_characters()


def begin_work() -> None:
    """From now on a signal raises an exception instead of ending the process at once."""
    global _working
    _working = True


def restore_signals() -> None:
    """Restores the default action of the signals: to end the process, which has no work left."""
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) is _on_signal:
            signal.signal(number, signal.SIG_DFL)
    if sys.platform != "win32":
        signal.setitimer(signal.ITIMER_REAL, 0.0)


def received() -> KeyboardInterrupt | None:
    """Returns the exception of the last signal, or None where none has arrived."""
    if not _received:
        return None
    return TerminatedError() if _received == signal.SIGTERM else KeyboardInterrupt()


def raise_postponed() -> None:
    """Raises the exception that an import has postponed; to be called when the work is done."""
    if sys.platform != "win32" and signal.setitimer(signal.ITIMER_REAL, 0.0)[0] > 0.0:
        raise KeyboardInterrupt if (interrupt := received()) is None else interrupt


def ending(interrupt: BaseException) -> tuple[str, int]:
    """Returns the message and the exit status of a process that a signal ends.

    Args:
        interrupt: The exception that the signal raised.
    """
    if isinstance(interrupt, TerminatedError):
        return "terminated", TERMINATED
    return "interrupted", INTERRUPTED


def represent_all_characters() -> None:
    """Has standard output and error print something else for characters that their encoding lacks.

    Those are all beyond ASCII in the C locale, and everywhere the bytes of a file name that are no
    text.
    """
    codecs.register_error("pneu", _represent)
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # neither None nor replaced by a test
            stream.reconfigure(errors="pneu")


def _represent(error: UnicodeError) -> tuple[str | bytes, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    lacking = error.object[error.start : error.end]
    shown = (_ASCII.get(c) or c.encode("ascii", "backslashreplace").decode() for c in lacking)
    return "".join(shown), error.end


def _on_signal(number: int, frame: FrameType | None) -> None:
    global _received
    _received = number
    interrupt = TerminatedError() if number == signal.SIGTERM else KeyboardInterrupt()
    if not _working:
        message, status = ending(interrupt)
        os.write(2, f"pneu: {message}\n".encode())
        os._exit(status)
    if sys.platform != "win32" and _importing(frame):
        signal.setitimer(signal.ITIMER_REAL, _RETRY_S)
    else:
        raise interrupt


def _importing(frame: FrameType | None) -> bool:
    while frame is not None and frame.f_code.co_filename != _IMPORT_SYSTEM:
        frame = frame.f_back
    return frame is not None


def _on_unraisable(unraisable: Any) -> None:
    """Repeats a signal whose exception could not be propagated, instead of printing it."""
    if sys.platform == "win32" or not isinstance(unraisable.exc_value, KeyboardInterrupt):
        sys.__unraisablehook__(unraisable)
    else:
        signal.setitimer(signal.ITIMER_REAL, _RETRY_S)
