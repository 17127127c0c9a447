# SPDX-License-Identifier: Apache-2.0
"""What happened on a bus: counters, and quantiles of recent durations."""

from collections import deque
from dataclasses import dataclass, field

LONG_S = 0.01
"""An exchange that takes no longer tells well enough when it was: half of it is unknown."""

LATEST = 64
"""Durations by which it is judged how quick a device is now."""

RECENT = 2000
"""Durations that quantiles are taken over."""


@dataclass
class Durations:
    """Recent durations.

    Attributes:
        recent_s: The newest of them, s.
    """

    recent_s: deque[float] = field(default_factory=lambda: deque(maxlen=RECENT))

    def add(self, duration_s: float) -> None:
        """Adds one.

        Args:
            duration_s: Duration, s.
        """
        self.recent_s.append(duration_s)

    def quantile(self, fraction: float) -> float:
        """Returns a quantile, s; NaN where there is none yet.

        Args:
            fraction: 0.5 for the median.
        """
        ordered = sorted(self.recent_s.copy())
        if not ordered:
            return float("nan")
        return ordered[min(int(fraction * len(ordered)), len(ordered) - 1)]


@dataclass
class Statistics:
    """Counters of one bus since it was opened.

    Attributes:
        connects: Connections made.
        connect_failures: Attempts that failed.
        losses: Connections that were lost or given up.
        cycles: Cycles that went through.
        late_cycles: Cycles that began more than a period late.
        writes: Writes that were confirmed.
        reads: Reads that were answered well.
        timeouts: Requests without an answer in time.
        repeats: Requests on a serial line that were asked again, spoilt as they were.
        exceptions: Exception replies.
        malformed: Answers that made no sense, or were of the wrong length.
        foreign: Outputs that read back as something else than was written.
        settings: Times that the map's settings were written.
        unclear: Readings of which nobody knows when they were taken, as the exchange took so long.
        unwritable: Outputs that the register's type could not hold.
        samples: Samples of a device with a clock that were taken, each once.
        samples_skipped: Samples that the device had forgotten before they were read.
        reads_without_news: Reads that found no new sample.
        commands_skipped: Commands of which the device no longer told when it took them.
        request: Durations of single requests.
        reply: The same of the latest few, by which replies are called slow.
        command: Durations from a command's arrival to its confirmation by the device.
    """

    connects: int = 0
    connect_failures: int = 0
    losses: int = 0
    cycles: int = 0
    late_cycles: int = 0
    writes: int = 0
    reads: int = 0
    timeouts: int = 0
    repeats: int = 0
    exceptions: int = 0
    malformed: int = 0
    foreign: int = 0
    settings: int = 0
    unclear: int = 0
    unwritable: int = 0
    samples: int = 0
    samples_skipped: int = 0
    reads_without_news: int = 0
    commands_skipped: int = 0
    request: Durations = field(default_factory=Durations)
    reply: Durations = field(default_factory=lambda: Durations(deque(maxlen=LATEST)))
    command: Durations = field(default_factory=Durations)

    def tells_when(self, took_s: float, requests: int) -> bool:
        """Whether the middle of an exchange is when it was: not where something held it up.

        Args:
            took_s: How long it took, s.
            requests: Of how many requests it was.
        """
        return not took_s > requests * max(LONG_S, 4.0 * self.reply.quantile(0.5))

    def counters(self) -> dict[str, int]:
        """Returns all counters by name."""
        return {name: value for name, value in vars(self).items() if isinstance(value, int)}
