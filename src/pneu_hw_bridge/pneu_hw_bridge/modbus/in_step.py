# SPDX-License-Identifier: Apache-2.0
"""Whether answers on a serial line are those to the latest requests.

Modbus RTU numbers no transactions: an answer that comes late passes for that to the request after
it. So a line is believed only after it has been silent and two questions were answered, each by as
much as it asked for. The questions differ from those before in how much they ask for, so that what
is still on its way from earlier ones does not fit.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from itertools import cycle

from pneu_hw_bridge.modbus.client import Client, RequestError
from pneu_hw_bridge.registers.batches import Batch

SILENT_S = 0.25
"""For so long nothing must come before questions are asked."""
LONG_SILENT_S = 1.0
"""The same where a device has so few registers that questions repeat at once."""
QUESTIONS = 2
"""So many questions must be answered."""


class InStep:
    """Proves it, and sends but safe voltages until then.

    Attributes:
        questions: What is asked, each of another length.
    """

    def __init__(
        self, reads: Sequence[Batch], writes: Sequence[Batch], safe: Mapping[str, float]
    ) -> None:
        """Plans the questions.

        Args:
            reads: What is read of the device.
            writes: How voltages are written.
            safe: The safe voltages.
        """
        self._writes = writes
        self._safe = safe
        found: dict[tuple[str, int], Batch] = {}
        for batch in (*reads, *writes):
            # (ending after a channel, as devices may not tell half of one)
            for k in range(1, len(batch.channels) + 1):
                last = batch.channels[k - 1][1]
                count = last.address + last.width - batch.address
                size = -(-count // 8) if last.is_bit else count  # what answers differ in
                part = Batch(batch.table, batch.address, count, batch.channels[:k])
                found.setdefault((batch.table, size), part)
        self._silent_s = SILENT_S if len(found) > QUESTIONS else LONG_SILENT_S
        self.questions = tuple(found.values())
        self._next = cycle(self.questions)

    async def prove(self, client: Client) -> None:
        """Asks until answers belong to requests.

        Args:
            client: The line.

        Raises:
            RequestError: They do not, or the line is not silent.
        """
        for batch in self._writes:
            with suppress(RequestError):  # answered or not: no answer is believed yet
                await client.write(batch.table, batch.address, batch.encode(self._safe))
        await client.silence(self._silent_s)
        for _ in range(QUESTIONS):
            await client.read(next(self._next))
