# SPDX-License-Identifier: Apache-2.0
"""Where the fit of a seal's friction begins anew: breakaways and Stribeck speeds side by side.

While much else is wrong, breakaway friction that is taken to last up to too high a speed is fitted
away. Then nothing shows that speed any more, and no slope leads back: what the two may be is tried.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pneu_sim.rig.parameters import get_parameter, with_parameters
from pneu_sim.rig.schema import FitParameter, Rig
from pneu_sysid.gauss_newton import Estimate
from pneu_sysid.problem import Problem
from pneu_sysid.trials import CHANCE, costs_of, moved

SPEEDS = (2.0, 1.0, 0.5, 0.25, 0.125)
"""Stribeck speeds, in parts of what it was."""
BREAKAWAYS = (0.25, 0.5, 1.0, 2.0)
"""Breakaway friction, in parts of the Coulomb friction that it comes on top of."""
NUMBERS = ("breakaway_n", "stribeck_m_s")


def friction_of(path: str) -> str | None:
    """The cylinder whose breakaway or Stribeck speed a parameter is; None of all others.

    Args:
        path: Path of the parameter.
    """
    base, _, number = path.rpartition(".")
    top, _, rest = base.partition(".")
    name, _, part = rest.partition(".")
    return name if (top, part) == ("cylinders", "friction") and number in NUMBERS else None


def try_friction(
    rig: Rig,
    problem: Problem,
    used: NDArray[np.bool_],
    estimate: Estimate,
    fitted: Sequence[FitParameter],
    every: Sequence[FitParameter],
) -> tuple[Rig, set[str]]:
    """The rig with the breakaways and Stribeck speeds, of those tried, with which it would do best.

    Args:
        rig: The rig, as it was estimated.
        problem: The problem that it was estimated on.
        used: (n_stretches,) stretches that it was estimated on.
        estimate: The estimation.
        fitted: Its parameters.
        every: All parameters that may be estimated.

    Returns:
        The rig, and the cylinders whose friction is another.
    """
    changed: set[str] = set()
    for name in dict.fromkeys(n for p in every if (n := friction_of(p.path)) is not None):
        base = f"cylinders.{name}.friction"
        bounds = {p.path: (p.lower, p.upper) for p in every}
        if any(f"{base}.{number}" not in bounds for number in NUMBERS):
            continue  # what is held is known
        slow = get_parameter(rig, f"{base}.stribeck_m_s")
        coulomb = get_parameter(rig, f"{base}.coulomb_n")
        trials = [
            with_parameters(
                rig,
                {
                    path: float(np.clip(value, *bounds[path]))
                    for path, value in (
                        (f"{base}.stribeck_m_s", speed * slow),
                        (f"{base}.breakaway_n", share * coulomb),
                    )
                },
            )
            for speed in SPEEDS
            for share in BREAKAWAYS
        ]
        set_so = np.array([friction_of(p.path) == name for p in fitted])
        costs, amounts = costs_of(rig, trials, problem, used, estimate, None, set_so)
        k = int(np.argmin(costs[1:]))
        if costs[0] - costs[1 + k] > CHANCE:
            rig = moved(trials[k], fitted, amounts[1 + k], set_so)
            changed.add(name)
    return rig, changed
