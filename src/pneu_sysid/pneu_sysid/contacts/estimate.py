# SPDX-License-Identifier: Apache-2.0
"""Trajectories and parameters estimated together, by Gauss and Newton's method.

Levenberg and Marquardt's damping keeps the Hessian definite, a line search that ends at Wolfe's
conditions keeps the cost falling, and parameters stay within bounds (thesis 2.4 and 2.8).
"""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky
from scipy.optimize import lsq_linear

from pneu_sysid.contacts.arrow import Arrow, Eliminated, eliminate
from pneu_sysid.contacts.chain import Chain, Outputs, by_kind
from pneu_sysid.contacts.effects import find_scene_effect
from pneu_sysid.contacts.effects.base import SceneEffect, Setup
from pneu_sysid.contacts.physics import Physics
from pneu_sysid.contacts.scene import Loaded, Value
from pneu_sysid.contacts.yielding import yielding_column

Floats = NDArray[np.float64]
Tell = Callable[[str, float], None]

ARMIJO = 1e-4
"""Share of the promised fall of the cost that a step must bring."""
WOLFE = 0.9
"""Share of the slope that may be left at the end of a step."""
SHORTEST = 1e-4
"""A shorter step along a direction is none: damping is raised instead."""
FIRST_DAMPING = 1e-6
MOST_DAMPING = 1e8
LEAST_DAMPING = 1e-10
ENOUGH = 1e-6
"""A share of the cost that is not worth another iteration."""


@dataclass(frozen=True)
class Parameter:
    """A parameter of the estimate.

    Attributes:
        effect: Its effect.
        place: Where.
        lower: Least value.
        upper: Largest value.
        std: Standard deviation of what is known of it beforehand; inf for nothing.
        known: That value.
    """

    effect: SceneEffect
    place: str
    lower: float
    upper: float
    std: float = np.inf
    known: float = 0.0

    @property
    def label(self) -> str:
        """Its name for people."""
        return f"{self.effect.name}@{self.place}"

    def coordinate(self, value: float) -> float:
        """What the estimate moves in place of a value.

        Args:
            value: The value.
        """
        return float(np.log(value)) if self.effect.logarithmic else value

    def value(self, coordinate: float) -> float:
        """The value of a coordinate.

        Args:
            coordinate: What the estimate moves.
        """
        return float(np.exp(coordinate)) if self.effect.logarithmic else coordinate


@dataclass(frozen=True)
class State:
    """Trajectories and parameters.

    Attributes:
        q: (n, nq) per chain.
        x: (c,) coordinates of the parameters.
    """

    q: tuple[Floats, ...]
    x: Floats


@dataclass
class Estimated:
    """Outcome of an estimate.

    Attributes:
        values: Effects with what was found, and those that were not fitted.
        state: Trajectories and parameters.
        parameters: What was estimated.
        history: Cost after each iteration, the start first.
        costs: Cost of each chain at the end.
        hessian: (chains, c, c) of the parameters, trajectories taken out.
        slope: (chains, c) gradient of them.
        iterations: How many were run.
        converged: Whether it ended because another was not worth it.
        seconds: Time of each part: ``slopes``, ``columns``, ``solve``, ``search``.
    """

    values: tuple[Value, ...]
    state: State
    parameters: list[Parameter]
    history: list[float]
    costs: Floats
    hessian: Floats
    slope: Floats
    iterations: int
    converged: bool
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def cost(self) -> float:
        """The cost at the end."""
        return self.history[-1]


