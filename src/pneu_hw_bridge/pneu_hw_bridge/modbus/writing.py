# SPDX-License-Identifier: Apache-2.0
"""What is written to a device: voltages, and the safe ones whatever becomes of the rest.

A voltage that has not changed is written again only every `KEEP_ALIVE_S`, which keeps the device's
own watchdog quiet.
"""

import math
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

from pneu_hw_bridge.modbus.client import Client, RequestError
from pneu_hw_bridge.modbus.statistics import Statistics
from pneu_hw_bridge.registers.batches import Batch, plan_writes
from pneu_hw_bridge.registers.schema import RegisterMap

KEEP_ALIVE_S = 0.02
"""Interval at which an unchanged voltage is written again."""

MOST_SENT = 64
"""Writes that are remembered, to be told from somebody else's."""


class WriteOwner(Protocol):
    """Who knows what to write."""

    def output(self, now_s: float) -> Mapping[str, float]:
        """Returns the voltages to write now.

        Args:
            now_s: Steady time.
        """

    def written(self, values: Mapping[str, float], stamp_ns: int) -> None:
        """Takes note of voltages that the device has confirmed.

        Args:
            values: Volts per output.
            stamp_ns: When they took effect, by the clock given to the bus.
        """


@dataclass
class _Sent:
    """Voltages that were sent, and when the device confirmed them (infinite: not yet)."""

    values: Mapping[str, float]
    confirmed_s: float = math.inf


