# SPDX-License-Identifier: Apache-2.0
"""The Modbus device of the emulated lab: registers in front of a plant, with its own watchdog.

Where the register map names a clock, the device shows its latest samples and commands as records
with number and device time, all from one moment in one read. Device time is the plant's.
"""

import asyncio
import math
import time
from collections import deque
from collections.abc import Coroutine
from dataclasses import dataclass
from typing import Any

import numpy as np
from pymodbus.constants import ExcCodes
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from pneu_common.errors import InputError
from pneu_hw_bridge.lab.faults import Faults
from pneu_hw_bridge.lab.plant import Plant, Sample
from pneu_hw_bridge.registers.clock import Count
from pneu_hw_bridge.registers.schema import ChannelBase, Encoder, Output, RegisterMap

POLL_S = 0.002
"""How often the device looks at its watchdog and at faults that end."""

GLANCE_S = 0.0005
"""How often a reading that the plant has not got to yet is asked for."""

LONGEST_WAIT_S = 1.0
"""After how long without a reading the device says that it is busy."""

STALL_S = 0.02
"""A look that comes so much too late is noted: the machine, not the bridge, was slow."""

_TABLES = {3: "holding", 6: "holding", 16: "holding", 22: "holding", 23: "holding", 4: "input"}
_RANGES = {
    "int16": (-(2**15), 2**15 - 1),
    "uint16": (0, 2**16 - 1),
    "int32": (-(2**31), 2**31 - 1),
    "uint32": (0, 2**32 - 1),
    "uint64": (0, 2**64 - 1),
}


@dataclass(frozen=True)
class Change:
    """A change of the voltages at the valves.

    Attributes:
        steady_s: When; the machine's steady clock, so that other processes can compare.
        volts: The voltages.
        cause: ``write``, ``watchdog`` or ``start``.
    """

    steady_s: float
    volts: dict[str, float]
    cause: str


@dataclass(frozen=True)
class Command:
    """A command that the device took, or gave itself.

    Attributes:
        number: How many there were before it.
        time_s: Simulated time from which on it acts, s.
        volts: The voltages.
    """

    number: int
    time_s: float
    volts: dict[str, float]


@dataclass
class Rest:
    """A time during which all valves had their safe voltage.

    Attributes:
        begun_s: When it began, by the machine's steady clock.
        cause: ``write``, ``watchdog`` or ``start``.
        ended_s: When it ended; None while it lasts.
    """

    begun_s: float
    cause: str
    ended_s: float | None = None


@dataclass(frozen=True)
class Stall:
    """A time in which this process did not get to run.

    Attributes:
        begun_s: When it began, by the machine's steady clock.
        seconds: How long it lasted.
    """

    begun_s: float
    seconds: float


