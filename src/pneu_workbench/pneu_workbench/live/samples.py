# SPDX-License-Identifier: Apache-2.0
"""Commands and readings that came in of late, to be made a recording of; and windows as lines."""

import math
import threading
from collections import deque
from typing import Any

import numpy as np

from pneu_common.errors import InputError
from pneu_sim.rig.schema import Rig
from pneu_sim.signals import Signal
from pneu_sysid.records.recording import Recording
from pneu_sysid.sensor_units import apart
from pneu_sysid.watch import Verdict, Window

KEPT_S = 120.0
"""So much of what came in can be taken."""
FASTEST_HZ = 5000.0


class Samples:
    """What came in of late. Its methods may be called from any thread.

    Attributes:
        count: How many came in all.
    """

    def __init__(self, rig: Rig) -> None:
        """Starts empty.

        Args:
            rig: The rig.
        """
        self._rig = rig
        most = int(KEPT_S * FASTEST_HZ)
        self._of: dict[str, deque[tuple[float, float]]] = {
            name: deque(maxlen=most) for name in (*rig.commands, *rig.taps, *rig.encoders)
        }
        self._lock = threading.Lock()
        self.count = 0

    def add(self, name: str, time_s: float, value: float) -> None:
        """Notes a command or a reading.

        Args:
            name: Its name.
            time_s: When, s.
            value: What, SI; what is not finite is left out.
        """
        with self._lock:
            self.count += 1
            trace = self._of.get(name)
            if trace is None or not math.isfinite(value):
                return
            if trace and time_s <= trace[-1][0]:
                if time_s < trace[-1][0] - 1.0:  # time began anew
                    for other in self._of.values():
                        other.clear()
                else:
                    return
            trace.append((time_s, value))
            # of a command the last one before all that is kept still holds
            while len(trace) > 2 and trace[1][0] < time_s - KEPT_S:
                trace.popleft()

    def last(self, seconds: float) -> Recording:
        """What came in of late, as a recording.

        Args:
            seconds: How much of it.

        Raises:
            InputError: There is none yet.
        """
        with self._lock:
            of = {name: list(trace) for name, trace in self._of.items()}
        sensors = [of[name] for name in (*self._rig.taps, *self._rig.encoders)]
        ends = [trace[-1][0] for trace in sensors if trace]
        if not ends or not all(of[name] for name in self._rig.commands):
            raise InputError("live: no readings, or no commands, came in yet")
        begin = max(ends) - seconds
        commands, readings = {}, {}
        for name, trace in of.items():
            if not trace:
                continue
            time, values = np.array(trace).T
            first = 0
            if name in self._rig.commands:  # the one that holds when the part begins
                first = max(int(np.searchsorted(time, begin, side="right")) - 1, 0)
                commands[name] = Signal(time[first:] - begin, values[first:])
                continue
            inside = time >= begin
            readings[name] = Signal(time[inside] - begin, values[inside])
        pressures, encoders = apart(readings, self._rig.encoders)
        return Recording("live", commands, pressures, start_time_s=begin, encoders=encoders)


def told_of(window: Window, verdict: Verdict) -> dict[str, Any]:
    """A window as a line.

    Args:
        window: It.
        verdict: What the last of them say together.
    """

    def plain(values: Any) -> list[float | None]:
        return [float(v) if math.isfinite(v) else None for v in values]

    return {
        "end_s": window.end_s,
        "level": verdict.level,
        "times": verdict.times_expected if math.isfinite(verdict.times_expected) else None,
        "worst": window.worst,
        "noise": dict(zip(window.sensors, plain(window.noise), strict=True)),
        "rms": dict(zip(window.sensors, plain(window.rms), strict=True)),
        "courses": {
            name: [values.tolist() for values in course]
            for name, course in zip(window.sensors, window.courses, strict=True)
        },
    }
