# SPDX-License-Identifier: Apache-2.0
"""The socket on which a bridge takes stops, with whatever a local process may send there."""

import contextlib
import itertools
import json
import os
import pwd
import queue
import socket
import subprocess
import sys

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from pneu_hw_bridge import stopping
from pneu_hw_bridge.stop_command import at_once
from pneu_hw_bridge.stopping import LONGEST_MESSAGE, Answer, StopListener, call_all, stop_here

pytestmark = pytest.mark.kernel_free


@pytest.fixture
def listening(tmp_path, monkeypatch):
    """A listener that answers how often it was called, and a queue of what it was asked."""
    monkeypatch.setenv("PNEU_RUN_DIR", str(tmp_path))
    asked = queue.Queue()
    count = itertools.count(1)

    def stop(message):
        asked.put(dict(message))
        return {"calls": next(count)}

    listener = StopListener("/valve_bridge", stop)
    yield listener, asked
    listener.close()


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@example(b"")
@example(b"{")
@example(b"null")
@example(b"[1]")
@example(b"\xff\xfe")
@example(b"[" * LONGEST_MESSAGE)
@example(b"[" * 2 * LONGEST_MESSAGE)
@given(st.binary(max_size=100))
def test_a_datagram_of_any_content_stops_and_leaves_the_socket_open(listening, datagram):
    listener, asked = listening
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
        sender.sendto(datagram, str(listener.path))
    assert asked.get(timeout=10.0) == {}
    assert call_all({"reason": "smoke"}) == [listener.path]
    assert asked.get(timeout=10.0) == {"reason": "smoke"}


def test_the_answer_goes_to_a_caller_that_has_an_address(listening, tmp_path):
    listener, _ = listening
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
        sender.bind(str(tmp_path / "caller"))
        sender.settimeout(10.0)
        for calls in (1, 2):
            sender.sendto(b'{"reason": "smoke"}', str(listener.path))
            assert json.loads(sender.recv(LONGEST_MESSAGE)) == {"calls": calls}


def test_each_socket_that_a_call_reaches_counts_and_a_dead_one_is_taken_away(
    listening, tmp_path, capsys
):
    """One that has more calls than it can take stops as well; a stranger's is left alone."""
    _, asked = listening
    kinds = {"a dead": socket.SOCK_DGRAM, "b busy": socket.SOCK_DGRAM, "c odd": socket.SOCK_STREAM}
    made = {name: socket.socket(socket.AF_UNIX, kind) for name, kind in kinds.items()}
    for name, one in made.items():
        one.bind(str(tmp_path / f"{name}.sock"))
    made["a dead"].close()
    with made["b busy"], made["c odd"], socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as many:
        many.setblocking(False)
        with pytest.raises(BlockingIOError):
            while True:
                many.sendto(b"{}", str(tmp_path / "b busy.sock"))
        assert len(call_all({"reason": "smoke"})) == 2
        assert asked.get(timeout=10.0) == {"reason": "smoke"}
        assert sorted(tmp_path.glob("? *.sock")) == [
            tmp_path / "b busy.sock",
            tmp_path / "c odd.sock",
        ]
        assert len(call_all({"reason": "fire"}, but=tmp_path / "b busy.sock")) == 1


def test_a_bridge_that_gives_no_answer_is_not_confirmed(tmp_path, monkeypatch, capsys):
    """Those that answer are told of, and the exit status is that of the worst."""
    monkeypatch.setenv("PNEU_RUN_DIR", str(tmp_path))
    answers = [
        {"bridge": "/near/valve_bridge", "safe": True, "message": "vented"},
        {"bridge": "/far/valve_bridge", "safe": False, "message": "no connection"},
    ]
    asked = []

    def listen(answer):
        return StopListener(answer["bridge"], lambda message: asked.append(message) or answer)

    near = listen(answers[0])
    assert at_once(["--local", "--reason", "smoke"]) == 0
    assert asked == [{"reason": "smoke"}]
    assert capsys.readouterr().out == "/near/valve_bridge: safe, vented\n"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as mute:
        mute.bind(str(tmp_path / "mute.sock"))
        assert at_once(["--local"]) == 1
    (tmp_path / "mute.sock").unlink()
    assert asked[1] == {"reason": "pneu stop"}
    assert capsys.readouterr().out.splitlines() == [
        "/near/valve_bridge: safe, vented",
        "mute.sock: NOT CONFIRMED, no answer",
    ]
    far = listen(answers[1])
    assert at_once(["--local"]) == 1
    assert sorted(capsys.readouterr().out.splitlines()) == [
        "/far/valve_bridge: NOT CONFIRMED, no connection",
        "/near/valve_bridge: safe, vented",
    ]
    near.close()
    far.close()


