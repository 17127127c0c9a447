# SPDX-License-Identifier: Apache-2.0
"""What sensors, of pressure or position, make of it: clock offset, lag, gain, bias; noise."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pneu_sim.compiling import compiled
from pneu_sim.rig.model import S_BIAS, S_GAIN, S_LAG, S_OFFSET, Model

Floats = NDArray[np.float64]


@compiled
def _lagged(
    true: Floats,
    keep: Floats,
    old: Floats,
    new: Floats,
    felt: Floats,
    shown: Floats,
    out: Floats,
) -> None:
    """First-order lags, exact for what is linear between samples.

    Args:
        true: (samples, n, lanes) what the sensors are on.
        keep: (n, lanes) what is kept of a reading ...
        old: ... what comes from the value a sample ago ...
        new: ... and what from the present one.
        felt: (n, lanes) value of the latest sample, changed in place.
        shown: (n, lanes) its reading, changed in place.
        out: (samples, n, lanes) readings.
    """
    for k in range(true.shape[0]):
        for t in range(true.shape[1]):
            for j in range(true.shape[2]):
                p = true[k, t, j]
                shown[t, j] = keep[t, j] * shown[t, j] + old[t, j] * felt[t, j] + new[t, j] * p
                felt[t, j] = p
                out[k, t, j] = shown[t, j]


class Sensors:
    """Sensors of one kind of rigs side by side, and the past that they still show.

    Values are in the unit of what the sensors are on: Pa, rad or m.
    """

    def __init__(self, sensor: Floats, about: Floats) -> None:
        """Takes the sensors.

        Args:
            sensor: (n, SENSOR_COLUMNS, lanes) lag, gain, bias and clock offset of each.
            about: (lanes,) value that a gain leaves as it is.
        """
        self._lag, self._offset = sensor[:, S_LAG], sensor[:, S_OFFSET]
        self._gain, self._bias = sensor[:, S_GAIN], sensor[:, S_BIAS]
        self._about = about
        self._exact = bool(np.all(self._gain == 1.0) and np.all(self._bias == 0.0))
        self._lags, self._late = bool(np.any(self._lag > 0.0)), bool(np.any(self._offset != 0.0))
        self._past = np.zeros((0, *self._lag.shape))
        self._felt, self._shown = np.zeros_like(self._lag), np.zeros_like(self._lag)
        self._interval_s = 0.0

    @classmethod
    def of_taps(cls, models: Sequence[Model]) -> "Sensors":
        """The pressure sensors of rigs; their gain is about the pressure of the room.

        Args:
            models: The rigs, on one plan.
        """
        room = np.array([m.ambient[0] for m in models])
        return cls(np.stack([m.sensor for m in models], axis=-1), room)

    @classmethod
    def of_encoders(cls, models: Sequence[Model]) -> "Sensors":
        """The encoders of rigs; their gain is about position 0.

        Args:
            models: The rigs, on one plan.
        """
        return cls(np.stack([m.encoder for m in models], axis=-1), np.zeros(len(models)))

    @property
    def lag_s(self) -> Floats:
        """(n, lanes) first-order lags, s."""
        return self._lag

    @property
    def remembers(self) -> bool:
        """Whether any shows what was before."""
        return self._lags or self._late

    def set_lag(self, lag_s: Floats) -> None:
        """Changes the lags from now on.

        Args:
            lag_s: (n, lanes) s, 0 or more.
        """
        self._lag = lag_s
        self._lags = bool(np.any(lag_s > 0.0))

    def begin(self, true: Floats) -> None:
        """Has values stand that have long been there.

        Args:
            true: (n, lanes) what the sensors are on.
        """
        self._past = true[None].copy()
        self._felt, self._shown = true.copy(), true.copy()

    def follow(self, true: Floats, interval_s: float) -> Floats:
        """Readings at further samples.

        A sensor whose clock is behind shows what was; one whose clock is ahead shows what comes, as
        far as it is given. Where the interval changes, what was is taken to have been constant.

        Args:
            true: (samples, n, lanes) what the sensors are on, beginning one interval after the
                latest.
            interval_s: Between samples, s.

        Returns:
            Readings of the same shape, without noise.
        """
        if interval_s != self._interval_s:
            self._past, self._interval_s = self._past[-1:], interval_s
        seen = true
        if self._late:
            whole = np.concatenate([self._past, true])
            seen = self._at_their_clocks(whole, len(true))
            reach = math.ceil(float(np.max(self._offset, initial=0.0)) / interval_s) + 2
            self._past = whole[-reach:].copy()
        if self._lags:
            lags = self._lag > 0.0
            r = interval_s / np.where(lags, self._lag, 1.0)
            keep = np.where(lags, np.exp(-r), 0.0)
            mean = np.where(lags, (1.0 - keep) / r, 0.0)
            out = np.empty_like(seen)
            _lagged(seen, keep, mean - keep, 1.0 - mean, self._felt, self._shown, out)
            seen = out
        elif len(seen):
            self._felt, self._shown = seen[-1], seen[-1]
        return self._told(seen)

    def readings(self) -> Floats:
        """Returns what the sensors show now, without noise: (n, lanes)."""
        return self._told(self._shown)

    def state(self) -> list[Floats]:
        """Returns all that the readings to come depend on, the rig as the last index."""
        return [self._past.copy(), self._felt.copy(), self._shown.copy()]

    def set_state(self, parts: Sequence[Floats], interval_s: float) -> None:
        """Goes back to a state.

        Args:
            parts: As of `state`.
            interval_s: Between the samples before it, s.
        """
        self._past, self._felt, self._shown = (part.copy() for part in parts)
        self._interval_s = interval_s

    def _told(self, seen: Floats) -> Floats:
        if self._exact:
            return seen.copy()
        return np.asarray(self._about + self._gain * (seen - self._about) + self._bias)

    def _at_their_clocks(self, whole: Floats, count: int) -> Floats:
        """The latest values as of the sensors' clocks; the earliest was there before."""
        seen = whole[len(whole) - count :].copy()
        last = len(whole) - 1
        for t, j in zip(*np.nonzero(self._offset), strict=True):
            shift = -self._offset[t, j] / self._interval_s
            at = len(whole) - count + np.arange(count) + math.floor(shift)
            f = shift - math.floor(shift)
            early, late = (whole[np.clip(at + k, 0, last), t, j] for k in (0, 1))
            seen[:, t, j] = (1.0 - f) * early + f * late
        return seen


def read(model: Model, pressures: Floats, dt_s: float) -> Floats:
    """Readings of the pressure sensors of a rig along a whole recording.

    Args:
        model: The rig.
        pressures: (T, n_taps) pressures at the taps, Pa.
        dt_s: Sample interval, s.

    Returns:
        Readings of the same shape, Pa. Before the first sample the pressure is taken as constant.
    """
    sensors = Sensors.of_taps([model])
    sensors.begin(pressures[0, :, None])
    return sensors.follow(pressures[:, :, None], dt_s)[:, :, 0]


def corrupt(readings: Floats, noise: Floats, quantum: Floats, rng: np.random.Generator) -> Floats:
    """Adds white noise and quantisation to readings.

    Args:
        readings: (T, n) Pa, rad or m.
        noise: (n,) standard deviations.
        quantum: (n,) steps; 0 is none.
        rng: Source of the noise.

    Returns:
        (T, n) noisy readings.
    """
    out = readings + rng.normal(size=readings.shape) * noise
    step = np.where(quantum > 0.0, quantum, 1.0)
    return np.where(quantum > 0.0, np.round(out / step) * step, out)