class Problem:
    """Chains of one scene, and the parameters that they share.

    Args:
        loaded: The scene.
        chains: Its recordings.
        values: Effects that differ from the MJCF.
        parameters: Which of them are estimated.
        physics: What evaluates models.
        centred: See `Physics.slopes`.
    """

    def __init__(
        self,
        loaded: Loaded,
        chains: Sequence[Chain],
        values: tuple[Value, ...],
        parameters: Sequence[Parameter],
        physics: Physics,
        centred: bool = True,
    ) -> None:
        self.loaded = loaded
        self.chains = list(chains)
        self.values = values
        self.parameters = list(parameters)
        self.physics = physics
        self.centred = centred

    def fitting(self, parameters: Sequence[Parameter]) -> "Problem":
        """The same problem with other parameters.

        Args:
            parameters: They.
        """
        return Problem(
            self.loaded, self.chains, self.values, parameters, self.physics, self.centred
        )

    def start(self) -> Floats:
        """(c,) coordinates of the parameters at the values that the scene has."""
        setup = self.loaded.setup(self.values)
        out = []
        for p in self.parameters:
            now = p.effect.value(setup, p.place)
            value = float(np.clip(now, p.lower, p.upper)) if now != p.effect.absent else now
            out.append(p.coordinate(value))
        return np.array(out)

    def bounds(self) -> tuple[Floats, Floats]:
        """(c,) least and largest coordinates."""
        low = [p.coordinate(p.lower) for p in self.parameters]
        high = [p.coordinate(p.upper) for p in self.parameters]
        return np.array(low), np.array(high)

    def valued(self, x: Floats) -> tuple[Value, ...]:
        """The scene's effects with the parameters' values.

        Args:
            x: (c,) coordinates.
        """
        out = {(v.effect, v.at): v for v in self.values}
        for p, at in zip(self.parameters, x, strict=True):
            key = (p.effect.name, p.place)
            given = out.get(key) or Value(effect=p.effect.name, at=p.place)
            out[key] = given.but(value=float(np.clip(p.value(at), p.effect.lower, p.effect.upper)))
        return tuple(out.values())

    def model(self, x: Floats) -> tuple[Any, Setup]:
        """The model of some parameters, and the scene it is made from.

        Args:
            x: (c,) coordinates.
        """
        setup = self.loaded.setup(self.values)
        for p, at in zip(self.parameters, x, strict=True):
            p.effect.put(setup, p.place, p.value(at))
        return setup.spec.compile(), setup

    def outputs(self, state: State) -> tuple[list[Outputs], Any, Setup]:
        """What the model says along every chain.

        Args:
            state: Trajectories and parameters.
        """
        model, setup = self.model(state.x)
        said = [
            chain.outputs(q, model, setup, self.physics)
            for chain, q in zip(self.chains, state.q, strict=True)
        ]
        return said, model, setup

    def cost(self, state: State) -> float:
        """The whole cost, what is known of parameters included.

        Args:
            state: Trajectories and parameters.
        """
        said, _, setup = self.outputs(state)
        total = sum(c.cost(o, setup) for c, o in zip(self.chains, said, strict=True))
        cost = total + self.prior(state.x)[0]
        return cost if np.isfinite(cost) else np.inf

    def kinds(self, state: State) -> Floats:
        """(chains, kinds) cost per knot, far from everything and near something; NaN without one.

        Args:
            state: Trajectories and parameters.
        """
        said, _, setup = self.outputs(state)
        return np.array([by_kind(c, o, setup) for c, o in zip(self.chains, said, strict=True)])

    def prior(self, x: Floats) -> tuple[float, Floats, Floats]:
        """Cost of what is known of parameters, its gradient, and the diagonal of its Hessian.

        Args:
            x: (c,) coordinates.
        """
        off = np.zeros(len(x))
        weight = np.zeros(len(x))
        for k, p in enumerate(self.parameters):
            if np.isfinite(p.std):
                scale = p.known if p.effect.logarithmic else 1.0
                off[k] = x[k] - p.coordinate(p.known)
                weight[k] = (scale / p.std) ** 2
        return float(0.5 * np.sum(weight * off**2)), weight * off, weight

    def columns(
        self, state: State, said: list[Outputs], setup: Setup
    ) -> list[list[tuple[Floats, Floats]]]:
        """What residuals change by with each parameter, per chain.

        Args:
            state: Trajectories and parameters.
            said: What the model says there.
            setup: The scene.
        """
        out: list[list[tuple[Floats, Floats]]] = [[] for _ in self.chains]
        for k, p in enumerate(self.parameters):
            if p.effect.adds_joint and p.effect.value(setup, p.place) == 0.0:
                for c, (chain, q) in enumerate(zip(self.chains, state.q, strict=True)):
                    column = yielding_column(chain, q, setup, p.effect, p.place, self.physics)
                    out[c].append(column)
                continue
            step = p.effect.step
            ends = []
            for way in (step, -step):
                x = state.x.copy()
                x[k] += way
                if p.effect.absent == p.lower and p.value(x[k]) < p.lower:
                    x[k] = state.x[k]  # what cannot be less than nothing is looked at one way
                moved = self.loaded.setup(self.values)
                for other, at in zip(self.parameters, x, strict=True):
                    other.effect.put(moved, other.place, other.value(at))
                model = moved.spec.compile() if p.effect.in_mjcf else None
                ends.append((x[k], model, moved))
            apart = ends[0][0] - ends[1][0]
            for c, chain in enumerate(self.chains):
                rows = []
                for _, model, moved in ends:
                    if model is not None:
                        o = chain.outputs(state.q[c], model, moved, self.physics)
                    elif moved.clock != setup.clock:
                        here, _ = self.model(state.x)
                        o = chain.outputs(state.q[c], here, moved, self.physics)
                    else:
                        o = said[c]
                    rows.append(chain.rows(o, moved))
                out[c].append(
                    ((rows[0][0] - rows[1][0]) / apart, (rows[0][1] - rows[1][1]) / apart)
                )
        return out

    def arrows(self, state: State, seconds: dict[str, float] | None = None) -> list[Arrow]:
        """Gradient and Gauss-Newton Hessian of every chain.

        Args:
            state: Trajectories and parameters.
            seconds: Where the time of each part is added to.
        """
        with _timed(seconds, "columns"):
            said, model, setup = self.outputs(state)
            columns = self.columns(state, said, setup)
        # of several recordings each is a thread's, and not the knots of one
        physics = self.physics if len(self.chains) == 1 else Physics(1)

        def one(chain: Chain, q: Floats, o: Outputs, column: list[tuple[Floats, Floats]]) -> Arrow:
            return chain.arrow(q, o, model, setup, column, physics, self.centred)

        with _timed(seconds, "slopes"):
            return self.physics.each(one, self.chains, state.q, said, columns)

    def moved(self, state: State, steps: Sequence[Floats], by: Floats, share: float) -> State:
        """A state some way along a direction.

        Args:
            state: Where from.
            steps: (n, nv) per chain.
            by: (c,) of the parameters.
            share: How much of it.
        """
        low, high = self.bounds()
        q = tuple(
            chain.manifold.moved(at, share * step)
            for chain, at, step in zip(self.chains, state.q, steps, strict=True)
        )
        return State(q, np.clip(state.x + share * by, low, high))


