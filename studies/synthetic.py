# SPDX-License-Identifier: Apache-2.0
"""Short recordings of rig A's own model on a finer grid, for tests that need one quickly."""

import numpy as np
from numpy.typing import NDArray

from pneu_sim.rig.schema import Rig
from pneu_sim.run import add_noise, run_rig
from pneu_sysid.records import Recording, even_recording

RATE_HZ = 500.0
NOISE_PA = 250.0


def commands(seconds: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """Valve volts: held random steps, large ones at first, then small ones around null."""
    volts = np.empty(round(seconds * RATE_HZ))
    at = 0
    while at < volts.size:
        hold = int(rng.uniform(0.02, 0.2) * RATE_HZ)
        spread = 5.0 if at < 0.4 * volts.size else 1.2
        volts[at : at + hold] = np.clip(5.0 + rng.uniform(-spread, spread), 0.0, 10.0)
        at += hold
    return volts


def synthetic(
    rig: Rig, seconds: float, seed: int, name: str, volts: NDArray[np.float64] | None = None
) -> Recording:
    """A recording of a rig on a grid of half the cell length, with noise; of `commands` if none."""
    rng = np.random.default_rng(seed)
    finer = rig.model_copy(
        update={"grid": rig.grid.model_copy(update={"dx_m": 0.5 * rig.grid.dx_m})}
    )
    volts = commands(seconds, rng) if volts is None else volts
    taps = add_noise(rig, run_rig(finer, {"voltage": volts}, 1.0 / RATE_HZ), rng, NOISE_PA)
    size = len(next(iter(taps.values())))
    return even_recording(name, np.arange(size) / RATE_HZ, {"voltage": volts[:size]}, taps)
