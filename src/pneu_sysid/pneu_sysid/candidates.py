# SPDX-License-Identifier: Apache-2.0
"""Candidate effects against the residual of a rig: score, quick refit, held-out gain."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from pneu_sim.effects import Effect, registry
from pneu_sim.effects.base import POSITION
from pneu_sim.rig.schema import AttachedEffect, Rig
from pneu_sysid.gauss_newton import Variable, huber_cost, minimise
from pneu_sysid.problem import Problem
from pneu_sysid.stages import residual_function

Floats = NDArray[np.float64]

SECANT = 0.5
"""Sensitivities are secants at this fraction of an effect's typical strength: effects such as a
blockage or a dead-band start flatter or steeper at zero than they go on."""
REFIT_ITERATIONS = 5
POSITIONS = 11
"""Positions along a pipe that are looked at again once the strength is known."""


@dataclass(frozen=True)
class Site:
    """An effect at a place.

    Attributes:
        effect: The effect.
        place: Part of the rig.
        shape: Its parameters but the strength.
    """

    effect: Effect
    place: str
    shape: dict[str, float]

    @property
    def label(self) -> str:
        """``effect@place``, with the position where there is one."""
        if POSITION in self.shape:
            return f"{self.effect.name}@{self.place}:{self.shape[POSITION]:.2f}"
        return f"{self.effect.name}@{self.place}"

    def attached(self, rig: Rig, strength: float) -> Rig:
        """Returns the rig with the effect at a strength.

        Args:
            rig: The rig; left as it is.
            strength: Strength in the effect's unit.
        """
        values = {**self.shape, self.effect.strength.name: strength}
        extra = AttachedEffect(effect=self.effect.name, place=self.place, parameters=values)
        return rig.model_copy(update={"effects": [*rig.effects, extra]})


@dataclass
class Score:
    """What the sensitivities at zero strength say of one candidate.

    Attributes:
        site: The candidate.
        strength: One-step estimate.
        explained: Fraction of the squared residual it would explain.
        t: Estimate over its jackknife standard error, stretches left out one at a time.
        sensitivity: (n_stretches, m) change of the prediction per unit strength, in noise units.
    """

    site: Site
    strength: float
    explained: float
    t: float
    sensitivity: Floats = field(repr=False)


@dataclass
class Refit:
    """What a candidate achieves when its parameters are fitted.

    Attributes:
        site: The candidate, its position fitted.
        strength: Fitted strength.
        std_error: Its standard error.
        explained: Fraction of the squared residual explained where it was fitted.
        held_out: The same on the part kept aside.
        t: Significance by the score's jackknife.
        score_explained: The score's explained fraction.
        change: (n_stretches, m) change of the prediction, in noise units.
        rig: Rig with the effect.
    """

    site: Site
    strength: float
    std_error: float
    explained: float
    held_out: float
    t: float
    score_explained: float
    change: Floats = field(repr=False)
    rig: Rig = field(repr=False)


def all_sites(rig: Rig, positions: int = 8) -> list[Site]:
    """Every effect of the catalogue at every place of a rig.

    Args:
        rig: The rig.
        positions: Intervals between the positions tried along the longest pipe.
    """
    spacing_m = max(0.25, max(pipe.length_m for pipe in rig.pipes.values()) / positions)
    return [
        Site(effect, place, shape)
        for effect in registry().values()
        for place, shape in effect.sites(rig, spacing_m)
    ]


def residual_matrix(problem: Problem, readings: Floats) -> Floats:
    """(n_stretches, m) residual of one rig in noise units.

    Args:
        problem: The problem.
        readings: (n_stretches, horizon, n_taps) predictions.
    """
    return problem.residual(readings).reshape(problem.stretches, -1)


def score(
    problem: Problem,
    rig: Rig,
    sites: Sequence[Site],
    project: Callable[[Floats], Floats] | None = None,
    progress: Callable[[float], None] | None = None,
) -> tuple[Floats, list[Score]]:
    """Scores candidates by the simulator's own sensitivities, all in one batched call.

    Args:
        problem: The problem.
        rig: Rig without them.
        sites: The candidates.
        project: Takes out of a residual what is uncertain anyway.
        progress: Called with the fraction done.

    Returns:
        (n_stretches, m) residual and the scores, in the order of the sites.
    """
    steps = [SECANT * site.effect.strength.typical for site in sites]
    rigs = [rig] + [
        s.attached(rig, s.effect.strength.absent + h) for s, h in zip(sites, steps, strict=True)
    ]
    y = problem.predict(rigs, progress)
    noise = problem.noise_pa
    missing = ~np.isfinite(problem.target())
    residual = residual_matrix(problem, y[0])
    project = project or (lambda x: x)
    r = project(residual)
    total = float(np.sum(r * r))
    out = []
    for k, (site, h) in enumerate(zip(sites, steps, strict=True)):
        s = (y[k + 1] - y[0]) / (noise * h)
        s[missing] = 0.0
        s = s.reshape(residual.shape)
        m = project(s)
        a, b = np.sum(m * r, axis=1), np.sum(m * m, axis=1)
        lower, _ = site.effect.limits(site.effect.strength, rig, site.place)
        out.append(_score_of(site, s, a, b, total, lower))
    return residual, out


def _score_of(site: Site, s: Floats, a: Floats, b: Floats, total: float, lower: float) -> Score:
    """One-step strength, explained fraction and jackknife significance."""
    total_b = float(b.sum())
    if total_b <= 1e-12 or total <= 0.0:
        return Score(site, 0.0, 0.0, 0.0, s)
    eta = float(a.sum()) / total_b
    strength = site.effect.strength
    if not lower <= strength.absent + eta:
        return Score(site, strength.absent, 0.0, 0.0, s)
    n = a.size
    rest = np.maximum(total_b - b, 1e-12)
    left_out = (a.sum() - a) / rest
    se = float(np.sqrt((n - 1) / n * np.sum((left_out - left_out.mean()) ** 2)))
    explained = eta * float(a.sum()) / total
    return Score(site, strength.absent + eta, explained, abs(eta) / max(se, 1e-300), s)


def best_per_place(scores: Sequence[Score]) -> list[Score]:
    """The best position of every effect on every part, best first.

    Args:
        scores: Scores of all sites.
    """
    best: dict[tuple[str, str], Score] = {}
    for item in scores:
        key = (item.site.effect.name, item.site.place)
        if key not in best or item.explained > best[key].explained:
            best[key] = item
    return sorted(best.values(), key=lambda item: -item.explained)


def refit(
    problem: Problem,
    rig: Rig,
    base: Floats,
    candidate: Score,
    project: Callable[[Floats], Floats] | None = None,
    iterations: int = REFIT_ITERATIONS,
) -> Refit:
    """Fits strength and position of one candidate on the part that is not held out.

    Args:
        problem: The problem.
        rig: Rig without the candidate.
        base: (n_stretches, m) residual of that rig.
        candidate: The candidate with its one-step estimate.
        project: Takes out of a residual what is uncertain anyway.
        iterations: Gauss-Newton iterations.
    """
    site = candidate.site
    strength = site.effect.strength
    low, high = site.effect.limits(strength, rig, site.place)
    floor = 0.25 * strength.typical
    start = candidate.strength - strength.absent
    if abs(start) < floor:
        start = floor if start >= 0.0 or low >= strength.absent else -floor
    start = float(np.clip(strength.absent + start, low, high))
    variables = [Variable(strength.name, start, low, high, strength.step)]
    position = next((p for p in site.effect.parameters if p.name == POSITION), None)
    if position is not None:
        lower, upper = site.effect.limits(position, rig, site.place)
        step = min(0.05, 0.05 * (upper - lower))
        variables.append(Variable(POSITION, site.shape[POSITION], lower, upper, step))

    def placed(x: Floats) -> Site:
        shape = {**site.shape, POSITION: float(x[1])} if position is not None else site.shape
        return Site(site.effect, site.place, shape)

    used = ~problem.held_out
    raw = residual_function(
        problem,
        used if project is None else np.ones_like(used),
        lambda x: placed(x).attached(rig, float(x[0])),
    )

    def residuals(points: Sequence[Floats]) -> Floats:
        found = raw(points)
        return found if project is None else np.stack([project(r)[used] for r in found])

    # whatever else is wrong in the recording must not bend the estimate
    estimate = minimise(residuals, variables, iterations, tolerance=3e-3, robust=True)
    if position is not None:
        # The misfit has several valleys along a pipe: look into all of them at the strength found.
        spots = np.linspace(variables[1].lower, variables[1].upper, POSITIONS)
        tried = [np.array([estimate.values[0], spot]) for spot in spots]
        costs = [huber_cost(r) for r in residuals(tried)]
        if min(costs) < huber_cost(estimate.residual):
            at = tried[int(np.argmin(costs))]
            again = [replace(v, value=float(x)) for v, x in zip(variables, at, strict=True)]
            estimate = minimise(residuals, again, iterations, tolerance=3e-3, robust=True)
    fitted = placed(estimate.values)
    better = fitted.attached(rig, float(estimate.values[0]))
    residual = residual_matrix(problem, problem.predict([better])[0])
    if project is not None:
        base, residual = project(base), project(residual)
    return Refit(
        site=fitted,
        strength=float(estimate.values[0]),
        std_error=float(estimate.std_errors[0]),
        explained=_gain(base[used], residual[used]),
        held_out=_gain(base[~used], residual[~used]),
        t=candidate.t,
        score_explained=candidate.explained,
        change=base - residual,
        rig=better,
    )


def _gain(before: Floats, after: Floats) -> float:
    total = float(np.sum(before * before))
    return 1.0 - float(np.sum(after * after)) / total if total > 0.0 else 0.0


def cosine(a: Floats, b: Floats) -> float:
    """Cosine between two changes of the prediction.

    Args:
        a: (n_stretches, m).
        b: (n_stretches, m).
    """
    norm = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(np.sum(a * b)) / norm if norm > 0.0 else 0.0
