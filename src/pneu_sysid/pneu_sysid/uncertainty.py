# SPDX-License-Identifier: Apache-2.0
"""What is known of fitted parameters: errors of noise, model, datasheet, cells and what is held."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pneu_sim.rig.schema import FitParameter
from pneu_sysid.gauss_newton import Estimate

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

CORRELATED = 0.98
"""Estimates that are correlated so much can only be told in combination."""
CONDITION_LIMIT = 1e6


@dataclass(frozen=True)
class Known:
    """What is known of each parameter of a list.

    Attributes:
        std_errors: (P,) standard error in the parameter's own unit; inf where the recordings do
            not show it.
        at_bound: (P,) whether the estimate sits on a bound.
        beyond: (P,) whether the truth may lie beyond it: nothing leaks less than not at all.
        seen: (P,) whether the recordings show it.
        held: (P,) whether it was held.
        pairs: Pairs that can only be told in combination: two indices and their correlation.
        correlation: (P, P) of the estimates; 0 where there is none.
        condition: Condition number of the scaled problem.
    """

    std_errors: Floats
    at_bound: Bools
    beyond: Bools
    seen: Bools
    held: Bools
    pairs: list[tuple[int, int, float]]
    correlation: Floats
    condition: float


def known_of(
    parameters: list[FitParameter],
    fitted: list[FitParameter],
    estimate: Estimate,
    held: list[str],
    held_change: Floats | None,
    measured: Mapping[str, float | None],
) -> Known:
    """What is known of all parameters after an estimation of some.

    Args:
        parameters: All.
        fitted: Those that were estimated.
        estimate: Their estimation.
        held: Paths of those that were held.
        held_change: (K, n_clusters, m) change of the residual per deviation of each held parameter.
        measured: Standard errors, by path, of what was fitted without the gas; None where unknown.
    """
    count = len(parameters)
    index = [
        next(k for k, p in enumerate(parameters) if (p.path, p.recording) == (f.path, f.recording))
        for f in fitted
    ]
    variance = estimate.std_errors**2
    j = estimate.jacobian
    for shift in [] if held_change is None else held_change:
        moved = estimate.gain @ np.einsum("smp,sm->p", j, shift)
        variance = variance + moved**2
    errors = np.full(count, np.inf)
    at_bound, seen = np.zeros(count, dtype=bool), np.zeros(count, dtype=bool)
    least = np.zeros(count, dtype=bool)  # there is nothing below the zero that bounds it
    correlation = np.eye(count)
    for a, k in enumerate(index):
        value = float(np.exp(estimate.values[a])) if parameters[k].log else 1.0
        errors[k] = float(np.sqrt(variance[a])) * value
        at_bound[k], seen[k] = estimate.at_bound[a], estimate.visible[a]
        correlation[k, index] = estimate.correlation[a]
        p = parameters[k]
        least[k] = p.lower == 0.0 and not p.log and estimate.values[a] < 0.5 * p.upper
    for k, p in enumerate(parameters):
        if p.path in measured:
            errors[k] = measured[p.path] or np.inf
    is_measured = np.array([p.path in measured for p in parameters])
    is_held = np.array([p.path in held for p in parameters])
    return Known(
        errors,
        at_bound & seen,
        at_bound & seen & ~least,
        (seen & np.isfinite(errors)) | is_measured,
        is_held,
        pairs_above(correlation, CORRELATED),
        correlation,
        estimate.condition,
    )


def pairs_above(correlation: Floats, limit: float) -> list[tuple[int, int, float]]:
    """Pairs whose correlation exceeds a limit in size, largest first: two indices and it.

    Args:
        correlation: (P, P).
        limit: Threshold.
    """
    i, j = np.triu_indices(correlation.shape[0], 1)
    size = np.abs(correlation[i, j])
    order = np.argsort(-size)
    return [
        (int(i[k]), int(j[k]), float(correlation[i[k], j[k]])) for k in order if size[k] >= limit
    ]


def warnings_of(parameters: list[FitParameter], known: Known) -> list[str]:
    """What the recordings cannot identify: a line for each kind, however many parameters.

    Args:
        parameters: The parameters.
        known: What is known of them.
    """
    out = []
    blind = [
        p.path
        for p, seen, held in zip(parameters, known.seen, known.held, strict=True)
        if not seen and not held
    ]
    bound = [p.path for p, beyond in zip(parameters, known.beyond, strict=True) if beyond]
    if blind:
        out.append(
            f"{len(blind)} of {len(parameters)} parameters kept their values, since the recordings"
            f" do not depend on them: {_listed(blind)}"
        )
    if bound:
        out.append(f"{len(bound)} at a bound, the truth may lie beyond: {_listed(bound)}")
    if known.pairs:
        named = [f"{parameters[a].path} with {parameters[b].path}" for a, b, _ in known.pairs]
        out.append(f"{len(named)} pairs can only be told in combination: {_listed(named, 2)}")
    if known.condition > CONDITION_LIMIT:
        out.append(
            f"the estimation is ill-conditioned ({known.condition:.1e}); more varied excitation"
            " or fewer parameters would help"
        )
    return out


def _listed(names: list[str], most: int = 4) -> str:
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more