def test_a_closed_listener_leaves_no_socket(listening):
    listener, _ = listening
    listener.close()
    listener._thread.join(10.0)
    assert not listener._thread.is_alive()
    assert not listener.path.exists()
    assert call_all({}) == []


FOREIGN = """
import json, os, socket, sys
out = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
out.bind(sys.argv[1].replace("PID", str(os.getpid())))
if len(sys.argv) > 3:
    os.setuid(int(sys.argv[3]))
print("ready", flush=True)
while True:
    _, sender = out.recvfrom(4096)
    for _ in range(3):
        out.sendto(sys.argv[2].encode(), sender)
"""
SAFE = json.dumps({"bridge": "/valve_bridge", "safe": True, "message": "read back voltage 0 V"})


@contextlib.contextmanager
def foreign(*words):
    """A process that answers calls with what it is given."""
    command = [sys.executable, "-P", "-c", FOREIGN, *map(str, words)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "ready\n"
        try:
            yield process
        finally:
            process.kill()


@pytest.mark.parametrize(
    ("name", "answer"),
    [
        ("0.sock", SAFE),
        ("99999.valve_bridge.sock", SAFE),  # of a process that it is not
        ("PID.other.sock", SAFE),  # of a bridge that it is not
        ("PID.valve_bridge.sock", "[]"),
        ("PID.valve_bridge.sock", "[" * 4000),
        ("PID.valve_bridge.sock", SAFE.replace("true", '"yes"')),
        ("PID.valve_bridge.sock", SAFE.replace("true", "1")),
    ],
)
def test_who_did_not_make_a_socket_does_not_answer_for_it(tmp_path, monkeypatch, name, answer):
    """Nor for another bridge, which is silent: its answers are not counted for that."""
    monkeypatch.setenv("PNEU_RUN_DIR", str(tmp_path))
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as silent:
        silent.bind(str(tmp_path / f"{os.getpid()}.valve_bridge.sock"))
        with foreign(tmp_path / name, answer):
            answers = stop_here("smoke")
    assert len(answers) == 2 and not any(one.safe for one in answers)


def test_a_bridge_is_believed_in_spite_of_a_liar_beside_it(tmp_path, monkeypatch):
    monkeypatch.setenv("PNEU_RUN_DIR", str(tmp_path))
    truth = {"bridge": "/valve_bridge", "safe": False, "message": "no connection"}
    listener = StopListener("/valve_bridge", lambda message: truth)
    with foreign(tmp_path / "0.sock", SAFE):
        answers = stop_here("smoke")
    listener.close()
    assert Answer("/valve_bridge", False, "no connection") in answers
    assert not any(one.safe for one in answers)


@pytest.mark.skipif(os.getuid() != 0, reason="only root can be several users")
def test_a_user_who_is_not_trusted_is_not_believed(tmp_path, monkeypatch):
    monkeypatch.setenv("PNEU_RUN_DIR", str(tmp_path))
    tmp_path.chmod(0o755)
    other = pwd.getpwnam("nobody").pw_uid
    monkeypatch.setattr(stopping.os, "getuid", lambda: 4242)  # who is not root either
    for trusted, safe in (("", False), ("lab,nobody", True)):
        monkeypatch.setenv("PNEU_TRUSTED_USERS", trusted)
        path = tmp_path / "PID.valve_bridge.sock"
        with foreign(path, SAFE, other) as process:
            made = tmp_path / f"{process.pid}.valve_bridge.sock"
            os.chown(made, other, other)
            (answer,) = stop_here("smoke")
        made.unlink()
        assert answer.safe is safe and answer.bridge == "/valve_bridge"
        assert safe or "nobody, who is not in PNEU_TRUSTED_USERS" in answer.message


def test_a_bridge_does_not_listen_where_others_can_replace_its_socket(tmp_path, monkeypatch):
    def listen(where):
        monkeypatch.setenv("PNEU_RUN_DIR", str(where))
        StopListener("/valve_bridge", lambda message: {}).close()

    listen(tmp_path / "new" / "folder")
    assert (tmp_path / "new" / "folder").stat().st_mode & 0o777 == 0o755
    (tmp_path / "open").mkdir()
    (tmp_path / "open").chmod(0o777)
    with pytest.raises(OSError, match="open can be changed by other users; remove it, or name"):
        listen(tmp_path / "open")
    (tmp_path / "link").symlink_to(tmp_path / "new")
    with pytest.raises(OSError, match="is no folder"):
        listen(tmp_path / "link")
    monkeypatch.setattr(stopping.os, "getuid", lambda: 4242)
    (tmp_path / "of another").mkdir()
    os.chown(tmp_path / "of another", 4343 if os.geteuid() == 0 else -1, -1)
    with pytest.raises(OSError, match=r"of another belongs to .*, not to user 4242"):
        listen(tmp_path / "of another")


def test_folders_of_all_users_are_called_but_those_that_are_not_their_own(tmp_path, monkeypatch):
    monkeypatch.delenv("PNEU_RUN_DIR", raising=False)
    monkeypatch.setattr(stopping.tempfile, "gettempdir", lambda: str(tmp_path))
    mine = StopListener("/mine", lambda message: {})
    assert mine.path.parent == tmp_path / f"pneu-bridges.{os.getuid()}"
    for name in ("pneu-bridges.4242", "pneu-bridges.x", "pneu-bridges."):
        if name.endswith("4242") and os.geteuid() != 0:
            continue
        (tmp_path / name).mkdir()
        os.chown(tmp_path / name, 4343 if os.geteuid() == 0 else -1, -1)
    (tmp_path / "pneu-bridges.4243").symlink_to(mine.path.parent)
    made = []
    for folder in tmp_path.glob("pneu-bridges.*"):
        if not folder.is_symlink() and folder != mine.path.parent:
            made.append(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM))
            made[-1].bind(str(folder / "1.sock"))
    assert call_all({}) == [mine.path]
    mine.close()
    for one in made:
        one.close()


