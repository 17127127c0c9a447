# SPDX-License-Identifier: Apache-2.0
"""A Net F/T box's client: asks for a stream, accounts for every record, and asks anew when it ends.

It never waits: `poll` takes what has come. Records that come twice or late are dropped; those that
are missing are counted by the numbers of their neighbours.
"""

import contextlib
import socket
import urllib.request
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass, field

from pneu_common.errors import InputError
from pneu_hw_bridge.phantom import rdt

ASK_S = 0.05
"""Without a record for so long the stream is asked for again."""

UNITS_N = {"N": 1.0, "kN": 1000.0, "lbf": 4.4482216152605, "klbf": 4448.2216152605, "kgf": 9.80665}
"""Newtons of the units of force that a box may count in."""
UNITS_N_M = {
    "N-m": 1.0,
    "Nm": 1.0,
    "N-mm": 0.001,
    "Nmm": 0.001,
    "kN-m": 1000.0,
    "lbf-in": 0.1129848290276167,
    "lbf-ft": 1.3558179483314004,
    "kgf-cm": 0.0980665,
}
"""Newton metres of its units of torque."""

HALF = 1 << 31


@dataclass(frozen=True)
class Calibration:
    """What a box's counts mean.

    Attributes:
        counts_per_n: Per newton.
        counts_per_n_m: Per newton metre.
        rate_hz: Records per second.
        sample_hz: Samples per second, which the box numbers.
    """

    counts_per_n: float
    counts_per_n_m: float
    rate_hz: float
    sample_hz: float


def read_calibration(host: str, port: int = 80, timeout_s: float = 2.0) -> Calibration:
    """Reads what a box's counts mean from its page ``netftapi2.xml``.

    Args:
        host: Address of the box.
        port: Of its web server.
        timeout_s: How long to wait.

    Raises:
        InputError: The page cannot be had, or does not say.
    """
    url = f"http://{host}:{port}/netftapi2.xml"
    try:
        with urllib.request.urlopen(url, timeout=timeout_s) as answer:
            text = answer.read(1 << 20)
        root = ElementTree.fromstring(text)
    except (OSError, ValueError, ElementTree.ParseError) as error:
        raise InputError(
            f"{url}: the force sensor's configuration cannot be read ({error})"
        ) from None
    told = {element.tag.rsplit("}", 1)[-1]: (element.text or "").strip() for element in root.iter()}

    def number(name: str) -> float:
        try:
            value = float(told[name])
        except (KeyError, ValueError):
            found = told.get(name)
            raise InputError(f"{url}: {name}: found {found!r}, a number is needed") from None
        if not 0.0 < value < float("inf"):
            raise InputError(f"{url}: {name}: found {value:g}, allowed is above 0")
        return value

    def unit(name: str, known: dict[str, float]) -> float:
        found = told.get(name, "")
        if found not in known:
            raise InputError(f"{url}: {name}: found {found!r}, known are {', '.join(known)}")
        return known[found]

    return Calibration(
        number("cfgcpf") / unit("scfgfu", UNITS_N),
        number("cfgcpt") / unit("scfgtu", UNITS_N_M),
        number("comrdtrate"),
        number("runrate") if "runrate" in told else number("comrdtrate"),
    )


@dataclass
class Received:
    """What became of packets.

    Attributes:
        records: Taken.
        lost: Missing between records that came.
        repeated: That came twice.
        late: That came after later ones.
        malformed: That are no records.
        asked: Times the stream was asked for.
    """

    records: int = 0
    lost: int = 0
    repeated: int = 0
    late: int = 0
    malformed: int = 0
    asked: int = 0


@dataclass
class NetFt:
    """The client.

    Attributes:
        host: Address of the box.
        port: Its UDP port.
        received: What became of packets.
        error: What the network says, while it says it.
    """

    host: str
    port: int = rdt.PORT
    received: Received = field(default_factory=Received)
    error: str = ""

    def __post_init__(self) -> None:
        self._socket: socket.socket | None = None
        self._asked_s = self._heard_s = float("-inf")
        self._last: int | None = None

    def poll(self, now_s: float) -> list[rdt.Record]:
        """Takes the records that have come, in order; asks for the stream where none come.

        Args:
            now_s: The steady time.
        """
        if max(self._heard_s, self._asked_s) + ASK_S < now_s:
            self._ask(now_s)
        out: list[rdt.Record] = []
        while self._socket is not None:
            try:
                packet = self._socket.recv(64)
            except BlockingIOError:
                break
            except OSError as error:  # nobody listens there, or the network is gone
                self.error = error.strerror or str(error)
                break
            record = rdt.unpacked(packet)
            if record is None:
                self.received.malformed += 1
            elif self._new(record.sequence):
                self._heard_s, self.error = now_s, ""
                self.received.records += 1
                out.append(record)
        return out

    def close(self) -> None:
        """Ends the stream."""
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.send(rdt.request(rdt.STOP))
            self._socket.close()
            self._socket = None

    def _ask(self, now_s: float) -> None:
        """Asks for a stream that begins anew."""
        self._asked_s, self._last = now_s, None
        try:
            if self._socket is None:
                self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
                self._socket.setblocking(False)
                self._socket.connect((self.host, self.port))
            self._socket.send(rdt.request(rdt.START))
            self.received.asked += 1
        except OSError as error:
            self.error = error.strerror or str(error)

    def _new(self, sequence: int) -> bool:
        """Whether a record is later than all before, and counts what is missing between."""
        if self._last is None:
            self._last = sequence
            return True
        ahead = (sequence - self._last) % (1 << 32)
        if ahead == 0:
            self.received.repeated += 1
            return False
        if ahead >= HALF:
            self.received.late += 1
            return False
        self.received.lost += ahead - 1
        self._last = sequence
        return True
