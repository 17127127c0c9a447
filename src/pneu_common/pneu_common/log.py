# SPDX-License-Identifier: Apache-2.0
"""What the packages log about themselves, such as that kernels are compiled, and who shows it.

A program that imports the library hears of it by the usual means of `logging`; the `pneu` command,
the nodes and the tasks of the identification hand it on to where their users look.
"""

import logging
from collections.abc import Callable

LOG = "pneu"
"""Name of the log, at level INFO."""


class _HandedOn(logging.Handler):
    """Calls somebody with each message."""

    def __init__(self, say: Callable[[str], object]) -> None:
        super().__init__()
        self._say = say

    def emit(self, record: logging.LogRecord) -> None:
        self._say(record.getMessage())


def hand_on(say: Callable[[str], object]) -> None:
    """Has messages told, unless this process tells them already.

    Args:
        say: Called with each message.
    """
    log = logging.getLogger(LOG)
    if not log.handlers:
        log.setLevel(logging.INFO)
        log.addHandler(_HandedOn(say))
