# SPDX-License-Identifier: Apache-2.0
"""Faults of the line to the device: late answers, spoilt frames, another master.

Here it does not count how soon valves are safe but whether anything wrong is ever applied.
"""

import asyncio
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

from tests.modbus_devices import Owner, Server, open_bus, rival, serial_bus

LATE_S = 4.0
SPOILT_S = 20.0
RIVAL_S = 4.0
MOST_LOSSES = 60.0
"""Valves may open once a second; so often in a minute a line may be given up."""


@dataclass(frozen=True)
class LineFault:
    """One kind of fault.

    Attributes:
        name: What happens.
        counts: What the number is that it gives.
        most: The most that is allowed.
        once: Tries it once and returns the number.
    """

    name: str
    counts: str
    most: float
    once: Callable[[], float]


def answers_late() -> float:
    """Answers on a serial line come 0.3 to 0.5 s late: how often the valve was opened."""
    owner = Owner()
    owner.volts = {"voltage": 5.5}
    with serial_bus(owner, (0.3, 0.5), timeout_s=0.1) as (_, server):
        time.sleep(LATE_S)
    return float(sum(volts != 0.0 for _, volts in server.written))


def frames_spoilt() -> float:
    """One frame of fifty on a serial line is spoilt: how often a minute the line was given up."""
    owner = Owner()
    with serial_bus(owner, spoilt=0.02, timeout_s=0.15) as (bus, _):
        end_s = time.monotonic() + 10.0
        while not owner.samples and time.monotonic() < end_s:
            time.sleep(0.01)
        told = len(owner.faults)
        end_s, k = time.monotonic() + SPOILT_S, 0
        while time.monotonic() < end_s:
            owner.volts = {"voltage": k % 200 / 32.0}
            k += 1
            bus.poke()
            time.sleep(0.02)
        found = owner.faults[told:]
    return 60.0 / SPOILT_S * sum(bool(b) and not a for a, b in pairwise(["", *found]))


def another_master() -> float:
    """Another master writes 9 V every 5 ms to a valve that is to be safe: share of time open, %."""
    server, owner, over = Server(), Owner(), threading.Event()
    server.open()
    try:
        with open_bus(server.port, owner):
            thread = threading.Thread(
                target=lambda: asyncio.run(rival(server.port, over)), daemon=True
            )
            thread.start()
            time.sleep(1.0)
            if "somebody else writes" not in owner.faults[-1]:
                raise AssertionError("it is not told that somebody else writes")
            begun = len(server.written)
            time.sleep(RIVAL_S)
            told = server.written[begun:]
            over.set()
            thread.join(2.0)
    finally:
        server.close()
        server.end()
    open_s = sum(b[0] - a[0] for a, b in pairwise(told) if a[1] == 9.0)
    return 100.0 * open_s / (told[-1][0] - told[0][0])


FAULTS = [
    LineFault("serial: answers 0.3 to 0.5 s late", "openings", 0.0, answers_late),
    LineFault(
        "serial: 2 % of frames spoilt", "losses of the line a minute", MOST_LOSSES, frames_spoilt
    ),
    LineFault("another master writes 9 V every 5 ms", "% of the time open", 50.0, another_master),
]
