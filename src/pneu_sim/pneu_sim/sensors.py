# SPDX-License-Identifier: Apache-2.0
"""What a sensor makes of the pressure at its tap: clock offset, lag, gain and bias; noise."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pneu_sim.compiling import compiled
from pneu_sim.rig.model import S_BIAS, S_GAIN, S_LAG, S_OFFSET, Model

Floats = NDArray[np.float64]


@compiled
def _lagged(
    pressure: Floats,
    keep: Floats,
    old: Floats,
    new: Floats,
    felt: Floats,
    shown: Floats,
    out: Floats,
) -> None:
    """First-order lags, exact for pressures that are linear between samples.

    Args:
        pressure: (samples, n_taps, lanes) Pa.
        keep: (n_taps, lanes) what is kept of a reading ...
        old: ... what comes from the pressure a sample ago ...
        new: ... and what from the present one.
        felt: (n_taps, lanes) pressure of the latest sample, changed in place.
        shown: (n_taps, lanes) its reading, changed in place.
        out: (samples, n_taps, lanes) readings.
    """
    for k in range(pressure.shape[0]):
        for t in range(pressure.shape[1]):
            for j in range(pressure.shape[2]):
                p = pressure[k, t, j]
                shown[t, j] = keep[t, j] * shown[t, j] + old[t, j] * felt[t, j] + new[t, j] * p
                felt[t, j] = p
                out[k, t, j] = shown[t, j]


class Sensors:
    """The sensors of rigs side by side, and the past that they still show."""

    def __init__(self, models: Sequence[Model]) -> None:
        """Takes the sensors as the rigs have them.

        Args:
            models: The rigs, on one plan.
        """
        sensor = np.stack([m.sensor for m in models], axis=-1)
        self._lag, self._offset = sensor[:, S_LAG], sensor[:, S_OFFSET]
        self._gain, self._bias = sensor[:, S_GAIN], sensor[:, S_BIAS]
        self._room = np.array([m.ambient[0] for m in models])
        self._exact = bool(np.all(self._gain == 1.0) and np.all(self._bias == 0.0))
        self._lags, self._late = bool(np.any(self._lag > 0.0)), bool(np.any(self._offset != 0.0))
        self._past = np.zeros((0, *self._lag.shape))
        self._felt, self._shown = np.zeros_like(self._lag), np.zeros_like(self._lag)
        self._interval_s = 0.0

    def begin(self, taps_pa: Floats) -> None:
        """Has pressures stand that have long been there.

        Args:
            taps_pa: (n_taps, lanes) pressures at the taps, Pa.
        """
        self._past = taps_pa[None].copy()
        self._felt, self._shown = taps_pa.copy(), taps_pa.copy()

    def follow(self, taps_pa: Floats, interval_s: float) -> Floats:
        """Readings at further samples.

        A sensor whose clock is behind shows what was; one whose clock is ahead shows what comes, as
        far as it is given. Where the interval changes, what was is taken to have been constant.

        Args:
            taps_pa: (samples, n_taps, lanes) pressures at the taps, Pa, beginning one interval
                after the latest.
            interval_s: Between samples, s.

        Returns:
            Readings of the same shape, Pa, without noise.
        """
        if interval_s != self._interval_s:
            self._past, self._interval_s = self._past[-1:], interval_s
        seen = taps_pa
        if self._late:
            whole = np.concatenate([self._past, taps_pa])
            seen = self._at_their_clocks(whole, len(taps_pa))
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
        """Returns what the sensors show now, without noise: (n_taps, lanes), Pa."""
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
        return np.asarray(self._room + self._gain * (seen - self._room) + self._bias)

    def _at_their_clocks(self, whole: Floats, count: int) -> Floats:
        """The latest pressures as of the sensors' clocks; the earliest was there before."""
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
    """Readings of the sensors of a rig along a whole recording.

    Args:
        model: The rig.
        pressures: (T, n_taps) pressures at the taps, Pa.
        dt_s: Sample interval, s.

    Returns:
        Readings of the same shape, Pa. Before the first sample the pressure is taken as constant.
    """
    sensors = Sensors([model])
    sensors.begin(pressures[0, :, None])
    return sensors.follow(pressures[:, :, None], dt_s)[:, :, 0]


def corrupt(
    readings: Floats, noise_pa: Floats, quantum_pa: Floats, rng: np.random.Generator
) -> Floats:
    """Adds white noise and quantisation to readings.

    Args:
        readings: (T, n_taps) Pa.
        noise_pa: (n_taps,) standard deviations.
        quantum_pa: (n_taps,) steps; 0 is none.
        rng: Source of the noise.

    Returns:
        (T, n_taps) noisy readings.
    """
    out = readings + rng.normal(size=readings.shape) * noise_pa
    step = np.where(quantum_pa > 0.0, quantum_pa, 1.0)
    return np.where(quantum_pa > 0.0, np.round(out / step) * step, out)
