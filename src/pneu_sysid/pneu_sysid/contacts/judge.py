# SPDX-License-Identifier: Apache-2.0
"""Fits a scene to some recordings and judges it by what it leaves of others."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pneu_sysid.contacts.anew import STEPS
from pneu_sysid.contacts.chain import Chain
from pneu_sysid.contacts.estimate import (
    Parameter,
    Problem,
    State,
    estimate,
    parameters_of,
)
from pneu_sysid.contacts.physics import Physics
from pneu_sysid.contacts.scene import Loaded, Value
from pneu_sysid.contacts.sureness import falls_of, trimmed
from pneu_sysid.contacts.together import SceneFit, joint
from pneu_sysid.contacts.track import Track
from pneu_sysid.contacts.trajectories import begun, redrawn
from pneu_sysid.contacts.turns import in_turns

Floats = NDArray[np.float64]

AHEAD_S = 0.1
"""How far ahead parameters predict: long enough for an impact, and too short for one that went
another way to spoil what follows (thesis 8.1.2: 0.1 to 0.5 s)."""
ITERATIONS = 15
"""Of each estimate, at most."""
ENOUGH = 1e-3
"""A share of the cost that is not worth another."""
POLISHED = 5
"""Steps of parameters to what predicts best, at most."""
TURNS = 2
"""Of what trajectories tell and what predicts best, one after the other."""
CANDIDATE_TURNS = 1
"""Of them with a candidate: all else is where it should be."""
CANDIDATE_STEPS = 2
"""Of what trajectories tell with a candidate, in each turn: it begins at its score."""
WORTH = 0.02
"""Share by which the cost of flights or of contacts that are kept aside must fall."""
MOST = 64
"""Recordings that are looked at, evenly from those given: every second is kept aside."""


def divided(loaded: Loaded, tracks: Sequence[Track]) -> tuple[list[Track], list[Track]]:
    """Recordings to fit, and recordings to judge by; one alone is cut into stretches.

    Args:
        loaded: The scene.
        tracks: The recordings.
    """
    if len(tracks) < 4:
        parts = []
        for track in tracks:
            begin, end = track.span_s
            count = max(4 // len(tracks), round((end - begin) / loaded.scene.segment_s))
            edges = np.linspace(begin, end, count + 1)
            parts += [
                track.between(a, b, f"{track.name} {a:.2f} to {b:.2f} s")
                for a, b in pairwise(edges)
            ]
        tracks = parts
    if len(tracks) > MOST:
        tracks = [tracks[int(k)] for k in np.linspace(0, len(tracks) - 1, MOST).round()]
    return list(tracks[::2]), list(tracks[1::2])


@dataclass(frozen=True)
class Aside:
    """What a fitted scene leaves of recordings that it was not fitted to.

    Attributes:
        chains: The recordings.
        q: Trajectory of each, estimated under parameters that are held (thesis, table 2.3).
        total: (chains,) cost of each.
        kinds: (chains, kinds) cost per knot; NaN without a knot.
    """

    chains: list[Chain]
    q: tuple[Floats, ...]
    total: Floats
    kinds: Floats

    def least(self, other: "Aside") -> "Aside":
        """The better of two for each recording: what one start misses another may find.

        Args:
            other: The same recordings, under the same parameters.
        """
        worse = other.total < self.total
        q = tuple(b if w else a for a, b, w in zip(self.q, other.q, worse, strict=True))
        kinds = np.where(worse[:, None], other.kinds, self.kinds)
        return Aside(self.chains, q, np.minimum(self.total, other.total), kinds)


def left_aside(
    fit: SceneFit, chains: Sequence[Chain], q: tuple[Floats, ...], physics: Physics
) -> Aside:
    """What a fitted scene leaves of other recordings.

    Args:
        fit: The scene.
        chains: The recordings.
        q: Trajectories to start from.
        physics: What evaluates models.
    """
    problem = Problem(fit.loaded, chains, fit.values, [], physics, centred=False)
    found = estimate(problem, State(q, problem.start()), ITERATIONS, enough=ENOUGH)
    return Aside(list(chains), found.state.q, found.costs, problem.kinds(found.state))


class Judge:
    """Fits a scene to some recordings and judges it by others.

    Its parameters are those that predict best a short way ahead where the scene has a horizon, else
    those of the joint estimate: where impacts are faster than sensors, contacts that push less
    leave less that nobody applied, and the joint estimate would do without friction. What judges is
    the cost of trajectories of other recordings under parameters that are held (thesis, table
    2.3).
    """

    def __init__(
        self,
        loaded: Loaded,
        used: Sequence[Track],
        aside: Sequence[Track],
        values: tuple[Value, ...],
        physics: Physics,
    ) -> None:
        """Knows what it fits and judges.

        Args:
            loaded: The scene.
            used: Recordings that are fitted.
            aside: Those that judge.
            values: The scene's effects.
            physics: What evaluates models.
        """
        self.loaded, self.used, self.aside = loaded, used, aside
        self.values, self.physics = values, physics
        self.foretells = loaded.scene.horizon_s is not None
        self.others: list[Chain] = []

    def base(self) -> tuple[SceneFit, Aside]:
        """The scene as it is, fitted, and what it leaves aside."""
        chains, q = begun(self.loaded, self.used, self.values, self.physics)
        fit = self._fitted(chains, q, self.values)
        return fit, self.left(fit)

    def _fitted(
        self,
        chains: Sequence[Chain],
        q: tuple[Floats, ...],
        values: tuple[Value, ...],
        steps: int = STEPS,
        also: Parameter | None = None,
        scales: Floats | None = None,
    ) -> SceneFit:
        turns = TURNS if also is None else CANDIDATE_TURNS
        if self.foretells and parameters_of(self.loaded, values):
            return in_turns(
                self.loaded, self.used, chains, q, values, self.physics, AHEAD_S, turns,
                also=also, scales=scales, polished=POLISHED, steps=steps,
            )  # fmt: skip
        return joint(
            self.loaded, chains, values, q, self.physics, ITERATIONS, ENOUGH, tracks=self.used
        )

    def left(self, fit: SceneFit) -> Aside:
        """What a fitted scene leaves of each recording kept aside.

        Args:
            fit: The scene.
        """
        if not self.others:  # knots, and what may be wrong of contacts, are the same for all
            self.others = begun(self.loaded, self.aside, fit.values, self.physics)[0]
        others = self.others
        if fit.chains[0].manifold.nv != others[0].manifold.nv:  # a joint was added
            others = begun(self.loaded, self.aside, fit.values, self.physics)[0]
        q = redrawn(self.loaded, others, self.aside, fit.values, self.physics)
        return left_aside(fit, others, q, self.physics)

    def pair(self, base: SceneFit, known: Aside, fit: SceneFit) -> tuple[Aside, Aside]:
        """What the scene as it is and another leave, each from where the other ended too.

        Trajectories that touch have many valleys; one that only one of the two models happened to
        start in would count for it.

        Args:
            base: The scene as it is.
            known: What it leaves.
            fit: The other.
        """
        here = self.left(fit)
        if here.q[0].shape != known.q[0].shape:
            return known, here
        there = left_aside(base, known.chains, here.q, self.physics)
        return known.least(there), here.least(left_aside(fit, here.chains, known.q, self.physics))

    def refitted(self, base: SceneFit, candidate: Parameter, start: float) -> SceneFit:
        """The scene with a candidate, which comes last of its parameters.

        Args:
            base: The scene as it is.
            candidate: The candidate.
            start: How strong it begins.
        """
        key = (candidate.effect.name, candidate.place)
        values = (
            *(v for v in base.values if (v.effect, v.at) != key),
            Value(effect=key[0], at=key[1], value=start),
        )
        chains, q = base.chains, base.q
        if candidate.effect.adds_joint:  # one more direction of motion
            chains, q = begun(self.loaded, self.used, values, self.physics)
            return self._fitted(chains, q, values, CANDIDATE_STEPS, candidate, base.scales)
        anew = redrawn(self.loaded, chains, self.used, values, self.physics)
        fit = self._fitted(chains, anew, values, CANDIDATE_STEPS, candidate, base.scales)
        if self.foretells:
            return fit
        # contacts that made up for what is missing hold a trajectory where it was; and one drawn
        # anew may have gone astray
        there = self._fitted(chains, q, values, CANDIDATE_STEPS, candidate, base.scales)
        return min(fit, there, key=lambda f: f.estimated.cost)

    def without(
        self, base: SceneFit, known: Aside, found: SceneFit, candidate: Parameter
    ) -> tuple[SceneFit, Aside] | None:
        """The scene as it is, fitted again from where a candidate left its other parameters.

        Args:
            base: The scene as it is.
            known: What it leaves.
            found: The scene with the candidate.
            candidate: It.

        Returns:
            It, and what it leaves of each recording kept aside, where that is less; recordings
            that judge choose for the scene as it is here, so no candidate is favoured.
        """
        key = (candidate.effect.name, candidate.place)
        values = tuple(v for v in found.values if (v.effect, v.at) != key)
        anew = redrawn(self.loaded, base.chains, self.used, values, self.physics)
        fit = self._fitted(base.chains, anew, values, scales=base.scales)
        first, second = self.pair(base, known, fit)
        mean, spread = trimmed(np.nanmean(falls_of(first.kinds, second.kinds), axis=1))
        if mean <= spread or mean < -np.log1p(-WORTH):
            return None
        return fit, second
