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
from pneu_sysid.evidence import lead, share_explained
from pneu_sysid.gauss_newton import Estimate, huber_cost, minimise
from pneu_sysid.problem import Problem
from pneu_sysid.sites import Site
from pneu_sysid.slopes import Variable
from pneu_sysid.stages import residual_function
from pneu_sysid.thresholds import Thresholds

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

ITERATIONS, TOLERANCE = 5, 1e-3
AT_LEAST = 0.25
"""A strength is fitted from this fraction of the typical one at least: from zero there may be no
slope."""
LADDER = (3.0, 10.0, 30.0)
"""Strengths, in typical ones, that are tried where none yet explains what is missing."""
ELSEWHERE = 0.2
"""A place is tried with another strength too where that would be other by this share."""
LOOKS = 5
LEAST_SHARE = 1e-2
"""Of its variance the strength keeps so much at least with the shape as found: few stretches tell
how both go together no better."""
KEPT = 4
"""So many of the best points are kept with their residuals; the estimate is nearly always one."""
SETTLING = 3
"""Iterations of a fit on other cells, from where it was found."""
NO_WORSE = 3.0
"""Places count as good that the best one does not lead by so many standard errors."""
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
        held_out: The same on the part kept aside; on all where none is (`Problem.judged`).
        t: Strength over its standard error; that with the shape as found, where both are traded.
        score_explained: The score's explained fraction.
        residual: (n_stretches, m) what is left, in noise units, without what is uncertain anyway.
        change: (n_stretches, m) change of the prediction.
        rig: Rig with the effect.
        places_m: From where to where along its pipe it explains nearly as much; None where that was
            not looked at, or it has no place.
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
    places_m: tuple[float, float] | None = None

    @property
    def at_bound(self) -> bool:
        """Whether the strength is as far as it may be from where the effect vanishes."""
        strength = self.site.effect.strength
        bounds = self.site.effect.limits(strength, self.rig, self.site.place)
        return any(
            bound != strength.absent and abs(self.strength - bound) <= 1e-6 * abs(bound)
            for bound in bounds
        )


class _Residuals:
    """Batched residuals of what is not held out, without what is uncertain anyway.

    Those of the best points, over all stretches, are kept: the estimate is asked for once more.

    Args:
        problem: The problem.
        rig_of: Rig at a parameter vector.
        project: Takes out of a residual what is uncertain anyway.
    """

    def __init__(
        self, problem: Problem, rig_of: Callable[[Floats], Rig], project: Project | None
    ) -> None:
        self._used = ~problem.held_out
        self._project = project
        self._all = residual_function(problem, np.ones_like(self._used), rig_of)
        self._best: list[tuple[float, bytes, Floats]] = []

    def __call__(self, points: Sequence[Floats]) -> Floats:
        """(K, n_used, m) residuals at points."""
        whole = [r if self._project is None else self._project(r) for r in self._all(points)]
        out = np.stack([r[self._used] for r in whole])
        tried = [
            (huber_cost(used), point.tobytes(), r)
            for used, point, r in zip(out, points, whole, strict=True)
        ]
        self._best = sorted([*self._best, *tried], key=lambda entry: entry[0])[:KEPT]
        return out

    def at(self, point: Floats) -> Floats:
        """(n_stretches, m) residual of all stretches at one point."""
        for _, known, r in self._best:
            if known == point.tobytes():
                return r
        r = self._all([point])[0]
        return np.asarray(r if self._project is None else self._project(r))


