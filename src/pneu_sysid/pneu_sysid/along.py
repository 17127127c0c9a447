# SPDX-License-Identifier: Apache-2.0
"""An effect looked at along the whole of its pipe: where it does best, and how sure that is."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pneu_sim.effects import find_effect
from pneu_sim.effects.base import POSITION
from pneu_sim.rig.schema import Rig
from pneu_sysid.candidates import Project, residual_matrix
from pneu_sysid.evidence import lead
from pneu_sysid.gauss_newton import huber_cost
from pneu_sysid.problem import Problem
from pneu_sysid.refits import WORTH_ANOTHER

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Positions:
    """What other positions of an effect do.

    Attributes:
        better: The rig with the effect where it does better; None where it does best as it is.
        untold_m: How far from where it is squared errors first differ by their difference's
            standard error, and predictions by what the cells get wrong, on that side where that is
            larger; 0 for an effect without a position.
    """

    better: Rig | None
    untold_m: float


def positions(
    problem: Problem,
    rig: Rig,
    index: int,
    blocks: Ints,
    project: Project | None,
    wrong: Floats | None = None,
) -> Positions:
    """Looks at an effect along the whole of its pipe.

    The slope at an estimate says too little: the misfit has several valleys, and a volume between
    two taps may be nearly anywhere between them.

    Args:
        problem: The problem.
        rig: Rig with the effect, fitted.
        index: Which of its effects.
        blocks: (n_stretches, m) block of time of each reading.
        project: Takes out of a residual what is uncertain anyway.
        wrong: (n_stretches, m) what the cells may get wrong about the effect, in noise deviations.
    """
    attached = rig.effects[index]
    effect = find_effect(attached.effect)
    position = next((p for p in effect.fitted(rig, attached.place) if p.name == POSITION), None)
    if position is None or not position.scanned:
        return Positions(None, 0.0)
    low, high = effect.limits(position, rig, attached.place)
    spots = np.linspace(low, high, position.scanned)
    found_m = attached.parameters[POSITION]
    strength = effect.strength

    def at(spot_m: float, value: float) -> Rig:
        values = {**attached.parameters, POSITION: float(spot_m), strength.name: float(value)}
        effects = list(rig.effects)
        effects[index] = attached.model_copy(update={"parameters": values})
        return rig.model_copy(update={"effects": effects})

    value = attached.parameters[strength.name]
    rigs = [rig, at(found_m, strength.absent), *(at(spot, value) for spot in spots)]
    readings = problem.simulate(rigs, strict=False).readings
    here, without, *there = (
        r if project is None else project(r)
        for r in (np.nan_to_num(residual_matrix(problem, y), nan=1e6) for y in readings)
    )
    used = ~problem.held_out
    wrong_square = 0.0 if wrong is None else float(np.sum(wrong * wrong))
    costs, scaled, leads = [], [], []
    for r in there:
        change = without - r  # elsewhere it is as strong as there explains most, to first order
        by = float(np.sum(change * without)) / max(float(np.sum(change * change)), 1e-300)
        left = without - by * change
        costs.append(huber_cost(left[used]))
        scaled.append(strength.absent + by * (value - strength.absent))
        told = max(0.0, lead(here, left, blocks))
        if wrong_square > 0.0:  # nor is what the cells get wrong as much told apart
            told = min(told, float(np.sqrt(np.sum((left - here) ** 2) / wrong_square)))
        leads.append(told)
    best = int(np.argmin(costs))
    better = None
    if costs[best] < (1.0 - WORTH_ANOTHER) * huber_cost(here[used]):
        bounds = effect.limits(strength, rig, attached.place)
        better = at(spots[best], float(np.clip(scaled[best], *bounds)))
    below, above = spots < found_m, spots > found_m
    return Positions(
        better,
        max(
            _until_one(found_m - spots[below][::-1], np.array(leads)[below][::-1]),
            _until_one(spots[above] - found_m, np.array(leads)[above]),
        ),
    )


def _until_one(away: Floats, rising: Floats) -> float:
    """Where a curve from 0 first is 1, between points on straight lines; else the last of them."""
    before_m, before = 0.0, 0.0
    for at_m, value in zip(away, rising, strict=True):
        if value >= 1.0:
            return float(before_m + (at_m - before_m) * (1.0 - before) / (value - before))
        before_m, before = at_m, value
    return float(before_m)