class Writer:
    """Writes to one device over any number of connections, one after the other."""

    def __init__(
        self,
        registers: RegisterMap,
        owner: WriteOwner,
        statistics: Statistics,
        clock_ns: Callable[[], int],
        device_tells: bool,
    ) -> None:
        """Plans the requests.

        Args:
            registers: The device.
            owner: Who knows what to write.
            statistics: Counters that are kept up to date.
            clock_ns: Clock of the stamps, ns.
            device_tells: Whether the device itself tells when it took commands.
        """
        self.batches = plan_writes(registers.outputs)
        self._registers = registers
        self._owner = owner
        self._statistics = statistics
        self._clock_ns = clock_ns
        self._device_tells = device_tells
        self._written: dict[str, float] = {}
        self._written_s = -math.inf
        self._confirmed = self.safe()
        self._confirmed_s = -math.inf
        self._sent: deque[_Sent] = deque([_Sent(self.safe(), -math.inf)], maxlen=MOST_SENT)
        self._busy = False

    def safe(self) -> dict[str, float]:
        """Returns the safe voltages."""
        return {name: output.safe for name, output in self._registers.outputs.items()}

    @property
    def is_safe(self) -> bool:
        """Whether the safe voltages were written last."""
        return self._written == self.safe()

    def renew(self) -> None:
        """Has all voltages written again, on a new connection."""
        self._written_s = -math.inf

    def due_s(self) -> float:
        """Returns the steady time at which unchanged voltages are due again."""
        return self._written_s + KEEP_ALIVE_S

    async def write(self, client: Client, force: bool) -> None:
        """Writes the owner's voltages where they changed or are due.

        Args:
            client: The connection.
            force: Whether they are due in any case.

        Raises:
            RequestError: An output was not written.
        """
        now_s = time.monotonic()
        values = dict(self._owner.output(now_s))
        if force or values != self._written or now_s >= self.due_s():
            self._busy = True
            try:
                await self.send(client, values)
            finally:
                self._busy = False
            self._written, self._written_s = values, now_s

    async def overtake(self, client: Client) -> None:
        """Writes the safe voltages at once where another write is still being answered.

        So that a reading that calls for them does not wait for a slow device to confirm what was
        right before. The next `write` repeats them, in case the device takes the two in another
        order.

        Args:
            client: Another connection than that of `write`.

        Raises:
            RequestError: An output was not written.
        """
        if self._busy and not self.is_safe and self._owner.output(time.monotonic()) == self.safe():
            await self.send(client, self.safe())

    async def send(self, client: Client, values: Mapping[str, float]) -> None:
        """Writes voltages, and tells the owner with the middle of the exchange as their time.

        Where one output cannot be written all others get their safe voltages.

        Args:
            client: The connection.
            values: Volts per output.

        Raises:
            RequestError: An output was not written.
        """
        begun_s, begun_ns = time.monotonic(), self._clock_ns()
        safe = self.safe()
        written: dict[str, float] = {}
        failed: dict[tuple[str, int], RequestError] = {}
        sent = self._note(values)
        for batch in list(self.batches):
            try:
                put = await self._put(client, batch, safe if failed else values)
            except RequestError as error:
                failed[batch.table, batch.address] = error
                sent = self._note(safe)
                if not (error.usable or client.usable):
                    break
                continue
            written |= {name: put[name] for name, _ in batch.channels}
        if failed:
            for batch in list(self.batches):
                names = [name for name, _ in batch.channels]
                if any(written.get(name, safe[name]) != safe[name] for name in names):
                    await self._put(client, batch, safe)
                    written |= {name: safe[name] for name in names}
            # The next connection begins with those that can be written.
            self.batches.sort(key=lambda batch: (batch.table, batch.address) in failed)
        if written:
            took_s = time.monotonic() - begun_s
            # (of one that was held up it is known that it has them at the end)
            held_up = not self._statistics.tells_when(took_s, len(self.batches))
            after_s = took_s if held_up else 0.5 * took_s
            self._confirm(
                {**self._confirmed, **written}, begun_s + after_s, begun_ns + round(1e9 * after_s)
            )
        if failed:
            raise next((e for e in failed.values() if not e.usable), next(iter(failed.values())))
        sent.confirmed_s = time.monotonic()

    async def send_safe(self, client: Client) -> None:
        """Writes the safe voltages.

        Args:
            client: The connection.

        Raises:
            RequestError: An output was not written.
        """
        await self.send(client, self.safe())
        self._written, self._written_s = self.safe(), time.monotonic()

    async def _put(
        self, client: Client, batch: Batch, values: Mapping[str, float]
    ) -> Mapping[str, float]:
        """Writes the voltages of one request; returns those that it holds."""
        try:
            raw = batch.encode(values)
        except ValueError:
            # Limits lie within what the types hold, so this is a fault of ours: be safe.
            self._statistics.unwritable += 1
            values = self.safe()
            raw = batch.encode(values)
        await client.write(batch.table, batch.address, raw)
        return values

    def _note(self, values: Mapping[str, float]) -> _Sent:
        """Remembers voltages that are about to be sent."""
        sent = _Sent(dict(values))
        self._sent.append(sent)
        return sent

    def _confirm(self, values: dict[str, float], steady_s: float, stamp_ns: int) -> None:
        """Keeps what the device has confirmed, and tells the owner."""
        self._confirmed = values
        if self._device_tells:
            return
        alone_s, self._confirmed_s = steady_s - self._confirmed_s, steady_s
        watchdog_s = self._registers.device.watchdog_s
        if watchdog_s and watchdog_s < alone_s < math.inf:
            # Left alone for so long, the device had the safe voltages until now. (How long, only
            # the steady clock knows: the other one may have been set.)
            self._owner.written(self.safe(), stamp_ns - round(1e9 * (alone_s - watchdog_s)))
        self._owner.written(values, stamp_ns)

    def foreign(self, found: Mapping[str, float], asked_s: float) -> str:
        """Says which output holds what was never written to it; empty where none does.

        Args:
            found: What was read back, volts per output.
            asked_s: Steady time before it was asked for.
        """
        for name, value in found.items():
            own = [self.safe()[name]]  # (after the device's own watchdog)
            for sent in reversed(self._sent):
                own.append(sent.values[name])
                if sent.confirmed_s <= asked_s:
                    break
            resolution = self._registers.outputs[name].resolution
            if not any(abs(value - one) <= resolution for one in own):
                return (
                    f"{name} reads back {value:g} V where {self._confirmed[name]:g} V was"
                    " written: somebody else writes to the device"
                )
        return ""

    async def vent(self, client: Client) -> tuple[bool, str, RequestError | None]:
        """Writes the safe voltages and reads them back, of each output whatever the others do.

        Args:
            client: The connection.

        Returns:
            Whether the device holds them, what was read back, and why the connection cannot be used
            any more, where it cannot.
        """
        safe = self.safe()
        shown: dict[str, str] = {}
        lost: RequestError | None = None
        try:
            await self.send_safe(client)
        except RequestError as error:
            lost = None if error.usable else error
        verified = True
        for batch in list(self.batches):
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
        return verified, "read back " + ", ".join(shown[name] for name in safe), lost
