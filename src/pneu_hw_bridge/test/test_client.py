# SPDX-License-Identifier: Apache-2.0
"""One connection against devices that answer by a script: what is believed, and what is not."""

import asyncio
import os
import struct
import tty
from contextlib import asynccontextmanager, contextmanager
from types import SimpleNamespace

import pytest
from pymodbus.framer.rtu import FramerRTU

from pneu_hw_bridge.modbus.client import LEAST_PATIENCE_S, PATIENCE, Client, RequestError
from pneu_hw_bridge.modbus.statistics import Statistics
from pneu_hw_bridge.registers.batches import Batch
from pneu_hw_bridge.registers.schema import Device

pytestmark = pytest.mark.kernel_free

LONG_S = 20.0
"""Timeout that no test waits for."""


@asynccontextmanager
async def tcp(*answers):
    """A client and its statistics; the device gives each request the next of these answers."""
    left = list(answers)
    asked = []

    async def serve(reader, writer):
        while head := await reader.read(7):
            length = int.from_bytes(head[4:6], "big") - 1
            asked.append((await reader.readexactly(length)).hex())
            body = bytes.fromhex(left.pop(0))
            writer.write(head[:4] + struct.pack(">H", 1 + len(body)) + head[6:7] + body)
        writer.close()

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    statistics = Statistics()
    client = Client(Device(port=server.sockets[0].getsockname()[1]), LONG_S, statistics)
    assert await client.connect() == ""
    try:
        yield client, statistics, asked
    finally:
        client.close()
        server.close()


def test_bits_are_read_and_written_as_many_as_were_asked_for():
    async def go():
        # 0b1001_1010 and 0b0000_0101, of which the last five bits are padding
        answers = ("02029a05", "01019a", "0f0007000b", "0f00090001")
        async with tcp(*answers) as (client, statistics, asked):
            bits = [0, 1, 0, 1, 1, 0, 0, 1, 1, 0, 1]
            assert await client.read(Batch("discrete", 5, 11, ())) == bits
            assert await client.read(Batch("coil", 6, 8, ())) == bits[:8]
            await client.write("coil", 7, bits)
            await client.write("coil", 9, [1])
            assert asked == ["020005000b", "0100060008", "0f0007000b029a05", "0f000900010101"]
            found = statistics.counters()
            assert (found["reads"], found["writes"], found["malformed"]) == (2, 2, 0)

    asyncio.run(go())


@pytest.mark.parametrize(
    ("table", "count", "answer", "found"),
    [
        ("input", 3, "04080001000200030004", 4),
        ("holding", 3, "030400010002", 2),
        ("coil", 9, "01019a", 8),
        ("coil", 8, "01029a05", 16),
        ("discrete", 8, "02029a05", 16),
    ],
)
def test_an_answer_of_another_length_is_refused(table, count, answer, found):
    async def go():
        async with tcp(answer) as (client, statistics, _):
            with pytest.raises(RequestError) as caught:
                await client.read(Batch(table, 5, count, ()))
            assert str(caught.value) == f"read of {count} at {table} 5: found {found}"
            assert not caught.value.usable
            assert (statistics.malformed, statistics.reads) == (1, 0)

    asyncio.run(go())


@pytest.mark.parametrize(
    ("table", "answer", "says"),
    [
        ("holding", "1000080002", "the device confirmed 2 at 8"),
        ("holding", "1000070001", "the device confirmed 1 at 7"),
        ("coil", "0f00070003", "the device confirmed 3 at 7"),
        ("coil", "0f00090002", "the device confirmed 2 at 9"),
        ("coil", "1000070002", "answered with function 16"),
    ],
)
def test_a_confirmation_of_something_else_is_refused(table, answer, says):
    async def go():
        async with tcp(answer) as (client, statistics, _):
            with pytest.raises(RequestError) as caught:
                await client.write(table, 7, [1, 0])
            assert str(caught.value) == f"write of 2 at {table} 7: {says}"
            assert not caught.value.usable
            assert (statistics.malformed, statistics.writes) == (1, 0)

    asyncio.run(go())


