# SPDX-License-Identifier: Apache-2.0
"""One run of a rig from rest along given commands, by whichever model the rig names."""

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sim import sensors
from pneu_sim.models import FromRest, kind_of
from pneu_sim.rig.schema import Rig

Floats = NDArray[np.float64]


def check_commands(rig: Rig, names: Iterable[str]) -> None:
    """Raises InputError unless some commands are exactly those of a rig.

    Args:
        rig: The rig.
        names: Names of the commands that are given.
    """
    given = set(names)
    known = ", ".join(rig.commands) or "none"
    for name in sorted(given - set(rig.commands)):
        raise InputError(f"rig {rig.name!r}: found command {name!r}, its commands are {known}")
    for name in sorted(set(rig.commands) - given):
        raise InputError(
            f"rig {rig.name!r}: found nothing for command {name!r}, needed are {known}"
        )


def run_rig(rig: Rig, commands: Mapping[str, Floats], sample_s: float) -> dict[str, Floats]:
    """Tap readings of a rig that starts from rest; see `run_from_rest`, which shows joints too.

    Args:
        rig: The rig.
        commands: (T,) volts per command, each held until the next.
        sample_s: Interval of commands and readings, s.

    Returns:
        Per tap its (T,) readings, Pa, without noise.

    Raises:
        InputError: A command is missing or not the rig's, or the simulation became unstable.
    """
    return run_from_rest(rig, commands, sample_s).taps


def run_from_rest(
    rig: Rig, commands: Mapping[str, Floats], sample_s: float, samples: int | None = None
) -> FromRest:
    """Taps and joints of a rig that starts from rest, bodies where their joints start.

    Lines open to a reservoir start at its pressure, all else at the room's.

    Args:
        rig: The rig.
        commands: (T,) volts per command, each held until the next; a rig without valves has none.
        sample_s: Interval of commands and readings, s.
        samples: How many there are, T; None is as many as commands have.

    Raises:
        InputError: A command is missing, not the rig's or of another length, or the simulation
            became unstable.
    """
    check_commands(rig, commands)
    if samples is None:
        samples = max((series.size for series in commands.values()), default=0)
    if samples < 2:
        raise InputError(f"rig {rig.name!r}: found {samples} samples to run along, needed are 2")
    return kind_of(rig).from_rest(rig, commands, sample_s, samples)


def add_noise(
    rig: Rig, taps: Mapping[str, Floats], rng: np.random.Generator, noise_pa: float | None = None
) -> dict[str, Floats]:
    """Readings with the noise and quantisation of the rig's sensors.

    Args:
        rig: The rig.
        taps: Per tap its (T,) readings, Pa.
        rng: Source of the noise.
        noise_pa: Standard deviation that replaces those of the rig.
    """
    parts = [rig.taps[name] for name in taps]
    sigma = [tap.noise_pa if noise_pa is None else noise_pa for tap in parts]
    return _noisy(taps, sigma, [tap.quantum_pa for tap in parts], rng)


def add_encoder_noise(
    rig: Rig, encoders: Mapping[str, Floats], rng: np.random.Generator
) -> dict[str, Floats]:
    """Readings with the noise and quantisation of the rig's encoders.

    Args:
        rig: The rig.
        encoders: Per encoder its (T,) readings, rad or m.
        rng: Source of the noise.
    """
    parts = [rig.encoders[name] for name in encoders]
    return _noisy(encoders, [e.noise for e in parts], [e.quantum for e in parts], rng)


def _noisy(
    readings: Mapping[str, Floats],
    noise: list[float],
    quantum: list[float],
    rng: np.random.Generator,
) -> dict[str, Floats]:
    if not readings:
        return {}
    clean = np.stack(list(readings.values()), axis=-1)
    noisy = sensors.corrupt(clean, np.array(noise), np.array(quantum), rng)
    return dict(zip(readings, noisy.T, strict=True))
