# SPDX-License-Identifier: Apache-2.0
"""A Modbus device at a steady rhythm, in a thread of its own that nothing else can hold up.

Every cycle asks the owner for the voltages, writes them, and hands over what was read. A command
that arrives between two cycles is written at once. A voltage that has not changed is written again
only every `KEEP_ALIVE_S`, which keeps the device's own watchdog quiet.

What was read is stamped by the middle of the exchange; but of a device that tells by its own clock
when it took samples and commands, every new sample is handed over once, with that time in terms of
our clock.
"""

import asyncio
import concurrent.futures
import contextlib
import logging
import math
import selectors
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from pneu_hw_bridge.device_clock import DeviceClock
from pneu_hw_bridge.modbus.client import Client, RequestError
from pneu_hw_bridge.modbus.in_step import InStep
from pneu_hw_bridge.modbus.records import CommandReader, Record, SampleReader
from pneu_hw_bridge.modbus.statistics import Statistics
from pneu_hw_bridge.registers.batches import Batch, plan, plan_writes
from pneu_hw_bridge.registers.schema import RegisterMap
from pneu_sim.errors import InputError

LONGEST_TIMEOUT_S = 0.2
"""Longest wait for an answer that a valve can afford."""

KEEP_ALIVE_S = 0.02
"""Interval at which an unchanged voltage is written again."""

SET_UP_AGAIN_S = 0.25
"""A device that refuses is set up again this often."""

LOOK_BACK_S = 0.02
"""Interval at which outputs are read back."""

FOREIGN_S = 1.0
"""So long after another voltage was read back than was written somebody else is held to write."""

FIRST_BACKOFF_S = 0.02
LONGEST_BACKOFF_S = 1.0

MOST_WAITING = 256
"""Commands kept while the device's clock is not yet compared with ours."""

UNDISTURBED_S = 1e-3
"""Two clocks that were read further apart say nothing about each other."""

SET_BACK_NS = 1_000_000_000
"""Stamps that go back by more follow a clock that was set."""


class Owner(Protocol):
    """Whom the bus works for. Called in the thread of the bus; must return quickly."""

    def output(self, now_s: float) -> Mapping[str, float]:
        """Returns the voltages to write now.

        Args:
            now_s: Steady time.
        """

    def readings(self, values: Mapping[str, float], steady_s: float, stamp_ns: int | None) -> None:
        """Takes what was read in one cycle.

        Args:
            values: SI value per channel; may be infinite or not a number.
            steady_s: Steady time of acquisition.
            stamp_ns: Time of acquisition by the clock given to the bus; None while the device's
                own clock is not yet compared with it.
        """

    def written(self, values: Mapping[str, float], stamp_ns: int) -> None:
        """Takes note of voltages that the device has confirmed.

        Args:
            values: Volts per output.
            stamp_ns: When they took effect, by the clock given to the bus.
        """

    def bus(self, fault: str) -> None:
        """Takes note that the bus changed.

        Args:
            fault: What is wrong with it; empty where it works.
        """


@dataclass(frozen=True)
class Vented:
    """What became of an attempt to write the safe voltages.

    Attributes:
        verified: Whether the device was read back and holds them.
        message: What was read back, or why it could not be.
        duration_s: How long it took.
    """

    verified: bool
    message: str
    duration_s: float


