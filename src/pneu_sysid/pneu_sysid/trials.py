# SPDX-License-Identifier: Apache-2.0
"""What rigs that differ from an estimated one would leave, were they fitted: trials, side by side.

What no slope leads to is tried. Each trial is simulated once; what the estimated variables could
make good of it is taken out by their Jacobian, to first order.
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from pneu_sim.rig.schema import FitParameter, Rig
from pneu_sysid.gauss_newton import Estimate
from pneu_sysid.parameters import rig_at, variables_of
from pneu_sysid.problem import Problem
from pneu_sysid.stages import UNSTABLE

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
Told = Callable[[int], Callable[[float], None]]

CHANCE = 15.0
"""The best trial has to take away so much of the cost to be more than chance. Of 24 limits of a
spool that are none the best takes away 5 in one of twenty cases, were the noise white (half of a
chi-squared of one degree), of twenty kinds of friction 6 (of two degrees); more than twice as much
is asked."""


def costs_of(
    rig: Rig,
    trials: list[Rig],
    problem: Problem,
    used: NDArray[np.bool_],
    estimate: Estimate,
    told: Told | None,
    gone: NDArray[np.bool_] | None = None,
) -> tuple[Floats, Floats]:
    """Costs of a rig and of trials of it, after what the variables make good to first order.

    Args:
        rig: The rig, as it was estimated.
        trials: Rigs that differ from it.
        problem: The problem that it was estimated on.
        used: (n_stretches,) stretches that it was estimated on.
        estimate: The estimation.
        told: Given the size of a batch, what is called with the fraction of it that is done.
        gone: (P,) the variables that make nothing good in the trials: these lack them, or have
            values of their own.

    Returns:
        (1 + n,) costs, and (1 + n, P) by how much the variables would move.
    """
    r = residuals_of([rig, *trials], problem, used, told)
    amounts = -np.concatenate([estimate.amounts(r[:1]), estimate.amounts(r[1:], gone)])
    left = r + np.einsum("smp,kp->ksm", estimate.jacobian, amounts)
    return np.array([0.5 * float(np.sum(one**2)) for one in left]), amounts


def residuals_of(
    rigs: list[Rig], problem: Problem, used: NDArray[np.bool_], told: Told | None = None
) -> Floats:
    """(n, n_stretches used, m) residuals of rigs as they are; large where one is unstable.

    Args:
        rigs: They.
        problem: The problem.
        used: (n_stretches,) stretches to use.
        told: See `costs_of`.
    """
    tell = None if told is None else told(len(rigs))
    out = problem.simulate(rigs, progress=tell, strict=False).readings
    r = np.nan_to_num(problem.residual(out), nan=UNSTABLE, posinf=UNSTABLE, neginf=-UNSTABLE)
    return np.asarray(r.reshape(len(rigs), problem.stretches, -1)[:, used])


def moved(rig: Rig, fitted: Sequence[FitParameter], amounts: Floats, gone: Mask) -> Rig:
    """A trial with what its variables make good.

    Args:
        rig: The trial.
        fitted: What was estimated.
        amounts: (P,) by how much each is to move.
        gone: (P,) which of them stay.
    """
    left = [(p, a) for p, a, g in zip(fitted, amounts, gone, strict=True) if not g]
    few = [p for p, _ in left]
    ends = [
        float(np.clip(v.value + a, v.lower, v.upper))
        for v, (_, a) in zip(variables_of(rig, few), left, strict=True)
    ]
    return rig_at(rig, few, np.array(ends))
