# SPDX-License-Identifier: Apache-2.0
"""The compiler of the kernels, which says so when it has work: the first time, and once only.

Kernels take `njit` from here. What is compiled is kept on disk, so that a message comes at the
first start on a machine and after an update; it goes to the log (`pneu_common.log`).
"""

import logging
import threading
import time
from typing import Any

from numba import njit
from numba.core import event

__all__ = ["njit"]

WORTH_TELLING_S = 5.0


class _Compilations(event.Listener):
    """Says when compiling begins, for the first time, and how long a kernel that took long took."""

    def __init__(self) -> None:
        self._log = logging.getLogger(__name__)
        self._depth = threading.local()
        self._told = False

    def on_start(self, event: Any) -> None:
        depth = getattr(self._depth, "value", 0)
        self._depth.value = depth + 1
        if depth == 0:
            self._depth.begun_s = time.monotonic()
            if not self._told:
                self._told = True
                self._log.info(
                    "compiling the numerical kernels for this machine: half a minute to two,"
                    " once; they are kept"
                )

    def on_end(self, event: Any) -> None:
        self._depth.value -= 1
        took_s = time.monotonic() - self._depth.begun_s
        if self._depth.value == 0 and took_s > WORTH_TELLING_S:
            name = event.data["dispatcher"].py_func.__name__
            self._log.info(f"compiled {name!r} in {took_s:.0f} s")


event.register("numba:compile", _Compilations())