@contextmanager
def _timed(seconds: dict[str, float] | None, name: str) -> Iterator[None]:
    """Adds the time of a block to a sum."""
    begun = time.perf_counter()
    yield
    if seconds is not None:
        seconds[name] = seconds.get(name, 0.0) + time.perf_counter() - begun


@dataclass(frozen=True)
class Direction:
    """A step of everything, and what it promises.

    Attributes:
        steps: (n, nv) per chain.
        by: (c,) of the parameters.
        slope: Derivative of the cost along it, negative.
    """

    steps: list[Floats]
    by: Floats
    slope: float


def direction(
    problem: Problem,
    state: State,
    arrows: Sequence[Arrow],
    damping: float,
    trajectory: bool = True,
    parameters: bool = True,
) -> Direction | None:
    """The damped Gauss-Newton step.

    Args:
        problem: The problem.
        state: Where.
        arrows: Gradient and Hessian there.
        damping: See `arrow.band_of`.
        trajectory: Whether trajectories move.
        parameters: Whether parameters move.

    Returns:
        The step; None where more damping is needed.
    """
    c = len(problem.parameters)
    _, prior_slope, prior_bend = problem.prior(state.x)
    hessian, slope = np.diag(prior_bend), prior_slope.copy()
    gone: list[Eliminated | None] = []
    for arrow in arrows:
        if not trajectory:
            hessian, slope = hessian + arrow.held(), slope + arrow.tip_slope
            gone.append(None)
            continue
        taken = eliminate(arrow, damping)
        if taken is None:
            return None
        gone.append(taken)
        hessian, slope = hessian + taken.hessian, slope + taken.slope
    by = np.zeros(c)
    if parameters and c:
        low, high = problem.bounds()
        found = bounded(hessian, slope, damping, low - state.x, high - state.x)
        if found is None:
            return None
        by = found
    steps, total = [], float(prior_slope @ by)
    for arrow, eliminated in zip(arrows, gone, strict=True):
        step = (
            np.zeros_like(arrow.slope)
            if eliminated is None
            else eliminated.step + eliminated.lever @ by
        )
        steps.append(step)
        total += float(np.sum(arrow.slope * step) + arrow.tip_slope @ by)
    return Direction(steps, by, total)


