# SPDX-License-Identifier: Apache-2.0
"""An emulated Net F/T box: records over UDP to whoever asks, and its page of settings over HTTP."""

import contextlib
import http.server
import socket
import threading
from collections.abc import Sequence

from pneu_common.errors import InputError
from pneu_hw_bridge.phantom import rdt
from pneu_sim.hand.settings import WrenchSettings

FAULTS = ("none", "silent", "lost", "repeated", "short", "status")
"""What a box can be made to do: say nothing; lose every second record; send each one twice; cut
them short; tell that its sensor is saturated."""

PAGE = """<?xml version="1.0" encoding="UTF-8"?>
<netft><prodname>Pneu emulated Net F/T</prodname>
<runstat>0x00000000</runstat><runrate>{rate:g}</runrate>
<scfgfu>N</scfgfu><scfgtu>N-m</scfgtu><cfgcpf>{force:g}</cfgcpf><cfgcpt>{torque:g}</cfgcpt>
<comrdte>Enabled</comrdte><comrdtrate>{rate:g}</comrdtrate></netft>
"""


class Box:
    """The box. Its plant calls `poll` at each step and `send` with each sample.

    Attributes:
        settings: The sensor.
        port: Its UDP port.
        web_port: Of its page.
        fault: One of `FAULTS`.
    """

    def __init__(
        self, settings: WrenchSettings, host: str = "127.0.0.1", port: int = rdt.PORT,
        web_port: int = 0,
    ) -> None:  # fmt: skip
        """Begins to listen.

        Args:
            settings: The sensor.
            host: Address.
            port: UDP port; 0 takes a free one.
            web_port: TCP port of its page; 0 takes a free one.

        Raises:
            InputError: A port cannot be had.
        """
        self.settings = settings
        self.fault = "none"
        self._asker: tuple[str, int] | None = None
        self._left: int | None = None
        self._sequence = 0
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        text = PAGE.format(
            rate=settings.rate_hz, force=settings.counts_per_n, torque=settings.counts_per_n_m
        ).encode()
        try:
            self._socket.bind((host, port))
            self._web = http.server.ThreadingHTTPServer((host, web_port), _page(text))
        except OSError as error:
            self._socket.close()
            raise InputError(
                f"{host}:{port} or {web_port}: an emulated force sensor cannot listen there"
                f" ({error.strerror})"
            ) from None
        self._socket.setblocking(False)
        self.port: int = self._socket.getsockname()[1]
        self.web_port: int = self._web.server_address[1]
        threading.Thread(target=self._web.serve_forever, name="page", daemon=True).start()

    def poll(self) -> None:
        """Takes requests."""
        while True:
            try:
                packet, sender = self._socket.recvfrom(64)
            except BlockingIOError:
                return
            except OSError:
                continue  # the one who asked before is gone
            if len(packet) != rdt.REQUEST.size:
                continue
            header, command, count = rdt.REQUEST.unpack(packet)
            if header != rdt.HEADER:
                continue
            if command == rdt.START:
                self._asker, self._left, self._sequence = sender, count or None, 0
            elif command == rdt.STOP:
                self._asker = None

    def send(self, sample: int, values: Sequence[float]) -> None:
        """Sends a record, where somebody has asked.

        Args:
            sample: Number of the sample.
            values: Force, N, and torque, N m.
        """
        if self._asker is None:
            return
        self._sequence += 1
        status = 0
        most = [self.settings.range_n] * 3 + [self.settings.range_n_m] * 3
        if self.fault == "status" or any(abs(v) > m for v, m in zip(values, most, strict=True)):
            status = 1 << 31 | 1 << 17
        by = [self.settings.counts_per_n] * 3 + [self.settings.counts_per_n_m] * 3
        counts = tuple(
            round(min(max(v, -m), m) * b) for v, m, b in zip(values, most, by, strict=True)
        )
        record = rdt.Record(self._sequence % (1 << 32), sample % (1 << 32), status, counts)  # type: ignore[arg-type]
        packet = record.packed()
        if self.fault == "silent" or (self.fault == "lost" and self._sequence % 2):
            return
        if self.fault == "short":
            packet = packet[:20]
        for _ in range(2 if self.fault == "repeated" else 1):
            with contextlib.suppress(OSError):
                self._socket.sendto(packet, self._asker)
        if self._left is not None:
            self._left -= 1
            if not self._left:
                self._asker = None

    def close(self) -> None:
        """Ends it."""
        self._web.shutdown()
        self._web.server_close()
        self._socket.close()


def _page(text: bytes) -> type[http.server.BaseHTTPRequestHandler]:
    class Page(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            if self.path.split("?")[0] != "/netftapi2.xml":
                self.send_error(404)
                return
            self.send_response(200)
            self.send_header("Content-Type", "text/xml")
            self.send_header("Content-Length", str(len(text)))
            self.end_headers()
            self.wfile.write(text)

        def log_message(self, *_: object) -> None:
            """Says nothing."""

    return Page
