# SPDX-License-Identifier: Apache-2.0
"""Between the thread of the bus and that of the node: the supervisor under a lock, and samples.

Everything here returns at once, whoever calls; the bus never waits for the graph, nor the graph for
the bus.
"""

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass

from pneu_hw_bridge.safety.supervisor import State, Supervisor

MOST_CHANGES = 4
"""Changes of state that are kept until the node reports them; of more the first are dropped."""

MOST_WAITING = 512
"""Samples kept for a node that does not come to publish them; older ones are dropped."""


@dataclass(frozen=True)
class Sample:
    """What was read, or written, in one cycle.

    Attributes:
        stamp_ns: Time of acquisition, or of taking effect, ns.
        values: SI value per channel.
    """

    stamp_ns: int
    values: Mapping[str, float]


@dataclass(frozen=True)
class Report:
    """What the node shows.

    Attributes:
        state: State of the supervisor.
        reason: Why.
        output: Voltages of the latest cycle.
        readings: Latest reading per channel.
        counters: What happened to commands and readings.
        dropped: Samples that nobody came to publish.
    """

    state: State
    reason: str
    output: Mapping[str, float]
    readings: Mapping[str, float]
    counters: Mapping[str, int]
    dropped: int


class Link:
    """The owner of a bus (see `pneu_hw_bridge.modbus.bus.Owner`) on behalf of a node."""

    def __init__(
        self,
        supervisor: Supervisor,
        notify: Callable[[], None],
        every: int = 1,
        device_time: bool = False,
    ) -> None:
        """Connects.

        Args:
            supervisor: Decides what goes to the valves.
            notify: Called, from the thread of the bus, when there are samples to publish.
            every: Hands over every so many samples.
            device_time: Whether stamps are the device's own times, by which readings are told
                apart better than by when they arrived.
        """
        self._device_time = device_time
        self._supervisor = supervisor
        self._notify = notify
        self._every = every
        self._count = 0
        self._lock = threading.Lock()
        self._samples: deque[Sample] = deque(maxlen=MOST_WAITING)
        self._dropped = 0
        self._applied: deque[Sample] = deque(maxlen=MOST_WAITING)
        self._output: Mapping[str, float] = supervisor.safe()
        self._readings: Mapping[str, float] = {}
        self._state: State | None = None
        self._changes: deque[tuple[State, str]] = deque(maxlen=MOST_CHANGES)

    # From the thread of the bus

    def output(self, now_s: float) -> Mapping[str, float]:
        """Returns the voltages to write now.

        Args:
            now_s: Steady time.
        """
        with self._lock:
            self._output = self._supervisor.output(now_s)
            self._look(now_s)
            return self._output

    def readings(self, values: Mapping[str, float], steady_s: float, stamp_ns: int | None) -> None:
        """Takes what was read in one cycle.

        Args:
            values: SI value per channel.
            steady_s: Steady time of acquisition.
            stamp_ns: Time of acquisition, ns; None where it is not known, so that nobody but the
                supervisor learns of it.
        """
        with self._lock:
            for name in self._supervisor.limits.sensors:
                if name in values:
                    self._supervisor.reading(name, values[name], steady_s)
            taken_s = steady_s
            if stamp_ns is not None and self._device_time:
                taken_s = 1e-9 * stamp_ns
            for name in self._supervisor.limits.encoders:
                if name in values:
                    known_s = None if stamp_ns is None else taken_s
                    self._supervisor.position(name, values[name], steady_s, known_s)
            self._readings = values
            if stamp_ns is None:
                return
            self._count += 1
            due = self._count % self._every == 0
            if due:
                self._dropped += len(self._samples) == MOST_WAITING
                self._samples.append(Sample(stamp_ns, values))
        if due:
            self._notify()

    def written(self, values: Mapping[str, float], stamp_ns: int) -> None:
        """Takes note of voltages that the device has confirmed.

        Args:
            values: Volts per output.
            stamp_ns: When they took effect, ns.
        """
        with self._lock:
            self._dropped += len(self._applied) == MOST_WAITING
            self._applied.append(Sample(stamp_ns, values))
        self._notify()

    def bus(self, fault: str) -> None:
        """Takes note that the bus changed.

        Args:
            fault: What is wrong with it; empty where it works.
        """
        with self._lock:
            self._supervisor.bus(fault)
            self._look(time.monotonic())

    def takes(self, mostly_s: float, usually_s: float) -> None:
        """Takes note of how long it takes from a decision until all outputs are written.

        Args:
            mostly_s: In 95 of 100 cases at most, s.
            usually_s: In every other case at most, s.
        """
        with self._lock:
            self._supervisor.takes(mostly_s, usually_s)

    def _look(self, now_s: float) -> None:
        """Notes where the state is another than before, and why."""
        state = self._supervisor.state(now_s)
        if state is not self._state:
            self._state = state
            self._changes.append((state, self._supervisor.explain(now_s)))

    # From the node

    def command(self, voltages: Mapping[str, float], sent_s: float | None = None) -> str:
        """Takes a command.

        Args:
            voltages: Volts per output.
            sent_s: Steady time at which it was sent, from where on the watchdog counts; None is
                now.

        Returns:
            Why it was refused; empty where it was taken.
        """
        with self._lock:
            sent_s = time.monotonic() if sent_s is None else sent_s
            return self._supervisor.command(voltages, sent_s)

    def malformed(self) -> None:
        """Counts a command that could not be read."""
        with self._lock:
            self._supervisor.counters.unknown += 1

    def enable(self, enabled: bool) -> None:
        """Lets commands through, or none.

        Args:
            enabled: Whether.
        """
        with self._lock:
            if enabled:
                self._supervisor.enable()
            else:
                self._supervisor.disable()

    def e_stop(self, reason: str) -> None:
        """Stops until it is reset.

        Args:
            reason: Who called for it.
        """
        with self._lock:
            self._supervisor.e_stop(reason)

    def reset(self) -> str:
        """Releases emergency stop and trip; returns why not, where something speaks against it."""
        with self._lock:
            return self._supervisor.reset(time.monotonic())

    def publishers(self, count: int, wrong: str = "") -> None:
        """Takes note of the publishers of the command topic.

        Args:
            count: How many.
            wrong: Why they are not followed, whatever their number; empty where they may be.
        """
        with self._lock:
            self._supervisor.publishers(count, wrong)

    @property
    def watchdog_s(self) -> float:
        """How long a command is followed now."""
        with self._lock:
            return self._supervisor.watchdog_s

    def take(self) -> list[Sample]:
        """Returns the samples that are to be published."""
        samples = []
        while self._samples:
            samples.append(self._samples.popleft())
        return samples

    def take_applied(self) -> list[Sample]:
        """Returns the voltages that were written since the last call."""
        written = []
        while self._applied:
            written.append(self._applied.popleft())
        return written

    def take_changes(self) -> list[tuple[State, str]]:
        """Returns the changes of state since the last call, each with its reason."""
        with self._lock:
            changes = list(self._changes)
            self._changes.clear()
        return changes

    def report(self) -> Report:
        """Returns what the node shows."""
        now_s = time.monotonic()
        with self._lock:
            return Report(
                self._supervisor.state(now_s),
                self._supervisor.explain(now_s),
                dict(self._output),
                dict(self._readings),
                asdict(self._supervisor.counters),
                self._dropped,
            )
