# SPDX-License-Identifier: Apache-2.0
"""Parameters that predict best, and those that trajectories tell, one after the other.

What contacts do is found by what roll-outs foretell; everything else, such as where the floor is or
how a sensor is scaled, by what trajectories leave that are drawn anew for it.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats.qmc import Sobol

from pneu_sysid.contacts.anew import STEPS, anew
from pneu_sysid.contacts.chain import Chain
from pneu_sysid.contacts.estimate import Parameter, Problem, Tell, parameters_of
from pneu_sysid.contacts.physics import Physics
from pneu_sysid.contacts.rollouts import losses, polish, predicted, scales_of
from pneu_sysid.contacts.scene import Loaded, Value
from pneu_sysid.contacts.together import SceneFit
from pneu_sysid.contacts.track import Track
from pneu_sysid.contacts.trajectories import smoothed

Floats = NDArray[np.float64]

STARTS = 32
"""Other values that are looked at before the first, by what they predict: impacts that go another
way make as many valleys."""
BEST = 3
"""Of them that are fitted."""


def in_turns(
    loaded: Loaded,
    tracks: Sequence[Track],
    chains: Sequence[Chain],
    q: tuple[Floats, ...],
    values: tuple[Value, ...],
    physics: Physics,
    horizon_s: float,
    turns: int,
    *,
    also: Parameter | None = None,
    scales: Floats | None = None,
    polished: int = 8,
    steps: int = STEPS,
    starts: int = 0,
    seed: int = 0,
    tell: Tell | None = None,
) -> SceneFit:
    """Fits a scene whose parameters are to be those that predict best.

    Args:
        loaded: The scene.
        tracks: The recordings.
        chains: Their knots.
        q: Trajectories to start from.
        values: The scene's effects.
        physics: What evaluates models.
        horizon_s: How far ahead parameters predict.
        turns: Of both kinds of parameters.
        also: A candidate, found as what trajectories tell whatever it is: what shifts readings is
            seen in them, and not in what follows. It comes last of the parameters.
        scales: What misreadings are measured by; by what they are at the start unless given.
        polished: Steps of parameters to what predicts best, at most, in each turn.
        steps: Of the others.
        starts: See `STARTS`; looked at in the first turn.
        seed: Of these.
        tell: Called with a note and the fraction done.

    Returns:
        The fit.
    """
    parameters = parameters_of(loaded, values)
    if also is not None:
        parameters = [*(p for p in parameters if p.label != also.label), also]
    told = [p for p in parameters if p is also or not p.effect.of_contacts]
    pushing = [p for p in parameters if p not in told]
    errors = {p.label: np.inf for p in parameters}
    chains, found = list(chains), None
    for turn in range(turns):
        part = _part(tell, turn, turns)
        if told:
            best = anew(loaded, tracks, chains, q, values, told, physics, steps, part)
            values, chains, q, found = best.values, best.chains, best.q, best.found
            errors |= {p.label: float(e) for p, e in zip(told, best.std_errors, strict=True)}
        if not pushing:
            break
        if not told and turn == 0:
            chains, q, found = smoothed(loaded, chains, values, q, physics)
        problem = Problem(loaded, chains, values, pushing, physics)
        x = problem.start()
        if scales is None:
            scales = scales_of(predicted(problem, *problem.model(x), q, horizon_s))
        if starts and turn == 0:
            x = _best_start(problem, x, q, horizon_s, scales, starts, seed, part)
            values = problem.valued(x)
            chains, q, found = smoothed(loaded, chains, values, q, physics)
            problem = Problem(loaded, chains, values, pushing, physics)
        ahead = polish(problem, x, q, horizon_s, iterations=polished, scales=scales, tell=part)
        values = problem.valued(ahead.x)
        errors |= {p.label: float(e) for p, e in zip(pushing, ahead.std_errors, strict=True)}
        chains, q, found = smoothed(loaded, chains, values, q, physics)
    assert found is not None  # there is a turn, and parameters
    problem = Problem(loaded, chains, values, parameters, physics)
    x = problem.start()
    foretold = predicted(problem, *problem.model(x), q, horizon_s)
    if scales is None:
        scales = scales_of(foretold)
    each = np.array([errors[p.label] for p in parameters])
    loss = losses(foretold, scales)
    return SceneFit(loaded, values, parameters, x, each, chains, q, found, scales, loss)


def _best_start(
    problem: Problem,
    x: Floats,
    q: tuple[Floats, ...],
    horizon_s: float,
    scales: Floats,
    count: int,
    seed: int,
    tell: Tell | None,
) -> Floats:
    """The start, or the one of several others, from which parameters predict best."""
    low, high = problem.bounds()
    reach = np.array(
        [
            np.log(10.0) if p.effect.logarithmic else 3.0 * p.effect.typical
            for p in problem.parameters
        ]
    )
    low, high = np.maximum(low, x - reach), np.minimum(high, x + reach)
    drawn_points = Sobol(len(x), seed=seed).random(count)
    points = [x, *(low + drawn_points * (high - low))]
    found = []
    for k, point in enumerate(points):
        if tell is not None:
            tell(f"start {k + 1} of {len(points)}", 0.1 * k / len(points))
        model, setup = problem.model(point)
        loss = float(np.mean(losses(predicted(problem, model, setup, q, horizon_s), scales)))
        found.append((loss, k))
    found.sort()
    better = []
    for _, k in found[:BEST]:
        fitted = polish(problem, points[k], q, horizon_s, iterations=4, scales=scales)
        better.append((fitted.history[-1], k, fitted.x))
    return min(better, key=lambda b: b[0])[2]


def _part(tell: Tell | None, number: int, of: int) -> Tell | None:
    if tell is None:
        return None
    return lambda note, done: tell(note, (number + done) / of)
