# SPDX-License-Identifier: Apache-2.0
"""A recording: every signal at its own times, and the findings made while it was read."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pneu_sim.signals import Signal

MOST_SPANS = 200
"""Of one finding."""
BETWEEN_S = 1.0
"""Recordings that follow one another are this far apart, to the next whole second."""


@dataclass(frozen=True)
class Finding:
    """One defect or peculiarity of a recording, and how it was handled.

    Attributes:
        channel: Name of the command or tap, or of the file; ``valve.position`` of the measured
            position of a valve's spool.
        kind: One of ``truncated``, ``no_metadata``, ``no_definition``, ``no_header_stamp``,
            ``clock_offset``, ``clock_rate``, ``clock_jump``, ``out_of_order``,
            ``duplicate``, ``not_finite``, ``unreadable``, ``short_row``, ``irregular``,
            ``missing``, ``gap``, ``event_driven``, ``frozen``, ``constant``, ``cropped``,
            ``thinned``, ``suspicious_unit``, ``mark``, ``absent``, ``wrapped``.
        count: Number of samples, gaps or rows concerned.
        action: What was found in figures and what was done, in one sentence.
        spans_ns: When, from and to, by the clock in use; empty where it is all along, or nowhere.
    """

    channel: str
    kind: str
    count: int
    action: str
    spans_ns: tuple[tuple[int, int], ...] = ()

    def __str__(self) -> str:
        """Return the finding as one line."""
        return f"{self.channel}: {self.kind} ({self.count}): {self.action}"


def spans_of(stamp_ns: NDArray[np.int64], there: NDArray[np.bool_]) -> tuple[tuple[int, int], ...]:
    """When samples are of a kind: from the first to the last of each run, the longest runs.

    Args:
        stamp_ns: (n,) stamps, ns, rising.
        there: (n,) whether a sample is of the kind.
    """
    edges = np.flatnonzero(np.diff(np.concatenate(([False], there, [False])).astype(np.int8)))
    begins, ends = stamp_ns[edges[::2]], stamp_ns[edges[1::2] - 1]
    return longest(begins, ends)


def longest(
    begins_ns: NDArray[np.int64], ends_ns: NDArray[np.int64]
) -> tuple[tuple[int, int], ...]:
    """The longest of many spans, as they follow one another.

    Args:
        begins_ns: (n,) where they begin, ns.
        ends_ns: (n,) where they end, ns.
    """
    kept = np.sort(np.argsort(begins_ns - ends_ns, kind="stable")[:MOST_SPANS])
    return tuple(zip(begins_ns[kept].tolist(), ends_ns[kept].tolist(), strict=True))


def absent(channel: str, why: str) -> Finding:
    """What is told of a measured position that a recording lacks.

    Args:
        channel: Its name.
        why: What is not there.
    """
    return Finding(channel, "absent", 0, f"{why}; the recording is read without it")


@dataclass
class Recording:
    """Signals of one recording, each at its own times, in SI units.

    Attributes:
        name: File or folder name without suffix.
        commands: Valve commands by name; each begins at or before time 0.
        pressures: Absolute pressures in Pa by tap.
        report: What was detected while reading, and how it was handled.
        start_time_s: Clock time of time 0 (Unix time for stamped bags).
        positions: Measured positions of spools by valve, volts of command; where they are recorded.
        encoders: Positions of joints and pistons by encoder, rad or m.
    """

    name: str
    commands: dict[str, Signal]
    pressures: dict[str, Signal]
    report: list[Finding] = field(default_factory=list)
    start_time_s: float = 0.0
    positions: dict[str, Signal] = field(default_factory=dict)
    encoders: dict[str, Signal] = field(default_factory=dict)

    @property
    def readings(self) -> dict[str, Signal]:
        """All that models are compared with, by sensor: pressures, then encoders."""
        return {**self.pressures, **self.encoders}

    @property
    def start_s(self) -> float:
        """Time of the first reading, s."""
        return min((float(s.time_s[0]) for s in self.readings.values() if len(s)), default=0.0)

    @property
    def end_s(self) -> float:
        """Time of the last reading, s."""
        return max((float(s.time_s[-1]) for s in self.readings.values() if len(s)), default=0.0)

    def marks(self) -> list[tuple[float, float, Finding]]:
        """When what was found is, from and to, s; of what is all along or nowhere there is none."""
        begin_ns = round(self.start_time_s * 1e9)
        return [
            ((a - begin_ns) * 1e-9, (b - begin_ns) * 1e-9, finding)
            for finding in self.report
            for a, b in finding.spans_ns
        ]

    def until(self, end_s: float) -> "Recording":
        """The first part of the recording; all of it where it is no longer.

        Args:
            end_s: Where the part ends, s.
        """
        if end_s >= self.end_s:
            return self
        first = min(float(s.time_s[0]) for s in self.commands.values()) if self.commands else 0.0
        return replace(
            self,
            commands={n: s.within(min(first, 0.0), end_s) for n, s in self.commands.items()},
            pressures={n: s.within(0.0, end_s) for n, s in self.pressures.items()},
            positions={n: s.within(0.0, end_s) for n, s in self.positions.items()},
            encoders={n: s.within(0.0, end_s) for n, s in self.encoders.items()},
        )


def begins_of(recordings: Sequence[Recording]) -> list[float]:
    """When each recording begins if one follows the other, a second apart at least, s.

    Args:
        recordings: The recordings.
    """
    begins, at = [], 0.0
    for recording in recordings:
        begins.append(at)
        at += float(np.ceil(recording.end_s + BETWEEN_S))
    return begins


def even_recording(
    name: str,
    time_s: ArrayLike,
    commands: Mapping[str, ArrayLike],
    pressures: Mapping[str, ArrayLike],
    encoders: Mapping[str, ArrayLike] | None = None,
) -> Recording:
    """A recording whose signals share their times, as a simulation gives them.

    Args:
        name: Its name.
        time_s: (T,) times, s.
        commands: Per command its (T,) volts.
        pressures: Per tap its (T,) readings, Pa; one that is NaN is missing.
        encoders: Per encoder its (T,) readings, rad or m, likewise.
    """
    time = np.asarray(time_s, dtype=float)

    def signal(values: ArrayLike) -> Signal:
        series = np.asarray(values, dtype=float)
        good = np.isfinite(series)
        return Signal(time[good], series[good])

    return Recording(
        name,
        {key: signal(value) for key, value in commands.items()},
        {key: signal(value) for key, value in pressures.items()},
        encoders={key: signal(value) for key, value in (encoders or {}).items()},
    )