def refit(
    problem: Problem,
    rig: Rig,
    base: Floats,
    candidate: Score,
    thresholds: Thresholds,
    project: Project | None = None,
    ladder: bool = False,
) -> Refit:
    """Fits strength and position of one candidate on the part that is not held out.

    Args:
        problem: The problem.
        rig: Rig without the candidate.
        base: (n_stretches, m) residual of that rig.
        candidate: The candidate with its one-step estimate.
        thresholds: What decides.
        project: Takes out of a residual what is uncertain anyway.
        ladder: Whether far larger strengths are tried too.
    """
    site = candidate.site
    strength = site.effect.strength
    low, high = site.effect.limits(strength, rig, site.place)
    least = AT_LEAST * thresholds.typical * abs(strength.typical - strength.absent)
    start = candidate.strength - strength.absent
    if abs(start) < least:
        start = least if start >= 0.0 or low >= strength.absent else -least
    start = float(np.clip(strength.absent + start, low, high))
    shape = site.effect.fitted(rig, site.place)
    of_shape = [_variable(rig, site, p, p.name, site.shape[p.name]) for p in shape]
    arm = next((k for k, v in enumerate(of_shape, start=1) if v.name == site.effect.arm), None)
    by = 1.0 if arm is None else of_shape[arm - 1].value
    most = 1.0 if arm is None else of_shape[arm - 1].upper
    variables = [
        Variable(strength.name, start * by, low * most, high * most, strength.step * by),
        *of_shape,
    ]

    def placed(x: Floats) -> Site:
        values = {p.name: float(v) for p, v in zip(shape, x[1:], strict=True)}
        return Site(site.effect, site.place, {**site.shape, **values})

    def strong(x: Floats) -> float:
        """The strength at a point; the first variable may be its product with an arm."""
        return float(x[0] if arm is None else np.clip(x[0] / x[arm], low, high))

    residuals = _Residuals(problem, lambda x: placed(x).attached(rig, strong(x)), project)
    # whatever else is wrong in the recording must not bend the estimate
    estimate = minimise(residuals, variables, ITERATIONS, TOLERANCE, robust=True)
    if ladder and arm is None:
        at = _stronger(residuals, estimate, variables[0], strength)
        if at is not None:
            again = [replace(v, value=float(x)) for v, x in zip(variables, at, strict=True)]
            other = minimise(residuals, again, ITERATIONS, TOLERANCE, robust=True)
            if huber_cost(other.residual) < huber_cost(estimate.residual):
                estimate = other
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
    value, error = strong(estimate.values), float(estimate.std_errors[0])
    sure = _error_of_this_shape(estimate) if site.effect.traded else error
    if arm is not None:
        by = float(estimate.values[arm])
        slope = np.array([1.0 / by, -value / by])
        here = np.ix_([0, arm], [0, arm])
        error = float(np.sqrt(np.maximum(slope @ estimate.covariance[here] @ slope, 0.0)))
        sure /= by  # whether there is any is asked of what is seen first
    better = fitted.attached(rig, value)
    residual = residuals.at(estimate.values)
    if project is not None:
        base = project(base)
    used = ~problem.held_out
    return Refit(
        site=fitted,
        strength=value,
        std_error=error,
        position_error_m=None if position is None else float(estimate.std_errors[position]),
        explained=share_explained(base[used], residual[used]),
        held_out=share_explained(base[problem.judged], residual[problem.judged]),
        t=abs(value - strength.absent) / max(sure, 1e-300),
        score_explained=candidate.explained,
        residual=residual,
        change=base - residual,
        rig=better,
    )


def _error_of_this_shape(estimate: Estimate) -> float:
    """Standard error of the strength, the first variable, with the others as found.

    Whether there is any of an effect is asked of the shape that it has: without strength there is
    no shape (Davies 1987, Biometrika 74(1), 33). Strength and shape may make up for each other, as
    the force and the speed of stiction do, so that neither is known well, though the effect
    is. An effect says so of itself (`Effect.traded`): a valve that opens above some pressure is
    found at one or another by chance.

    Args:
        estimate: The estimate.
    """
    error = float(estimate.std_errors[0])
    free = np.flatnonzero(estimate.visible[1:] & ~estimate.at_bound[1:]) + 1
    if not free.size or not np.isfinite(error):
        return error
    c = estimate.covariance
    with_shape = c[0, free] @ np.linalg.lstsq(c[np.ix_(free, free)], c[free, 0], rcond=None)[0]
    rest = c[0, 0] - float(with_shape)
    return error * float(np.sqrt(np.clip(rest / max(c[0, 0], 1e-300), LEAST_SHARE, 1.0)))