class ModbusBus:
    """The thread. `start`, `vent` and `stop` are called by the owner, from any thread."""

    def __init__(
        self,
        registers: RegisterMap,
        owner: Owner,
        period_s: float = 0.002,
        timeout_s: float = 0.1,
        clock_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        """Plans the requests; `start` begins.

        Args:
            registers: The device and its channels.
            owner: Whom the bus works for.
            period_s: Interval of cycles, s.
            timeout_s: Longest wait for a connection or an answer, s.
            clock_ns: Clock of the stamps, ns.

        Raises:
            InputError: A period or timeout is not allowed.
        """
        if not 0.0 < timeout_s <= LONGEST_TIMEOUT_S:
            raise InputError(
                f"timeout_s: found {timeout_s:g}, needed is more than 0 and at most"
                f" {LONGEST_TIMEOUT_S:g} s"
            )
        if not 0.0005 <= period_s <= 1.0:
            raise InputError(f"period_s: found {period_s:g}, needed are 0.0005 to 1 s")
        self._registers = registers
        self._owner = owner
        self._period_s = period_s
        self._timeout_s = timeout_s
        self._clock_ns = clock_ns
        self._samples: SampleReader | None = None
        self._commands: CommandReader | None = None
        self._newest: dict[str, int] = {}
        self._waiting: deque[Record] = deque(maxlen=MOST_WAITING)
        self.clock: DeviceClock | None = None
        inputs = registers.inputs
        if registers.clock is not None:
            self.clock = DeviceClock()
            self._samples = SampleReader(registers)
            inputs = {n: c for n, c in inputs.items() if n not in registers.taps}
            if registers.clock.commands is not None:
                self._commands = CommandReader(registers)
        self._records = self._plan_records()
        self._reads = plan(inputs, registers.batching)
        self._writes = plan_writes(registers.outputs)
        serial = registers.device.transport != "tcp"
        self._in_step = InStep(self._reads, self._writes, self._safe()) if serial else None
        self.statistics = Statistics()
        self.fault = "not connected yet"
        self._told: str | None = None
        self._thread: threading.Thread | None = None
        # select() waits for microseconds, epoll and poll only for whole milliseconds.
        self._loop = asyncio.SelectorEventLoop(selectors.SelectSelector())
        self._loop.set_exception_handler(self._undecodable)
        self._wake: asyncio.Future[None] | None = None
        self._poked_s: float | None = None
        self._stopping = False
        self._vent: concurrent.futures.Future[Vented] | None = None
        self._vent_begun_s = 0.0
        self._vent_deadline_s = 0.0
        self._written: dict[str, float] = {}
        self._written_s = -math.inf
        self._set_up_s = -math.inf
        self._looked_s = -math.inf
        self._foreign = ""
        self._foreign_s = -math.inf
        self.readable = True
        self._confirmed = self._safe()
        self._confirmed_ns: int | None = None

    def start(self) -> None:
        """Begins to connect and to work, in a thread of its own."""
        # Every failure is counted and told to the owner; pymodbus would log each one as well.
        logging.getLogger("pymodbus.logging").setLevel(logging.CRITICAL)
        self._thread = threading.Thread(target=self._run, name="modbus", daemon=True)
        self._thread.start()

    def poke(self) -> None:
        """Has the owner's voltages written at once rather than at the next cycle."""
        if self._poked_s is None:
            self._poked_s = time.monotonic()
        self._rouse()

    def vent(self, timeout_s: float = 0.14) -> Vented:
        """Writes the safe voltages and reads them back, before anything else is done.

        Args:
            timeout_s: When to give up, s.

        Returns:
            Whether the device holds them.
        """
        begun_s = time.monotonic()
        if self._thread is None or not self._thread.is_alive():
            return Vented(False, "the bus is not open", 0.0)
        future: concurrent.futures.Future[Vented] = concurrent.futures.Future()
        self._vent_begun_s = begun_s
        self._vent_deadline_s = begun_s + timeout_s
        self._vent = future
        self._rouse()
        try:
            return future.result(timeout_s + self._timeout_s)
        except concurrent.futures.TimeoutError:
            return Vented(False, f"{self.fault or 'the bus is busy'}", time.monotonic() - begun_s)

    def stop(self) -> None:
        """Closes the connection and ends the thread."""
        self._stopping = True
        if self._thread is None:
            self._loop.close()
            return
        self._rouse()
        self._thread.join(2.0 * self._timeout_s + 1.0)
        self._thread = None

    # In the thread

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        try:
            self._loop.run_until_complete(self._supervise())
        except Exception as error:
            # Nothing is written from now on: the owner has to know, and the device's watchdog acts.
            self._tell(f"the thread of the bus failed: {type(error).__name__}: {error}")
            raise
        finally:
            self._loop.close()

    async def _supervise(self) -> None:
        """Connects, works until it fails, connects again."""
        backoff_s = FIRST_BACKOFF_S
        while not self._stopping:
            client = Client(self._registers.device, self._timeout_s, self.statistics)
            fault = await client.connect()
            if fault:
                self._tell(fault)
            else:
                before = self.statistics.cycles
                try:
                    await self._work(client)
                except RequestError as error:
                    self._tell(str(error))
                    self.statistics.losses += 1
                if self.statistics.cycles > before:
                    backoff_s = FIRST_BACKOFF_S
            client.close()
            self._written_s = -math.inf
            if self._vent is not None and time.monotonic() >= self._vent_deadline_s:
                self._finish_vent(False, self.fault)
            wait_s = FIRST_BACKOFF_S if self._vent is not None else backoff_s
            await self._until(time.monotonic() + wait_s, only=self._asked)
            backoff_s = min(2.0 * backoff_s, LONGEST_BACKOFF_S)
        if self._vent is not None:
            self._finish_vent(False, "the bus was closed")

    async def _work(self, client: Client) -> None:
        """Cycles on one connection."""
        if self.clock is not None and self.clock.settled:
            self.clock.doubt()
        if self._in_step is not None:
            await self._in_step.prove(client)
        await self._set_up(client)
        tick_s = time.monotonic()
        while not self._stopping:
            if self._vent is not None:
                await self._do_vent(client)
            try:
                poked_s, self._poked_s = self._poked_s, None
                foreign = time.monotonic() - self._foreign_s < FOREIGN_S
                await self._write(client, force=foreign or poked_s is not None)
                if poked_s is not None:
                    self.statistics.command.add(time.monotonic() - poked_s)
                now_s = time.monotonic()
                if now_s >= tick_s:
                    if now_s > tick_s + self._period_s:
                        self.statistics.late_cycles += 1
                        # Ticks keep their phase, so that readings stand on one even grid of time.
                        tick_s += self._period_s * math.floor((now_s - tick_s) / self._period_s)
                    tick_s += self._period_s
                    await self._look_back(client, foreign)
                    await self._read(client)
                    self.statistics.cycles += 1
                    foreign = time.monotonic() - self._foreign_s < FOREIGN_S
                    self._tell(self._foreign if foreign else "")
            except RequestError as error:
                if not error.usable:
                    raise
                self._tell(str(error))
                if time.monotonic() > self._set_up_s + SET_UP_AGAIN_S:
                    with contextlib.suppress(RequestError):
                        await self._set_up(client)
                tick_s = max(tick_s, time.monotonic() + self._period_s)
            if not foreign:  # else the last word is to be ours as often as can be
                await self._until(tick_s, only=self._roused)

    async def _set_up(self, client: Client) -> None:
        """Writes the settings of the map: at first, and to a device that refuses.

        Couplers whose own watchdog has acted take no outputs before they are set up again.
        """
        self._set_up_s = time.monotonic()
        for setting in self._registers.settings:
            await client.write(setting.table, setting.address, setting.encode())
            self.statistics.settings += 1

    async def _write(self, client: Client, force: bool) -> None:
        """Writes the owner's voltages where they changed or are due."""
        now_s = time.monotonic()
        values = dict(self._owner.output(now_s))
        if not force and values == self._written and now_s - self._written_s < KEEP_ALIVE_S:
            return
        await self._send(client, values)
        self._written, self._written_s = values, now_s

    async def _send(self, client: Client, values: Mapping[str, float]) -> None:
        """Writes voltages, and tells the owner with the middle of the exchange as their time.

        Where one output cannot be written all others get their safe voltages.

        Raises:
            RequestError: An output was not written.
        """
        begun_s, begun_ns = time.monotonic(), self._clock_ns()
        safe = self._safe()
        written: dict[str, float] = {}
        failed: dict[tuple[str, int], RequestError] = {}
        for batch in self._writes:
            try:
                await self._put(client, batch, safe if failed else values)
            except RequestError as error:
                failed[batch.table, batch.address] = error
                if not (error.usable or client.usable):
                    break
                continue
            written |= {name: (safe if failed else values)[name] for name, _ in batch.channels}
        if failed:
            for batch in self._writes:
                names = [name for name, _ in batch.channels]
                if any(written.get(name, safe[name]) != safe[name] for name in names):
                    await self._put(client, batch, safe)
                    written |= {name: safe[name] for name in names}
            # The next connection begins with those that can be written.
            self._writes.sort(key=lambda batch: (batch.table, batch.address) in failed)
        if written:
            half_s = 0.5 * (time.monotonic() - begun_s)
            self._confirm({**self._confirmed, **written}, begun_ns + round(1e9 * half_s))
        if failed:
            raise next((e for e in failed.values() if not e.usable), next(iter(failed.values())))

    async def _put(self, client: Client, batch: Batch, values: Mapping[str, float]) -> None:
        """Writes the voltages of one request."""
        try:
            raw = batch.encode(values)
        except ValueError:
            # Limits lie within what the types hold, so this is a fault of ours: be safe.
            self.statistics.unwritable += 1
            raw = batch.encode(self._safe())
        await client.write(batch.table, batch.address, raw)

    def _confirm(self, values: dict[str, float], stamp_ns: int) -> None:
        """Keeps what the device has confirmed, and tells the owner."""
        self._confirmed = values
        if self._commands is not None:
            return  # the device itself will tell when it took them
        watchdog_s, before_ns = self._registers.device.watchdog_s, self._confirmed_ns
        if watchdog_s and before_ns is not None and stamp_ns - before_ns > 1e9 * watchdog_s:
            # Left alone for so long, the device had the safe voltages until now.
            self._owner.written(self._safe(), before_ns + round(1e9 * watchdog_s))
        self._confirmed_ns = stamp_ns
        self._owner.written(values, stamp_ns)

    async def _look_back(self, client: Client, often: bool) -> None:
        """Reads the outputs back: another master of the device may write to them.

        Args:
            client: The connection.
            often: Whether at every call; else every `LOOK_BACK_S`.
        """
        now_s = time.monotonic()
        if not self.readable or not (often or now_s >= self._looked_s + LOOK_BACK_S):
            return
        self._looked_s = now_s
        safe = self._safe()
        for batch in self._writes:
            try:
                found = batch.decode(await client.read(batch))
            except RequestError as error:
                if not error.usable:
                    raise
                self.readable = False  # told in the diagnostics: nobody would notice
                return
            for name, value in found.items():
                nearest = min((self._confirmed[name], safe[name]), key=lambda v: abs(v - value))
                # (safe after the device's own watchdog)
                if not abs(value - nearest) <= self._registers.outputs[name].resolution:
                    self.statistics.foreign += 1
                    self._foreign_s = now_s
                    self._foreign = (
                        f"{name} reads back {value:g} V where {self._confirmed[name]:g} V was"
                        " written: somebody else writes to the device"
                    )

    async def _read(self, client: Client) -> None:
        """Reads all inputs and hands them over with the middle of the exchange as their time."""
        values: dict[str, float] = {}
        begun_s, begun_ns = time.monotonic(), self._clock_ns()
        for batch in self._reads:
            values.update(batch.decode(await client.read(batch)))
        if self._samples is not None:
            await self._read_records(client, self._samples, values)
            return
        half_s = 0.5 * (time.monotonic() - begun_s)
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
        self.statistics.samples += len(news.records)
        self.statistics.samples_skipped += news.skipped
        self.statistics.reads_without_news += not news.records
        if news.records and after_s - ended_s < UNDISTURBED_S:
            self.clock.observe(news.records[-1].device_ns, ended_ns, ended_s)
        # That it is new says that it was taken lately; how lately, no more than the exchange does.
        steady_s = 0.5 * (begun_s + ended_s)
        for record in news.records:
            stamp_ns = self._stamp("samples", record)
            self._owner.readings({**values, **record.values}, steady_s, stamp_ns)
        if self._commands is None:
            return
        if len(self._records) > 1:
            raw = await client.read(self._records[1])
        start = self._commands.span.address - self._records[-1].address
        taken = self._commands.take(raw[start : start + self._commands.span.count])
        self.statistics.commands_skipped += taken.skipped
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

    async def _do_vent(self, client: Client) -> None:
        """Writes the safe voltages and reads them back, of each output whatever the others do."""
        safe = self._safe()
        shown: dict[str, str] = {}
        lost: RequestError | None = None
        try:
            await self._send(client, safe)
            self._written, self._written_s = safe, time.monotonic()
        except RequestError as error:
            lost = None if error.usable else error
        verified = True
        for batch in self._writes:
            try:
                if lost is not None and not client.usable:
                    raise lost
                found = batch.decode(await client.read(batch))
            except RequestError as error:
                lost = lost or (None if error.usable else error)
                shown |= {name: f"{name} {error}" for name, _ in batch.channels}
                verified = False
                continue
            shown |= {name: f"{name} {value:g} V" for name, value in found.items()}
            for name, value in found.items():
                if not abs(value - safe[name]) <= self._registers.outputs[name].resolution:
                    verified = False
        message = ", ".join(shown[name] for name in safe)
        if verified:
            self._finish_vent(True, f"read back {message}")
        elif time.monotonic() >= self._vent_deadline_s:
            self._finish_vent(False, f"read back {message}")
        if lost is not None:
            raise lost
        if not verified:
            await asyncio.sleep(0.005)  # the device refused: ask again until the deadline

    def _finish_vent(self, verified: bool, message: str) -> None:
        future, self._vent = self._vent, None
        if future is not None and future.set_running_or_notify_cancel():
            duration_s = time.monotonic() - self._vent_begun_s
            future.set_result(Vented(verified, message, duration_s))

    def _safe(self) -> dict[str, float]:
        return {name: output.safe for name, output in self._registers.outputs.items()}

    def _tell(self, fault: str) -> None:
        self.fault = fault
        if fault != self._told:
            self._told = fault
            self._owner.bus(fault)

    # Waiting

    def _asked(self) -> bool:
        return self._stopping or self._vent is not None

    def _roused(self) -> bool:
        return self._asked() or self._poked_s is not None

    async def _until(self, deadline_s: float, only: Callable[[], bool]) -> None:
        """Waits until a time, or until there is something to do."""
        while not only():
            now_s = time.monotonic()
            if now_s >= deadline_s:
                return
            self._wake = self._loop.create_future()
            timer = self._loop.call_at(self._loop.time() + deadline_s - now_s, self._on_rouse)
            if not only():  # it may have come before there was a future to complete
                await self._wake
            timer.cancel()
            self._wake = None

    def _rouse(self) -> None:
        if not self._loop.is_closed():
            try:
                self._loop.call_soon_threadsafe(self._on_rouse)
            except RuntimeError:
                # The loop closed between the question and the call: nothing is left to rouse.
                return

    def _on_rouse(self) -> None:
        if self._wake is not None and not self._wake.done():
            self._wake.set_result(None)

    def _undecodable(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """Counts what pymodbus raises out of its receive callback: bytes it could not decode."""
        del loop, context
        self.statistics.malformed += 1
