# SPDX-License-Identifier: Apache-2.0
"""No process outlives the launch that started it, not even where the launch is killed with -9.

On Linux the kernel sends SIGTERM to each process when the launch dies, so that a node can bring its
valves into the safe state. A small process beside the launch kills what is still there afterwards.
"""

import contextlib
import ctypes
import os
import signal
import socket
import sys
import time
from collections.abc import Callable

GRACE_S = 3.0
"""Time from SIGTERM to SIGKILL after the launch has died, s."""

_PR_SET_PDEATHSIG = 1


def on_death_of_parent() -> Callable[[], None] | None:
    """Returns what a child runs before its program, so that it gets SIGTERM when we die.

    None where the system has no such signal.
    """
    if not sys.platform.startswith("linux"):
        return None
    libc = ctypes.CDLL(None)  # loaded here, because a forked child should load nothing
    parent = os.getpid()

    def ask() -> None:
        libc.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
        if os.getppid() != parent:  # it died before we could ask
            os._exit(1)

    return ask


class Guard:
    """A process that waits for our end and then kills the process groups we had.

    It holds the reading ends of their output, and empties them when we are gone: a node that
    brings its valves into the safe state must not die of a line it logs meanwhile.
    """

    def __init__(self) -> None:
        watching, self._ours = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._pid = os.fork()
        if self._pid == 0:
            try:
                self._ours.close()
                _watch(watching)
            finally:
                os._exit(0)
        watching.close()

    def add(self, group: int, outputs: list[int]) -> None:
        """Takes a process group under guard.

        Args:
            group: Its number.
            outputs: Descriptors from which its output is read.
        """
        socket.send_fds(self._ours, [f"+{group}".encode()], outputs)

    def remove(self, group: int) -> None:
        """Releases a process group that has ended.

        Args:
            group: Its number.
        """
        self._ours.send(f"-{group}".encode())

    def close(self) -> None:
        """Ends the guard; what it still has is killed."""
        self._ours.close()
        os.waitpid(self._pid, 0)


def _watch(channel: socket.socket) -> None:
    os.setsid()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    nowhere = os.open(os.devnull, os.O_RDWR)
    for descriptor in range(3):  # a pipe behind our output must see its end when the launch dies
        os.dup2(nowhere, descriptor)
    groups: dict[int, list[int]] = {}
    while True:
        message, outputs, _, _ = socket.recv_fds(channel, 64, 8)
        if not message:
            break
        group = int(message[1:])
        if message[:1] == b"+":
            groups[group] = outputs
        else:
            for output in groups.pop(group, []):
                os.close(output)
    for output in [output for outputs in groups.values() for output in outputs]:
        os.set_blocking(output, False)
    for number in (signal.SIGTERM, signal.SIGKILL):
        for group in groups:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(group, number)
        deadline = time.monotonic() + GRACE_S
        while groups and time.monotonic() < deadline:
            for group in [group for group in groups if not _lives(group)]:
                del groups[group]
            for output in [output for outputs in groups.values() for output in outputs]:
                with contextlib.suppress(BlockingIOError):
                    os.read(output, 65536)
            time.sleep(0.02)


def _lives(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except (ProcessLookupError, PermissionError):
        return False
    return True
