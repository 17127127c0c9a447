# SPDX-License-Identifier: Apache-2.0
"""`pneu stop`: an emergency stop of all bridges, of this machine first and without the graph.

Each bridge listens on a datagram socket in the folder of its user, whatever its domain and
namespace. A word there is at the valve within milliseconds, while joining the graph takes seconds;
all bridges are called by their service afterwards. Any datagram stops, whoever sends it and
whatever it holds. An answer counts only if it comes from the process that made the socket, by the
credentials that the kernel attaches, and if that process runs as this user, as root, or as a user
in ``PNEU_TRUSTED_USERS``. This file imports little: half of the time that a person waits is spent
on imports.
"""

import contextlib
import json
import os
import pwd
import socket
import stat
import struct
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pneu_common.text import one_line

FOLDER_VARIABLE = "PNEU_RUN_DIR"
"""Environment variable that names another folder."""
TRUSTED_VARIABLE = "PNEU_TRUSTED_USERS"
"""Environment variable with names of users, separated by commas, whose bridges are trusted."""

ANSWER_WITHIN_S = 0.5
LONGEST_MESSAGE = 4096
LONGEST_REASON = 200
SHARED = "pneu-bridges."
"""What the name of a user's folder begins with, in the folder for temporary files."""
CREDENTIALS = struct.Struct("3i")
"""Process, user and group of a sender, from the kernel."""


def run_folder(environment: Mapping[str, str] = os.environ) -> Path:
    """Return the folder of the sockets of this user.

    Args:
        environment: The variable ``PNEU_RUN_DIR`` is read.
    """
    given = environment.get(FOLDER_VARIABLE)
    return Path(given) if given else Path(tempfile.gettempdir()) / f"{SHARED}{os.getuid()}"


def _folders() -> Iterator[Path]:
    """Yield the folders of all users that nobody else can have put sockets into."""
    if os.environ.get(FOLDER_VARIABLE):
        yield run_folder()
        return
    for path in sorted(Path(tempfile.gettempdir()).glob(f"{SHARED}*")):
        with contextlib.suppress(OSError, ValueError):
            if not _misuse(path, int(path.name.removeprefix(SHARED))):
                yield path


def _misuse(path: Path, owner: int) -> str:
    """Return why a folder is not safe to listen in; empty where it is.

    Args:
        path: The folder.
        owner: Who it has to belong to, if not to root.
    """
    info = path.lstat()
    if not stat.S_ISDIR(info.st_mode):
        return "is no folder"
    if info.st_uid not in (owner, 0):
        return f"belongs to {_user(info.st_uid)}, not to {_user(owner)}"
    if info.st_mode & 0o022 and not info.st_mode & stat.S_ISVTX:
        return "can be changed by other users"
    return ""


def _user(uid: int) -> str:
    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return f"user {uid}"


def _trusted(uid: int) -> bool:
    """Return whether the answers of a user's bridges are trusted."""
    names = os.environ.get(TRUSTED_VARIABLE, "").split(",")
    return uid in (0, os.getuid()) or _user(uid) in names


class StopListener:
    """A bridge's ear: a thread that does nothing but wait for a stop."""

    def __init__(self, name: str, stop: Callable[[Mapping[str, Any]], Mapping[str, Any]]) -> None:
        """Begins to listen.

        Args:
            name: Full name of the bridge.
            stop: Called with what is asked, in the thread; returns the answer. An empty one is not
                sent.

        Raises:
            OSError: The socket cannot be made, or not where nobody else can replace it.
        """
        where = run_folder()
        with contextlib.suppress(FileExistsError):
            where.mkdir(parents=True)
            where.chmod(0o755)
        if why := _misuse(where, os.getuid()):
            raise OSError(f"{where} {why}; remove it, or name another folder by {FOLDER_VARIABLE}")
        self._name, self._stop, self._closing = name, stop, threading.Event()
        self.path = where / f"{os.getpid()}{name.replace('/', '.')}.sock"
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        with contextlib.suppress(FileNotFoundError):
            self.path.unlink()
        self._socket.bind(str(self.path))
        self.path.chmod(0o666)  # whoever sees an accident may stop it
        self._thread = threading.Thread(target=self._listen, name="stop", daemon=True)
        self._thread.start()

    @property
    def listening(self) -> bool:
        """Whether the thread runs and its socket is where callers look for it."""
        return self._thread.is_alive() and self.path.is_socket()

    def _listen(self) -> None:
        while not self._closing.is_set():
            try:
                message, sender = self._socket.recvfrom(LONGEST_MESSAGE)
            except OSError:
                if self._closing.is_set():
                    return
                time.sleep(0.01)  # whatever it was, the next call must be heard
                continue
            if self._closing.is_set():
                return
            try:
                asked = json.loads(message)
            except (ValueError, RecursionError):
                asked = {}  # whatever it was, somebody called
            asked = asked if isinstance(asked, dict) else {}
            try:
                answer = dict(self._stop(asked))
            except Exception as error:  # this thread has to outlive whatever a stop meets
                why = one_line(f"{type(error).__name__}: {error}", LONGEST_REASON)
                answer = {"bridge": self._name, "safe": False, "message": why}
            if sender and answer:
                with contextlib.suppress(OSError, ValueError):
                    self._socket.sendto(json.dumps(answer).encode(), sender)

    def close(self) -> None:
        """Ends listening."""
        self._closing.set()
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()
        with contextlib.suppress(OSError):
            self.path.unlink()