class LabDevice:
    """Registers, watchdog, faults and the Modbus server.

    Attributes:
        faults: Faults on demand.
        history: The newest changes of voltage.
        rests: The newest times at the safe voltages.
        stalls: The newest times in which this process did not get to run.
        requests: Requests that were carried out.
        refused: Requests that were refused.
        watchdog_trips: Times the watchdog went off.
    """

    def __init__(
        self, plant: Plant, registers: RegisterMap, watchdog_s: float, seed: int = 0
    ) -> None:
        """Lays out the registers; `open` begins to serve.

        Args:
            plant: The plant behind the registers.
            registers: Where things are.
            watchdog_s: After how long without a write the valves get their safe voltage, s.
            seed: Seed of malformed answers.

        Raises:
            InputError: The map does not fit the plant, or the emulation.
        """
        if not 0.0 < watchdog_s <= 10.0:
            raise InputError(f"watchdog_s: found {watchdog_s:g}, needed is more than 0, at most 10")
        for name, channel in registers.places.items():
            if channel.is_bit:
                raise InputError(
                    f"channel {name!r}: the lab serves holding and input registers only"
                )
        missing = sorted(set(registers.taps) - set(plant.rig.taps))
        if missing:
            raise InputError(
                f"channel {missing[0]!r}: the rig has taps {', '.join(plant.rig.taps)}"
            )
        missing = sorted(set(registers.encoders) - set(plant.rig.encoders))
        if missing:
            raise InputError(
                f"encoder {missing[0]!r}: the rig has encoders"
                f" {', '.join(plant.rig.encoders) or 'none'}"
            )
        self._plant = plant
        self._registers = registers
        self._watchdog_s = watchdog_s
        self._rng = np.random.default_rng(seed)
        self._safe = {name: output.safe for name, output in registers.outputs.items()}
        self._fed_s = dict.fromkeys(self._safe, plant.now_s())
        self._bitten: set[str] = set()
        self._zero = (0, 0.0)
        told = registers.clock.commands if registers.clock is not None else None
        self._commands: deque[Command] = deque(maxlen=told.records if told else 1)
        self._commands.append(Command(0, 0.0, plant.volts()))
        self._server: ModbusTcpServer | None = None
        self._address = ("127.0.0.1", 0)
        self._tasks: set[asyncio.Task[None]] = set()
        self._closed = False
        places = {
            "sensor": list(registers.sampled),
            "encoder": list(registers.encoders),
            "output": list(registers.outputs),
        }
        self.faults = Faults(places, self._fault_changed)
        self.history: deque[Change] = deque(maxlen=500)
        self.rests: deque[Rest] = deque(maxlen=100)
        self.stalls: deque[Stall] = deque(maxlen=100)
        self.requests = self.refused = self.watchdog_trips = 0
        self._note("start")

    async def open(self, host: str, port: int) -> int:
        """Begins to serve; returns the port.

        Args:
            host: Address to listen on.
            port: Port; 0 takes a free one.

        Raises:
            InputError: The port cannot be had.
        """
        self._address = (host, port)
        await self._listen()
        self._start(self._watch())
        return self._address[1]

    async def close(self) -> None:
        """Ends serving, with the valves at their safe voltage."""
        self._closed = True
        for task in self._tasks:
            task.cancel()
        await self._hang_up()
        self._apply(self._safe)

    def restart(self) -> None:
        """Has clock, counters and outputs begin anew, as when the supply of the device failed.

        Raises:
            InputError: The device has no clock.
        """
        if self._registers.clock is None:
            raise InputError("the device of this register map has no clock that could begin anew")
        self._apply(self._safe)
        self._note("start")
        shown = self._plant.taken(time.monotonic())
        newest = shown[0] if shown else self._plant.newest()
        self._zero = newest.number, newest.time_s
        last = self._commands[-1]
        self._commands.clear()
        self._commands.append(Command(0, max(last.time_s, newest.time_s), last.volts))

    @property
    def bitten(self) -> bool:
        """Whether the watchdog holds a valve at its safe voltage."""
        return bool(self._bitten)

    # Connection

    async def _listen(self) -> None:
        server = ModbusTcpServer(
            self._layout(), address=self._address, trace_packet=self._trace_packet
        )
        try:
            await server.serve_forever(background=True)
        except RuntimeError:
            host, port = self._address
            raise InputError(f"cannot listen on {host}:{port}") from None
        self._server = server
        listener: Any = server.transport  # an asyncio.Server, whatever pymodbus declares
        self._address = (self._address[0], int(listener.sockets[0].getsockname()[1]))

    async def _hang_up(self) -> None:
        server, self._server = self._server, None
        if server is not None:
            await server.shutdown()

    def _fault_changed(self, name: str, begins: bool) -> None:
        if name == "drop" and not self._closed:
            self._start(self._hang_up() if begins else self._reopen())

    async def _reopen(self) -> None:
        if self._server is None:
            await self._listen()

    def _start(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _watch(self) -> None:
        """Looks after the watchdog, and ends faults whose time is over."""
        due_s = time.monotonic()
        while True:
            now_s = time.monotonic()
            if now_s - due_s > STALL_S:
                self.stalls.append(Stall(due_s, now_s - due_s))
            due_s = now_s + POLL_S
            self.faults.present(now_s)
            self._plant.supply(self.faults.get("supply", now_s) is not None)
            starved = {
                name
                for name, fed_s in self._fed_s.items()
                if self._plant.now_s() - fed_s > self._watchdog_s
            }
            if starved - self._bitten:
                self._bitten |= starved
                self.watchdog_trips += 1
                self._apply({name: self._safe[name] for name in starved})
                self._note("watchdog")
            await asyncio.sleep(POLL_S)

    def _apply(self, volts: dict[str, float]) -> None:
        """Sets voltages, and keeps when they act where the device tells of that."""
        if self._registers.clock is None:
            self._plant.apply(volts)
            return
        time_s = self._plant.take(volts)
        self._commands.append(Command(self._commands[-1].number + 1, time_s, self._plant.volts()))

    def _note(self, cause: str) -> None:
        change = Change(time.monotonic(), self._plant.volts(), cause)
        self.history.append(change)
        rests = bool(self.rests) and self.rests[-1].ended_s is None
        if change.volts == self._safe and not rests:
            self.rests.append(Rest(change.steady_s, cause))
        elif change.volts != self._safe and rests:
            self.rests[-1].ended_s = change.steady_s

    # Registers

    def _layout(self) -> SimDevice:
        """Registers of all tables, the gaps between channels included."""
        blocks: dict[str, list[SimData]] = {}
        for table in ("holding", "input"):
            spans = [
                (channel.address, channel.address + channel.width)
                for channel in self._registers.places.values()
                if channel.table == table
            ]
            if table == "holding":
                spans += [
                    (setting.address, setting.address + len(setting.encode()))
                    for setting in self._registers.settings
                ]
            spans += [
                (span.address, span.address + span.count)
                for span in (self._registers.sample_span, self._registers.command_span)
                if span is not None and span.table == table
            ]
            first = min((start for start, _ in spans), default=0)
            last = max((end for _, end in spans), default=1)
            blocks[table] = [
                SimData(first, values=[0] * (last - first), datatype=DataType.REGISTERS)
            ]
        bits = SimData(0, values=[False] * 16, datatype=DataType.BITS)
        return SimDevice(
            self._registers.device.unit,
            ([bits], [bits], blocks["holding"], blocks["input"]),
            action=self._access,
        )

    async def _access(
        self,
        function: int,
        first: int,
        address: int,
        count: int,
        registers: list[int],
        written: list[int] | list[bool] | None,
    ) -> ExcCodes | None:
        """Carries a request out, and is late with the answer where it shall be."""
        asked_s = time.monotonic()
        clocked = self._registers.clock is not None
        look = self._plant.taken if clocked else self._plant.readings
        found: list[Sample] | dict[str, float] | None = {}
        if written is None and (not clocked or self._shows(function, address, count)):
            found = look(asked_s)
            while found is None and time.monotonic() - asked_s < LONGEST_WAIT_S:
                await asyncio.sleep(GLANCE_S)
                found = look(asked_s)
        if found is None:
            self.refused += 1
            return ExcCodes.DEVICE_BUSY
        samples = found if isinstance(found, list) else []
        values = samples[0].readings if isinstance(found, list) else found
        answer = self._answer(
            function, first, address, count, registers, written, dict(values), samples
        )
        slow = self.faults.get("slow", time.monotonic())
        if slow is not None:
            await asyncio.sleep(slow.value)
        return answer

    def _answer(
        self,
        function: int,
        first: int,
        address: int,
        count: int,
        registers: list[int],
        written: list[int] | list[bool] | None,
        values: dict[str, float],
        samples: list[Sample],
    ) -> ExcCodes | None:
        """Brings registers up to date before they are read; carries out what is written."""
        now_s = time.monotonic()
        if self.faults.get("silent", now_s) is not None:
            return ExcCodes.DEVICE_BUSY  # and the answer is not sent
        refuse = self.faults.get("exception", now_s)
        if refuse is not None:
            self.refused += 1
            return ExcCodes(int(refuse.value))
        table = _TABLES.get(function)
        if table is None:
            self.refused += 1
            return ExcCodes.ILLEGAL_FUNCTION
        self.requests += 1
        end = address + count
        shown = self._shown(now_s, values) if values else {}
        if samples:
            self._show_samples(now_s, first, registers, samples)
        if written is None:
            self._show_commands(table, first, registers)
        volts = self._plant.volts()
        for name, channel in self._registers.places.items():
            at = channel.address - first
            inside = channel.address < end and address < channel.address + channel.width
            if channel.table != table or not inside:
                continue
            if isinstance(channel, Output):
                registers[at : at + channel.width] = channel.encode(volts[name])
            elif written is None and name in shown:
                self._show(now_s, channel, shown[name], registers, at)
        if written is not None and table == "holding":
            return self._carry_out(first, address, [int(word) for word in written], registers)
        return None

    def _shows(self, function: int, address: int, count: int) -> bool:
        """Whether a read asks for samples."""
        span = self._registers.sample_span
        return (
            span is not None
            and span.table == _TABLES.get(function)
            and address < span.address + span.count
            and span.address < address + count
        )

    def _show(
        self, now_s: float, channel: ChannelBase, value: float, registers: list[int], at: int
    ) -> None:
        """Puts one reading into the registers."""
        raw = _saturated(channel, value)
        if self.faults.get("word_order", now_s) is not None:
            raw.reverse()
        registers[at : at + channel.width] = raw

    def _show_samples(
        self, now_s: float, first: int, registers: list[int], samples: list[Sample]
    ) -> None:
        """Puts all records of samples into the registers of their table, one moment's."""
        clock, span = self._registers.clock, self._registers.sample_span
        assert clock is not None and span is not None
        number0, time0_s = self._zero
        samples = [one for one in samples if one.number >= number0] or samples[:1]
        for place in range(clock.samples.records):
            # A record that is not used yet repeats the oldest.
            one = samples[min(place, len(samples) - 1)]
            at = place * clock.samples.stride - first
            _put(registers, clock.samples.counter, at, one.number - number0)
            ticks = round((one.time_s - time0_s) / clock.samples.time.tick_s)
            _put(registers, clock.samples.time, at, ticks)
            readings = self._shown(now_s, dict(one.readings))
            for name, sensor in self._registers.sampled.items():
                self._show(now_s, sensor, readings[name], registers, at + sensor.address)

    def _show_commands(self, table: str, first: int, registers: list[int]) -> None:
        """Puts all records of commands into the registers of their table."""
        clock, span = self._registers.clock, self._registers.command_span
        if clock is None or clock.commands is None or span is None or span.table != table:
            return
        newest_first = list(self._commands)[::-1]
        for place in range(clock.commands.records):
            one = newest_first[min(place, len(newest_first) - 1)]
            at = place * clock.commands.stride - first
            _put(registers, clock.commands.counter, at, one.number)
            ticks = round((one.time_s - self._zero[1]) / clock.commands.time.tick_s)
            _put(registers, clock.commands.time, at, ticks)
            for name, output in self._registers.outputs.items():
                begin = at + clock.commands.values[name]
                registers[begin : begin + output.width] = output.encode(one.volts[name])

    def _carry_out(
        self, first: int, address: int, written: list[int], registers: list[int]
    ) -> ExcCodes | None:
        """Sets the voltages that written registers stand for."""
        after = list(registers)
        after[address - first : address - first + len(written)] = written
        volts = {}
        for name, output in self._registers.outputs.items():
            touched = (
                output.address < address + len(written) and address < output.address + output.width
            )
            if not touched:
                continue
            at = output.address - first
            value = output.decode(after[at : at + output.width])
            if not math.isfinite(value):
                self.refused += 1
                return ExcCodes.ILLEGAL_VALUE
            volts[name] = min(max(value, output.range[0]), output.range[1])
        dead = self._dead()
        if dead & set(volts):
            self.refused += 1
            return ExcCodes.GATEWAY_NO_RESPONSE
        if volts:
            before = self._plant.volts()
            self._apply(volts)
            fed = set(self._safe) - dead
            self._fed_s |= dict.fromkeys(fed, self._plant.now_s())
            self._bitten -= fed
            if self._plant.volts() != before:
                self._note("write")
        return None

    def _dead(self) -> set[str]:
        """Outputs that nothing gets through to; their own watchdogs look after them."""
        fault = self.faults.get("dead_valve", time.monotonic())
        if fault is None:
            return set()
        return {fault.channel} if fault.channel else set(self._safe)

    def _shown(self, now_s: float, values: dict[str, float]) -> dict[str, float]:
        """Readings as the sensors show them, faults included."""
        frozen = self.faults.get("frozen", now_s)
        if frozen is not None:
            if not frozen.held:
                chosen = [frozen.channel] if frozen.channel else list(values)
                frozen.held.update({name: values[name] for name in chosen})
            values.update(frozen.held)
        jump = self.faults.get("jump", now_s)
        if jump is not None:
            for name in [jump.channel] if jump.channel else list(self._registers.encoders):
                values[name] += jump.value
        wild = self.faults.get("out_of_range", now_s)
        if wild is not None:
            for name in [wild.channel] if wild.channel else list(values):
                values[name] = wild.value
        return values

    def _trace_packet(self, sending: bool, data: bytes) -> bytes:
        """What goes out on the wire."""
        now_s = time.monotonic()
        if not sending:
            return data
        if self.faults.get("silent", now_s) is not None:
            return b""
        if self.faults.get("malformed", now_s) is not None:
            return self._rng.bytes(int(self._rng.integers(1, 2 * len(data))))
        return data


def _put(registers: list[int], count: Count, at: int, number: int) -> None:
    """Writes a whole number into the registers of its table."""
    begin = at + count.address
    registers[begin : begin + count.width] = count.encode(number)


def _saturated(channel: ChannelBase, value: float) -> list[int]:
    """Registers of a reading, at the end of its range where the type cannot hold it."""
    raw = (value - channel.offset) / channel.scale
    if isinstance(channel, Encoder) and channel.wrap is not None and math.isfinite(raw):
        raw = round(raw) % channel.wrap if channel.type in _RANGES else raw % channel.wrap
    if channel.type in _RANGES:
        low, high = _RANGES[channel.type]
        raw = min(max(raw, low), high)
    return channel.encode(raw * channel.scale + channel.offset)