def test_a_name_that_no_host_can_have_is_told_of():
    """It makes the library raise what is no OSError, which ended the thread of the bus."""

    async def go():
        client = Client(Device(host="valve..lab", port=1502), LONG_S, Statistics())
        return await client.connect()

    found = asyncio.run(go())
    assert found.startswith("no connection to valve..lab:1502 (") and found.endswith(")")
    assert "idna" in found


# Serial

SEEN_S = 0.01
"""After which the client has taken what was sent to it."""


@contextmanager
def terminal():
    """The device's end of a serial line, and the name of the other."""
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    try:
        yield ours, os.ttyname(theirs)
    finally:
        os.close(ours)
        os.close(theirs)


class Line:
    """A client on a serial line whose device answers by a script.

    The clock stands still but for what the script adds, and the client's patience ends when the
    device is done with a wrong answer.
    """

    def __init__(self, monkeypatch, *script):
        """Prepares.

        Args:
            monkeypatch: The fixture.
            *script: Per request what is done to the right answer, and how long that takes in s;
                the right answer at once to all that follow.
        """
        self.script, self.asked, self.waits, self.patience_s = list(script), [], [], []
        self.now_s = 1000.0
        self.statistics = Statistics()
        monkeypatch.setattr(
            "pneu_hw_bridge.modbus.client.time", SimpleNamespace(monotonic=lambda: self.now_s)
        )
        whole = asyncio.timeout

        def timeout(seconds):
            self.patience_s.append(seconds)
            self.waits.append(whole(None))
            return self.waits[-1]

        monkeypatch.setattr(asyncio, "timeout", timeout)

    def answer(self, end):
        request = os.read(end, 256)
        function, count = request[1], int.from_bytes(request[4:6], "big")
        body = request[:6]
        if function in (3, 4):
            body = bytes([1, function, 2 * count]) + bytes(range(2 * count))
        right = body + FramerRTU.compute_CRC(body).to_bytes(2, "big")
        self.asked.append((function, count))
        change, takes_s = self.script.pop(0) if self.script else (None, 0.0)
        self.now_s += takes_s
        os.write(end, right if change is None else change(right))
        if change is not None:
            loop = asyncio.get_running_loop()
            loop.call_later(SEEN_S, lambda: self.waits[-1].reschedule(loop.time()))

    @asynccontextmanager
    async def open(self, *replies_s):
        self.statistics.reply.recent_s.extend(replies_s)
        loop = asyncio.get_running_loop()
        with terminal() as (end, name):
            device = Device(transport="rtu", serial_port=name, parity="N")
            client = Client(device, LONG_S, self.statistics)
            client.in_step = True
            inputs = [Batch("input", 0, count, ()) for count in (2, 3, 4)]
            client.questions = (*inputs, Batch("holding", 0, 2, ()))
            assert await client.connect() == ""
            loop.add_reader(end, self.answer, end)
            try:
                yield client
            finally:
                loop.remove_reader(end)
                client.close()


def spoilt(frame):
    return frame[:-3] + bytes([frame[-3] ^ 0x10]) + frame[-2:]


def half(frame):
    return frame[:4]


def nothing(frame):
    return b""


ASKS = (4, 2)
QUESTIONS = [(4, 3), (4, 4), (3, 2)]
"""All but the one that the answer to the request would fit."""


@pytest.mark.parametrize("wrong", [spoilt, half, nothing])
@pytest.mark.parametrize(
    ("good", "asked"),
    [
        ([False], [ASKS, QUESTIONS[0], ASKS]),
        ([False, False, False], [ASKS, *QUESTIONS, ASKS]),
        ([False, True, False], [ASKS, QUESTIONS[0], ASKS, QUESTIONS[1], ASKS]),
    ],
)
def test_what_was_spoilt_on_a_serial_line_is_asked_for_again(monkeypatch, wrong, good, asked):
    """After a question that no late answer fits: once that is answered, nothing more will come."""
    line = Line(monkeypatch, *((None if one else wrong, 0.0) for one in good))

    async def go():
        async with line.open(0.02, 0.03, 0.05) as client:
            return await client.read(Batch("input", 0, 2, ()))

    assert asyncio.run(go()) == [0x0001, 0x0203]
    assert line.asked == asked
    assert line.patience_s == [0.2] * len(asked), "four times the slowest of its replies"
    counts = line.statistics.counters()
    assert (counts["repeats"], counts["timeouts"]) == (asked.count(ASKS) - 1, 0)


