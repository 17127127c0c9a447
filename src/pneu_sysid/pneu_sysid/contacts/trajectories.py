# SPDX-License-Identifier: Apache-2.0
"""Trajectories of recordings: where they start, and as they are under parameters that are held."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_sysid.contacts.chain import Chain, with_slack
from pneu_sysid.contacts.drawn import settled
from pneu_sysid.contacts.effects.base import Reading, Setup
from pneu_sysid.contacts.estimate import Estimated, Problem, State, estimate
from pneu_sysid.contacts.knots import chain_of, guess
from pneu_sysid.contacts.physics import Physics
from pneu_sysid.contacts.rest import touching_down
from pneu_sysid.contacts.scene import Loaded, Value
from pneu_sysid.contacts.track import Track

Floats = NDArray[np.float64]

SMOOTHING = 8
"""Iterations of a trajectory under parameters that are held."""
SMOOTH = 1e-3
"""A share of the cost that is not worth another of them."""


def begun(
    loaded: Loaded, tracks: Sequence[Track], values: tuple[Value, ...], physics: Physics
) -> tuple[list[Chain], tuple[Floats, ...]]:
    """Chains of recordings, and trajectories to start from: the model drawn to what is seen.

    Args:
        loaded: The scene.
        tracks: The recordings.
        values: Its effects.
        physics: What evaluates models.
    """
    setup = loaded.setup(values)
    model = setup.spec.compile()

    def one(track: Track) -> tuple[Chain, Floats]:
        return settled(unscaled(chain_of(loaded, track, model), setup, model), model, setup)

    both = physics.each(one, tracks)
    chains = [c for c, _ in both]
    starts = [np.where(_finite(q), q, c.start) for c, q in both]
    chains = [
        with_slack(c, loaded, q, model, setup, physics) for c, q in zip(chains, starts, strict=True)
    ]
    return chains, tuple(starts)


def redrawn(
    loaded: Loaded,
    chains: Sequence[Chain],
    tracks: Sequence[Track],
    values: tuple[Value, ...],
    physics: Physics,
) -> tuple[Floats, ...]:
    """Trajectories to start from under other values, on the knots that there are.

    Args:
        loaded: The scene.
        chains: The recordings' knots.
        tracks: The recordings.
        values: The scene's effects.
        physics: What evaluates models.
    """
    setup = loaded.setup(values)
    model = setup.spec.compile()

    def one(chain: Chain, track: Track) -> Floats:
        raw = replace(chain, start=guess(loaded, track, chain.time_s, model))
        there, q = settled(unscaled(raw, setup, model), model, setup)
        return np.where(_finite(q), q, there.start)

    return tuple(physics.each(one, chains, tracks))


def _finite(q: Floats) -> NDArray[np.bool_]:
    """(n, 1) which configurations are known."""
    return np.asarray(np.isfinite(q).all(axis=1))[:, None]


def unscaled(chain: Chain, setup: Setup, model: Any) -> Chain:
    """A chain that starts where bodies are, not where a sensor of another scale has them.

    Args:
        chain: The chain.
        setup: The scene.
        model: The model.
    """
    start = chain.start.copy()
    for channel in chain.channels:
        told = setup.readings[channel.name]
        if channel.turns or channel.size != 3 or channel.stage != 1:
            continue
        for at in range(int(model.njnt)):
            if int(model.jnt_type[at]) == 0:
                address = int(model.jnt_qposadr[at])
                start[:, address : address + 3] /= told.gain
                for component, bias in told.bias.items():
                    start[:, address + component] -= bias / told.gain
                if told != Reading(lag_s=told.lag_s):  # it has come down in its own scale
                    for component in channel.unzeroed:
                        start[:, address + component] += touching_down(start, at, component, model)
                break
    return replace(chain, start=start)


def smoothed(
    loaded: Loaded,
    chains: Sequence[Chain],
    values: tuple[Value, ...],
    q: tuple[Floats, ...],
    physics: Physics,
    iterations: int = SMOOTHING,
) -> tuple[list[Chain], tuple[Floats, ...], Estimated]:
    """Trajectories under parameters that are held, from where they stand.

    Args:
        loaded: The scene.
        chains: The recordings.
        values: Its effects.
        q: Trajectories to start from.
        physics: What evaluates models.
        iterations: At most.
    """
    setup = loaded.setup(values)
    model = setup.spec.compile()
    chains = [
        with_slack(c, loaded, at, model, setup, physics) for c, at in zip(chains, q, strict=True)
    ]
    problem = Problem(loaded, chains, values, [], physics, centred=False)
    found = estimate(problem, State(q, problem.start()), iterations, enough=SMOOTH)
    return chains, found.state.q, found