@pytest.mark.parametrize("error", [RecursionError(), ValueError("\ud800 \x1b[31m")])
def test_a_stop_that_fails_is_not_confirmed_and_the_next_is_heard(tmp_path, monkeypatch, error):
    monkeypatch.setenv("PNEU_RUN_DIR", str(tmp_path))

    def stop(message):
        raise error

    listener = StopListener("/valve_bridge", stop)
    for _ in range(2):
        (answer,) = stop_here("smoke")
        assert (answer.bridge, answer.safe) == ("/valve_bridge", False)
        assert answer.message.startswith(type(error).__name__) and answer.message.isprintable()
    assert listener.listening
    listener.path.unlink()
    assert not listener.listening
    listener.close()


@pytest.mark.parametrize("lost", ["room for the answers", "the credentials", "the socket"])
def test_a_bridge_is_stopped_although_its_answer_cannot_be_taken(tmp_path, monkeypatch, lost):
    monkeypatch.setenv("PNEU_RUN_DIR", str(tmp_path))
    stopped = queue.Queue()

    def stop(message):
        stopped.put(dict(message))
        if lost == "the socket":  # a bridge that ends at once
            listener.path.unlink()
        return {"bridge": "/valve_bridge", "safe": True, "message": "vented"}

    listener = StopListener("/valve_bridge", stop)
    if lost == "room for the answers":

        def full(**names):
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(stopping.tempfile, "TemporaryDirectory", full)
    elif lost == "the credentials":
        monkeypatch.delattr(stopping.socket, "SO_PASSCRED")
    (answer,) = stop_here("smoke")
    assert stopped.get(timeout=10.0) == {"reason": "smoke"} and not answer.safe
    listener.close()
