# SPDX-License-Identifier: Apache-2.0
"""A Modbus TCP proxy between a bridge and its device that delays, drops, garbles and lies."""

import asyncio
import random
import threading

HEADER = 7
"""Bytes before the function code of a Modbus TCP frame."""


def _wrong_id(frame, rng):
    return bytes([frame[0], frame[1] ^ (1 + rng.randrange(255))]) + frame[2:]


def _wrong_unit(frame, rng):
    return frame[:6] + bytes([frame[6] ^ (1 + rng.randrange(255))]) + frame[7:]


def _wrong_function(frame, rng):
    return frame[:7] + bytes([(frame[7] + 1 + rng.randrange(100)) % 128]) + frame[8:]


def _short(frame, rng):
    return frame[: rng.randrange(1, len(frame))]


def _random(frame, rng):
    return rng.randbytes(rng.randrange(1, 300))


def _garbled(frame, rng):
    body = bytearray(frame)
    for _ in range(3):
        body[rng.randrange(len(body))] ^= 1 + rng.randrange(255)
    return bytes(body)


def _doubled(frame, rng):
    return frame + frame


def _refused(frame, rng):
    return frame[:4] + bytes([0, 3, frame[6], frame[7] | 0x80, rng.choice([1, 2, 4, 6, 11])])


LIES = {
    "a reply of another transaction": _wrong_id,
    "a reply of another unit": _wrong_unit,
    "a reply of another function": _wrong_function,
    "half a reply": _short,
    "random bytes": _random,
    "a garbled reply": _garbled,
    "every reply twice": _doubled,
    "exception replies": _refused,
}
"""By name what becomes of a reply."""


class Proxy:
    """The proxy, in a thread of its own; what it does may be changed while it runs.

    Attributes:
        port: Where it listens.
        reply_s: How late replies are, s.
        request_s: How late requests are, s.
        lie: What becomes of replies; None leaves them.
        swallow: Whether replies are kept back for good.
        hold: Whether requests wait until this is over.
        most: How many connections are served at a time; others wait unanswered.
        ousts: Whether a new connection ends those before.
    """

    def __init__(self, device_port, seed=0):
        self.device_port = device_port
        self.reply_s = self.request_s = 0.0
        self.lie = None
        self.swallow = self.hold = False
        self.most, self.ousts = 1000, False
        self._rng = random.Random(seed)
        self._lines = set()
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        self.port = asyncio.run_coroutine_threadsafe(self._open(), self._loop).result(10.0)

    async def _open(self):
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", 0)
        return self._server.sockets[0].getsockname()[1]

    async def _serve(self, reader, writer):
        try:
            while len(self._lines) >= self.most:
                await asyncio.sleep(0.01)
            if self.ousts:
                self.hang_up()
            self._lines.add(writer)
            device = await asyncio.open_connection("127.0.0.1", self.device_port)
            ways = [
                asyncio.ensure_future(self._carry(reader, device[1], replies=False)),
                asyncio.ensure_future(self._carry(device[0], writer, replies=True)),
            ]
            try:
                await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
            finally:
                for way in ways:
                    way.cancel()
                device[1].close()
        except (OSError, asyncio.CancelledError):  # (streams log it if it is cancelled)
            pass
        finally:
            self._lines.discard(writer)
            writer.close()

    async def _carry(self, source, target, replies):
        """Carries frames in their order, each as late as it is to be, without holding others up."""
        queue = asyncio.Queue()

        async def deliver():
            while True:
                due_s, frame = await queue.get()
                await asyncio.sleep(max(due_s - self._loop.time(), 0.0))
                while self.hold and not replies:
                    await asyncio.sleep(0.01)
                if target.is_closing():
                    return
                target.write(frame)

        delivering = asyncio.ensure_future(deliver())
        try:
            while True:
                head = await source.readexactly(HEADER - 1)
                frame = head + await source.readexactly(int.from_bytes(head[4:6], "big"))
                if replies and self.swallow:
                    continue
                if replies and self.lie is not None:
                    frame = self.lie(frame, self._rng)
                late_s = self.reply_s if replies else self.request_s
                queue.put_nowait((self._loop.time() + late_s, frame))
        except (asyncio.IncompleteReadError, OSError):
            return
        finally:
            delivering.cancel()

    def hang_up(self):
        """Closes all connections."""
        for line in list(self._lines):
            self._loop.call_soon_threadsafe(line.transport.abort)

    def heal(self):
        """Lets everything through again."""
        self.reply_s = self.request_s = 0.0
        self.lie, self.swallow, self.hold, self.most = None, False, False, 1000
        self.ousts = False

    def close(self):
        """Ends the proxy."""

        async def end():
            self._server.close()
            others = asyncio.all_tasks() - {asyncio.current_task()}
            for task in others:
                task.cancel()
            await asyncio.gather(*others, return_exceptions=True)

        asyncio.run_coroutine_threadsafe(end(), self._loop).result(5.0)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(5.0)
        self._loop.close()
