# SPDX-License-Identifier: Apache-2.0
"""Trajectories and parameters of a scene estimated together, and what a fitted scene is."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pneu_sysid.contacts.arrow import jackknife
from pneu_sysid.contacts.chain import Chain
from pneu_sysid.contacts.estimate import (
    Estimated,
    Parameter,
    Problem,
    State,
    Tell,
    estimate,
    parameters_of,
)
from pneu_sysid.contacts.physics import Physics
from pneu_sysid.contacts.scene import Loaded, Value
from pneu_sysid.contacts.track import Track
from pneu_sysid.contacts.trajectories import redrawn

Floats = NDArray[np.float64]

TOGETHER = 50
"""Iterations of trajectories and parameters together, at most."""
SETTLED = 1e-5
"""A share of the cost that is not worth another of them."""
DRAWN_ANEW = 6
"""Times that trajectories are drawn anew under what was found, at most."""
EXPLAINED = 0.5
"""Cost per reading that norms expect where a trajectory explains what was read."""
BETTER = 0.02
"""Share of the cost that drawing anew must take away to count as help."""
GIVEN_UP = 2
"""Times in a row that it did not help: parameters may move on while one trajectory goes astray."""


@dataclass
class SceneFit:
    """A scene fitted to recordings.

    Attributes:
        loaded: The scene.
        values: Its effects, with what was found.
        parameters: What was fitted.
        x: (c,) their coordinates.
        std_errors: (c,) of them, by leaving out one recording after another.
        chains: The recordings.
        q: Trajectory of each.
        estimated: The last estimate.
        scales: (R,) what predictions are off by, robustly, where the scene has a horizon.
        loss: (chains,) mean Huber loss of predictions, or cost per reading without a horizon.
        notes: What was noticed, a sentence each.
    """

    loaded: Loaded
    values: tuple[Value, ...]
    parameters: list[Parameter]
    x: Floats
    std_errors: Floats
    chains: list[Chain]
    q: tuple[Floats, ...]
    estimated: Estimated
    scales: Floats | None
    loss: Floats
    notes: list[str] = field(default_factory=list)

    def told(self, k: int) -> tuple[float, float]:
        """Value and standard error of a parameter.

        Args:
            k: Which.
        """
        p = self.parameters[k]
        value = p.value(float(self.x[k]))
        error = float(self.std_errors[k])
        return value, value * error if p.effect.logarithmic else error


def joint(
    loaded: Loaded,
    chains: Sequence[Chain],
    values: tuple[Value, ...],
    q: tuple[Floats, ...],
    physics: Physics,
    iterations: int = TOGETHER,
    enough: float = SETTLED,
    tell: Tell | None = None,
    tracks: Sequence[Track] = (),
) -> SceneFit:
    """Trajectories and parameters estimated together, from where they stand.

    Where they leave much, or creep on after as many iterations as others need to settle,
    trajectories may lie on a floor that is no longer where it was: they are drawn anew under what
    was found, and all is estimated again, as long as that helps.

    Args:
        loaded: The scene.
        chains: Its recordings.
        values: Its effects.
        q: Trajectories.
        physics: What evaluates models.
        iterations: At most.
        enough: A share of the cost that is not worth another.
        tell: Called with a note and the fraction done.
        tracks: The recordings as they were read; without them nothing is drawn anew.
    """
    parameters = parameters_of(loaded, values)
    readings = np.array([readings_of(c) for c in chains])
    problem = Problem(loaded, chains, values, parameters, physics)
    found = estimate(problem, State(q, problem.start()), iterations, enough=enough, tell=tell)
    last, worse = found, 0
    for _ in range(DRAWN_ANEW if tracks and parameters else 0):
        creeps = not found.converged and iterations >= TOGETHER
        if not creeps and np.all(found.costs <= EXPLAINED * readings):
            break
        drawn = redrawn(loaded, chains, tracks, last.values, physics)
        state = State(drawn, last.state.x)
        last = estimate(problem, state, iterations, enough=enough, tell=tell)
        worse = worse + 1 if last.cost > (1.0 - BETTER) * found.cost else 0
        found = min(found, last, key=lambda estimated: estimated.cost)
        if worse == GIVEN_UP:
            break
    unsettled = "The estimate did not settle; more iterations may help."
    return SceneFit(
        loaded=loaded,
        values=found.values,
        parameters=parameters,
        x=found.state.x,
        std_errors=jackknife(found.hessian, found.slope),
        chains=list(chains),
        q=found.state.q,
        estimated=found,
        scales=None,
        loss=found.costs / readings,
        notes=[] if found.converged else [unsettled],
    )


def readings_of(chain: Chain) -> int:
    """How many numbers sensors told along a chain.

    Args:
        chain: The chain.
    """
    return sum(len(c.knots) * c.size for c in chain.channels)
