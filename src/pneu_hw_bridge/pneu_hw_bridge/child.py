# SPDX-License-Identifier: Apache-2.0
"""A process beside a node, for what must not wait for the node: started, told, heard, and ended.

Both talk over a socket pair that keeps messages whole, of which each end knows at once when the
other has ended, however it did. Messages of plain values are JSON after the letter J; others are
the process's own.
"""

import contextlib
import itertools
import json
import socket
import subprocess
import threading
from collections.abc import Callable
from typing import Any

from pneu_common.children import python
from pneu_common.errors import InputError

JSON = b"J"
LONGEST = 1 << 16
"""Bytes of a message."""

OPENS_S = 8.0
"""A process that has not said anything after so long has failed."""
ANSWERS_S = 0.1
ENDS_S = 1.0

ROOM = 1 << 20
"""Bytes that may wait for the node."""


def packed(values: dict[str, Any]) -> bytes:
    """A message of plain values.

    Args:
        values: They.
    """
    return JSON + json.dumps(values).encode()


class Child:
    """The process, as its node sees it.

    Attributes:
        ended: Why it has ended; empty while it runs.
    """

    def __init__(
        self, module: str, settings: dict[str, Any], heard: Callable[[bytes], None]
    ) -> None:
        """Starts it and waits until it says that it is ready.

        Args:
            module: What it runs, with the number of its socket as argument. Its first message
                says ``ready``, or ``failed`` and why.
            settings: The first message it gets.
            heard: Called with each further message but answers, in a thread of its own; with
                nothing when it has ended by itself.

        Raises:
            InputError: It is not ready.
        """
        self.ended = ""
        self._heard = heard
        self._wanted = True
        self._answers: dict[int, dict[str, Any]] = {}
        self._answered = threading.Condition()
        self._numbers = itertools.count(1)
        self._sending = threading.Lock()
        self._link, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with contextlib.suppress(OSError):
            theirs.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, ROOM)
        with theirs:
            number = theirs.fileno()
            self._process = subprocess.Popen(
                python(module, str(number)),
                pass_fds=(number,),
                start_new_session=True,  # the terminal's signals are its node's, which ends it
            )
        try:
            self._link.send(packed(settings))
            self._link.settimeout(OPENS_S)
            first = self._link.recv(LONGEST)
        except OSError as error:
            self._kill()
            raise InputError(f"the process of {module} does not answer: {error}") from None
        self._link.settimeout(None)
        answer = json.loads(first[1:]) if first else {"failed": f"{module} ended at its start"}
        if "failed" in answer:
            self._kill()
            raise InputError(answer["failed"])
        self._thread = threading.Thread(target=self._listen, name="child", daemon=True)
        self._thread.start()

    @property
    def pid(self) -> int:
        """Number of the process."""
        return self._process.pid

    def send(self, message: bytes) -> None:
        """Sends a message.

        Args:
            message: The message.
        """
        with self._sending, contextlib.suppress(OSError):  # that it has ended is heard
            self._link.send(message)

    def tell(self, **values: Any) -> None:
        """Tells it something that needs no answer.

        Args:
            **values: What.
        """
        self.send(packed(values))

    def ask(self, **values: Any) -> dict[str, Any]:
        """Tells it something, and waits for what it says; from any thread but its own.

        Args:
            **values: What.

        Returns:
            Its answer; empty where none came in time.
        """
        number = next(self._numbers)
        self.send(packed(values | {"answer": number}))
        with self._answered:
            self._answered.wait_for(lambda: number in self._answers or bool(self.ended), ANSWERS_S)
            return self._answers.pop(number, {})

    def end(self) -> None:
        """Ends it, in good order where it still can."""
        self._wanted = False
        if not self.ended:
            self.tell(end=True)
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(ENDS_S)
        self._kill()
        if threading.current_thread() is not self._thread:
            self._thread.join(ENDS_S)

    def _kill(self) -> None:
        with contextlib.suppress(OSError):
            self._link.shutdown(socket.SHUT_RDWR)
        if self._process.poll() is None:
            self._process.kill()
        self._process.wait()
        self._link.close()

    def _listen(self) -> None:
        while True:
            try:
                message = self._link.recv(LONGEST)
            except OSError:
                message = b""
            if not message:
                break
            if message[:1] == JSON and b'"answer"' in message:
                told = json.loads(message[1:])
                with self._answered:
                    self._answers[told["answer"]] = told
                    self._answered.notify_all()
            elif self._wanted:
                self._heard(message)
        with self._answered:
            self.ended = self.ended or "its process has ended"
            self._answered.notify_all()
        if self._wanted:
            self._heard(b"")
