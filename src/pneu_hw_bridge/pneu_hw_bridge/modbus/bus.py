# SPDX-License-Identifier: Apache-2.0
"""A Modbus device at a steady rhythm, in a thread of its own that nothing else can hold up.

Two loops share it: one asks the owner for the voltages and writes them, the other reads and hands
over what was read (`writing.py`, `reading.py`). Where the device takes two connections each has its
own, so that no write waits for a reading; else they take turns, request by request. A command that
arrives between two cycles is written at once.
"""

import asyncio
import concurrent.futures
import logging
import math
import selectors
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Protocol

from pneu_common.errors import InputError
from pneu_hw_bridge.device_clock import DeviceClock
from pneu_hw_bridge.modbus.client import Client, RequestError
from pneu_hw_bridge.modbus.in_step import InStep
from pneu_hw_bridge.modbus.reading import Reader, ReadOwner
from pneu_hw_bridge.modbus.statistics import Statistics
from pneu_hw_bridge.modbus.writing import WriteOwner, Writer
from pneu_hw_bridge.registers.schema import RegisterMap

LONGEST_TIMEOUT_S = 0.2
"""Longest wait for an answer that a valve can afford."""

LOOK_S = 0.005
"""The owner is asked at least so often what to write, whatever the period."""

SET_UP_AGAIN_S = 0.25
"""A device that refuses is set up again this often."""

FIRST_BACKOFF_S = 0.02
LONGEST_BACKOFF_S = 1.0

LASTING_S = 1.0
"""Two connections that are lost sooner may be more than the device takes."""
TRIES_OF_TWO = 3
"""After so many a single one is used, until one has lasted and was lost."""


