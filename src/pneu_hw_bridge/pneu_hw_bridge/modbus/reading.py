# SPDX-License-Identifier: Apache-2.0
"""What is read of a device: its sensors, and its outputs, which another master may write to.

What was read is stamped by the middle of the exchange; but of a device that tells by its own clock
when it took samples and commands, every new sample is handed over once, with that time in terms of
our clock.
"""

import math
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import Protocol

from pneu_hw_bridge.device_clock import DeviceClock
from pneu_hw_bridge.modbus.client import Client, RequestError
from pneu_hw_bridge.modbus.records import CommandReader, Record, SampleReader
from pneu_hw_bridge.modbus.statistics import Statistics
from pneu_hw_bridge.modbus.writing import Writer
from pneu_hw_bridge.registers.batches import Batch, plan
from pneu_hw_bridge.registers.schema import ChannelBase, RegisterMap
from pneu_hw_bridge.registers.turns import Turns

LOOK_BACK_S = 0.02
"""Interval at which outputs are read back."""

SLOW_S = 0.03
"""With slower replies outputs are read back only while the valves are safe, and rarely: the next
reading comes so late for it that it may count as stale, and valves that are not followed for a
second after that would else never be followed again."""
SLOW_LOOK_BACK_S = 3.0
"""Interval of that."""

FOREIGN_S = 1.0
"""So long after another voltage was read back than was written somebody else is held to write."""

MOST_WAITING = 256
"""Commands kept while the device's clock is not yet compared with ours."""

UNDISTURBED_S = 1e-3
"""Two clocks that were read further apart say nothing about each other."""

SET_BACK_NS = 1_000_000_000
"""Stamps that go back by more follow a clock that was set."""


class ReadOwner(Protocol):
    """Who takes what was read."""

    def readings(self, values: Mapping[str, float], steady_s: float, stamp_ns: int | None) -> None:
        """Takes what was read in one cycle.

        Args:
            values: SI value per channel; may be infinite or not a number.
            steady_s: Steady time of acquisition.
            stamp_ns: Time of acquisition by the clock given to the bus; None while the device's
                own clock is not yet compared with it.
        """

    def written(self, values: Mapping[str, float], stamp_ns: int) -> None:
        """Takes note of voltages that the device has taken.

        Args:
            values: Volts per output.
            stamp_ns: When they took effect, by the clock given to the bus.
        """


