# SPDX-License-Identifier: Apache-2.0
"""Natural frequencies of loss-free lines: tube with end volume, closed and open tubes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq


def tube_volume_roots(q: float, count: int) -> NDArray[np.float64]:
    """Returns the first roots of ``x tan x = q``, shape (count,).

    A tube open at its source end (pressure imposed), area A and length L, ending in a volume V
    resonates at ``omega = x c / L`` with ``q = A L / V``.
    """
    return np.array(
        [
            brentq(
                lambda x: x * np.sin(x) - q * np.cos(x),
                n * np.pi,
                (n + 0.5) * np.pi,
                xtol=1e-15,
                rtol=1e-15,
            )
            for n in range(count)
        ]
    )


def tube_volume_frequencies(
    area: float, length: float, volume: float, sound_speed: float, count: int
) -> NDArray[np.float64]:
    """Returns the frequencies, Hz, of a tube with imposed source pressure and an end volume."""
    roots = tube_volume_roots(area * length / volume, count)
    return roots * sound_speed / (2.0 * np.pi * length)


def helmholtz_frequency(area: float, length: float, volume: float, sound_speed: float) -> float:
    """Returns the resonance, Hz, of a short neck on a large volume."""
    return float(sound_speed / (2.0 * np.pi) * np.sqrt(area / (volume * length)))


def closed_open_frequencies(length: float, sound_speed: float, count: int) -> NDArray[np.float64]:
    """Returns ``(2n - 1) c / 4L``, Hz: one end closed, pressure imposed at the other."""
    return np.asarray((2.0 * np.arange(1, count + 1) - 1.0) * sound_speed / (4.0 * length))


def closed_closed_frequencies(length: float, sound_speed: float, count: int) -> NDArray[np.float64]:
    """Returns ``n c / 2L``, Hz: both ends alike."""
    return np.asarray(np.arange(1, count + 1) * sound_speed / (2.0 * length))
