# SPDX-License-Identifier: Apache-2.0
"""A scene fitted to recordings: trajectories and parameters, and what the model then predicts."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats.qmc import Sobol

from pneu_common.errors import InputError
from pneu_sysid.contacts.chain import Chain, with_slack
from pneu_sysid.contacts.drawn import settled
from pneu_sysid.contacts.effects.base import Setup
from pneu_sysid.contacts.estimate import (
    Estimated,
    Parameter,
    Problem,
    State,
    Tell,
    estimate,
    parameters_of,
)
from pneu_sysid.contacts.frames import turned_frames, words
from pneu_sysid.contacts.knots import chain_of, guess
from pneu_sysid.contacts.physics import Physics
from pneu_sysid.contacts.rest import touching_down
from pneu_sysid.contacts.rollouts import (
    losses,
    polish,
    predicted,
    scales_of,
)
from pneu_sysid.contacts.scene import Loaded, Value
from pneu_sysid.contacts.track import Track

Floats = NDArray[np.float64]

ROUNDS = 2
"""Turns of trajectories and parameters, where parameters are those that predict best."""
STARTS = 32
"""Other values that are looked at before the first, by what they predict: impacts that go another
way make as many valleys."""
BEST = 3
"""Of them that are fitted."""
TOGETHER = 50
"""Iterations of trajectories and parameters together, at most."""
SETTLED = 1e-5
"""A share of the cost that is not worth another of them."""
SMOOTHING = 8
"""Iterations of a trajectory under parameters that are held."""
SMOOTH = 1e-3
"""A share of the cost that is not worth another of them."""


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
                for component in channel.unzeroed:
                    start[:, address + component] += touching_down(start, at, component, model)
                break
    return replace(chain, start=start)


def fit_scene(
    loaded: Loaded,
    tracks: Sequence[Track],
    values: tuple[Value, ...] | None = None,
    physics: Physics | None = None,
    tell: Tell | None = None,
    start: tuple[list[Chain], tuple[Floats, ...]] | None = None,
    scales: Floats | None = None,
    starts: int = STARTS,
    rounds: int = ROUNDS,
    seed: int = 0,
) -> SceneFit:
    """Fits a scene to recordings.

    Args:
        loaded: The scene.
        tracks: The recordings.
        values: Its effects; the scene's own unless given.
        physics: What evaluates models.
        tell: Called with a note and the fraction done.
        start: Chains and trajectories to start from.
        scales: What misreadings of predictions are measured by.
        starts: See `STARTS`.
        rounds: See `ROUNDS`.
        seed: Of the other values.

    Returns:
        The fit.
    """
    physics = physics or Physics()
    values = loaded.scene.values if values is None else values
    horizon = loaded.scene.horizon_s
    chains, q = start or begun(loaded, tracks, values, physics)
    parameters = parameters_of(loaded, values)
    _check_frames(loaded, chains, q, values, physics)
    if horizon is None or not parameters:
        return joint(loaded, chains, values, q, physics, tell=tell)
    longest = max(float(c.time_s[-1] - c.time_s[0]) for c in chains)
    horizon = min(horizon, longest)
    problem = Problem(loaded, chains, values, [], physics)
    found = estimate(
        problem, State(q, problem.start()), SMOOTHING, enough=SMOOTH, tell=_part(tell, 0, rounds)
    )
    q = found.state.q
    problem = problem.fitting(parameters)
    x = problem.start()
    errors = np.full(len(x), np.inf)
    if starts:
        if scales is None:
            scales = scales_of(predicted(problem, *problem.model(x), q, horizon))
        x = _best_start(problem, x, q, horizon, scales, starts, seed, _part(tell, 0.5, rounds))
        values = problem.valued(x)
        chains, q, found = smoothed(loaded, chains, values, q, physics)
    for number in range(rounds):
        problem = Problem(loaded, chains, values, parameters, physics)
        best = polish(problem, x, q, horizon, scales=scales, tell=_part(tell, number + 0.6, rounds))
        x, errors = best.x, best.std_errors
        values = problem.valued(x)
        chains, q, found = smoothed(loaded, chains, values, q, physics)
    problem = Problem(loaded, chains, values, parameters, physics)
    foretold = predicted(problem, *problem.model(x), q, horizon)
    if scales is None:
        scales = scales_of(foretold)
    loss = losses(foretold, scales)
    return SceneFit(loaded, values, parameters, x, errors, chains, q, found, scales, loss)


def joint(
    loaded: Loaded,
    chains: Sequence[Chain],
    values: tuple[Value, ...],
    q: tuple[Floats, ...],
    physics: Physics,
    iterations: int = TOGETHER,
    enough: float = SETTLED,
    tell: Tell | None = None,
) -> SceneFit:
    """Trajectories and parameters estimated together, from where they stand.

    Args:
        loaded: The scene.
        chains: Its recordings.
        values: Its effects.
        q: Trajectories.
        physics: What evaluates models.
        iterations: At most.
        enough: A share of the cost that is not worth another.
        tell: Called with a note and the fraction done.
    """
    parameters = parameters_of(loaded, values)
    problem = Problem(loaded, chains, values, parameters, physics)
    found = estimate(problem, State(q, problem.start()), iterations, enough=enough, tell=tell)
    cost = found.costs / np.array([readings_of(c) for c in chains])
    unsettled = "The estimate did not settle; more iterations may help."
    return SceneFit(
        loaded, found.values, parameters, found.state.x, jackknife(found), list(chains),
        found.state.q, found, None, cost, [] if found.converged else [unsettled],
    )  # fmt: skip


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


def jackknife(found: Estimated) -> Floats:
    """(c,) standard errors of an estimate's parameters, by leaving out one chain after another.

    Args:
        found: The estimate.
    """
    n, c = found.slope.shape
    if not c:
        return np.zeros(0)
    if n < 2:  # what the curvature of the cost tells, were the norms what they say
        return np.sqrt(np.maximum(np.diag(np.linalg.pinv(found.hessian.sum(axis=0))), 0.0))
    H, g = found.hessian.sum(axis=0), found.slope.sum(axis=0)
    left = np.array(
        [-np.linalg.pinv(H - h) @ (g - b) for h, b in zip(found.hessian, found.slope, strict=True)]
    )
    return np.asarray(np.sqrt((n - 1) / n * np.sum((left - left.mean(axis=0)) ** 2, axis=0)))


def readings_of(chain: Chain) -> int:
    """How many numbers sensors told along a chain.

    Args:
        chain: The chain.
    """
    return sum(len(c.knots) * c.size for c in chain.channels)


def _part(tell: Tell | None, number: float, rounds: int) -> Tell | None:
    if tell is None:
        return None
    whole = rounds + 0.5
    return lambda note, done: tell(note, (number + done) / whole)
