# SPDX-License-Identifier: Apache-2.0
"""How well a pressure followed its target: error, apparent latency, effort and oscillation.

Everything is taken from what a run recorded. Means are over time, each sample counting for the time
it stands for, so that recordings at different or uneven rates compare.
"""

import math
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_policy.judge.latency import EARLY_S, LATE_S, latency, rms

Floats = NDArray[np.float64]

ATM_PA = 101325.0
RATE_WINDOW_S = 0.01
"""Interval of the command's rate of change: that of the slowest controller, so that a controller
is not charged for commanding more often."""
SWING_PA = 5.0e3
"""Least swing that counts as a reversal: twenty times the sensors' noise."""
LONGEST_GAP_S = 0.05
"""Longest time without a reading in a recording that can be judged."""


@dataclass(frozen=True)
class Track:
    """What a run leaves behind; times of the three series are by one clock.

    Attributes:
        time_s: (n,) times of the readings, s.
        pressure_pa: (n,) readings, Pa.
        target_time_s: (m,) times at which the target is known, s; linear between.
        target_pa: (m,) the target, Pa.
        command_time_s: (k,) times from which a command held, s.
        volts: (k,) commands, V.
    """

    time_s: Floats
    pressure_pa: Floats
    target_time_s: Floats
    target_pa: Floats
    command_time_s: Floats
    volts: Floats


