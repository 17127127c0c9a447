# SPDX-License-Identifier: Apache-2.0
"""One Modbus connection: requests that either give checked registers or say what went wrong.

pymodbus's own retries and reconnection are off. It would repeat a request three times at three
seconds each and wait up to five minutes between connections, and an answer that cannot be decoded
shows only as silence; a valve needs to know at once.
"""

import asyncio
import math
import socket
import struct
import time
from collections.abc import Callable, Coroutine, Sequence
from typing import Any

from pymodbus.client import AsyncModbusSerialClient, AsyncModbusTcpClient
from pymodbus.exceptions import ModbusException
from pymodbus.framer import FramerType

from pneu_hw_bridge.modbus.statistics import Statistics
from pneu_hw_bridge.registers.batches import Batch
from pneu_hw_bridge.registers.schema import Device

_FUNCTIONS = {
    "read_coils": 1,
    "read_discrete_inputs": 2,
    "read_holding_registers": 3,
    "read_input_registers": 4,
    "write_coils": 15,
    "write_registers": 16,
}

PATIENCE = 8.0
"""A line that does not fall silent is given up after so many times the silence that is wanted."""


LEAST_PATIENCE_S = 0.03
"""An answer on a serial line is missed after four times the usual, but not before this, s."""


class RequestError(Exception):
    """A request that failed.

    Attributes:
        usable: Whether the connection may be used further: the device answered properly, but
            refused.
    """

    def __init__(self, message: str, usable: bool = False) -> None:
        """Keeps the reason.

        Args:
            message: What went wrong.
            usable: Whether the connection may be used further.
        """
        super().__init__(message)
        self.usable = usable


