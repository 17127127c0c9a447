# SPDX-License-Identifier: Apache-2.0
"""Candidates fitted for real: strength, and position along a pipe, one at a time or together."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from pneu_sim.effects import find_effect
from pneu_sim.effects.base import POSITION, EffectParameter
from pneu_sim.rig import with_parameters
from pneu_sim.rig.schema import Rig
from pneu_sysid.candidates import Project, Score, residual_matrix
from pneu_sysid.evidence import share_explained
from pneu_sysid.gauss_newton import Estimate, Variable, huber_cost, minimise
from pneu_sysid.problem import Problem
from pneu_sysid.sites import Site
from pneu_sysid.stages import residual_function
from pneu_sysid.thresholds import Thresholds

Floats = NDArray[np.float64]

ITERATIONS, TOLERANCE = 5, 1e-3
AT_LEAST = 0.25
"""A strength is fitted from this fraction of the typical one at least: from zero there may be no
slope."""
ELSEWHERE = 0.2
"""A place is tried with another strength too where that would be other by this share."""
LOOKS = 5
WORTH_ANOTHER = 1e-3
"""Places are looked at again, so many times at most, as long as the misfit falls by this share."""


@dataclass(eq=False)
class Refit:
    """What a candidate achieves when its parameters are fitted.

    Attributes:
        site: The candidate, its position fitted.
        strength: Fitted strength.
        std_error: Its standard error.
        position_error_m: Standard error of its position; None where it has none.
        explained: Fraction of the squared residual explained where it was fitted.
        held_out: The same on the part kept aside.
        t: Strength over its standard error.
        score_explained: The score's explained fraction.
        residual: (n_stretches, m) what is left, in noise units, without what is uncertain anyway.
        change: (n_stretches, m) change of the prediction.
        rig: Rig with the effect.
    """

    site: Site
    strength: float
    std_error: float
    position_error_m: float | None
    explained: float
    held_out: float
    t: float
    score_explained: float
    residual: Floats = field(repr=False)
    change: Floats = field(repr=False)
    rig: Rig = field(repr=False)


def _projected(
    problem: Problem, rig_of: Callable[[Floats], Rig], project: Project | None
) -> Callable[[Sequence[Floats]], Floats]:
    """Batched residuals of what is not held out, without what is uncertain anyway."""
    used = ~problem.held_out
    if project is None:
        return residual_function(problem, used, rig_of)
    raw = residual_function(problem, np.ones_like(used), rig_of)
    return lambda points: np.stack([project(r)[used] for r in raw(points)])


def refit(
    problem: Problem,
    rig: Rig,
    base: Floats,
    candidate: Score,
    thresholds: Thresholds,
    project: Project | None = None,
) -> Refit:
    """Fits strength and position of one candidate on the part that is not held out.

    Args:
        problem: The problem.
        rig: Rig without the candidate.
        base: (n_stretches, m) residual of that rig.
        candidate: The candidate with its one-step estimate.
        thresholds: What decides.
        project: Takes out of a residual what is uncertain anyway.
    """
    site = candidate.site
    strength = site.effect.strength
    low, high = site.effect.limits(strength, rig, site.place)
    least = AT_LEAST * thresholds.typical * abs(strength.typical - strength.absent)
    start = candidate.strength - strength.absent
    if abs(start) < least:
        start = least if start >= 0.0 or low >= strength.absent else -least
    start = float(np.clip(strength.absent + start, low, high))
    variables = [Variable(strength.name, start, low, high, strength.step)]
    shape = site.effect.fitted(rig, site.place)
    variables += [_variable(rig, site, p, p.name, site.shape[p.name]) for p in shape]

    def placed(x: Floats) -> Site:
        values = {p.name: float(v) for p, v in zip(shape, x[1:], strict=True)}
        return Site(site.effect, site.place, {**site.shape, **values})

    residuals = _projected(problem, lambda x: placed(x).attached(rig, float(x[0])), project)
    # whatever else is wrong in the recording must not bend the estimate
    estimate = minimise(residuals, variables, ITERATIONS, TOLERANCE, robust=True)
    own = (base if project is None else project(base))[~problem.held_out]
    for k, p in enumerate(shape, start=1):
        for _ in range(LOOKS if p.scanned else 0):
            spots = np.linspace(variables[k].lower, variables[k].upper, p.scanned)
            at = _elsewhere(residuals, estimate, k, spots, own, variables[0], strength.absent)
            if at is None:
                break
            again = [replace(v, value=float(x)) for v, x in zip(variables, at, strict=True)]
            estimate = minimise(residuals, again, ITERATIONS, TOLERANCE, robust=True)
    fitted = placed(estimate.values)
    position = next((k for k, p in enumerate(shape, start=1) if p.name == POSITION), None)
    value, error = float(estimate.values[0]), float(estimate.std_errors[0])
    better = fitted.attached(rig, value)
    residual = residual_matrix(problem, problem.simulate([better], strict=False).readings[0])
    if project is not None:
        base, residual = project(base), project(residual)
    used = ~problem.held_out
    return Refit(
        site=fitted,
        strength=value,
        std_error=error,
        position_error_m=None if position is None else float(estimate.std_errors[position]),
        explained=share_explained(base[used], residual[used]),
        held_out=share_explained(base[~used], residual[~used]),
        t=abs(value - strength.absent) / max(error, 1e-300),
        score_explained=candidate.explained,
        residual=residual,
        change=base - residual,
        rig=better,
    )


def _elsewhere(
    residuals: Callable[[Sequence[Floats]], Floats],
    estimate: Estimate,
    which: int,
    spots: Floats,
    base: Floats,
    strength: Variable,
    absent: float,
) -> Floats | None:
    """A better point at another value of one variable; None where there is none.

    The misfit has several valleys. Each value is tried with the strength that was found, and with
    the one that there does the same.

    Args:
        residuals: Batched residuals.
        estimate: What was found so far; the strength is its first variable.
        which: The variable that is changed.
        spots: Values to try.
        base: (n_stretches, m) residual without the effect.
        strength: Bounds of the strength.
        absent: Strength at which the effect vanishes.
    """
    tried = []
    for spot in spots:
        tried.append(estimate.values.copy())
        tried[-1][which] = spot
    costs = []
    others = []
    for point, r in zip(tried, residuals(tried), strict=True):
        costs.append(huber_cost(r))
        change = base - r
        size = float(np.sum(change * change))
        by = float(np.sum(change * base)) / size if size > 0.0 else 1.0
        if abs(by - 1.0) > ELSEWHERE:
            others.append(point.copy())
            others[-1][0] = np.clip(
                absent + by * (point[0] - absent), strength.lower, strength.upper
            )
    if others:
        costs += [huber_cost(r) for r in residuals(others)]
    best = int(np.argmin(costs))
    better = costs[best] < (1.0 - WORTH_ANOTHER) * huber_cost(estimate.residual)
    return [*tried, *others][best] if better else None


def _variable(
    rig: Rig, site: Site, parameter: EffectParameter, name: str, value: float
) -> Variable:
    """A parameter of an effect as a variable."""
    low, high = site.effect.limits(parameter, rig, site.place)
    step = parameter.step
    if parameter.name == POSITION:
        step = min(0.05, 0.05 * (high - low))
    return Variable(name, float(np.clip(value, low, high)), low, high, step)


def effect_variables(rig: Rig, index: int) -> list[Variable]:
    """What is fitted of an attached effect, as variables named by their paths, strength first.

    Args:
        rig: The rig.
        index: Which of ``rig.effects``.
    """
    attached = rig.effects[index]
    effect = find_effect(attached.effect)
    bare = rig.model_copy(update={"effects": rig.effects[:index]})
    site = Site(effect, attached.place, {})
    return [
        _variable(
            bare,
            site,
            p,
            f"effects.{index}.parameters.{p.name}",
            attached.parameters.get(p.name, p.absent),
        )
        for p in (effect.strength, *effect.fitted(bare, attached.place))
    ]


def refit_effects(
    problem: Problem,
    rig: Rig,
    indices: list[int],
    iterations: int = 4,
    project: Project | None = None,
) -> tuple[Rig, Estimate]:
    """Fits strengths and positions of attached effects together.

    Args:
        problem: The problem; what it holds out is not used.
        rig: Rig with the effects attached.
        indices: Which of them to fit.
        iterations: Gauss-Newton iterations.
        project: Takes out of a residual what is uncertain anyway.

    Returns:
        The fitted rig and the estimate, whose variables are those of `effect_variables` in order.
    """
    variables = [v for i in indices for v in effect_variables(rig, i)]
    # A parameter left at its default is not in the file yet.
    rig = rig.model_copy(deep=True)
    for v in variables:
        _, i, _, name = v.name.split(".")
        rig.effects[int(i)].parameters.setdefault(name, v.value)

    def rig_of(x: Floats) -> Rig:
        return with_parameters(
            rig, {v.name: float(value) for v, value in zip(variables, x, strict=True)}
        )

    # whatever else is wrong in the recording must not bend the estimate
    estimate = minimise(
        _projected(problem, rig_of, project),
        variables,
        iterations=iterations,
        tolerance=2e-3,
        robust=True,
    )
    return rig_of(estimate.values), estimate
