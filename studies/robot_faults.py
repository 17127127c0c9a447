# SPDX-License-Identifier: Apache-2.0
"""Faults of a robot: a Kokoro behind Modbus whose arm a controller swings, one fault after another.

Times are those of the lab: from the fault to the moment from which on both valves have and keep
their safe voltage.
"""

import time
from collections.abc import Iterator
from pathlib import Path

from tests.bridges import safe_since
from tests.measured import MachineStalledError
from tests.robots import FAULTS, KokoroRig, kokoro_lab

LOOK_S = 0.8
"""So long after a fault it is looked at what the device has."""
ATTEMPTS = 3
"""A fault that could not be brought about is tried so often."""


def tries_of(folder: Path, count: int) -> Iterator[tuple[str, list[float], str]]:
    """Tries every fault.

    Args:
        folder: For files.
        count: How often each is tried.

    Yields:
        The fault, seconds until both valves were safe, and what went wrong besides.
    """
    folder.mkdir()
    with kokoro_lab(folder) as lab:
        for name, (begin, encoder) in FAULTS.items():
            seconds: list[float] = []
            wrong = ""
            for left in reversed(range(count * ATTEMPTS)):
                lab.ask("clear")
                try:
                    with KokoroRig(lab, **encoder) as rig:
                        begun_s = begin(rig)
                        time.sleep(LOOK_S)
                        safe = not any(lab.ask("status")["volts"].values())
                        seconds.append(safe_since(lab)[0] - begun_s if safe else float("inf"))
                except (TimeoutError, MachineStalledError) as error:
                    wrong = "" if left else str(error)
                if len(seconds) == count:
                    break
            yield name, seconds, wrong