def _stronger(
    residuals: Callable[[Sequence[Floats]], Floats],
    estimate: Estimate,
    bounds: Variable,
    strength: EffectParameter,
) -> Floats | None:
    """The best point of far larger strengths, either way; None where they are all alike.

    An effect that changes its kind with its strength, as a wall that yields so much that the line
    becomes a vessel, has several valleys.

    Args:
        residuals: Batched residuals.
        estimate: What was found so far; the strength is its first variable.
        bounds: Bounds of the strength.
        strength: The strength.
    """
    typical = abs(strength.typical - strength.absent)
    tried: list[Floats] = []
    for factor in LADDER:
        for sign in (1.0, -1.0):
            value = float(
                np.clip(strength.absent + sign * factor * typical, bounds.lower, bounds.upper)
            )
            if value != strength.absent and all(value != point[0] for point in tried):
                point = estimate.values.copy()
                point[0] = value
                tried.append(point)
    if not tried:
        return None
    return tried[int(np.argmin([huber_cost(r) for r in residuals(tried)]))]


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


def settled(problem: Problem, base: Floats, found: Refit, project: Project | None = None) -> Refit:
    """A candidate fitted once more from where it was found: on other cells, it may do better.

    Args:
        problem: The problem, on the cells that count.
        base: (n_stretches, m) residual of the rig without the candidate.
        found: What was found on others.
        project: Takes out of a residual what is uncertain anyway.
    """
    last = len(found.rig.effects) - 1
    rig, estimate = refit_effects(problem, found.rig, [last], SETTLING, project)
    residual = residual_matrix(problem, problem.predict([rig])[0])
    if project is not None:
        residual, base = project(residual), project(base)
    used = ~problem.held_out
    values = rig.effects[last].parameters
    site = found.site
    shape = {name: values.get(name, value) for name, value in site.shape.items()}
    named = [v.name.rpartition(".")[2] for v in effect_variables(rig, last)]
    at = named.index(POSITION) if POSITION in named else None
    strength, error = site.effect.strength, float(estimate.std_errors[0])
    value = values[strength.name]
    sure = _error_of_this_shape(estimate) if site.effect.traded else error
    return replace(
        found,
        site=Site(site.effect, site.place, shape),
        strength=value,
        std_error=error,
        t=abs(value - strength.absent) / max(sure, 1e-300),
        position_error_m=None
        if at is None
        else _place_error(float(estimate.std_errors[at]), found.places_m),
        explained=share_explained(base[used], residual[used]),
        held_out=share_explained(base[problem.judged], residual[problem.judged]),
        residual=residual,
        change=base - residual,
        rig=rig,
    )


def _place_error(std_error_m: float, places_m: tuple[float, float] | None) -> float:
    """Error of a place: no less than half of the way that it may be along."""
    if places_m is None:
        return std_error_m
    half_m = 0.5 * (places_m[1] - places_m[0])
    return max(std_error_m, half_m) if np.isfinite(std_error_m) else half_m


def well_placed(
    problem: Problem, found: Refit, blocks: Ints, project: Project | None = None
) -> Refit:
    """A candidate along its pipe where it explains most, what cells get wrong there made good.

    What a place explains depends on where in a cell it is, by as much as one place differs from
    another far away.

    Args:
        problem: The problem, on the cells that count.
        found: What was found.
        blocks: (n_stretches, m) block of time of each reading.
        project: Takes out of a residual what is uncertain anyway.

    Returns:
        The candidate at that place, with how far it may be from there and nothing else made anew.
    """
    last = len(found.rig.effects) - 1
    variables = effect_variables(found.rig, last)
    own = next((v for v in variables if v.name.endswith(f".{POSITION}")), None)
    shape = {p.name: p for p in found.site.effect.fitted(found.rig, found.site.place)}
    if own is None or not shape[POSITION].scanned:
        return found
    spots = np.linspace(own.lower, own.upper, shape[POSITION].scanned)
    rigs = [found.rig, *(with_parameters(found.rig, {own.name: float(x)}) for x in spots)]
    readings, wrong = problem.wrong_of_cells(rigs)
    every = [residual_matrix(problem, whole) for whole in readings + wrong]
    if project is not None:
        every = [project(r) for r in every]
    best = int(np.argmin([huber_cost(r[~problem.held_out]) for r in every]))
    fine = [lead(every[best], r, blocks) < NO_WORSE for r in every[1:]]
    ends = [float(rigs[best].effects[last].parameters[POSITION]), *spots[fine].tolist()]
    return replace(found, rig=rigs[best], places_m=(min(ends), max(ends)))


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
        _Residuals(problem, rig_of, project),
        variables,
        iterations=iterations,
        tolerance=2e-3,
        robust=True,
    )
    return rig_of(estimate.values), estimate