def test_a_write_that_was_spoilt_is_repeated_and_quick_replies_have_some_patience(monkeypatch):
    line = Line(monkeypatch, (spoilt, 0.0))

    async def go():
        async with line.open(0.001) as client:
            await client.write("holding", 7, [5, 6])

    asyncio.run(go())
    assert line.asked == [(16, 2), (4, 2), (16, 2)]
    assert line.patience_s == [LEAST_PATIENCE_S] * 3
    assert line.statistics.writes == line.statistics.repeats == 1


@pytest.mark.parametrize(
    ("script", "asked"),
    [
        ([(nothing, 1.0)] * 4, [ASKS, *QUESTIONS]),
        ([(nothing, 15.0), (None, 4.9), (nothing, 1.0)], [ASKS, QUESTIONS[0], ASKS]),
        ([(nothing, 15.0), (None, 5.1)], [ASKS, QUESTIONS[0]]),
        ([(nothing, 19.0), (nothing, 2.0)], [ASKS, QUESTIONS[0]]),
    ],
)
def test_a_serial_line_that_stays_mute_is_given_up_in_time(monkeypatch, script, asked):
    """Whoever waits for its turn meanwhile asks nothing: an answer could be that to the former."""
    line = Line(monkeypatch, *script)

    async def go():
        async with line.open(0.05) as client:
            for what in ("read of 2 at input 0", "read of 5 at input 9"):
                _, _, count, _, table, at = what.split()
                with pytest.raises(RequestError) as caught:
                    await client.read(Batch(table, int(at), int(count), ()))
                assert str(caught.value) == f"{what}: no good answer within 20 s"
                assert not caught.value.usable and not client.usable

    asyncio.run(go())
    assert line.asked == asked
    assert line.statistics.timeouts == 1


@pytest.mark.parametrize(
    ("write", "says"),
    [
        (False, "read of 3 at input 0: found 2"),
        (True, "read of 2 at input 0: answered with function 16"),
    ],
)
def test_an_answer_that_comes_late_is_not_that_to_the_question_after_it(monkeypatch, write, says):
    late = []

    def keep(frame):
        late.append(frame)
        return b""

    line = Line(monkeypatch, (keep, 0.0), (lambda frame: late[0], 0.0))

    async def go():
        async with line.open(0.05) as client:
            with pytest.raises(RequestError) as caught:
                if write:
                    await client.write("holding", 7, [5, 6])
                else:
                    await client.read(Batch("input", 0, 2, ()))
            assert str(caught.value) == says
            assert not caught.value.usable
            # That to the question is still on its way, and would fit a read of as much.
            with pytest.raises(RequestError, match=says.partition(": ")[2]):
                await client.read(Batch("input", 6, line.asked[-1][1], ()))

    asyncio.run(go())
    assert len(line.asked) == 2
    assert line.statistics.malformed == 1


@pytest.mark.parametrize(
    ("heard_s", "silent_s"),
    [
        ([], 0.25),
        ([0.1, 0.3], 0.55),
        ([0.25], 0.25),
        ([0.2 * k for k in range(9)], 1.85),
        ([0.2 * k for k in range(20)], None),
    ],
)
def test_a_serial_line_is_silent_a_while_after_it_was_heard_last(monkeypatch, heard_s, silent_s):
    line = Line(monkeypatch)
    heard, begun_s = list(heard_s), line.now_s

    async def sleep(seconds):
        end_s = line.now_s + seconds
        while heard and begun_s + heard[0] < end_s:
            line.now_s = begun_s + heard.pop(0)
            client._heard(False, b"x")
        line.now_s = end_s
        client._heard(True, b"y")  # what is sent is not heard

    async def go():
        nonlocal client
        client = Client(Device(transport="rtu"), LONG_S, line.statistics)
        monkeypatch.setattr(asyncio, "sleep", sleep)
        await client.silence(0.25)

    client = None
    if silent_s is None:
        with pytest.raises(RequestError, match="the line is never silent"):
            asyncio.run(go())
        assert PATIENCE * 0.25 < line.now_s - begun_s < PATIENCE * 0.25 + 0.25
    else:
        asyncio.run(go())
        assert line.now_s - begun_s == pytest.approx(silent_s)
