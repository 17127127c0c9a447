# SPDX-License-Identifier: Apache-2.0
"""The noise of a rig's sensors, as its file or its calibration has it."""

from collections.abc import Mapping

import numpy as np

from pneu_sim.observe.settings import ObserverSettings
from pneu_sim.rig.schema import Rig


def noise_of(rig: Rig, settings: ObserverSettings) -> dict[str, float]:
    """Noise of every sensor, Pa, rad or m: of its file, else of its calibration, else usual.

    Args:
        rig: The rig.
        settings: What is usual.
    """
    found = {} if rig.calibration is None else rig.calibration.noise
    noise = {}
    for name, tap in rig.taps.items():
        own = float(np.hypot(tap.noise_pa, tap.quantum_pa / np.sqrt(12.0)))
        noise[name] = own if tap.noise_pa else found.get(name) or settings.noise_pa
    for name, encoder in rig.encoders.items():
        own = float(np.hypot(encoder.noise, encoder.quantum / np.sqrt(12.0)))
        noise[name] = own or found.get(name) or settings.noise_position
    return noise


def with_noise(rig: Rig, noise: Mapping[str, float]) -> Rig:
    """A rig all of whose taps have noise.

    Args:
        rig: The rig.
        noise: Of those whose file tells none, by their names, Pa.
    """
    taps = {
        name: tap if tap.noise_pa else tap.model_copy(update={"noise_pa": noise[name]})
        for name, tap in rig.taps.items()
    }
    return rig.model_copy(update={"taps": taps})
