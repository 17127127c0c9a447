# SPDX-License-Identifier: Apache-2.0
"""Precedence over ordinary processes, for those whose delays would falsify what they measure."""

import contextlib
import ctypes
import os
from collections.abc import Iterator

NICENESS = -11
"""Well before ordinary work, yet not such that a runaway thread could lock a machine up."""


@contextlib.contextmanager
def precedence() -> Iterator[bool]:
    """Has the system run this thread, and those it starts meanwhile, before ordinary processes.

    Yields:
        Whether it does; without the privilege all stays as it is.
    """
    before = os.getpriority(os.PRIO_PROCESS, 0)
    try:
        os.setpriority(os.PRIO_PROCESS, 0, NICENESS)
    except PermissionError:
        yield False
        return
    try:
        yield True
    finally:
        os.setpriority(os.PRIO_PROCESS, 0, before)


PR_SET_TIMERSLACK = 29


def punctual() -> None:
    """Has the system wake this thread as exactly as it can."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(PR_SET_TIMERSLACK, 1, 0, 0, 0)
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))
