# SPDX-License-Identifier: Apache-2.0
"""The socket on which a bridge takes stops, with whatever a local process may send there."""

import itertools
import json
import queue
import socket

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from pneu_hw_bridge.stop_command import at_once
from pneu_hw_bridge.stopping import LONGEST_MESSAGE, StopListener, call_all

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
    assert call_all({"reason": "smoke"}) == 1
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
        assert call_all({"reason": "smoke"}) == 2
        assert asked.get(timeout=10.0) == {"reason": "smoke"}
        assert sorted(tmp_path.glob("? *.sock")) == [
            tmp_path / "b busy.sock",
            tmp_path / "c odd.sock",
        ]
        assert call_all({"reason": "fire"}, but=tmp_path / "b busy.sock") == 1


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
        "NOT CONFIRMED: 1 bridges of this machine gave no answer",
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
    assert call_all({}) == 0