def call_all(
    message: Mapping[str, Any], but: Path | None = None, answer_to: Any = None
) -> list[Path]:
    """Send a message to all bridges of this machine; return the sockets that it reached.

    Args:
        message: The message.
        but: The socket of the bridge that is not to get it.
        answer_to: A bound socket that takes the answers; None wants none.
    """
    found = []
    text = json.dumps(dict(message)).encode()
    with contextlib.ExitStack() as stack:
        sender = answer_to
        if sender is None:
            sender = stack.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM))
        sender.setblocking(False)
        for path in (path for where in _folders() for path in sorted(where.glob("*.sock"))):
            if path == but:
                continue
            try:
                sender.sendto(text, str(path))
                found.append(path)
            except ConnectionRefusedError:  # its bridge was killed
                with contextlib.suppress(OSError):
                    path.unlink()
            except BlockingIOError:  # it has more calls than it can take: it will stop
                found.append(path)
            except OSError:
                continue
    return found


@dataclass(frozen=True)
class Answer:
    """What a bridge answered.

    Attributes:
        bridge: Its full name, or that of its socket.
        safe: Whether it is known to be safe.
        message: Why, or why that is not known.
    """

    bridge: str
    safe: bool
    message: str


def stop_here(reason: str) -> list[Answer]:
    """Stop all bridges of this machine, and return what is known of each that was called.

    Args:
        reason: Who calls for it.
    """
    message = {"reason": reason}
    with contextlib.ExitStack() as stack:
        ours = stack.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM))
        try:
            folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="pneu-stop-"))
            ours.bind(f"{folder}/answers")
            ours.setsockopt(socket.SOL_SOCKET, socket.SO_PASSCRED, 1)
            os.chmod(folder, 0o711)
            os.chmod(f"{folder}/answers", 0o666)
        except (OSError, AttributeError) as error:  # a full disk, or a kernel that names no sender
            why = one_line(f"its answer cannot be taken ({error})", LONGEST_REASON)
            return [Answer(one_line(path.name), False, why) for path in call_all(message)]
        # of a process, those of its sockets that have not answered
        left: dict[int, list[Path]] = {}
        for path in call_all(message, answer_to=ours):
            left.setdefault(_process_of(path), []).append(path)
        answers = []
        end_s = time.monotonic() + ANSWER_WITHIN_S
        while any(left.values()) and (left_s := end_s - time.monotonic()) > 0.0:
            ours.settimeout(left_s)
            try:
                text, sent_with, _, _ = ours.recvmsg(
                    LONGEST_MESSAGE, socket.CMSG_SPACE(CREDENTIALS.size)
                )
            except TimeoutError:
                break
            process, uid = _sender(sent_with)
            answer = _understood(text, uid)
            # an answer is of the process that made the socket, and of no more sockets than it has
            for path in left.get(process, []):
                if answer and path.name == _name_of(process, answer) and _owner(path) == uid:
                    left[process].remove(path)
                    answers.append(answer)
                    break
    for path in (path for paths in left.values() for path in paths):
        answers.append(Answer(one_line(path.name, LONGEST_REASON), False, "no answer"))
    return answers


def _owner(path: Path) -> int:
    """Return the user that a socket belongs to; -2 where it is gone."""
    try:
        return path.lstat().st_uid
    except OSError:
        return -2


def _process_of(path: Path) -> int:
    """Return the process that a socket is named for; 0 for none."""
    number = path.name.partition(".")[0]
    return int(number) if number.isascii() and number.isdigit() and len(number) < 12 else 0


def _name_of(process: int, answer: Answer) -> str:
    return f"{process}{answer.bridge.replace('/', '.')}.sock"


def _sender(sent_with: list[tuple[int, int, bytes]]) -> tuple[int, int]:
    """Return process and user of who sent a datagram; -1 where the kernel does not tell."""
    for level, kind, data in sent_with:
        if (level, kind) == (socket.SOL_SOCKET, socket.SCM_CREDENTIALS):
            process, uid, _ = CREDENTIALS.unpack(data[: CREDENTIALS.size])
            return process, uid
    return -1, -1


def _understood(message: bytes, uid: int) -> Answer | None:
    """Return an answer as far as its sender is trusted; None where it is none."""
    try:
        reply = json.loads(message)
    except (ValueError, RecursionError):
        return None
    if not isinstance(reply, dict) or not isinstance(reply.get("bridge"), str):
        return None
    bridge, said = (one_line(reply.get(key), LONGEST_REASON) for key in ("bridge", "message"))
    if not _trusted(uid):
        said = f"of {_user(uid)}, who is not in {TRUSTED_VARIABLE}, says: {said}"
        return Answer(bridge, False, said)
    return Answer(bridge, reply.get("safe") is True, said)
