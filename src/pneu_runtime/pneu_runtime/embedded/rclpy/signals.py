# SPDX-License-Identifier: Apache-2.0
"""SIGINT and SIGTERM shut all contexts down.

Python runs signal handlers between two instructions of the main thread, and never while that
thread waits inside a library. So a thread of its own reads the descriptor to which the interpreter
writes each signal at once, and wakes whoever waits.

The library of Cyclone DDS calls functions written in Python while it hands a message over. An
exception in one of them makes it use an object that is not there, and the process crashes. Where a
signal interrupts such a function its own handler, which may raise, is called a little later.
"""

import contextlib
import os
import signal
import socket
import threading
import time
from collections.abc import Callable
from enum import IntFlag
from types import FrameType
from typing import Any

from pneu_runtime.transport.dds import called_by_library
from rclpy import context as _context
from rclpy.guard_condition import GuardCondition

LATER_S = 0.002
"""After which a signal is raised again that came at a moment when nothing may be raised."""


class SignalHandlerOptions(IntFlag):
    """Which signals are handled."""

    NO = 0
    SIGINT = 1
    SIGTERM = 2
    ALL = 3


class _Handlers:
    """The handlers that are installed, and what was there before."""

    def __init__(self, options: SignalHandlerOptions) -> None:
        self.options = options
        self._numbers = [
            number
            for option, number in (
                (SignalHandlerOptions.SIGINT, signal.SIGINT),
                (SignalHandlerOptions.SIGTERM, signal.SIGTERM),
            )
            if options & option
        ]
        self._before: dict[int, Any] = {}
        self._receiver, self._sender = socket.socketpair()
        self._sender.setblocking(False)
        for number in self._numbers:
            self._before[number] = signal.signal(number, self._handle)
        # another user of the descriptor goes on to get its bytes
        self._descriptor_before = signal.set_wakeup_fd(
            self._sender.fileno(), warn_on_full_buffer=False
        )
        self._late: set[int] = set()
        self._removed = False
        self._thread = threading.Thread(target=self._watch, name="rclpy signals", daemon=True)
        self._thread.start()

    def _handle(self, number: int, frame: FrameType | None) -> None:
        # No lock may be taken here: the main thread, which this interrupts, may hold it. The
        # contexts only count as shut down; the thread does the rest.
        for context in _context._contexts_to_shut():
            context._valid = False
        before = self._before.get(number)
        if not callable(before):
            return
        if called_by_library(frame):
            self._late.add(number)
            with contextlib.suppress(OSError):  # full: the thread is awake anyway
                self._sender.send(b"\0")
        else:
            before(number, frame)

    def _watch(self) -> None:
        while received := self._receiver.recv(64):
            if any(number in self._numbers for number in received):
                for context in _context._contexts_to_shut():
                    context._shutdown_by_signal()
            while self._late:
                number = self._late.pop()
                time.sleep(LATER_S)
                main = threading.main_thread().ident
                if main is not None and not self._removed:
                    signal.pthread_kill(main, number)
            if self._descriptor_before >= 0:
                with contextlib.suppress(OSError):  # its owner may have closed it
                    os.write(self._descriptor_before, received)

    def remove(self) -> None:
        """Put back what was there before."""
        self._removed = True
        for number, before in self._before.items():
            # somebody else's handler stays
            if signal.getsignal(number) == self._handle:
                signal.signal(number, signal.SIG_DFL if before is None else before)
        if signal.set_wakeup_fd(self._descriptor_before) not in (-1, self._sender.fileno()):
            raise RuntimeError("the descriptor for signals was replaced while rclpy was using it")
        self._sender.close()
        self._thread.join()
        self._receiver.close()


_installed: _Handlers | None = None


def install_signal_handlers(options: SignalHandlerOptions = SignalHandlerOptions.ALL) -> None:
    """Install the handlers that shut all contexts down. Those before them are called as well.

    Python lets only the main thread install handlers; elsewhere this does nothing.

    Args:
        options: Which signals are handled.
    """
    global _installed
    if threading.current_thread() is not threading.main_thread():
        return
    if _installed is not None:
        if _installed.options == options:
            return
        uninstall_signal_handlers()
    if options != SignalHandlerOptions.NO:
        _installed = _Handlers(options)


def get_current_signal_handlers_options() -> SignalHandlerOptions:
    """Return which signals are handled.

    Returns:
        SignalHandlerOptions: As they were installed.
    """
    return SignalHandlerOptions.NO if _installed is None else _installed.options


def uninstall_signal_handlers() -> None:
    """Put the handlers back that were there before."""
    global _installed
    if _installed is None or threading.current_thread() is not threading.main_thread():
        return
    handlers, _installed = _installed, None
    handlers.remove()


class SignalHandlerGuardCondition(GuardCondition):
    """A guard condition that a signal triggers.

    Args:
        context: The context it belongs to; the default one where not given.
    """

    def __init__(self, context: Any = None) -> None:
        super().__init__(callback=None, callback_group=None, context=context)
        self._waker: Callable[[], None] = self.trigger
        self._context._add_waker(self._waker)

    def destroy(self) -> None:
        """Make the condition unusable."""
        self._context._remove_waker(self._waker)
        super().destroy()