@dataclass(frozen=True)
class Metrics:
    """The figures of one run.

    Attributes:
        rmse_atm: Root mean square of pressure minus target.
        latency_s: Shift of the target that fits the pressure best; positive where the pressure
            comes late (thesis table 9.2). NaN where the target does not move.
        adjusted_rmse_atm: The error that is left at that shift.
        effort_v: Root mean square of the command about the valve's null, V.
        effort_rate_v_s: Root mean square of the command's change per second, over 10 ms, V/s.
        oscillation_atm: Root mean square of that part of the error that lies above the target's
            band: what the controller adds by itself.
        reversals_hz: Turns of the pressure with swings of at least 5 kPa per second, less those of
            the target; two make a full oscillation.
        worst_atm: Largest error.
    """

    rmse_atm: float
    latency_s: float
    adjusted_rmse_atm: float
    effort_v: float
    effort_rate_v_s: float
    oscillation_atm: float
    reversals_hz: float
    worst_atm: float

    def to_dict(self) -> dict[str, float]:
        """The figures by name."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @staticmethod
    def from_dict(data: dict[str, Any]) -> "Metrics":
        """The figures as `to_dict` gives them; a missing one is NaN.

        Args:
            data: By name.
        """
        values = {f.name: data.get(f.name) for f in fields(Metrics)}
        return Metrics(**{n: math.nan if v is None else float(v) for n, v in values.items()})


def measure(track: Track, begin_s: float, end_s: float, null_v: float, band_hz: float) -> Metrics:
    """The figures of a run between two times.

    Args:
        track: The run; its target must be known 0.25 s before and 0.1 s after the two times.
        begin_s: From when on it is judged, s.
        end_s: Until when, s.
        null_v: Voltage at which the valve is closed, V.
        band_hz: Upper end of the target's band, Hz.

    Raises:
        ValueError: The run does not cover the two times, has a gap, or is not finite.
    """
    _check(track, begin_s, end_s)
    inside = (track.time_s >= begin_s) & (track.time_s <= end_s)
    time, pressure = track.time_s[inside], track.pressure_pa[inside]
    error = pressure - target_at(track, time)
    rmse = rms(time, error)
    latency, adjusted = latency_of(track, time, pressure)
    at, volts = _held(track, begin_s, end_s)
    step = float(np.median(np.diff(time)))
    even = time[0] + step * np.arange(int((time[-1] - time[0]) / step + 1e-6) + 1)
    high = _above(np.interp(even, time, error), step, band_hz)
    reversals = _turns(pressure) - _turns(target_at(track, time))
    steps = np.diff(volts[:: max(1, round(RATE_WINDOW_S / (at[1] - at[0])))]) / RATE_WINDOW_S
    return Metrics(
        rmse_atm=rmse / ATM_PA,
        latency_s=latency,
        adjusted_rmse_atm=adjusted / ATM_PA,
        effort_v=float(np.sqrt(np.mean((volts - null_v) ** 2))),
        effort_rate_v_s=float(np.sqrt(np.mean(steps**2))),
        oscillation_atm=float(np.sqrt(np.mean(high**2))) / ATM_PA,
        reversals_hz=reversals / (end_s - begin_s),
        worst_atm=float(np.max(np.abs(error))) / ATM_PA,
    )


def target_at(track: Track, time_s: Floats) -> Floats:
    """The target of a run at some times.

    Args:
        track: The run.
        time_s: Times, s.
    """
    return np.asarray(np.interp(time_s, track.target_time_s, track.target_pa))


def latency_of(track: Track, time_s: Floats, pressure_pa: Floats) -> tuple[float, float]:
    """The delay of the target that fits the pressure best; see `latency`.

    Args:
        track: The run, for its target.
        time_s: (n,) times of the readings, s.
        pressure_pa: (n,) the readings, Pa.

    Returns:
        The delay, positive where the pressure is late, s, and the error left, Pa.
    """
    return latency(time_s, pressure_pa, track.target_time_s, track.target_pa)


def _check(track: Track, begin_s: float, end_s: float) -> None:
    """Raises ValueError where a run cannot be judged."""
    for name in ("time_s", "pressure_pa", "target_time_s", "target_pa", "command_time_s", "volts"):
        if not np.isfinite(getattr(track, name)).all():
            raise ValueError(f"{name}: found a value that is not finite")
    for name in ("time_s", "target_time_s", "command_time_s"):
        times = getattr(track, name)
        if times.size < 2 or np.any(np.diff(times) <= 0.0):
            raise ValueError(f"{name}: needs at least two times, increasing")
    inside = track.time_s[(track.time_s >= begin_s) & (track.time_s <= end_s)]
    gap = float(np.max(np.diff(np.concatenate([[begin_s], inside, [end_s]]))))
    if gap > LONGEST_GAP_S:
        raise ValueError(f"no reading for {gap:.3f} s between {begin_s:g} and {end_s:g} s")
    first, last = track.target_time_s[0], track.target_time_s[-1]
    # A hair of tolerance: times are sums of periods.
    if first > begin_s - LATE_S + 1e-6 or last < end_s + EARLY_S - 1e-6:
        raise ValueError(
            f"the target is known from {first:.3f} to {last:.3f} s, needed is"
            f" {begin_s - LATE_S:.3f} to {end_s + EARLY_S:.3f} s"
        )
    if track.command_time_s[0] > begin_s:
        raise ValueError(f"the first command is of {track.command_time_s[0]:.3f} s")


def _held(track: Track, begin_s: float, end_s: float) -> tuple[Floats, Floats]:
    """The command every millisecond, each held until the next."""
    at = np.arange(begin_s, end_s, 1e-3)
    index = np.searchsorted(track.command_time_s, at + 1e-9, side="right") - 1
    return at, track.volts[np.maximum(index, 0)]


def _above(values: Floats, step_s: float, frequency_hz: float) -> Floats:
    """What of a signal lies above a frequency: Butterworth, forth and back, so without delay."""
    from scipy.signal import butter, sosfiltfilt

    sections = butter(4, frequency_hz, "highpass", fs=1.0 / step_s, output="sos")
    return np.asarray(sosfiltfilt(sections, values))


def _turns(values: Floats) -> int:
    """Turning points of a signal, swings smaller than `SWING_PA` left out."""
    count, direction = 0, 0
    extreme = float(values[0])
    for value in values.tolist():
        if (direction >= 0 and value > extreme) or (direction <= 0 and value < extreme):
            if direction == 0 and abs(value - values[0]) >= SWING_PA:
                direction = 1 if value > values[0] else -1
            if direction != 0:
                extreme = value
        elif direction != 0 and abs(value - extreme) >= SWING_PA:
            count += 1
            direction, extreme = -direction, value
    return count
