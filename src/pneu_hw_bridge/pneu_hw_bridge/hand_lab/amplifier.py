# SPDX-License-Identifier: Apache-2.0
"""An arm's emulated amplifier: takes torques, tells counts, and lets go when nobody talks to it."""

import contextlib
import socket
from pathlib import Path

from pneu_common.errors import InputError
from pneu_hw_bridge.phantom.emulated import FRAME, TORQUES

WATCHDOG_S = 0.005
"""Without a word for so long the motors get no torque."""

FAULTS = ("none", "gone", "frozen", "jump", "amplifier")
"""What an amplifier can be made to do: hang up and take no calls, send no more frames, send counts
that jump by a quarter of a thousand, report that it is faulty."""


class Amplifier:
    """The amplifier. Its plant calls `take` before each step and `tell` after it.

    Attributes:
        path: Its socket.
        fault: One of `FAULTS`.
        torque_n_m: What the motors get.
        let_go: Times that the watchdog took the torque.
        heard_s: When a torque came last, by the steady clock.
        zero_s: Since when the motors have no torque, by the steady clock; None while they have.
    """

    def __init__(self, path: str | Path) -> None:
        """Begins to listen.

        Args:
            path: Its socket, which is made.

        Raises:
            InputError: It cannot be made.
        """
        self.path = Path(path)
        self.fault = "none"
        self.torque_n_m = [0.0, 0.0, 0.0]
        self.let_go = 0
        self.heard_s = float("-inf")
        self.zero_s: float | None = float("-inf")
        self._link: socket.socket | None = None
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            if self._answers():
                raise InputError(f"{self.path}: another emulated device listens there")
            with contextlib.suppress(FileNotFoundError):
                self.path.unlink()
            self._listener.bind(str(self.path))
            self._listener.listen(1)
            self._listener.setblocking(False)
        except OSError as error:
            self._listener.close()
            raise InputError(
                f"{self.path}: an emulated device cannot listen there ({error.strerror})"
            ) from None

    def take(self, now_s: float) -> list[float]:
        """Takes torques.

        Args:
            now_s: The steady time.

        Returns:
            Torques of the motors, N m.
        """
        if self.fault == "gone":
            self._hang_up()
        elif self._link is None:
            with contextlib.suppress(BlockingIOError):
                self._link = self._listener.accept()[0]
                self._link.setblocking(False)
        if self._link is not None:
            self._hear(now_s)
        if self._link is None or now_s - self.heard_s > WATCHDOG_S:
            self.let_go += any(self.torque_n_m)
            self.torque_n_m = [0.0, 0.0, 0.0]
        given = [0.0, 0.0, 0.0] if self.fault == "amplifier" else self.torque_n_m
        if any(given):
            self.zero_s = None
        elif self.zero_s is None:
            self.zero_s = now_s
        return list(given)

    def tell(self, counts: tuple[int, int, int], plant_ns: int) -> None:
        """Tells counts.

        Args:
            counts: Of the encoders.
            plant_ns: When they were read, of the plant's time.
        """
        if self._link is None or self.fault == "frozen":
            return
        if self.fault == "jump":
            counts = (counts[0] + 250, counts[1], counts[2])
        wrong = 1 if self.fault == "amplifier" else 0
        try:
            self._link.send(FRAME.pack(plant_ns, *counts, wrong))
        except BlockingIOError:  # its reader is behind: it reads what is older first
            pass
        except OSError:
            self._hang_up()

    def close(self) -> None:
        """Ends it."""
        self._hang_up()
        self._listener.close()
        with contextlib.suppress(OSError):
            self.path.unlink()

    def _hear(self, now_s: float) -> None:
        while self._link is not None:
            try:
                packet = self._link.recv(TORQUES.size)
            except BlockingIOError:
                return
            except OSError:
                packet = b""
            if len(packet) != TORQUES.size:
                self._hang_up()
                return
            _, *torques = TORQUES.unpack(packet)
            self.torque_n_m, self.heard_s = torques, now_s

    def _hang_up(self) -> None:
        if self._link is not None:
            self._link.close()
            self._link = None
        self.torque_n_m = [0.0, 0.0, 0.0]

    def _answers(self) -> bool:
        """Whether somebody listens on the socket already."""
        with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as probe:
            try:
                probe.connect(str(self.path))
                return True
            except OSError:
                return False
