# SPDX-License-Identifier: Apache-2.0
"""The Net F/T box's protocol, by the bytes of its manual, and what becomes of packets."""

import socket
import struct
import time
from collections.abc import Iterator

import pytest

from pneu_common.errors import InputError
from pneu_hw_bridge.hand_lab.box import Box
from pneu_hw_bridge.phantom import rdt
from pneu_hw_bridge.phantom.net_ft import NetFt, read_calibration
from pneu_sim.hand.settings import WrenchSettings

pytestmark = pytest.mark.realtime

SENSOR = WrenchSettings(force="f", torque="t", counts_per_n=1000.0, counts_per_n_m=20000.0)


@pytest.fixture
def box() -> Iterator[Box]:
    box = Box(SENSOR, port=0)
    yield box
    box.close()


def fed(client: NetFt, box: Box, first: int, count: int, now_s: float = 0.0) -> list[rdt.Record]:
    """Has a client ask, and the box send samples; returns what is taken."""
    out = client.poll(now_s)
    box.poll()
    for sample in range(first, first + count):
        box.send(sample, [0.5, -1.0, 2.0, 0.01, 0.0, -0.02])
        out += client.poll(now_s)
    return out


def test_a_request_and_a_record_are_the_manuals_bytes(box: Box) -> None:
    assert rdt.request(rdt.START) == bytes.fromhex("1234 0002 00000000")
    assert rdt.request(rdt.STOP) == bytes.fromhex("1234 0000 00000000")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asker:
        asker.settimeout(2.0)
        asker.sendto(bytes.fromhex("1234000200000001"), ("127.0.0.1", box.port))
        time.sleep(0.01)
        box.poll()
        box.send(7, [0.5, -1.0, 2.0, 0.01, 0.0, -0.02])
        box.send(8, [0.0] * 6)  # one was asked for
        packet = asker.recv(100)
        asker.setblocking(False)
        with pytest.raises(BlockingIOError):
            asker.recv(100)
    assert len(packet) == 36
    numbers = struct.unpack(">3I6i", packet)
    assert numbers == (1, 7, 0, 500, -1000, 2000, 200, 0, -400)


def test_the_page_tells_what_counts_mean(box: Box) -> None:
    told = read_calibration("127.0.0.1", box.web_port)
    assert (told.counts_per_n, told.counts_per_n_m, told.rate_hz) == (1000.0, 20000.0, 1000.0)
    with pytest.raises(InputError, match="cannot be read"):
        read_calibration("127.0.0.1", 9, timeout_s=0.5)


def test_a_stream_is_taken_whole(box: Box) -> None:
    client = NetFt("127.0.0.1", box.port)
    records = fed(client, box, 100, 50)
    assert [r.sample for r in records] == list(range(100, 150))
    assert client.received.records == 50
    assert client.received.lost == client.received.repeated == 0
    client.close()
    box.poll()
    box.send(0, [0.0] * 6)  # to nobody


@pytest.mark.parametrize(
    ("fault", "told"),
    [
        ("lost", {"records": 10, "lost": 9, "malformed": 0}),
        ("repeated", {"records": 20, "repeated": 20}),
        ("short", {"records": 0, "malformed": 20}),
        ("silent", {"records": 0, "malformed": 0}),
    ],
)
def test_what_becomes_of_packets_is_counted(box: Box, fault: str, told: dict[str, int]) -> None:
    client = NetFt("127.0.0.1", box.port)
    box.fault = fault
    fed(client, box, 0, 20)
    for name, value in told.items():
        assert getattr(client.received, name) == value, name
    client.close()


def test_a_stream_that_ended_is_asked_for_again(box: Box) -> None:
    client = NetFt("127.0.0.1", box.port)
    fed(client, box, 0, 5, now_s=0.0)
    client.poll(0.02)
    assert client.received.asked == 1
    client.poll(0.06)
    assert client.received.asked == 2
    client.close()


def test_nobody_there_is_told() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    client = NetFt("127.0.0.1", port)
    client.poll(0.0)
    time.sleep(0.02)
    client.poll(0.001)
    assert "refused" in client.error.lower()
    client.close()


@pytest.mark.parametrize(
    ("status", "says"),
    [
        (0, ""),
        (0x8001_0000, ""),  # a condition that the user set
        (0x8002_0000, "transducer saturated"),
        (0x8010_0000, "RDT communication error"),
        (0xC000_0000, "processor or memory error"),
    ],
)
def test_status_words_are_read_as_the_manual_says(status: int, says: str) -> None:
    fault = rdt.Record(1, 1, status, (0, 0, 0, 0, 0, 0)).fault
    assert (says in fault) if says else fault == ""


def test_numbers_that_begin_anew_are_no_loss() -> None:
    client = NetFt("127.0.0.1", 1)
    assert client._new(0xFFFF_FFFE)
    assert client._new(0xFFFF_FFFF)
    assert client._new(0)
    assert client.received.lost == 0
    assert not client._new(0xFFFF_FFFF)
    assert client.received.late == 1