def bounded(
    hessian: Floats, slope: Floats, damping: float, low: Floats, high: Floats
) -> Floats | None:
    """Least of a quadratic within a box.

    Args:
        hessian: (c, c).
        slope: (c,).
        damping: Share of the diagonal that is added to it.
        low: (c,) least step.
        high: (c,) largest.

    Returns:
        (c,) the step; None where the quadratic has no least.
    """
    diagonal = np.maximum(np.diag(hessian), 0.0)
    scale = np.sqrt(np.maximum(diagonal, 1e-30))
    scaled = hessian / np.outer(scale, scale)
    scaled = scaled + max(damping, 1e-10) * np.eye(len(slope))
    try:
        upper = cholesky(scaled)
    except np.linalg.LinAlgError:
        return None
    except ValueError:  # not finite
        return None
    right = np.linalg.solve(upper.T, -slope / scale)
    gap = 1e-15
    found = lsq_linear(
        upper, right, bounds=(np.minimum(low * scale, -gap), np.maximum(high * scale, gap))
    )
    return np.asarray(np.clip(found.x / scale, low, high))


def estimate(
    problem: Problem,
    state: State | None = None,
    iterations: int = 50,
    trajectory: bool = True,
    parameters: bool = True,
    enough: float = ENOUGH,
    tell: Tell | None = None,
    kept: Path | None = None,
) -> Estimated:
    """Finds trajectories and parameters of least cost, from where they stand.

    Args:
        problem: The problem.
        state: Where to start; what sensors tell and the scene's values, unless given.
        iterations: At most.
        trajectory: Whether trajectories are estimated.
        parameters: Whether parameters are.
        enough: See `ENOUGH`.
        tell: Called with a note and the fraction done.
        kept: File that holds where an interrupted run stood; it is gone after a whole one.

    Returns:
        What was found.
    """
    state = state or State(tuple(chain.start for chain in problem.chains), problem.start())
    if trajectory and not problem.parameters and len(problem.chains) > 1 and kept is None:
        return _one_by_one(problem, state, iterations, enough, tell)
    damping = FIRST_DAMPING
    seconds: dict[str, float] = {}
    history: list[float] = []
    begun = 0
    if kept is not None and kept.exists():
        state, damping, history = _resumed(kept, state)
        begun = max(0, len(history) - 1)
    arrows = problem.arrows(state, seconds)
    cost = sum(a.cost for a in arrows) + problem.prior(state.x)[0]
    history = history or [cost]
    converged = False
    number = begun
    for number in range(begun + 1, iterations + 1):
        if tell is not None:
            tell(f"cost {cost:.6g}, iteration {number}", number / iterations)
        better: tuple[float, State, float] | None = None
        way: Direction | None = None
        while better is None and damping <= MOST_DAMPING:
            with _timed(seconds, "solve"):
                way = direction(problem, state, arrows, damping, trajectory, parameters)
            if way is None:
                damping = max(10.0 * damping, 1e-8)
                continue
            if way.slope > -5e-4 * enough * cost:
                break
            with _timed(seconds, "search"):
                better = _searched(problem, state, way, cost)
            if better is None:
                damping *= 10.0
        if better is None or way is None:
            converged = damping <= MOST_DAMPING
            break
        share, state, now = better
        damping = max(damping * (0.1 if share >= 0.5 else 3.0), LEAST_DAMPING)
        arrows = problem.arrows(state, seconds)
        fallen = cost - now
        # Wolfe's second condition: a step that ends where the slope is still steep was too short,
        # by too much damping
        if _slope_left(arrows, way) < WOLFE * way.slope:
            damping = max(0.01 * damping, LEAST_DAMPING)
        cost = now
        history.append(cost)
        if kept is not None:
            _keep(kept, state, damping, history)
        if fallen <= enough * cost and share >= 0.5:
            converged = True
            break
    last = [eliminate(arrow, 1e-12) or eliminate(arrow, 1e-6) for arrow in arrows]
    c = len(problem.parameters)
    if kept is not None and kept.exists():
        kept.unlink()
    return Estimated(
        values=problem.valued(state.x),
        state=state,
        parameters=problem.parameters,
        history=history,
        costs=np.array([a.cost for a in arrows]),
        hessian=np.array([np.zeros((c, c)) if e is None else e.hessian for e in last]),
        slope=np.array([np.zeros(c) if e is None else e.slope for e in last]),
        iterations=number,
        converged=converged,
        seconds=seconds,
    )