class Owner(WriteOwner, ReadOwner, Protocol):
    """Whom the bus works for. Called in the thread of the bus; must return quickly."""

    def bus(self, fault: str) -> None:
        """Takes note that the bus changed.

        Args:
            fault: What is wrong with it; empty where it works.
        """

    def takes(self, mostly_s: float, usually_s: float) -> None:
        """Takes note of how long it takes from a decision until all outputs are written.

        Args:
            mostly_s: In 95 of 100 cases at most, s.
            usually_s: In every other case at most, s.
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
        self.statistics = Statistics()
        self._reader = Reader(registers, owner, self.statistics, clock_ns)
        self._writer = Writer(
            registers, owner, self.statistics, clock_ns, self._reader.device_tells
        )
        self._in_step: InStep | None = None
        if registers.device.transport != "tcp":
            self._in_step = InStep(self._reader.batches, self._writer.batches, self._writer.safe())
        self.lines = 1
        self.fault = "not connected yet"
        self._told = self.fault
        self._thread: threading.Thread | None = None
        # select() waits for microseconds, epoll and poll only for whole milliseconds.
        self._loop = asyncio.SelectorEventLoop(selectors.SelectSelector())
        self._loop.set_exception_handler(self._undecodable)
        self._wake: asyncio.Future[None] | None = None
        self._poked_s: float | None = None
        self._stopping = False
        self._venting = threading.Lock()
        self._vent: concurrent.futures.Future[Vented] | None = None
        self._vent_begun_s = 0.0
        self._vent_deadline_s = 0.0
        self._set_up_s = -math.inf
        self._faults = {"write": self.fault, "read": self.fault}
        self._refused = False
        self._ending = False
        self._over = False
        self._short_lived = 0

    @property
    def clock(self) -> DeviceClock | None:
        """The clock of a device that has one."""
        return self._reader.clock

    @property
    def readable(self) -> bool:
        """Whether the outputs can be read back."""
        return self._reader.readable

    def takes_s(self, fraction: float) -> float:
        """Returns how long it takes from a decision until all outputs are written, s.

        In front of a write as many requests may be on their way. NaN while nothing was answered.

        Args:
            fraction: Of replies that take no longer than is reckoned with.
        """
        return LOOK_S + 2 * len(self._writer.batches) * self.statistics.reply.quantile(fraction)

    def reads_s(self, fraction: float) -> float:
        """Return the longest interval between two readings, s.

        At least the period. Slow replies make it longer: before a reading is repeated the outputs
        may be read back, and on a single connection as many writes may come between.

        Args:
            fraction: Share of replies that take no longer than assumed.
        """
        requests = self._reader.requests + len(self._writer.batches) * self._reader.readable
        turns = 2 if self.lines == 1 else 1
        return max(self._period_s, turns * requests * self.statistics.reply.quantile(fraction))

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
        with self._venting:
            return self._vent_now(timeout_s)

    def _vent_now(self, timeout_s: float) -> Vented:
        """Does so; one at a time."""
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
            second: Client | None = None
            begun_s = time.monotonic()
            fault = await client.connect()
            if fault:
                self.statistics.connect_failures += 1
                self._all_fail(fault)
            else:
                self.statistics.connects += 1
                before = self.statistics.cycles
                try:
                    await self._begin(client)
                    second = await self._second(client)
                    await self._work(client, second or client)
                except RequestError as error:
                    self._all_fail(str(error))
                    self.statistics.losses += 1
                if self.statistics.cycles > before:
                    backoff_s = FIRST_BACKOFF_S
                lasted = time.monotonic() - begun_s > LASTING_S
                self._short_lived = 0 if lasted else self._short_lived + 1
            for line in (client, second):
                if line is not None:
                    line.close()
            self._writer.renew()
            if self._vent is not None and time.monotonic() >= self._vent_deadline_s:
                self._finish_vent(False, self.fault)
            if fault and self._vent is not None:  # refusals come at once, hundreds in a vent
                await asyncio.sleep(FIRST_BACKOFF_S)
            else:
                await self._until(time.monotonic() + backoff_s, only=self._asked)
            backoff_s = min(2.0 * backoff_s, LONGEST_BACKOFF_S)
        if self._vent is not None:
            self._finish_vent(False, "the bus was closed")

    async def _begin(self, client: Client) -> None:
        """Prepares a new connection."""
        self._reader.begin()
        if self._in_step is not None:
            await self._in_step.prove(client)
            client.in_step = True
            client.questions = self._in_step.questions
        await self._set_up(client)

    async def _second(self, client: Client) -> Client | None:
        """A connection of its own for reading; None where the device takes no second one.

        A device that serves one at a time may accept another and never answer on it, or close the
        first.
        """
        self.lines = 1
        device = self._registers.device
        if device.transport != "tcp" or device.connections < 2 or self._short_lived >= TRIES_OF_TWO:
            return None
        with suppress(RequestError):
            await self._writer.write(client, force=True)  # what may take long comes after
        second = Client(device, self._timeout_s, self.statistics)
        await second.connect()  # where that fails, so does the question
        try:
            await self._reader.question(second)
        except RequestError as error:
            if not error.usable:
                second.close()
                return None
        self.lines = 2
        return second

    async def _work(self, client: Client, reading: Client) -> None:
        """Writes and reads until a connection fails, and writes the safe voltages if it still can.

        Raises:
            RequestError: A connection failed.
        """
        self._ending = self._over = False
        write = self._loop.create_task(self._write_on(client))
        read = self._loop.create_task(self._read_on(reading))
        try:
            await asyncio.wait((write, read), return_when=asyncio.FIRST_COMPLETED)
            if read.done() and not write.done() and client is not reading:
                # Safe first, on the connection that works: to connect again takes a while.
                self._all_fail(str(read.exception()))
                self._ending = True
                self._rouse()
                await asyncio.wait((write,), timeout=self._timeout_s)
        finally:
            # (cancelling alone is not enough: up to Python 3.11 `asyncio.wait_for` forgets it where
            # an answer comes at the same time, and the other loop would go on by itself for ever)
            self._over = True
            for task in (write, read):
                task.cancel()
            found = await asyncio.gather(read, write, return_exceptions=True)
        for error in found:
            if isinstance(error, Exception):
                raise error

    async def _write_on(self, client: Client) -> None:
        """Writes what the owner says, on one connection."""
        tick_s = time.monotonic()
        while not (self._stopping or self._ending or self._over):
            if self._vent is not None:
                await self._do_vent(client)
            foreign = self._reader.foreign
            try:
                poked_s, self._poked_s = self._poked_s, None
                if self._refused and time.monotonic() > self._set_up_s + SET_UP_AGAIN_S:
                    with suppress(RequestError):
                        await self._set_up(client)
                await self._writer.write(client, force=bool(foreign) or poked_s is not None)
                if poked_s is not None:
                    self.statistics.command.add(time.monotonic() - poked_s)
                self._works("write", foreign)
            except RequestError as error:
                self._works("write", str(error))
                if not error.usable:
                    raise
                foreign = ""
            self._owner.takes(self.takes_s(0.95), self.takes_s(0.5))
            if not foreign:  # else the last word is to be ours as often as can be
                tick_s = max(tick_s + min(self._period_s, LOOK_S), time.monotonic())
                await self._until(tick_s, only=self._roused)
        if self._ending:
            await self._writer.write(client, force=True)

    async def _read_on(self, client: Client) -> None:
        """Reads at the rhythm of the period, on one connection."""
        tick_s = time.monotonic()
        while not (self._stopping or self._over):
            now_s = time.monotonic()
            if now_s > tick_s + self._period_s:
                self.statistics.late_cycles += 1
                # Ticks keep their phase, so that readings stand on one even grid of time.
                tick_s += self._period_s * math.floor((now_s - tick_s) / self._period_s)
            tick_s += self._period_s
            try:
                await self._reader.look_back(client, self._writer)
                await self._reader.read(client)
                if self.lines == 2:
                    await self._writer.overtake(client)
                self.statistics.cycles += 1
                self._works("read", "")
            except RequestError as error:
                self._works("read", str(error))
                if not error.usable:
                    raise
                tick_s = max(tick_s, time.monotonic() + self._period_s)
            await asyncio.sleep(max(tick_s - time.monotonic(), 0.0))

    async def _set_up(self, client: Client) -> None:
        """Writes the settings of the map: at first, and to a device that refuses.

        Couplers whose own watchdog has acted take no outputs before they are set up again.
        """
        self._set_up_s = time.monotonic()
        for setting in self._registers.settings:
            await client.write(setting.table, setting.address, setting.encode())
            self.statistics.settings += 1

    async def _do_vent(self, client: Client) -> None:
        """Writes the safe voltages and reads them back, until the device holds them."""
        verified, message, lost = await self._writer.vent(client)
        if verified or time.monotonic() >= self._vent_deadline_s:
            self._finish_vent(verified, message)
        if lost is not None:
            raise lost
        if not verified:
            await asyncio.sleep(0.005)  # the device refused: ask again until the deadline

    def _finish_vent(self, verified: bool, message: str) -> None:
        future, self._vent = self._vent, None
        assert future is not None
        future.set_result(Vented(verified, message, time.monotonic() - self._vent_begun_s))

    def _works(self, what: str, fault: str) -> None:
        """Takes note of how writing or reading does."""
        self._faults[what] = fault
        self._refused = any(self._faults.values()) and not self._reader.foreign
        self._tell(next(filter(None, self._faults.values()), ""))

    def _all_fail(self, fault: str) -> None:
        """Takes note that nothing can be written nor read."""
        self._faults = dict.fromkeys(self._faults, fault)
        self._tell(fault)

    def _tell(self, fault: str) -> None:
        self.fault = fault
        if fault != self._told:
            self._told = fault
            self._owner.bus(fault)

    # Waiting

    def _asked(self) -> bool:
        return self._stopping or self._vent is not None

    def _roused(self) -> bool:
        return self._asked() or self._ending or self._poked_s is not None

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
        with suppress(RuntimeError):  # the loop is closed: nothing is left to rouse
            self._loop.call_soon_threadsafe(self._on_rouse)

    def _on_rouse(self) -> None:
        if self._wake is not None and not self._wake.done():
            self._wake.set_result(None)

    def _undecodable(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """Counts what pymodbus raises out of its receive callback: bytes it could not decode."""
        del loop, context
        self.statistics.malformed += 1
