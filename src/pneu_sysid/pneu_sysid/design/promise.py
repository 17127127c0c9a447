# SPDX-License-Identifier: Apache-2.0
"""What a plan promises: extremes, standard errors, leads, and in words what it cannot tell."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pneu_sim.rig.schema import FitParameter
from pneu_sysid.design.foreseen import Foreseen, fastest_pa_s
from pneu_sysid.design.hypotheses import Hypothesis
from pneu_sysid.design.information import Information
from pneu_sysid.design.plan import Expected, Separation
from pneu_sysid.thresholds import Thresholds

Floats = NDArray[np.float64]

MUCH_LONGER = 16.0
"""Candidates that so many times the length would not tell apart are said to be alike. Of those that
are one and the same, what two places in a model make of them differs by so little as well."""
LITTLE = 0.8
"""A standard error above this share of what was known before: the recording tells little of it."""
SPARE = 1.2
"""So many times the time that would just do is said to do."""


def separable(lead: float) -> bool:
    """Whether two are told apart in any length of time.

    Args:
        lead: By how many standard errors at best, in the time of a plan; it grows with the root of
            time.
    """
    return lead * math.sqrt(MUCH_LONGER) >= Thresholds().tied


def separation_of(one: str, other: str, lead: float, best: float) -> Separation:
    """How well a plan tells two candidates apart.

    Args:
        one: One of them.
        other: The other.
        lead: By how many standard errors.
        best: By how many one that is made for these two alone does.
    """
    needed = Thresholds().tied
    return Separation(
        one=one, other=other, standard_errors=lead, needed=needed, told_apart=lead >= needed,
        inseparable=not separable(best),
    )  # fmt: skip


def expected_of(
    seen: Foreseen,
    promised: Information,
    separations: Sequence[Separation],
    best: Sequence[float],
    learnt: Sequence[FitParameter],
    seconds: float,
) -> Expected:
    """What is to be expected of a plan.

    Args:
        seen: What happens along it.
        promised: What it tells, as one piece.
        separations: Of every two candidates.
        best: Of each by how many standard errors a plan for the two alone tells them.
        learnt: Parameters that it is to tell.
        seconds: Its length, s.
    """
    told_of = list(zip(separations, best, strict=True))
    words = [_short(s, most, seconds) for s, most in told_of if not s.told_apart]
    errors: dict[str, float | None] = {}
    if learnt:
        logarithmic = {p.path for p in learnt if p.log}
        share = np.sqrt(np.diag(promised.covariance(promised.grams.sum(axis=0))))
        for v, part, std in zip(promised.variables, share, promised.known_std, strict=True):
            size = math.exp(v.value) if v.name in logarithmic else 1.0
            errors[v.name] = float(part * std * size)
        little = [v.name for v, s in zip(promised.variables, share, strict=True) if s > LITTLE]
        if little:
            words.append(
                f"It tells little of {', '.join(little)}: what was known of"
                f" {'them' if len(little) > 1 else 'it'} before stays nearly as it was."
            )
    pressures = seen.recording.pressures
    return Expected(
        highest_pa={name: float(s.values.max()) for name, s in pressures.items()},
        lowest_pa={name: float(s.values.min()) for name, s in pressures.items()},
        fastest_pa_s=dict(fastest_pa_s(seen.recording)),
        joints={name: [float(q.min()), float(q.max())] for name, q in seen.joints.items()},
        air_kg=float(seen.air_kg[-1]),
        std_errors=errors,
        separations=list(separations),
        words=words,
    )


def pairs_of(hypotheses: Sequence[Hypothesis]) -> list[tuple[int, int]]:
    """Every two of them, by their numbers, but for one and the same at two places.

    Args:
        hypotheses: They.
    """
    every = range(len(hypotheses))
    return [
        (a, b) for a in every for b in every if a < b and hypotheses[a].part != hypotheses[b].part
    ]


def _short(of: Separation, best: float, seconds: float) -> str:
    """What is said of two that a plan does not tell apart."""
    one, other, needed = of.one, of.other, of.needed
    if of.inseparable:
        return (
            f"No experiment within these limits can tell {one} from {other}: what either changes"
            f" the other does too, but for {best:.2g} standard errors of the {needed:g} that are"
            f" needed, and {MUCH_LONGER:g} times the length would not tell them."
        )
    if best >= needed:
        return (
            f"This plan tells {one} from {other} by {of.standard_errors or 0.0:.2g} standard errors"
            f" of the {needed:g} that are needed; one for these two alone, by {best:.2g}."
        )
    longer = SPARE * seconds * (needed / best) ** 2
    return (
        f"{seconds:g} s cannot tell {one} from {other}: {best:.2g} standard errors are to be"
        f" expected of the {needed:g} that are needed; about {longer:.0f} s could."
    )