class Reader:
    """Reads one device over any number of connections, one after the other."""

    def __init__(
        self,
        registers: RegisterMap,
        owner: ReadOwner,
        statistics: Statistics,
        clock_ns: Callable[[], int],
    ) -> None:
        """Plans the requests.

        Args:
            registers: The device.
            owner: Who takes what was read.
            statistics: Counters that are kept up to date.
            clock_ns: Clock of the stamps, ns.
        """
        self._registers = registers
        self._owner = owner
        self._statistics = statistics
        self._clock_ns = clock_ns
        self._samples: SampleReader | None = None
        self._commands: CommandReader | None = None
        self._newest: dict[str, int] = {}
        self._waiting: deque[Record] = deque(maxlen=MOST_WAITING)
        self.clock: DeviceClock | None = None
        inputs: dict[str, ChannelBase] = {**registers.inputs, **registers.encoders}
        self._turns = Turns(registers.encoders)
        if registers.clock is not None:
            self.clock = DeviceClock()
            self._samples = SampleReader(registers)
            inputs = {n: c for n, c in inputs.items() if n not in registers.sampled}
            if registers.clock.commands is not None:
                self._commands = CommandReader(registers)
        self._records = self._plan_records()
        self.batches = plan(inputs, registers.batching)
        self._looked_s = -math.inf
        self._foreign = ""
        self._foreign_s = -math.inf
        self.readable = True

    @property
    def device_tells(self) -> bool:
        """Whether the device itself tells when it took commands."""
        return self._commands is not None

    @property
    def requests(self) -> int:
        """How many requests a cycle takes, at most."""
        return len(self.batches) + len(self._records)

    def begin(self) -> None:
        """Takes note of a new connection."""
        if self.clock is not None and self.clock.settled:
            self.clock.doubt()

    @property
    def foreign(self) -> str:
        """What somebody else has written lately; empty where nobody has."""
        return self._foreign if time.monotonic() - self._foreign_s < FOREIGN_S else ""

    async def question(self, client: Client) -> None:
        """Asks for something of what a cycle asks for.

        Args:
            client: The connection.

        Raises:
            RequestError: It was not answered well.
        """
        await client.read((*self.batches, *self._records)[0])

    async def look_back(self, client: Client, writer: Writer) -> None:
        """Reads the outputs back, where it is time to.

        Args:
            client: The connection.
            writer: Knows what was written.

        Raises:
            RequestError: The connection cannot be used any more.
        """
        now_s = time.monotonic()
        slow = self._statistics.reply.quantile(0.95) > SLOW_S
        if slow and not writer.is_safe:
            self._looked_s = now_s
            return
        due_s = self._looked_s + (SLOW_LOOK_BACK_S if slow else LOOK_BACK_S)
        if not (self.readable and (self.foreign or now_s >= due_s)):
            return
        self._looked_s = now_s
        for batch in list(writer.batches):
            asked_s = time.monotonic()
            try:
                found = batch.decode(await client.read(batch))
            except RequestError as error:
                if not error.usable:
                    raise
                self.readable = False  # told in the diagnostics: nobody would notice
                return
            told = writer.foreign(found, asked_s)
            if told:
                self._statistics.foreign += 1
                self._foreign, self._foreign_s = told, time.monotonic()

    async def read(self, client: Client) -> None:
        """Reads all inputs and hands them over with the middle of the exchange as their time.

        Of an exchange that took far longer than usual that is not known.

        Args:
            client: The connection.

        Raises:
            RequestError: They could not be read.
        """
        values: dict[str, float] = {}
        begun_s, begun_ns = time.monotonic(), self._clock_ns()
        for batch in self.batches:
            values.update(batch.decode(await client.read(batch)))
        if self._samples is not None:
            await self._read_records(client, self._samples, values)
            return
        values = self._turns.unwrap(values)
        took_s = time.monotonic() - begun_s
        if not self._statistics.tells_when(took_s, len(self.batches)):
            # The machine or the line stood still: only the supervisor learns of it, as of an old
            # one. In a recording it would stand at a time at which the pressure was another one.
            self._statistics.unclear += 1
            self._owner.readings(values, begun_s, None)
            return
        half_s = 0.5 * took_s
        self._owner.readings(values, begun_s + half_s, begun_ns + round(1e9 * half_s))

    def _plan_records(self) -> list[Batch]:
        """Requests for samples and commands: one, where both fit."""
        spans = [part.span for part in (self._samples, self._commands) if part is not None]
        if len(spans) == 2 and spans[0].table == spans[1].table:
            first = min(span.address for span in spans)
            count = max(span.address + span.count for span in spans) - first
            gap = count - sum(span.count for span in spans)
            batching = self._registers.batching
            if count <= batching.max_registers and gap <= batching.max_gap:
                return [Batch(spans[0].table, first, count, ())]
        return [Batch(span.table, span.address, span.count, ()) for span in spans]

    async def _read_records(
        self, client: Client, samples: SampleReader, values: Mapping[str, float]
    ) -> None:
        """Reads samples and commands of a device with a clock, and hands the new ones over."""
        assert self.clock is not None
        begun_s = time.monotonic()
        raw = await client.read(self._records[0])
        ended_s, ended_ns, after_s = time.monotonic(), self._clock_ns(), time.monotonic()
        start = samples.span.address - self._records[0].address
        news = samples.take(raw[start : start + samples.span.count])
        if news.anew:
            self.clock.restart(news.anew)
            self._waiting.clear()
            if self._commands is not None:
                self._commands.forget()
        self._statistics.samples += len(news.records)
        self._statistics.samples_skipped += news.skipped
        self._statistics.reads_without_news += not news.records
        if news.records and after_s - ended_s < UNDISTURBED_S:
            self.clock.observe(news.records[-1].device_ns, ended_ns, ended_s)
        # That it is new says that it was taken lately; how lately, no more than the exchange does.
        steady_s = 0.5 * (begun_s + ended_s)
        for record in news.records:
            stamp_ns = self._stamp("samples", record)
            self._owner.readings(
                self._turns.unwrap({**values, **record.values}), steady_s, stamp_ns
            )
        if self._commands is None:
            return
        if len(self._records) > 1:
            raw = await client.read(self._records[1])
        start = self._commands.span.address - self._records[-1].address
        taken = self._commands.take(raw[start : start + self._commands.span.count])
        self._statistics.commands_skipped += taken.skipped
        self._waiting.extend(taken.records)
        while self._waiting and (stamp_ns := self._stamp("commands", self._waiting[0])) is not None:
            self._owner.written(self._waiting.popleft().values, stamp_ns)

    def _stamp(self, kind: str, record: Record) -> int | None:
        """The device time of a record by our clock, later than that of the one before."""
        assert self.clock is not None
        stamp_ns = self.clock.stamp(record.device_ns)
        if stamp_ns is None:
            return None
        newest_ns = self._newest.get(kind)
        if newest_ns is not None and newest_ns - SET_BACK_NS < stamp_ns <= newest_ns:
            stamp_ns = newest_ns + 1
        self._newest[kind] = stamp_ns
        return stamp_ns
