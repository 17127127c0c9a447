# SPDX-License-Identifier: Apache-2.0
"""Modbus devices whose behaviour can be changed, at a socket or at the end of a serial line."""

import asyncio
import os
import random
import struct
import threading
import time
import tty
from collections import deque
from contextlib import contextmanager, suppress

from pymodbus.client import AsyncModbusTcpClient
from pymodbus.constants import ExcCodes
from pymodbus.framer import FramerType
from pymodbus.server import ModbusSerialServer, ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from pneu_hw_bridge.modbus.bus import ModbusBus
from pneu_hw_bridge.registers.load import load_register_map

PRESSURES = [6.0e5, 3.0e5, 2.5e5, 2.0e5, 1.0e5]


class Owner:
    """Keeps what the bus tells, and says what to write."""

    def __init__(self):
        self.volts = {"voltage": 0.0}
        self.samples = []
        self.applied = []
        self.faults = []

    def output(self, now_s):
        return self.volts

    def readings(self, values, steady_s, stamp_ns):
        self.samples.append((values, steady_s, stamp_ns))

    def written(self, values, stamp_ns):
        self.applied.append((values, stamp_ns))

    def bus(self, fault):
        self.faults.append(fault)

    def takes(self, mostly_s, usually_s):
        self.takes_s = mostly_s, usually_s


class Server:
    """A pymodbus device in a thread, whose behaviour can be changed while it runs."""

    def __init__(self):
        self.written = []
        self.volts = {}
        self.reads = []
        self.delay_s = 0.0
        self.refuse = None
        self.refused = set()  # of these addresses writes alone are refused
        self.mute = set()  # and of these they are not answered
        self.hidden = set()  # these cannot be read
        self.set_up_at = None  # a write here ends the refusals
        self.loop = asyncio.new_event_loop()
        self.server = None
        self.port = 0
        threading.Thread(target=self.loop.run_forever, daemon=True).start()

    def device(self):
        words = list(struct.unpack(">10H", struct.pack(">5f", *PRESSURES)))
        bits = SimData(0, values=[False] * 16, datatype=DataType.BITS)
        holding = SimData(100, values=[0] * 12, datatype=DataType.REGISTERS)
        inputs = SimData(0, values=words, datatype=DataType.REGISTERS)
        return SimDevice(1, ([bits], [bits], [holding], [inputs]), action=self.access)

    async def access(self, function, first, address, count, registers, written):
        if self.delay_s:
            await asyncio.sleep(self.delay_s)
        if self.refuse is not None:
            return self.refuse
        if not written and address in self.hidden:
            return ExcCodes.ILLEGAL_ADDRESS
        if written and address == self.set_up_at:
            self.refused.clear()
        if written and address in self.mute:
            await asyncio.sleep(0.5)
            return ExcCodes.DEVICE_FAILURE
        if written and address in self.refused:
            return ExcCodes.DEVICE_FAILURE
        if written:
            volts = struct.unpack(">f", struct.pack(">2H", *written))[0]
            self.written.append((time.monotonic(), volts))
            self.volts[address] = volts
        else:
            self.reads.append((function, address, count))
        return None

    def call(self, coroutine):
        return asyncio.run_coroutine_threadsafe(coroutine, self.loop).result(5.0)

    def open(self):
        async def start():
            self.server = ModbusTcpServer(self.device(), address=("127.0.0.1", self.port))
            await self.server.serve_forever(background=True)
            self.port = self.server.transport.sockets[0].getsockname()[1]

        self.call(start())

    def close(self):
        self.call(self.server.shutdown())

    def end(self):
        self.loop.call_soon_threadsafe(self.loop.stop)


@contextmanager
def open_bus(port, owner, **options):
    bus = ModbusBus(load_register_map("generic_plc", {"port": port}), owner, **options)
    bus.start()
    try:
        yield bus
    finally:
        bus.stop()


async def rival(port, over):
    """Another Modbus master, which writes 9 V every 5 ms until an event is set."""
    other = AsyncModbusTcpClient("127.0.0.1", port=port)
    await other.connect()
    while not over.is_set():
        high, low = struct.unpack(">2H", struct.pack(">f", 9.0))
        await other.write_registers(100, [high, low], device_id=1)
        await asyncio.sleep(0.005)
    other.close()


@contextmanager
def serial_pair(late_s=(0.0, 0.0), spoilt=0.0):
    """Two serial ports that are connected to each other; what the first gets may come late.

    Args:
        late_s: Between how many seconds late each answer is.
        spoilt: Share of what is sent of which a byte is changed.
    """
    rng = random.Random(5)
    ends = [os.openpty() for _ in range(2)]
    stop = threading.Event()
    for controller, terminal in ends:
        tty.setraw(terminal)
        os.set_blocking(controller, False)

    def carry(source, target):
        waiting = deque()
        while not stop.is_set():
            now_s = time.monotonic()
            with suppress(BlockingIOError):
                late = rng.uniform(*late_s) if target == ends[0][0] else 0.0
                told = bytearray(os.read(source, 4096))
                if rng.random() < spoilt:
                    told[rng.randrange(len(told))] ^= 1 << rng.randrange(8)
                waiting.append((now_s + late, bytes(told)))
            while waiting and waiting[0][0] <= now_s:
                os.write(target, waiting.popleft()[1])
            time.sleep(0.0005)

    threads = [
        threading.Thread(target=carry, args=(ends[a][0], ends[1 - a][0]), daemon=True)
        for a in range(2)
    ]
    for thread in threads:
        thread.start()
    try:
        yield tuple(os.ttyname(terminal) for _, terminal in ends)
    finally:
        stop.set()
        for thread in threads:
            thread.join(1.0)
        for controller, terminal in ends:
            os.close(controller)
            os.close(terminal)


@contextmanager
def serial_bus(owner, late_s=(0.0, 0.0), spoilt=0.0, **options):
    """A bus on a serial line, and the device at its other end."""
    server = Server()
    with serial_pair(late_s, spoilt) as (ours, theirs):

        async def start():
            server.server = ModbusSerialServer(
                server.device(),
                framer=FramerType.RTU,
                port=theirs,
                baudrate=115200,
                parity="N",
            )
            await server.server.serve_forever(background=True)

        server.call(start())
        registers = load_register_map(
            "generic_plc", {"transport": "rtu", "serial_port": ours, "parity": "N"}
        )
        bus = ModbusBus(registers, owner, period_s=0.02, **options)
        bus.start()
        try:
            yield bus, server
        finally:
            bus.stop()
            server.close()
            server.end()
