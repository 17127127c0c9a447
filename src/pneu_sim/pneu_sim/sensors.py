# SPDX-License-Identifier: Apache-2.0
"""What a sensor makes of the pressure at its tap: clock offset, lag, gain and bias; noise."""

import numpy as np
from numpy.typing import NDArray

from pneu_sim.rig.model import Model

Floats = NDArray[np.float64]


def read(model: Model, pressures: Floats, dt_s: float) -> Floats:
    """Readings of the sensors of a rig.

    Args:
        model: The rig.
        pressures: (T, n_taps, ...) pressures at the taps, Pa.
        dt_s: Sample interval, s.

    Returns:
        Readings of the same shape, Pa. Before the first sample the pressure is taken as constant.
    """
    out = pressures
    for t, (lag, gain, bias, offset) in enumerate(model.sensor):
        if lag <= 0.0 and gain == 1.0 and bias == 0.0 and offset == 0.0:
            continue
        if out is pressures:
            out = pressures.copy()
        x = out[:, t]
        if offset != 0.0:
            at = np.clip(np.arange(len(x)) - offset / dt_s, 0.0, len(x) - 1.0)
            i = np.minimum(at.astype(int), len(x) - 2)
            f = (at - i).reshape((-1,) + (1,) * (x.ndim - 1))
            x = (1.0 - f) * x[i] + f * x[i + 1]
        if lag > 0.0:
            from scipy.signal import lfilter  # slow to import, and most sensors have no lag

            # First-order lag, exact for an input that is linear between samples.
            r = dt_s / lag
            a = float(np.exp(-r))
            g = (1.0 - a) / r
            b0, b1 = 1.0 - g, g - a
            start = (x[:1] * (1.0 - b0)) if x.ndim > 1 else np.array([x[0] * (1.0 - b0)])
            x, _ = lfilter([b0, b1], [1.0, -a], x, axis=0, zi=start)
        room = model.ambient[0]
        out[:, t] = room + gain * (x - room) + bias
    return out


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