class Client:
    """One connection to one device, used from one event loop, by one request at a time.

    Attributes:
        in_step: Whether answers are those to the latest requests; on a serial line others prove it
            (`pneu_hw_bridge.modbus.in_step`).
        questions: What may be asked on a serial line to learn whether a frame was spoilt.
    """

    def __init__(self, device: Device, timeout_s: float, statistics: Statistics) -> None:
        """Prepares the connection; `connect` makes it.

        Args:
            device: The device.
            timeout_s: Longest wait for a connection or an answer, s.
            statistics: Counters that are kept up to date.
        """
        self._device = device
        self._timeout_s = timeout_s
        self._statistics = statistics
        self._heard_s = -math.inf
        self._turn = asyncio.Lock()
        self._lost = ""
        self.questions: Sequence[Batch] = ()
        self.in_step = device.transport == "tcp"
        self._modbus: AsyncModbusTcpClient | AsyncModbusSerialClient
        if device.transport == "tcp":
            self._modbus = AsyncModbusTcpClient(
                device.host,
                port=device.port,
                timeout=timeout_s,
                retries=0,
                reconnect_delay=0,
                trace_connect=self._connection_changed,
            )
        else:
            self._modbus = AsyncModbusSerialClient(
                device.serial_port,
                framer=FramerType.RTU,
                baudrate=device.baud_rate,
                parity=device.parity,
                stopbits=device.stop_bits,
                bytesize=8,
                timeout=timeout_s,
                retries=0,
                reconnect_delay=0,
                trace_connect=self._connection_changed,
                trace_packet=self._heard,
            )

    async def connect(self) -> str:
        """Makes the connection; returns why it failed, empty where it worked."""
        device = self._device
        tcp = device.transport == "tcp"
        fault = f"no connection to {f'{device.host}:{device.port}' if tcp else device.serial_port}"
        try:
            up = await self._modbus.connect()
        except Exception as error:
            # A serial port fails in the ways of its driver, which share no class of exception.
            return f"{fault} ({error})"
        if not up:
            return fault
        try:
            self._forget_when_closed()
        except (OSError, AttributeError) as error:  # a device that hangs up at once has left none
            self._modbus.close()
            return f"{fault} ({error})"
        return ""

    @property
    def usable(self) -> bool:
        """Whether another request may be sent after one that failed.

        On a serial line an answer to the failed one could come late and pass for its answer.
        """
        return self._device.transport == "tcp" and bool(self._modbus.connected)

    def close(self) -> None:
        """Closes the connection; what was not sent until now never will be."""
        self._modbus.close()

    def _forget_when_closed(self) -> None:
        """Has the kernel drop what waits to be sent once the connection ends, however it ends.

        On a cable that is cut a command stays in the kernel's queue. Unless told otherwise the
        kernel sends it when the cable is back, even long after this process was killed.
        """
        if self._device.transport != "tcp":
            return
        line = self._modbus.ctx.transport.get_extra_info("socket")
        line.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))

    async def silence(self, length_s: float) -> None:
        """Waits until nothing has come for a while; only a serial line is listened to.

        Args:
            length_s: For how long.

        Raises:
            RequestError: Something always comes.
        """
        begun_s = now_s = time.monotonic()
        while now_s < max(begun_s, self._heard_s) + length_s:
            if now_s > begun_s + PATIENCE * length_s:
                raise RequestError("the line is never silent")
            await asyncio.sleep(max(begun_s, self._heard_s) + length_s - now_s)
            now_s = time.monotonic()

    async def read(self, batch: Batch) -> list[int]:
        """Returns the registers or bits of a batch.

        Args:
            batch: What to read.

        Raises:
            RequestError: It could not be read.
        """
        return await self._read(batch, self._request)

    async def _ask(self, batch: Batch) -> list[int]:
        """Reads a batch, while it is one's turn."""
        return await self._read(batch, self._request_now)

    async def _read(self, batch: Batch, request: Callable[..., Any]) -> list[int]:
        reply = await request(
            f"read of {batch.count} at {batch.table} {batch.address}",
            self._asks(batch.table),
            batch.address,
            count=batch.count,
            device_id=self._device.unit,
        )
        return self._registers_of(batch, reply)

    def _asks(self, table: str) -> Callable[..., Any]:
        """What reads a table."""
        ask: dict[str, Callable[..., Any]] = {
            "holding": self._modbus.read_holding_registers,
            "input": self._modbus.read_input_registers,
            "coil": self._modbus.read_coils,
            "discrete": self._modbus.read_discrete_inputs,
        }
        return ask[table]

    def _registers_of(self, batch: Batch, reply: Any) -> list[int]:
        """The registers or bits in a reply, as many as were asked for."""
        if batch.table in ("coil", "discrete"):
            raw = [int(bit) for bit in reply.bits]
            wanted = -(-batch.count // 8) * 8  # replies are padded to whole bytes
        else:
            raw = list(reply.registers)
            wanted = batch.count
        if len(raw) != wanted:
            what = f"read of {batch.count} at {batch.table} {batch.address}"
            raise self._misfit(what, f"found {len(raw)}")
        self._statistics.reads += 1
        return raw[: batch.count]

    async def write(self, table: str, address: int, raw: Sequence[int]) -> None:
        """Writes registers or bits.

        Args:
            table: ``holding`` or ``coil``.
            address: First of them.
            raw: What to write.

        Raises:
            RequestError: The device did not confirm it.
        """
        what = f"write of {len(raw)} at {table} {address}"
        unit = self._device.unit
        if table == "coil":
            reply = await self._request(
                what,
                self._modbus.write_coils,
                address,
                [bool(bit) for bit in raw],
                device_id=unit,
            )
        else:
            reply = await self._request(
                what, self._modbus.write_registers, address, list(raw), device_id=unit
            )
        if (reply.address, reply.count) != (address, len(raw)):
            raise self._misfit(what, f"the device confirmed {reply.count} at {reply.address}")
        self._statistics.writes += 1

    async def _request(
        self, what: str, send: Callable[..., Any], *args: Any, **options: Any
    ) -> Any:
        """Sends one request and sorts out what came back."""
        async with self._turn:
            asides = self._asides(send, options.get("count"))
            patience_s = max(4.0 * self._statistics.reply.quantile(0.95), LEAST_PATIENCE_S)
            if not (asides and patience_s < 0.5 * self._timeout_s):
                return await self._request_now(what, send, *args, **options)
            end_s = time.monotonic() + self._timeout_s
            while True:
                reply = await self._within(
                    patience_s, self._request_now(what, send, *args, **options)
                )
                if reply is not None:
                    return reply
                # Spoilt on its way, or late? A device answers in turn: if it answers a question
                # that no late answer fits, nothing more will come to what was asked before.
                self._statistics.repeats += 1
                answered = False
                while asides and not answered and time.monotonic() < end_s:
                    answered = bool(await self._within(patience_s, self._ask(asides.pop(0))))
                if not answered or time.monotonic() > end_s:
                    self._statistics.timeouts += 1
                    self._lost = f"no good answer within {self._timeout_s:g} s"
                    raise RequestError(f"{what}: {self._lost}")

    async def _within(self, patience_s: float, asking: Coroutine[Any, Any, Any]) -> Any:
        """Waits for an answer for a while; None where none came."""
        try:
            async with asyncio.timeout(patience_s):
                return await asking
        except TimeoutError:
            return None

    def _asides(self, send: Callable[..., Any], count: int | None) -> list[Batch]:
        """Questions whose answers cannot be mistaken for that to a request, nor for one another's.

        Args:
            send: The request.
            count: How many registers it reads; None where it writes.
        """
        return [
            batch
            for batch in self.questions
            if count is None or batch.table not in send.__name__ or batch.count != count
        ]

    async def _request_now(
        self, what: str, send: Callable[..., Any], *args: Any, **options: Any
    ) -> Any:
        """Does so at once."""
        begun_s = time.monotonic()
        if not self._modbus.connected:
            raise RequestError(f"{what}: not connected")
        if self._lost:
            raise RequestError(f"{what}: {self._lost}")
        try:
            reply = await send(*args, **options)
        except (ModbusException, OSError):
            reason = "connection lost"
            if self._modbus.connected:
                reason = f"no answer within {self._timeout_s:g} s"
                self._statistics.timeouts += 1
            raise self._given_up(what, reason) from None
        if reply.isError():
            self._statistics.exceptions += 1
            code = getattr(reply, "exception_code", 0)
            raise RequestError(f"{what}: exception reply {code}", usable=True)
        # A confused device may answer another function; pymodbus hands that out as it is.
        if reply.function_code != _FUNCTIONS[send.__name__]:
            raise self._misfit(what, f"answered with function {reply.function_code}")
        took_s = time.monotonic() - begun_s
        self._statistics.request.add(took_s)
        self._statistics.reply.add(took_s)
        return reply

    def _misfit(self, what: str, reason: str) -> RequestError:
        """Counts an answer that does not fit its request, and gives the line up."""
        self._statistics.malformed += 1
        return self._given_up(what, reason)

    def _given_up(self, what: str, reason: str) -> RequestError:
        """Sees to it that nothing more is asked on a serial line, and returns the error to raise.

        Whoever comes next might take the answer to this request for its own.
        """
        if self.in_step and not self.usable:
            self._lost = reason
        return RequestError(f"{what}: {reason}")

    def _heard(self, sending: bool, data: bytes) -> bytes:
        """Takes note of when something came last."""
        if not sending:
            self._heard_s = time.monotonic()
        return data

    def _connection_changed(self, connected: bool) -> None:
        """Ends a waiting request when the connection goes; pymodbus would sit out the timeout."""
        if connected:
            return
        waiting: asyncio.Future[Any] = self._modbus.ctx.response_future
        if not waiting.done():
            waiting.set_exception(ModbusException("connection lost"))
