# SPDX-License-Identifier: Apache-2.0
"""Whole recordings foretold from how they begin: where a model ends up, and how far off."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pneu_sysid.contacts.chain import Chain, Outputs
from pneu_sysid.contacts.drawn import drawn, settled
from pneu_sysid.contacts.estimate import Problem, State, estimate
from pneu_sysid.contacts.knots import chain_of
from pneu_sysid.contacts.physics import Motion, Physics
from pneu_sysid.contacts.rollouts import rolled_out
from pneu_sysid.contacts.scene import Loaded, Value
from pneu_sysid.contacts.track import Track
from pneu_sysid.contacts.trajectories import unscaled

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Foreseen:
    """A recording foretold from its beginning.

    Attributes:
        track: The recording.
        chain: Its knots.
        motion: What the model does.
        off: Per sensor (m,) how far it is off: length of the difference, or angle, SI.
        time_s: Per sensor (m,) when.
        read: Per sensor that tells no orientation (m, w) what it read.
        told: Likewise what it should have, NaN where the model ran away.
    """

    track: Track
    chain: Chain
    motion: Motion
    off: dict[str, Floats]
    time_s: dict[str, Floats]
    read: dict[str, Floats]
    told: dict[str, Floats]

    def mean(self, sensor: str) -> float:
        """Mean over the whole recording of how far a sensor is off, SI.

        Args:
            sensor: Its name.
        """
        return float(np.mean(self.off[sensor]))


def foresee(
    loaded: Loaded,
    tracks: Sequence[Track],
    values: tuple[Value, ...] | None = None,
    physics: Physics | None = None,
) -> list[Foreseen]:
    """Foretells recordings from the scene's ``start_s`` of each, without what comes later.

    Args:
        loaded: The scene.
        tracks: The recordings.
        values: Its effects; the scene's own unless given.
        physics: What evaluates models.
    """
    physics = physics or Physics()
    values = loaded.scene.values if values is None else values
    setup = loaded.setup(values)
    model = setup.spec.compile()
    alone = Physics(1)

    def one(track: Track) -> Foreseen:
        begin, end = track.span_s
        first = track.between(begin, min(begin + loaded.scene.start_s, end), track.name)
        chain, _ = settled(unscaled(chain_of(loaded, track, model), setup, model), model, setup)
        known = unscaled(chain_of(loaded, first, model), setup, model)
        # a zero that is the recording's own is told by all of it, as by where it comes to rest
        for at in np.flatnonzero(model.jnt_type == 0):
            place = slice(int(model.jnt_qposadr[at]), int(model.jnt_qposadr[at]) + 3)
            known.start[:, place] += chain.start[0, place] - known.start[0, place]
        problem = Problem(loaded, [known], values, [], alone)
        found = estimate(problem, State((drawn(known, model, setup),), problem.start()), 15)
        q = chain.start.copy()
        # the two grids of knots agree where they begin
        q[:2] = found.state.q[0][:2]
        if chain.time_s[1] != known.time_s[1]:
            share = (chain.time_s[1] - chain.time_s[0]) / (known.time_s[1] - known.time_s[0])
            q[1:2] = chain.manifold.moved(q[:1], share * chain.manifold.between(q[:1], q[1:2]))
        motion = rolled_out(chain, model, setup, q, np.array([0]))
        there = motion.there
        safe = motion.whole(chain.start)
        outputs = Outputs(np.zeros_like(safe.v), alone.evaluate(model, safe)[1], safe)
        off: dict[str, Floats] = {}
        when: dict[str, Floats] = {}
        read: dict[str, Floats] = {}
        told: dict[str, Floats] = {}
        for channel in chain.channels:
            misread = chain.misreadings(channel, outputs, setup)
            seen = there[channel.knots]
            off[channel.name] = np.where(seen, np.linalg.norm(misread, axis=1), np.inf)
            when[channel.name] = chain.time_s[channel.knots]
            if not channel.turns:
                measured = chain.measured(channel, setup.readings[channel.name])
                read[channel.name] = measured
                told[channel.name] = np.where(seen[:, None], measured + misread, np.nan)
        return Foreseen(track, chain, motion, off, when, read, told)

    return physics.each(one, tracks)
