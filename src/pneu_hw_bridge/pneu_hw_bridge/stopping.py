# SPDX-License-Identifier: Apache-2.0
"""`pneu stop`: an emergency stop of all bridges, of this machine first and without the graph.

Each bridge listens on a datagram socket of its own in one folder, whatever its user, domain and
namespace. A word there is at the valve within milliseconds, while joining the graph takes seconds;
bridges of other machines are called by their service afterwards. This file imports little: half of
the time that a person waits is spent on imports.
"""

import contextlib
import json
import os
import socket
import tempfile
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

FOLDER_VARIABLE = "PNEU_RUN_DIR"
"""Environment variable that names another folder."""

ANSWER_WITHIN_S = 0.5
LONGEST_MESSAGE = 4096


def run_folder(environment: Mapping[str, str] = os.environ) -> Path:
    """Returns the folder of the sockets.

    Args:
        environment: The variable ``PNEU_RUN_DIR`` is read.
    """
    return Path(environment.get(FOLDER_VARIABLE) or Path(tempfile.gettempdir()) / "pneu-bridges")


class StopListener:
    """A bridge's ear: a thread that does nothing but wait for a stop."""

    def __init__(self, name: str, stop: Callable[[Mapping[str, Any]], Mapping[str, Any]]) -> None:
        """Begins to listen.

        Args:
            name: Full name of the bridge.
            stop: Called with what is asked, in the thread; returns the answer. An empty one is not
                sent.

        Raises:
            OSError: The socket cannot be made.
        """
        where = run_folder()
        with contextlib.suppress(FileExistsError):
            where.mkdir(parents=True)
            where.chmod(0o1777)  # whoever sees an accident may stop it
        self._stop, self._closing = stop, False
        self.path = where / f"{os.getpid()}{name.replace('/', '.')}.sock"
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        with contextlib.suppress(FileNotFoundError):
            self.path.unlink()
        self._socket.bind(str(self.path))
        self.path.chmod(0o666)
        self._thread = threading.Thread(target=self._listen, name="stop", daemon=True)
        self._thread.start()

    def _listen(self) -> None:
        while True:
            try:
                message, sender = self._socket.recvfrom(LONGEST_MESSAGE)
            except OSError:
                return
            if self._closing:
                return
            try:
                asked = json.loads(message)
            except (ValueError, RecursionError):
                asked = {}  # whatever it was, somebody called
            answer = self._stop(asked if isinstance(asked, dict) else {})
            if sender and answer:
                with contextlib.suppress(OSError):
                    self._socket.sendto(json.dumps(dict(answer)).encode(), sender)

    def close(self) -> None:
        """Ends listening."""
        self._closing = True
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()
        with contextlib.suppress(OSError):
            self.path.unlink()


def call_all(message: Mapping[str, Any], but: Path | None = None, answer_to: Any = None) -> int:
    """Sends a message to all bridges of this machine; returns how many there are.

    Args:
        message: The message.
        but: The socket of the bridge that is not to get it.
        answer_to: A bound socket that takes the answers; None wants none.
    """
    found = 0
    text = json.dumps(dict(message)).encode()
    with contextlib.ExitStack() as stack:
        sender = answer_to
        if sender is None:
            sender = stack.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM))
        sender.setblocking(False)
        for path in sorted(run_folder().glob("*.sock")):
            if path == but:
                continue
            try:
                sender.sendto(text, str(path))
                found += 1
            except ConnectionRefusedError:  # its bridge was killed
                with contextlib.suppress(OSError):
                    path.unlink()
            except BlockingIOError:  # it has more calls than it can take: it will stop
                found += 1
            except OSError:
                continue
    return found


def stop_here(reason: str) -> tuple[list[dict[str, Any]], int]:
    """Stops all bridges of this machine.

    Args:
        reason: Who calls for it.

    Returns:
        The answers, and how many bridges gave none in time.
    """
    answers: list[dict[str, Any]] = []
    with (
        tempfile.TemporaryDirectory(prefix="pneu-stop-") as folder,
        socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as ours,
    ):
        ours.bind(f"{folder}/answers")
        os.chmod(folder, 0o711)
        os.chmod(f"{folder}/answers", 0o666)
        expected = call_all({"reason": reason}, answer_to=ours)
        end_s = time.monotonic() + ANSWER_WITHIN_S
        while len(answers) < expected and (left_s := end_s - time.monotonic()) > 0.0:
            ours.settimeout(left_s)
            with contextlib.suppress(TimeoutError, ValueError, RecursionError):
                answers.append(json.loads(ours.recv(LONGEST_MESSAGE)))
    return answers, expected - len(answers)
