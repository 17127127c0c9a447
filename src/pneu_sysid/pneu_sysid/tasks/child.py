# SPDX-License-Identifier: Apache-2.0
"""A process that is spoken with in lines of JSON, at either end.

Whoever starts it says what it wants on its standard input, and hears of it from a thread; the
process answers on its standard output, and ends when its input does.
"""

import json
import subprocess
import sys
import threading
from collections.abc import Callable
from typing import Any

from pneu_common.children import python

GRACE_S = 2.0
"""Seconds that a process has to end by itself when it is told to."""

Say = Callable[[dict[str, Any]], None]


class Child:
    """A module that runs as a process of its own."""

    def __init__(
        self, module: str, first: dict[str, Any], heard: Say, gone: Callable[[int, bool], object]
    ) -> None:
        """Starts it.

        Args:
            module: Its name.
            first: The first line that it reads.
            heard: Called from a thread with each answer, also with one on its way when it is ended.
            gone: Called once from that thread, with its exit status and whether it was told to end.
        """
        self._heard, self._gone = heard, gone
        self._told = False
        self._process = subprocess.Popen(
            python(module),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            # A Ctrl-C meant for whoever started it reaches it through `end`, not by itself.
            start_new_session=True,
        )
        self.say(first)
        self._thread = threading.Thread(target=self._listen, name=module, daemon=True)
        self._thread.start()

    @property
    def pid(self) -> int:
        """Number of the process."""
        return self._process.pid

    def say(self, line: dict[str, Any]) -> None:
        """Writes it a line.

        Args:
            line: What.
        """
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps(line) + "\n")
            self._process.stdin.flush()
        except (BrokenPipeError, ValueError):  # it died; the thread finds out how
            pass

    def end(self) -> None:
        """Ends it; `gone` hears of it. Does not wait."""
        self._told = True
        self._process.terminate()

    def wait(self) -> None:
        """Waits until all is over; not from the thread that would have to end first."""
        if threading.current_thread() is not self._thread:
            self._thread.join()

    def _listen(self) -> None:
        assert self._process.stdin is not None and self._process.stdout is not None
        for line in self._process.stdout:
            try:
                answer = json.loads(line)
            except json.JSONDecodeError:  # cut off by `end`
                continue
            self._heard(answer)
        try:
            status = self._process.wait(GRACE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            status = self._process.wait()
        self._process.stdin.close()
        self._process.stdout.close()
        self._gone(status, self._told)


def answering() -> Say:
    """In such a process: what answers. All else that is printed goes to standard error."""
    answers = sys.stdout
    sys.stdout = sys.stderr  # what a library prints must not come between the answers

    def say(line: dict[str, Any]) -> None:
        print(json.dumps(line), file=answers, flush=True)

    return say
