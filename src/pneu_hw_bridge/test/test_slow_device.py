# SPDX-License-Identifier: Apache-2.0
"""A slow device holds up neither the safe voltage behind a write nor readings behind a look."""

import asyncio
import time

import pytest

from pneu_hw_bridge.modbus.reading import LOOK_BACK_S, SLOW_LOOK_BACK_S, Reader
from pneu_hw_bridge.modbus.statistics import Statistics
from pneu_hw_bridge.modbus.writing import Writer
from pneu_hw_bridge.registers.load import load_register_map

pytestmark = pytest.mark.realtime

MAP = load_register_map("generic_plc")
SAFE = {name: output.safe for name, output in MAP.outputs.items()}
OPEN = dict.fromkeys(SAFE, 5.5)


class Line:
    """A connection whose device answers when it is let; it remembers what it was asked."""

    def __init__(self):
        self.written, self.asked = [], 0
        self.answers = asyncio.Event()

    async def write(self, table, address, raw):
        self.written.append(raw)
        await self.answers.wait()

    async def read(self, batch):
        self.asked += 1
        return [0] * batch.count


class Owner:
    """Says what to write."""

    def __init__(self, volts):
        self.volts = volts

    def output(self, now_s):
        return self.volts

    def written(self, values, stamp_ns):
        pass

    def readings(self, values, steady_s, stamp_ns):
        pass


def writer_of(owner):
    return Writer(MAP, owner, Statistics(), time.time_ns, device_tells=False)


def encoded(volts):
    return [batch.encode(volts) for batch in writer_of(Owner(volts)).batches]


def test_the_safe_voltage_overtakes_a_write_that_is_not_answered_yet():
    async def go():
        owner, slow, other = Owner(OPEN), Line(), Line()
        writer = writer_of(owner)
        other.answers.set()
        pending = asyncio.create_task(writer.write(slow, force=True))
        await asyncio.sleep(0)
        assert slow.written == encoded(OPEN)[:1]
        await writer.overtake(other)
        assert not other.written  # nothing calls for it
        owner.volts = dict(SAFE)
        await writer.overtake(other)
        assert other.written == encoded(SAFE)
        slow.answers.set()
        await pending
        assert not writer.is_safe  # so that the next write repeats it behind the one overtaken
        await writer.write(slow, force=False)
        assert slow.written[-1] == encoded(SAFE)[-1] and writer.is_safe
        await writer.overtake(other)
        assert other.written == encoded(SAFE)

    asyncio.run(go())


def looks_back(reply_s, safe, after_s, monkeypatch):
    """How often outputs are read back at once and a while later, with replies so slow."""
    now = [1000.0]
    monkeypatch.setattr("pneu_hw_bridge.modbus.reading.time.monotonic", lambda: now[0])

    async def go():
        owner, line = Owner(dict(SAFE) if safe else OPEN), Line()
        line.answers.set()
        statistics = Statistics()
        for _ in range(64):
            statistics.reply.add(reply_s)
        writer = writer_of(owner)
        reader = Reader(MAP, owner, statistics, time.time_ns)
        await writer.write(line, force=True)
        reader._looked_s = now[0]
        now[0] += after_s
        await reader.look_back(line, writer)
        return line.asked

    return asyncio.run(go())


def test_outputs_are_read_back_often_only_where_replies_are_quick(monkeypatch):
    often, rarely = 1.5 * LOOK_BACK_S, 1.5 * SLOW_LOOK_BACK_S
    assert looks_back(0.001, False, 0.999 * LOOK_BACK_S, monkeypatch) == 0
    assert looks_back(0.001, False, LOOK_BACK_S, monkeypatch) > 0
    assert looks_back(0.001, False, often, monkeypatch) > 0
    assert looks_back(0.05, False, rarely, monkeypatch) == 0
    assert looks_back(0.05, True, often, monkeypatch) == 0
    assert looks_back(0.05, True, rarely, monkeypatch) > 0
