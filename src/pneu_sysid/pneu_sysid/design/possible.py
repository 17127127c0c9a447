# SPDX-License-Identifier: Apache-2.0
"""Rigs as they may be by what is known of them before an experiment: draws from a fit's prior.

What a plan tells of a rig depends on the rig, and at the very numbers of a datasheet it may promise
what no rig like it keeps. So plans are made and judged by rigs that are drawn (pseudo-Bayesian
designs: Chaloner and Verdinelli 1995, Statistical Science 10(3), 273).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pneu_sim.rig.schema import FitParameter, Rig
from pneu_sysid.curves import Mirrors, curve_ties
from pneu_sysid.parameters import rig_at, variables_of
from pneu_sysid.slopes import Variable


@dataclass(frozen=True)
class Possible:
    """A rig as it may be.

    Attributes:
        rig: The rig.
        parameters: Its numbers that are not known exactly, as they are known there.
    """

    rig: Rig
    parameters: list[FitParameter]


def possible_rigs(
    rig: Rig,
    parameters: Sequence[FitParameter],
    mirrors: Mirrors,
    count: int,
    rng: np.random.Generator,
) -> list[Possible]:
    """Draws rigs from what is known of their numbers.

    Numbers are known as a fit takes them to be: each to its standard deviation, or to its standard
    error where it has been calibrated, and opening curves bend only so much. What would leave its
    bounds stays on them.

    Args:
        rig: The rig as a fit begins with it (`fit.as_fitted`).
        parameters: Its numbers that are not known exactly, each for all recordings.
        mirrors: Opening curves that are about the mirrors of others.
        count: How many.
        rng: Of the draws.
    """
    listed = list(parameters)
    variables = variables_of(rig, listed)
    value = np.array([v.value for v in variables])
    known = np.array([_known(p, v) for p, v in zip(listed, variables, strict=True)])
    ties = curve_ties(rig, listed, mirrors)
    # in deviations of what is known: most likely is what the ties make of the numbers given
    tied = ties.matrix * known
    precision = np.eye(known.size) + tied.T @ tied
    middle = np.linalg.solve(precision, tied.T @ (ties.right - ties.matrix @ value))
    root = np.linalg.cholesky(precision)
    out = []
    for _ in range(count):
        draw = middle + np.linalg.solve(root.T, rng.normal(size=known.size))
        x = np.array(
            [
                float(np.clip(v.value + k * d, v.lower, v.upper))
                for v, k, d in zip(variables, known, draw, strict=True)
            ]
        )
        out.append(Possible(rig_at(rig, listed, x), _as_known_at(listed, x - value)))
    return out


def _known(parameter: FitParameter, variable: Variable) -> float:
    """How well a number is known, in its own variable."""
    std = variable.known_std
    if parameter.std_error is None:
        return std
    by = float(np.exp(variable.value)) if parameter.log else 1.0
    return max(min(std, parameter.std_error / by), 1e-6 * (variable.upper - variable.lower))


def _as_known_at(parameters: Sequence[FitParameter], moved: np.ndarray) -> list[FitParameter]:
    """Parameters elsewhere: what is known to a share is known to that share there."""
    return [
        p.model_copy(update={"std": p.std * float(np.exp(by))}) if p.log and p.std else p
        for p, by in zip(parameters, moved, strict=True)
    ]
