# SPDX-License-Identifier: Apache-2.0
"""What the page knows of a running graph, and what it may do to it.

The node that listens, the recorder and the stop are processes of their own: what goes wrong in one
of them does not hold up the page, and a stop waits for nothing else.
"""

import os
import subprocess
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_common.entry import COMMAND
from pneu_common.errors import InputError
from pneu_graph.bag.recorder_process import Recorder
from pneu_sim.rig import load_rig
from pneu_sysid.sensor_units import encoder_units, unit_of
from pneu_sysid.tasks.child import Child

Floats = NDArray[np.float64]

SHOWN_S = 30.0
"""So much of what came in is shown."""
STALE_S = 5.0
"""A status that was not heard for so long is told as gone."""
RATE_HZ = 250.0
"""Rate at which model and sensors are compared; of faster ones readings are left out."""
LISTENER = "pneu_workbench.nodes.listener"


@dataclass
class Status:
    """What a node told of itself.

    Attributes:
        level: 0 is well, 1 a warning, 2 an error, 3 stale.
        message: In words.
        heard_s: When, by the monotonic clock, s.
    """

    level: int
    message: str
    heard_s: float


@dataclass
class Course:
    """What came in of one sensor.

    Attributes:
        unit: Unit, SI.
        noise: Its noise floor; NaN until it is known.
        rms: Error of the newest window.
        parts: Times, measured and model of each window.
    """

    unit: str
    noise: float = float("nan")
    rms: float = float("nan")
    parts: deque[tuple[Floats, Floats, Floats]] = field(default_factory=deque)


