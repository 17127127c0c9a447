# SPDX-License-Identifier: Apache-2.0
"""A first look at candidate effects: what each would explain of a residual, to first order."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pneu_sim.rig.schema import Rig
from pneu_sysid.evidence import cosine
from pneu_sysid.problem import Problem
from pneu_sysid.sites import Site
from pneu_sysid.thresholds import Thresholds

Floats = NDArray[np.float64]
Project = Callable[[Floats], Floats]
"""Takes out of (n_stretches, m) residuals what is uncertain anyway."""

SECANT = 0.5
"""Sensitivities are secants at this fraction of an effect's typical strength ..."""
LARGER = 2.0
"""... and at this multiple too, where an effect is far from proportional to its strength: a small
narrowing reflects waves, a large one throttles the flow."""


@dataclass(eq=False)
class Score:
    """What the sensitivities at zero strength say of one candidate.

    Attributes:
        site: The candidate.
        strength: One-step estimate.
        explained: Fraction of the squared residual it would explain.
        t: Estimate over its jackknife standard error, stretches left out one at a time.
        sensitivity: (n_stretches, m) change of the prediction per unit strength, in noise units.
        projected: What it changes, without what is uncertain anyway.
    """

    site: Site
    strength: float
    explained: float
    t: float
    sensitivity: Floats = field(repr=False)
    projected: Floats = field(repr=False)


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """A candidate and what it changes of the prediction.

    Attributes:
        site: The candidate.
        least: The least strength that is possible on this rig.
        most: The greatest.
        change: (n_stretches, m) change per unit strength, in noise units.
    """

    site: Site
    least: float
    most: float
    change: Floats = field(repr=False)


def residual_matrix(problem: Problem, readings: Floats) -> Floats:
    """(n_stretches, m) residual of one rig in noise units.

    Args:
        problem: The problem.
        readings: (n_stretches, horizon, n_taps) predictions.
    """
    return problem.residual(readings).reshape(problem.stretches, -1)


def sensitivities(
    problem: Problem,
    rig: Rig,
    sites: Sequence[Site],
    thresholds: Thresholds,
    progress: Callable[[float], None] | None = None,
) -> list[Sensitivity]:
    """What candidates change of the prediction, by the simulator itself, all in one batched call.

    Args:
        problem: The problem.
        rig: Rig without them.
        sites: The candidates.
        thresholds: What decides.
        progress: Called with the fraction done.

    Returns:
        One for each, two for those that are far from proportional to their strength.
    """
    tried: list[tuple[Site, tuple[float, float], float]] = []
    for site in sites:
        p = site.effect.strength
        low, high = site.effect.limits(p, rig, site.place)
        for factor in (SECANT, LARGER) if site.effect.curved else (SECANT,):
            step = factor * thresholds.typical * (p.typical - p.absent)
            at = min(step, 0.9 * (high - p.absent)) if step > 0.0 else step
            tried.append((site, (low, high), at))
    rigs = [rig] + [s.attached(rig, s.effect.strength.absent + h) for s, _, h in tried]
    y = problem.simulate(rigs, progress, strict=False).readings
    out = []
    for k, (site, (low, high), h) in enumerate(tried):
        change = problem.weighed((y[k + 1] - y[0]) / h)
        if np.isfinite(change).all():  # else the rig with it cannot be simulated at all
            out.append(Sensitivity(site, low, high, change.reshape(problem.stretches, -1)))
    return out


def scores_of(
    residual: Floats, known: Sequence[Sensitivity], project: Project | None = None
) -> list[Score]:
    """Scores candidates by what they change.

    Args:
        residual: (n_stretches, m) in noise units.
        known: What candidates change.
        project: Takes out of a residual what is uncertain anyway.
    """
    r = residual if project is None else project(residual)
    total = float(np.sum(r * r))
    out = []
    for one in known:
        m = one.change if project is None else project(one.change)
        a, b = np.sum(m * r, axis=1), np.sum(m * m, axis=1)
        out.append(_score_of(one, m, a, b, total))
    return out


def _score_of(one: Sensitivity, projected: Floats, a: Floats, b: Floats, total: float) -> Score:
    """One-step strength within its bounds, explained fraction and jackknife significance."""
    site, s = one.site, one.change
    total_b = float(b.sum())
    if total_b <= 1e-12 or total <= 0.0:
        return Score(site, site.effect.strength.absent, 0.0, 0.0, s, projected)
    absent = site.effect.strength.absent
    eta = float(np.clip(float(a.sum()) / total_b, one.least - absent, one.most - absent))
    n = a.size
    rest = np.maximum(total_b - b, 1e-12)
    left_out = (a.sum() - a) / rest
    se = float(np.sqrt((n - 1) / n * np.sum((left_out - left_out.mean()) ** 2)))
    explained = eta * (2.0 * float(a.sum()) - eta * total_b) / total
    return Score(site, absent + eta, explained, abs(eta) / max(se, 1e-300), s, projected)


def best_per_place(scores: Sequence[Score]) -> list[Score]:
    """The best position of every effect on every part, best first.

    Args:
        scores: Scores of all sites.
    """
    best: dict[tuple[str, str], Score] = {}
    for item in scores:
        key = item.site.part
        if key not in best or item.explained > best[key].explained:
            best[key] = item
    return sorted(best.values(), key=lambda item: -item.explained)


def to_refit(best: Sequence[Score], thresholds: Thresholds) -> tuple[list[Score], list[Score]]:
    """Which candidates are refitted: one of each kind that changes the prediction alike.

    Args:
        best: Scores, best first.
        thresholds: What decides.

    Returns:
        Those, and the others that change the prediction as one of them does.
    """
    leaders: list[Score] = []
    mates: list[Score] = []
    for k, item in enumerate(best):
        share = item.explained
        if share <= 0.0 or (k >= 3 and share < thresholds.contender * best[0].explained):
            break
        if share < thresholds.little * thresholds.worth:
            break  # what it explains would not be worth it
        if any(abs(cosine(item.projected, o.projected)) >= thresholds.alike for o in leaders):
            mates.append(item)
        else:
            leaders.append(item)
    room = max(thresholds.finalists - len(leaders), thresholds.finalists // 3)
    chosen = leaders[: thresholds.finalists - min(room, len(mates))]
    chosen += mates[: thresholds.finalists - len(chosen)]
    left = [one for one in (*leaders, *mates) if one not in chosen]
    return chosen, left
