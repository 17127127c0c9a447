# SPDX-License-Identifier: Apache-2.0
"""Lines in the spectrum of a residual: what pulsates at a frequency of its own."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pneu_sysid.problem import Problem
from pneu_sysid.records import Recording

Floats = NDArray[np.float64]

SLOWEST_PERIODS = 5.0
"""A line goes through so many periods in a recording at least."""
FINER = 6
"""Frequencies that are looked at within the width that a line has."""
FASTEST_HZ = 100.0
TICK_S = 1e-3
"""Readings count at the nearest of such ticks."""
STANDS_OUT = 16.0
"""Squared amplitude of a line over the mean of what is near it in the spectrum. Of noise these are
exponential: among some thousand frequencies one of e^-16 comes up in one of thousands of cases."""
NEAR = 40
"""What is near: so many widths of a line on either side."""
DRIVEN = 0.01
"""Share of a command's and of a position's variance at a frequency at which a rig is made to move:
what is wrong with its motion pulsates there too, and nothing has a frequency of its own."""


@dataclass(frozen=True)
class Line:
    """A line in the spectrum of the residual at a tap.

    Attributes:
        tap: The tap.
        frequency_hz: Its frequency, Hz.
        share: Share of the squared residual that it is.
    """

    tap: str
    frequency_hz: float
    share: float


def lines_of(problem: Problem, residual: Floats) -> list[Line]:
    """The strongest line at each tap, where one stands out; the largest share first.

    The periodogram of readings at their own times, along the longest recording. Where the rig is
    made to swing at a line's frequency, it is none.

    Args:
        problem: The problem.
        residual: (n_stretches, horizon * n_taps) in noise units.
    """
    r = residual.reshape(problem.measured.shape)
    recording = int(np.bincount(problem.of).argmax())
    mine = problem.of == recording
    out = []
    for k, tap in enumerate(problem.taps):
        times, values = problem.time_s[mine][:, :, k], r[mine][:, :, k]
        good = np.isfinite(problem.measured[mine][:, :, k]) & np.isfinite(times)
        time, values = times[good], values[good] - values[good].mean()
        total, span = float(np.sum(values**2)), float(np.ptp(time)) if time.size else 0.0
        if time.size < 4 * NEAR or total <= 0.0:
            continue
        width = 1.0 / span
        series = np.bincount(np.round((time - time.min()) / TICK_S).astype(int), weights=values)
        size = FINER * series.size
        frequency = np.fft.rfftfreq(size, TICK_S)
        wanted = (frequency > SLOWEST_PERIODS * width) & (
            frequency < min(FASTEST_HZ, 0.4 * time.size / span)
        )
        if wanted.sum() < 2 * NEAR * FINER:
            continue
        # a sine of amplitude A has |F| = n A / 2, and n A^2 / 2 of the squares
        power = 2.0 * np.abs(np.fft.rfft(series, size)[wanted]) ** 2 / (time.size * total)
        frequency = frequency[wanted]
        best = int(np.argmax(power))
        around = np.abs(frequency - frequency[best])
        near = (around > 1.5 * width) & (around < NEAR * width)
        stands_out = power[best] > STANDS_OUT * float(power[near].mean())
        if stands_out and not _is_driven(problem.recordings[recording], float(frequency[best])):
            out.append(Line(tap, float(frequency[best]), float(power[best])))
    return sorted(out, key=lambda line: -line.share)


def _is_driven(recording: Recording, frequency_hz: float) -> bool:
    """Whether commands make what encoders watch swing at a frequency."""
    if not recording.encoders:
        return False
    begin, end = recording.start_s, recording.end_s
    time = np.arange(begin, end, 4.0 * TICK_S)
    commands = [signal.held(time) for signal in recording.commands.values()]
    positions = [np.interp(time, s.time_s, s.values) for s in recording.encoders.values() if len(s)]

    def swings(values: Floats) -> bool:
        centred = values - values.mean()
        total = float(np.sum(centred**2))
        if total <= 0.0:
            return False
        around = frequency_hz + np.linspace(-1.5, 1.5, 4 * FINER) / (end - begin)
        wave = np.exp(-2j * np.pi * np.outer(around, time - begin))
        share = 2.0 * np.abs(wave @ centred) ** 2 / (time.size * total)
        return bool(share.max() > DRIVEN)

    return any(map(swings, commands)) and any(map(swings, positions))