class Live:
    """A running graph. Its methods may be called from any thread.

    Attributes:
        rig: Rig file of the model alongside; empty while nothing is listened to.
        statuses: What nodes tell of themselves.
        times: Error over that expected, of late; None until it is known.
        level: 0 as expected, 1 worse, 2 the model does not describe the rig, -1 not known yet.
        worst: Sensor where the error is largest.
        samples: How many came in.
        fault: What is wrong.
        stopped: What the last stop was answered with, line by line.
        namespace: Where the rig is on the graph; empty until that is known.
    """

    def __init__(self, folder: Path, changed: Callable[[], None]) -> None:
        """Knows nothing yet.

        Args:
            folder: Where recordings go.
            changed: Called from a thread when anything has changed.
        """
        self._folder, self._changed = folder, changed
        self._lock = threading.RLock()
        self._child: Child | None = None
        self._recorder: Recorder | None = None
        self._taken: Callable[[str], None] | None = None
        self._count = 0
        self.stopped: list[str] = []
        self._forget()

    def _forget(self) -> None:
        self.rig, self.fault, self.worst, self.namespace = "", "", "", ""
        self.statuses: dict[str, Status] = {}
        self.times: float | None = None
        self.level, self.samples = -1, 0
        self._origin_s = 0.0
        self.courses: dict[str, Course] = {}
        self.commands: dict[str, deque[tuple[float, float]]] = {}

    # ---- listening --------------------------------------------------------------------------

    def listen(self, rig_file: Path, namespace: str = "") -> None:
        """Runs a model alongside what comes in.

        Args:
            rig_file: Its rig file.
            namespace: Where the rig's relative topics are; empty is the one where they all are.

        Raises:
            InputError: It is wrong.
        """
        rig = load_rig(rig_file)
        self.end()
        units = encoder_units(rig)
        with self._lock:
            self._forget()
            self.rig = str(rig_file)
            names = (*rig.taps, *rig.encoders)
            self.courses = {name: Course(unit_of(name, units).si) for name in names}
            self.commands = {name: deque() for name in rig.commands}
            first = {"rig": self.rig, "rate_hz": RATE_HZ, "namespace": namespace}
            self._child = Child(LISTENER, first, self._heard, self._gone)
        self._changed()

    def end(self) -> None:
        """Listens no longer; what came in stays to be seen."""
        with self._lock:
            child, self._child = self._child, None
        if child is not None:
            child.end()
            child.wait()
            self._changed()

    @property
    def listening(self) -> bool:
        """Whether it is listened to."""
        return self._child is not None

    @property
    def recording(self) -> str:
        """Folder of the bag that is recorded; empty while none is."""
        recorder = self._recorder
        return "" if recorder is None else str(recorder.bag)

    def take(self, seconds: float, then: Callable[[str], None]) -> None:
        """Makes a bag of what came in of late.

        Args:
            seconds: How much of it.
            then: Called from a thread with its path.

        Raises:
            InputError: Nothing is listened to.
        """
        with self._lock:
            if self._child is None:
                raise InputError("live: nothing is listened to")
            self._taken = then
            self._count += 1
            to = self._folder / f"live_{self._count}_{os.getpid()}.mcap"
            self._child.say({"take": seconds, "to": str(to)})

    def _heard(self, told: dict[str, Any]) -> None:
        then: Callable[[str], None] | None = None
        with self._lock:
            if "window" in told:
                self._window(told["window"])
            elif "commands" in told:
                for name, samples in told["commands"].items():
                    trace = self.commands[name]
                    trace.extend((float(t), float(v)) for t, v in samples)
                    old = sum(at < trace[-1][0] - SHOWN_S for at, _ in trace)
                    for _ in range(old - 1):  # the last of them holds where what is shown begins
                        trace.popleft()
                return  # shown with the next window
            elif "status" in told:
                now = time.monotonic()
                for name, level, message in told["status"]:
                    self.statuses[name] = Status(int(level), message, now)
            elif "alive" in told:
                if told["alive"] == self.samples:
                    return
                self.samples = told["alive"]
            elif "namespace" in told:
                self.namespace, self.fault = told["namespace"], ""
            elif "taken" in told:
                then, self._taken = self._taken, None
            elif "fault" in told:
                self.fault = told["fault"]
        self._changed()
        if then is not None:
            then(told["taken"])

    def _window(self, window: dict[str, Any]) -> None:
        self.level, self.worst = window["level"], window["worst"]
        self.times, self.fault = window["times"], ""
        for name, (time_s, measured, model) in window["courses"].items():
            course = self.courses[name]
            noise, rms = window["noise"][name], window["rms"][name]
            course.noise = float("nan") if noise is None else noise
            course.rms = float("nan") if rms is None else rms
            parts = course.parts
            times = np.array(time_s)
            if parts and times.size and parts[-1][0].size and times[0] < parts[-1][0][-1]:
                parts.clear()  # time began anew
            if times.size and not any(c.parts for c in self.courses.values()):
                self._origin_s = float(times[0])
            parts.append((times, np.array(measured), np.array(model)))
            while len(parts) > 1 and window["end_s"] - parts[0][0][-1:].max(initial=0) > SHOWN_S:
                parts.popleft()

    def _gone(self, status: int, told: bool) -> None:
        with self._lock:
            if not told:
                self._child = None
                self.fault = self.fault or f"the listening node ended with status {status}"
        self._changed()

    # ---- what there is to see ---------------------------------------------------------------

    def shown(self) -> tuple[dict[str, tuple[Floats, Floats, Floats, float]], dict[str, Floats]]:
        """What came in of late: by sensor times, measured, model and noise; by command (2, n).

        Times count from the first window.
        """
        with self._lock:
            sensors = {}
            for name, course in self.courses.items():
                parts = list(course.parts) or [(np.zeros(0),) * 3]
                time_s, measured, model = (np.concatenate(of) for of in zip(*parts, strict=True))
                sensors[name] = (time_s - self._origin_s, measured, model, course.noise)
            commands = {
                name: np.array(trace, dtype=float).reshape(-1, 2).T - [[self._origin_s], [0.0]]
                for name, trace in self.commands.items()
            }
        return sensors, commands

    def state(self) -> list[tuple[str, int, str]]:
        """What nodes tell of themselves, the worst first: name, level, words."""
        with self._lock:
            statuses = list(self.statuses.items())
        now = time.monotonic()
        told = [
            (name, s.level, s.message)
            if now - s.heard_s < STALE_S
            else (name, 3, f"not heard for {now - s.heard_s:.0f} s")
            for name, s in statuses
        ]
        return sorted(told, key=lambda entry: (-entry[1], entry[0]))

    # ---- what it may do ---------------------------------------------------------------------

    def record(self) -> None:
        """Begins a bag of all topics, with the rig file in it.

        Raises:
            InputError: One is recorded already.
        """
        with self._lock:
            if self._recorder is not None:
                raise InputError("recording: one goes on already")
            self._count += 1
            bag = self._folder / f"recorded_{self._count}_{os.getpid()}"
            self._recorder = Recorder(bag, self.rig)
        self._changed()

    def stop_recording(self, then: Callable[[str], None] | None = None) -> None:
        """Ends the bag.

        Args:
            then: Called from a thread with its folder, once it is whole.
        """
        with self._lock:
            recorder, self._recorder = self._recorder, None
        if recorder is None:
            return

        def ended(there: bool) -> None:
            if not there:
                self.fault = "recording: nothing came in that could be written"
            elif then is not None:
                then(str(recorder.bag))
            self._changed()

        recorder.end(ended)
        self._changed()

    def e_stop(self) -> None:
        """Stops all bridges, those of this machine first; `stopped` tells what they answered."""
        self.stopped = ["stopping all bridges"]
        self._changed()

        def stop() -> None:
            done = subprocess.run(
                [*COMMAND, "stop", "--reason", "workbench"], stdin=subprocess.DEVNULL,
                capture_output=True, text=True, check=False,
            )  # fmt: skip
            lines = [line for line in done.stdout.splitlines() if line.strip()]
            self.stopped = lines or [f"NOT CONFIRMED: {done.stderr.strip()[-300:]}"]
            self._changed()

        threading.Thread(target=stop, daemon=True).start()

    def close(self) -> None:
        """Ends the node that listens and the recorder."""
        self.end()
        self.stop_recording()