def _one_by_one(
    problem: Problem, state: State, iterations: int, enough: float, tell: Tell | None
) -> Estimated:
    """Trajectories that share no parameter, each for itself.

    One that is far off would else hold back the steps of all.
    """
    count = len(problem.chains)
    done = [0.0] * count

    def one(k: int) -> Estimated:
        chain = problem.chains[k]

        def part(note: str, share: float) -> None:
            assert tell is not None
            done[k] = share
            tell(f"{chain.name}: {note}", sum(done) / count)

        # a recording is short: threads share recordings, and not the knots of one
        alone = Physics(1)
        only = Problem(problem.loaded, [chain], problem.values, [], alone, problem.centred)
        begun = State((state.q[k],), state.x)
        return estimate(only, begun, iterations, enough=enough, tell=tell and part)

    found = problem.physics.each(one, range(count))
    longest = max(len(f.history) for f in found)
    history = np.sum([f.history + f.history[-1:] * (longest - len(f.history)) for f in found], 0)
    seconds: dict[str, float] = {}
    for name, took in (item for f in found for item in f.seconds.items()):
        seconds[name] = seconds.get(name, 0.0) + took
    return Estimated(
        values=problem.values,
        state=State(tuple(f.state.q[0] for f in found), state.x),
        parameters=[],
        history=[float(cost) for cost in history],
        costs=np.concatenate([f.costs for f in found]),
        hessian=np.concatenate([f.hessian for f in found]),
        slope=np.concatenate([f.slope for f in found]),
        iterations=max(f.iterations for f in found),
        converged=all(f.converged for f in found),
        seconds=seconds,
    )


def _slope_left(arrows: Sequence[Arrow], way: Direction) -> float:
    """Derivative of the cost along a direction, at its end."""
    return sum(
        float(np.sum(a.slope * step) + a.tip_slope @ way.by)
        for a, step in zip(arrows, way.steps, strict=True)
    )


def _searched(
    problem: Problem, state: State, way: Direction, cost: float
) -> tuple[float, State, float] | None:
    """The first step along a direction that brings enough; None where none does."""
    share = 1.0
    while share >= SHORTEST:
        there = problem.moved(state, way.steps, way.by, share)
        now = problem.cost(there)
        if now <= cost + ARMIJO * share * way.slope:
            return share, there, now
        # least of the parabola through what is known, kept within a tenth and a half
        bend = now - cost - share * way.slope
        best = -0.5 * way.slope * share**2 / bend if np.isfinite(bend) and bend > 0.0 else 0.0
        share = float(np.clip(best, 0.1 * share, 0.5 * share))
    return None


def _keep(path: Path, state: State, damping: float, history: list[float]) -> None:
    from pneu_common.files import whole

    arrays: dict[str, Any] = {f"q{k}": q for k, q in enumerate(state.q)}
    with whole(path) as aside, aside.open("wb") as stream:
        np.savez(stream, x=state.x, damping=damping, history=np.array(history), **arrays)


def _resumed(path: Path, state: State) -> tuple[State, float, list[float]]:
    with np.load(path) as kept:
        q = tuple(kept[f"q{k}"] for k in range(len(state.q)) if f"q{k}" in kept)
        same = len(q) == len(state.q) and all(
            a.shape == b.shape for a, b in zip(q, state.q, strict=True)
        )
        if not same or kept["x"].shape != state.x.shape:
            return state, FIRST_DAMPING, []
        return State(q, kept["x"]), float(kept["damping"]), [float(x) for x in kept["history"]]


def parameters_of(loaded: Loaded, values: tuple[Value, ...]) -> list[Parameter]:
    """The parameters that a scene has fitted.

    Args:
        loaded: The scene.
        values: Its effects.
    """
    setup = loaded.setup(values)
    out = []
    for value in values:
        if not value.fit:
            continue
        effect = find_scene_effect(value.effect)
        low = effect.lower if value.lower is None else max(value.lower, effect.lower)
        high = effect.upper if value.upper is None else min(value.upper, effect.upper)
        known = effect.value(setup, value.at)
        std = np.inf if value.std is None else value.std
        out.append(Parameter(effect, value.at, low, high, std, known))
    return out
