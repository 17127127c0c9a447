# SPDX-License-Identifier: Apache-2.0
"""Parameters by what trajectories leave that are drawn anew for every step of them.

Where parameters say where a floor is or which way is down, a trajectory that was estimated with
other values lies on another floor, and nothing that moves it a little brings it onto this one; nor
does one recording that is far off let the others move. Here each step of the parameters is that of
Gauss and Newton with trajectories taken out, and every recording is drawn and estimated anew for
it, alone. How wrong a model is of each recording is not known, nor of its flights and its contacts:
with a variance of its own for each the likelihood is a sum of logarithms of their costs (variance
components), one that went another way outweighs none, and what shows in flight is not drowned by
what contacts get wrong.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from pneu_sysid.contacts.arrow import Arrow, Eliminated, eliminate, jackknife
from pneu_sysid.contacts.chain import LEAST, Chain
from pneu_sysid.contacts.estimate import (
    Estimated,
    Parameter,
    Problem,
    State,
    Tell,
    bounded,
)
from pneu_sysid.contacts.physics import Physics
from pneu_sysid.contacts.scene import Loaded, Value
from pneu_sysid.contacts.track import Track
from pneu_sysid.contacts.trajectories import redrawn, smoothed

Floats = NDArray[np.float64]

STEPS = 8
"""Of the parameters, at most."""
REACH = 3.0
"""Most that a step changes a parameter by, in what is typical of it."""
HALVINGS = 2
"""Of a step that makes nothing better."""
SETTLED = 0.1
"""Standard errors: a step that is shorter is none."""
DAMPING = 1e-6
"""Of the parameters' step, as a share of its Hessian's diagonal."""


@dataclass
class Anew:
    """Parameters found, and the trajectories that go with them.

    Attributes:
        values: The scene's effects with them.
        x: (c,) their coordinates.
        std_errors: (c,) of them, by leaving out one recording after another.
        chains: The recordings.
        q: Trajectory of each.
        found: The last estimate of the trajectories.
        history: Cost by `likelihood` after each step, the start first.
    """

    values: tuple[Value, ...]
    x: Floats
    std_errors: Floats
    chains: list[Chain]
    q: tuple[Floats, ...]
    found: Estimated
    history: list[float]


def likelihood(kinds: Floats, counts: Floats) -> float:
    """Minus the logarithm of the likelihood, each recording's flights and contacts for themselves.

    Args:
        kinds: (chains, kinds) cost per knot; NaN without a knot.
        counts: (chains, kinds) knots.
    """
    return float(np.nansum(counts * np.log(np.maximum(kinds, LEAST))))


def counts_of(chains: Sequence[Chain]) -> Floats:
    """(chains, kinds) knots far from everything, and near something.

    Args:
        chains: The recordings.
    """
    return np.array([[np.sum(~c.near), np.sum(c.near)] for c in chains], dtype=float)


def trusted(chains: Sequence[Chain], kinds: Floats) -> list[Chain]:
    """Recordings whose knots count by what their kind leaves: its variance.

    Args:
        chains: The recordings.
        kinds: (chains, kinds) cost per knot.
    """
    by = 1.0 / np.maximum(np.nan_to_num(kinds, nan=1.0), LEAST)
    return [
        replace(c, trust=np.where(c.near, near, far))
        for c, (far, near) in zip(chains, by, strict=True)
    ]


def left(arrows: Sequence[Arrow]) -> list[Eliminated]:
    """What is left of parameters with trajectories taken out; nothing where that cannot be done.

    Args:
        arrows: Of the recordings.
    """
    out = []
    for arrow in arrows:
        gone = eliminate(arrow, 1e-12) or eliminate(arrow, 1e-6)
        if gone is None:
            c = len(arrow.tip_slope)
            gone = Eliminated(
                np.zeros((c, c)),
                np.zeros(c),
                np.zeros_like(arrow.slope),
                np.zeros_like(arrow.shaft),
            )
        out.append(gone)
    return out


def anew(
    loaded: Loaded,
    tracks: Sequence[Track],
    chains: Sequence[Chain],
    q: tuple[Floats, ...],
    values: tuple[Value, ...],
    parameters: Sequence[Parameter],
    physics: Physics,
    steps: int = STEPS,
    tell: Tell | None = None,
) -> Anew:
    """Finds parameters by what trajectories leave that are drawn anew for them.

    Args:
        loaded: The scene.
        tracks: The recordings.
        chains: Their knots.
        q: Trajectories to start from, drawn under the scene's values.
        values: The scene's effects.
        parameters: Which of them are found.
        physics: What evaluates models.
        steps: Of the parameters, at most.
        tell: Called with a note and the fraction done.

    Returns:
        What was found.
    """
    counts = counts_of(chains)

    def leaves(chains: list[Chain], values: tuple[Value, ...], q: tuple[Floats, ...]) -> Floats:
        return Problem(loaded, chains, values, [], physics).kinds(State(q, np.zeros(0)))

    there, q, found = smoothed(loaded, chains, values, q, physics)
    kinds = leaves(there, values, q)
    now = likelihood(kinds, counts)
    history = [now]
    x, errors = np.zeros(0), np.full(len(parameters), np.inf)
    for number in range(steps + 1):
        weighed = trusted(there, kinds)
        problem = Problem(loaded, weighed, values, parameters, physics, centred=False)
        x = problem.start()
        ways, errors = _steps(problem, State(q, x))
        if number == steps or np.all(np.abs(ways[0]) <= SETTLED * errors):
            break
        if tell is not None:
            tell(f"likelihood {-now:.5g}", number / steps)
        better = None
        for halving, step in product(range(HALVINGS + 1), ways):
            tried = problem.valued(x + 0.5**halving * step)
            drawn = redrawn(loaded, there, tracks, tried, physics)
            others, at, estimated = smoothed(loaded, there, tried, drawn, physics)
            left_over = leaves(others, tried, at)
            cost = likelihood(left_over, counts)
            if cost < now:
                better = (tried, others, at, estimated, left_over, cost)
                break
        if better is None:
            break
        values, there, q, found, kinds, now = better
        history.append(now)
    return Anew(values, x, errors, there, q, found, history)


def _steps(problem: Problem, state: State) -> tuple[list[Floats], Floats]:
    """Steps of the parameters that may help, and (c,) their standard errors.

    The first is that of least likelihood. Where a trajectory lies on the wrong floor nothing of its
    recording is as its slopes say, and a few such may lead all astray: the second is the median of
    what each recording alone would have.
    """
    arrows = problem.arrows(state)
    gone = left(arrows)
    H = np.array([e.hessian for e in gone])
    g = np.array([e.slope for e in gone])
    _, known_slope, known_bend = problem.prior(state.x)
    known = np.diag(known_bend)
    whole, slope = H.sum(axis=0) + known, g.sum(axis=0) + known_slope
    low, high = problem.bounds()
    reach = np.array(
        [1.0 if p.effect.logarithmic else REACH * p.effect.typical for p in problem.parameters]
    )

    def within(hessian: Floats, slope: Floats) -> Floats:
        step = bounded(hessian, slope, DAMPING, low - state.x, high - state.x)
        if step is None:
            return np.zeros(len(state.x))
        return np.asarray(step / max(1.0, float(np.max(np.abs(step) / reach))))

    ways = [within(whole, slope)]
    errors = jackknife(H, g, known, known_slope)
    if len(H) > 1:
        alone = [within(h + known, b + known_slope) for h, b in zip(H, g, strict=True)]
        ways.append(np.median(alone, axis=0))
    return ways, errors
