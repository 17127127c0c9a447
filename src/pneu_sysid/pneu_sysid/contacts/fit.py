# SPDX-License-Identifier: Apache-2.0
"""A scene fitted to recordings: trajectories and parameters, and what the model then predicts."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sysid.contacts.chain import Chain
from pneu_sysid.contacts.estimate import Problem, State, Tell, parameters_of
from pneu_sysid.contacts.frames import turned_frames, words
from pneu_sysid.contacts.physics import Physics
from pneu_sysid.contacts.scene import Loaded, Value
from pneu_sysid.contacts.together import SceneFit, joint
from pneu_sysid.contacts.track import Track
from pneu_sysid.contacts.trajectories import begun
from pneu_sysid.contacts.turns import STARTS, in_turns

Floats = NDArray[np.float64]

TURNS = 2
"""Of trajectories and parameters, where parameters are those that predict best."""


def fit_scene(
    loaded: Loaded,
    tracks: Sequence[Track],
    values: tuple[Value, ...] | None = None,
    physics: Physics | None = None,
    tell: Tell | None = None,
    seed: int = 0,
) -> SceneFit:
    """Fits a scene to recordings.

    Args:
        loaded: The scene.
        tracks: The recordings.
        values: Its effects; the scene's own unless given.
        physics: What evaluates models.
        tell: Called with a note and the fraction done.
        seed: Of other values that are looked at before the first.

    Returns:
        The fit.
    """
    physics = physics or Physics()
    values = loaded.scene.values if values is None else values
    horizon = loaded.scene.horizon_s
    chains, q = begun(loaded, tracks, values, physics)
    _check_frames(loaded, chains, q, values, physics)
    if horizon is None or not parameters_of(loaded, values):
        return joint(loaded, chains, values, q, physics, tell=tell, tracks=tracks)
    longest = max(float(c.time_s[-1] - c.time_s[0]) for c in chains)
    return in_turns(
        loaded, tracks, chains, q, values, physics, min(horizon, longest), TURNS,
        starts=STARTS, seed=seed, tell=tell,
    )  # fmt: skip


def _check_frames(
    loaded: Loaded,
    chains: Sequence[Chain],
    q: tuple[Floats, ...],
    values: tuple[Value, ...],
    physics: Physics,
) -> None:
    """Refuses a recording whose vectors are those of the model in a frame turned far."""
    problem = Problem(loaded, chains, values, [], physics)
    said, _, setup = problem.outputs(State(q, problem.start()))
    turned = turned_frames(chains, said, setup)
    if turned:
        raise InputError(f"{chains[0].name}: {words(turned)}")
