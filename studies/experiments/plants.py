# SPDX-License-Identifier: Apache-2.0
"""Plants of the experiments, which are not the models, and what is recorded of them."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from pneu_sim.rig.schema import AttachedEffect, Rig
from pneu_sim.run import add_encoder_noise, add_noise, run_from_rest
from pneu_sim.signals import Signal
from pneu_sysid.design.limits import Limits
from pneu_sysid.design.waves import STEP_S, draw_piece, joined
from pneu_sysid.records import Recording, even_recording

ROOT = Path(__file__).resolve().parents[2]
PLANT_S = 2e-4
RATE_HZ = 500.0
PIECE_S = 1.25
Volts = Mapping[str, np.ndarray]


def plant_of(rig: Rig, hidden: AttachedEffect | None = None) -> Rig:
    """A plant that is not the model: a quarter of its cells' length, another flux.

    Cells half as long still get two fifths as much wrong, the air of a rig nothing.
    """
    grid = rig.grid.model_copy(update={"dx_m": 0.25 * rig.grid.dx_m, "flux": "exact"})
    return rig.model_copy(
        update={"grid": grid, "effects": [] if hidden is None else [hidden], "calibration": None}
    )


def record(plant: Rig, volts: Volts, name: str, seed: int) -> Recording:
    """What its sensors read along commands, with noise."""
    rng = np.random.default_rng([seed, 41])
    size = len(next(iter(volts.values())))
    grid = np.arange(size) * STEP_S
    at = np.arange(round(size * STEP_S / PLANT_S)) * PLANT_S
    commands = {n: Signal(grid, np.asarray(v)) for n, v in volts.items()}
    out = run_from_rest(plant, {n: s.held(at) for n, s in commands.items()}, PLANT_S)
    every = round(1.0 / (RATE_HZ * PLANT_S))
    taps = add_noise(plant, {n: x[::every] for n, x in out.taps.items()}, rng)
    turns = add_encoder_noise(plant, {n: x[::every] for n, x in out.encoders.items()}, rng)
    recording = even_recording(name, at[::every], {}, taps, turns)
    recording.commands.update(commands)
    return recording


def random_volts(rig: Rig, limits: Limits, seconds: float, seed: int) -> dict[str, np.ndarray]:
    """Random steps."""
    rng = np.random.default_rng([seed, 43])
    count = round(seconds / PIECE_S)
    return joined([draw_piece(rig, limits, PIECE_S, "steps", rng) for _ in range(count)], limits)
