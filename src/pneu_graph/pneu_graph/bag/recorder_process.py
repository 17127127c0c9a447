# SPDX-License-Identifier: Apache-2.0
"""`pneu bag record` as a process of its own, begun and ended by whoever runs a rig."""

import signal
import subprocess
import threading
from collections.abc import Callable
from pathlib import Path

from pneu_common.entry import COMMAND

END_S = 15.0
"""A recorder that takes longer to write its bag is killed; what it wrote can be recovered."""


class Recorder:
    """A bag that is being recorded.

    Attributes:
        bag: Its folder.
    """

    def __init__(self, bag: Path, rig: str) -> None:
        """Begins with all topics.

        Args:
            bag: Folder of the bag; it must be new.
            rig: Rig file that is kept in it; empty is none.
        """
        self.bag = bag
        words = [*COMMAND, "bag", "record", "-a", "-o", str(bag)]
        words += ["--attach", rig] if rig else []
        self._process = subprocess.Popen(
            words, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            start_new_session=True,
        )  # fmt: skip

    def end(self, then: Callable[[bool], None]) -> None:
        """Ends it; does not wait.

        Args:
            then: Called from a thread, once the bag is whole, with whether there is one.
        """
        self._process.send_signal(signal.SIGINT)

        def wait() -> None:
            try:
                self._process.wait(END_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
            then(self.bag.exists())

        threading.Thread(target=wait, daemon=True).start()

    def end_and_wait(self) -> bool:
        """Ends it, waits until the bag is whole, and returns whether there is one."""
        ended, there = threading.Event(), []

        def told(is_there: bool) -> None:
            there.append(is_there)
            ended.set()

        self.end(told)
        ended.wait()
        return there[0]

    @property
    def ended(self) -> bool:
        """Whether the process has ended, by itself or not."""
        return self._process.poll() is not None
