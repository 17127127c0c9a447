# SPDX-License-Identifier: Apache-2.0
"""The socket on which a bridge takes stops, with whatever a local process may send there."""

import itertools
import json
import queue
import socket

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

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


def test_a_closed_listener_leaves_no_socket(listening):
    listener, _ = listening
    listener.close()
    listener._thread.join(10.0)
    assert not listener._thread.is_alive()
    assert not listener.path.exists()
    assert call_all({}) == 0
