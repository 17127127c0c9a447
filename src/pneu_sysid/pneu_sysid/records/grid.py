# SPDX-License-Identifier: Apache-2.0
"""Channels put on one uniform time grid.

A grid point with a sample within 5 % of a period takes that sample unaltered, and one near a
sample among even ones takes that sample moved by the slope there, so that noise keeps its
statistics. Elsewhere pressures are interpolated. Commands are held.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pneu_sim.errors import InputError
from pneu_sysid.records.clean import GAP_PERIODS, is_regular
from pneu_sysid.records.recording import Finding
from pneu_sysid.records.stream import Stream, median_period_ns

SNAP = 0.05
NEAR = 1.75
"""Periods up to which two samples are neighbours, none missing between them."""
_MAX_POINTS = 50_000_000


@dataclass(frozen=True)
class Grid:
    """Uniform grid ``origin_ns + start_s + k / rate_hz`` for k = 0 ... count - 1."""

    origin_ns: int
    start_s: float
    period_s: float
    count: int

    @property
    def offsets_s(self) -> NDArray[np.float64]:
        """Grid points in s after ``origin_ns``, shape (count,)."""
        return self.start_s + self.period_s * np.arange(self.count, dtype=np.float64)


def seconds_after(stream: Stream, origin_ns: int) -> NDArray[np.float64]:
    """Return stamps in s after an origin; the difference is exact in integers.

    Args:
        stream: The channel.
        origin_ns: The origin, ns.
    """
    return (stream.stamp_ns - origin_ns).astype(np.float64) * 1e-9


def make_grid(
    path: str, streams: list[Stream], rate_hz: float | None
) -> tuple[Grid, list[Finding]]:
    """Lay the grid on which most pressure samples already stand.

    It runs from the first to the last pressure sample, cut to where every command is
    known: from its first sample, and to its last where it is sampled at a rate.

    Args:
        path: Recording, for messages.
        streams: Clean streams, at least one of them a pressure.
        rate_hz: Grid rate, or None for the median rate of the pressures.

    Raises:
        InputError: Two channels have no time in common.
    """
    pressures = [s for s in streams if s.role == "pressure"]
    origin_ns = min(int(s.stamp_ns[0]) for s in pressures)
    latest = max(streams, key=lambda s: s.stamp_ns[0])
    earliest = min(streams, key=lambda s: s.stamp_ns[-1])
    if latest.stamp_ns[0] > earliest.stamp_ns[-1]:
        apart = (int(latest.stamp_ns[0]) - int(earliest.stamp_ns[-1])) * 1e-9
        raise InputError(
            f"{path}: no time in common: {earliest.label} ends {apart:.6g} s before "
            f"{latest.label} begins"
        )
    periods = [median_period_ns(s.stamp_ns) * 1e-9 for s in pressures]
    if rate_hz is None:
        order = int(np.argsort(periods)[len(periods) // 2])
        base = seconds_after(pressures[order], origin_ns)
        start_s, period_s = _fit_grid(base, periods[order])
    else:
        order = int(np.argmin([s.stamp_ns[0] for s in pressures]))
        start_s, period_s = float(seconds_after(pressures[order], origin_ns)[0]), 1.0 / rate_hz

    begin = 0.0
    end = max(float(seconds_after(s, origin_ns)[-1]) for s in pressures)
    findings = []
    for stream in streams:
        if stream.role != "command":
            continue
        times = seconds_after(stream, origin_ns)
        if times[0] > begin + SNAP * period_s:
            begin = float(times[0])
            note = f"the {begin:.6g} s before its first sample were left out"
            findings.append(Finding(stream.name, "cropped", 1, note))
        own = median_period_ns(stream.stamp_ns) * 1e-9
        if is_regular(stream) and end > times[-1] + GAP_PERIODS * max(own, period_s):
            note = f"the {end - times[-1]:.6g} s after its last sample were left out"
            end = float(times[-1])
            findings.append(Finding(stream.name, "cropped", 1, note))
    first = int(np.ceil((begin - start_s) / period_s - SNAP))
    last = int(np.floor((end - start_s) / period_s + SNAP))
    count = last - first + 1
    if count > _MAX_POINTS:
        raise InputError(
            f"{path}: {end - begin:.6g} s at {1 / period_s:.6g} Hz are {count} grid points, "
            f"at most {_MAX_POINTS} are allowed (choose a lower rate)"
        )
    return Grid(origin_ns, start_s + first * period_s, period_s, count), findings


def _fit_grid(times: NDArray[np.float64], period_s: float) -> tuple[float, float]:
    """Return phase and period of the grid that the samples stand on best.

    The median step is exact for an even clock. Under jitter a straight line through all
    stamps is better, over counts that round every step, or, where jitter comes near
    half a period, only the long ones.
    """
    steps = np.diff(times) / period_s
    candidates = [(float(times[0]), period_s)]
    for counts in (np.rint(steps), np.where(steps > 1.75, np.rint(steps), 1.0)):
        slope, start = np.polyfit(np.concatenate(([0.0], np.cumsum(counts))), times, 1)
        if slope > 0.0:
            candidates.append((float(start), float(slope)))

    def coherence(candidate: tuple[float, float]) -> float:
        phase = 2.0 * np.pi * (times - candidate[0]) / candidate[1]
        return round(float(np.cos(phase).mean()), 6)  # equal ones go to the median

    return max(candidates, key=coherence)


def interpolate(stream: Stream, grid: Grid) -> tuple[NDArray[np.float64], list[Finding]]:
    """Return a pressure on the grid, NaN outside its samples and inside long gaps.

    Args:
        stream: The pressure.
        grid: The grid.
    """
    at = grid.offsets_s
    times, values = seconds_after(stream, grid.origin_ns), stream.values
    right = np.clip(np.searchsorted(times, at), 1, len(times) - 1)
    left = right - 1
    span = times[right] - times[left]
    out = values[left] + (values[right] - values[left]) * ((at - times[left]) / span)
    own = max(median_period_ns(stream.stamp_ns) * 1e-9, grid.period_s)
    inside = (at >= times[0]) & (at <= times[-1])
    out[~inside | (span > (GAP_PERIODS + SNAP) * own)] = np.nan
    nearest = np.where(at - times[left] <= times[right] - at, left, right)
    # Between its two neighbours, a sample may be moved by a part of a period along their slope.
    before, after = np.maximum(nearest - 1, 0), np.minimum(nearest + 1, len(times) - 1)
    near = np.maximum(times[after] - times[nearest], times[nearest] - times[before]) < NEAR * own
    near &= (nearest > before) & (nearest < after) & (own <= NEAR * grid.period_s) & inside
    slope = (values[after] - values[before]) / np.where(near, times[after] - times[before], 1.0)
    moved = values[nearest] + slope * (at - times[nearest])
    out[near] = moved[near]
    stands = np.abs(times[nearest] - at) <= SNAP * grid.period_s
    out[stands] = values[nearest[stands]]
    made = int((~stands & np.isfinite(out)).sum())
    if not made:
        return out, []
    note = f"of {len(at)} grid points were interpolated from the samples beside them"
    return out, [Finding(stream.name, "interpolated", made, note)]


def hold(stream: Stream, grid: Grid) -> NDArray[np.float64]:
    """Return a command on the grid, each value held until the next sample.

    Where stamps tell when the values took effect, a grid point gets the mean until the next one, so
    that a change between them is neither early nor late.

    Args:
        stream: The command.
        grid: The grid.
    """
    times = seconds_after(stream, grid.origin_ns)
    if stream.applied:
        edges = np.append(grid.offsets_s, grid.start_s + grid.period_s * grid.count)
        since = np.concatenate(([0.0], np.cumsum(stream.values[:-1] * np.diff(times))))
        index = np.maximum(np.searchsorted(times, edges, side="right") - 1, 0)
        integral = since[index] + stream.values[index] * (edges - times[index])
        return np.asarray(np.diff(integral) / grid.period_s)
    # A stamp a hair after its grid point belongs to it, not to the next.
    index = np.searchsorted(times, grid.offsets_s + SNAP * grid.period_s, side="right") - 1
    return stream.values[np.maximum(index, 0)]
