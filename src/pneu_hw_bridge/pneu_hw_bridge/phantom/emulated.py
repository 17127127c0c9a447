# SPDX-License-Identifier: Apache-2.0
"""An emulated device: a socket of this machine, behind which a plant moves in its own time.

The plant sends a frame at each of its steps; what is sent holds until something else is, or until
the emulated amplifier has heard nothing for so long that it lets go, as real ones do.
"""

import contextlib
import socket
import struct
import time
from collections.abc import Sequence
from pathlib import Path

from pneu_hw_bridge.phantom.device import DeviceGoneError, DeviceMissingError, Frame, Tick
from pneu_hw_bridge.priority import punctual

FRAME = struct.Struct("<qiiiI")
"""Plant time, ns; counts; what is wrong, as a bit of `FAULTS`."""
TORQUES = struct.Struct("<Iddd")
"""Number of the frame, N m."""
FAULTS = ("amplifier fault",)

OPENS_S = 0.3
"""How long the socket is tried for."""

LONGEST_RUN = 4096
"""Frames that are taken at a tick, at most."""


class EmulatedDevice:
    """The device.

    Attributes:
        path: Its socket.
        ticks: Ticks of the loop.
        missed: Of them, those that were skipped because the one before took too long.
    """

    def __init__(self, path: str | Path) -> None:
        """Opens nothing yet.

        Args:
            path: Its socket.
        """
        self.path = Path(path)
        self._socket: socket.socket | None = None
        self._number = 0
        self.ticks = self.missed = 0

    def open(self) -> None:
        """Opens it.

        Raises:
            DeviceMissingError: Nobody is there.
        """
        end_s = time.monotonic() + OPENS_S
        while True:
            link = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            try:
                link.connect(str(self.path))
                link.setblocking(False)
                self._socket = link
                return
            except OSError as error:
                link.close()
                if time.monotonic() > end_s:
                    raise DeviceMissingError(
                        f"device {self.path}: no emulated device there ({error.strerror})"
                    ) from None
                time.sleep(0.02)

    def run(self, tick: Tick, rate_hz: float) -> None:
        """Runs the loop; see `Device`.

        Args:
            tick: What is done at each tick.
            rate_hz: Ticks per second.
        """
        punctual()
        period_s = 1.0 / rate_hz
        next_s = time.monotonic()
        while True:
            torques = tick(self._newest())
            self._send([0.0, 0.0, 0.0] if torques is None else torques)
            if torques is None:
                return
            self.ticks += 1
            next_s += period_s
            left_s = next_s - time.monotonic()
            if left_s > 0.0:
                time.sleep(left_s)
            elif left_s < -period_s:
                skipped = int(-left_s / period_s)
                self.missed += skipped
                next_s += skipped * period_s

    def close(self) -> None:
        """Takes torque from the motors and closes it."""
        if self._socket is not None:
            with contextlib.suppress(DeviceGoneError):
                self._send([0.0, 0.0, 0.0])
            self._socket.close()
            self._socket = None

    def _newest(self) -> Frame | None:
        assert self._socket is not None
        newest = b""
        for _ in range(LONGEST_RUN):
            try:
                packet = self._socket.recv(FRAME.size)
            except BlockingIOError:
                break
            except OSError as error:
                raise DeviceGoneError(error.strerror or str(error)) from None
            if not packet:
                raise DeviceGoneError("it hung up")
            newest = packet
        if not newest:
            return None
        time_ns, a, b, c, wrong = FRAME.unpack(newest)
        told = ", ".join(text for bit, text in enumerate(FAULTS) if wrong >> bit & 1)
        return Frame((a, b, c), time_ns, told)

    def _send(self, torques: Sequence[float]) -> None:
        assert self._socket is not None
        self._number = (self._number + 1) % (1 << 32)
        padded = [*torques, 0.0, 0.0, 0.0][:3]
        try:
            self._socket.send(TORQUES.pack(self._number, *padded))
        except BlockingIOError:  # it is full of what is older: the plant stands still
            pass
        except OSError as error:
            raise DeviceGoneError(error.strerror or str(error)) from None
