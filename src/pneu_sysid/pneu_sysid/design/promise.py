# SPDX-License-Identifier: Apache-2.0
"""What a plan promises: extremes, standard errors, leads, and in words what it cannot tell."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pneu_sim.rig.schema import FitParameter
from pneu_sysid.design.foreseen import Foreseen, fastest_pa_s
from pneu_sysid.design.hypotheses import Hypothesis
from pneu_sysid.design.information import Information
from pneu_sysid.design.limits import Limits
from pneu_sysid.design.plan import Expected, Separation
from pneu_sysid.thresholds import Thresholds

Floats = NDArray[np.float64]

MUCH_LONGER = 16.0
"""Candidates that so many times the length would not tell apart are said to be alike. Of those that
are one and the same, what two places in a model make of them differs by so little as well."""
LITTLE = 0.8
"""A standard error above this share of what was known before: the recording tells little of it."""
DEPENDS = 10.0
"""An error that is so many times greater in one rig than in another depends on which it is."""
MOST_NAMED = 6
"""Of those so many are named in the sentence that says so; the plan has them all."""
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


@dataclass(frozen=True)
class Promise:
    """What a plan is to be expected of on one rig.

    Attributes:
        seen: What happens.
        told: What each stretch of it tells that a fit has of it.
    """

    seen: Foreseen
    told: Information

    def errors(self, learnt: Sequence[FitParameter]) -> Floats:
        """(P,) standard errors that a fit is to find, each in the parameter's own unit.

        Args:
            learnt: The parameters.
        """
        told = self.told
        logarithmic = {p.path for p in learnt if p.log}
        size = [math.exp(v.value) if v.name in logarithmic else 1.0 for v in told.variables]
        return np.asarray(told.found() * told.known_std * size)


def expected_of(
    promises: Sequence[Promise],
    limits: Limits,
    separations: Sequence[Separation],
    best: Sequence[float],
    learnt: Sequence[FitParameter],
    seconds: float,
) -> Expected:
    """What is to be expected of a plan.

    Extremes are those of all rigs that it is judged by, standard errors the middle one of theirs
    and from where to where they go: what shows a number in one, as a piston that comes to its cover
    there, may be missing in another.

    Args:
        promises: By the rig, or by rigs as it may be.
        limits: What is kept to.
        separations: Of every two candidates.
        best: Of each by how many standard errors a plan for the two alone tells them.
        learnt: Parameters that it is to tell.
        seconds: Its length, s.
    """
    told_of = list(zip(separations, best, strict=True))
    words = [_short(s, most, seconds) for s, most in told_of if not s.told_apart]
    errors: dict[str, float | None] = {}
    ranges: dict[str, list[float]] = {}
    if learnt:
        share = np.median([one.told.found() for one in promises], axis=0)
        names = [v.name for v in promises[0].told.variables]
        own = np.array([one.errors(learnt) for one in promises])
        errors.update(zip(names, np.median(own, axis=0).tolist(), strict=True))
        lowest, highest = own.min(axis=0), own.max(axis=0)
        if len(promises) > 1:
            ranges.update(zip(names, np.stack([lowest, highest], axis=1).tolist(), strict=True))
        little = [name for name, s in zip(names, share, strict=True) if s > LITTLE]
        if little:
            words.append(
                f"It tells little of {', '.join(little)}: what was known of"
                f" {'them' if len(little) > 1 else 'it'} before stays nearly as it was."
            )
        depends = [n for n, wide in zip(names, highest > DEPENDS * lowest, strict=True) if wide]
        if depends:
            more = len(depends) - MOST_NAMED
            named = ", ".join(depends[:MOST_NAMED]) + (f" and {more} more" if more > 0 else "")
            words.append(
                f"How much it tells of {named} depends on what the rig is, by more"
                f" than {DEPENDS:g} times in {len(promises)} as this one may be by what is known of"
                " it."
            )
    beyond = sum(not one.seen.within(limits) for one in promises)
    if beyond and len(promises) > 1:
        words.append(
            f"In {beyond} of {len(promises)} rigs as this one may be by what is known of it, the"
            " limits would be left: the bridge would end the plan there."
        )
    every = [one.seen for one in promises]
    taps = every[0].recording.pressures
    values = {name: [one.recording.pressures[name].values for one in every] for name in taps}
    fastest = [fastest_pa_s(one.recording) for one in every]
    return Expected(
        highest_pa={name: float(np.max(of)) for name, of in values.items()},
        lowest_pa={name: float(np.min(of)) for name, of in values.items()},
        fastest_pa_s={name: max(one[name] for one in fastest) for name in fastest[0]},
        joints={
            name: [
                float(min(one.joints[name].min() for one in every)),
                float(max(one.joints[name].max() for one in every)),
            ]
            for name in every[0].joints
        },
        air_kg=max(float(one.air_kg[-1]) for one in every),
        std_errors=errors,
        std_errors_range=ranges,
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
