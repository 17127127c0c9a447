# SPDX-License-Identifier: Apache-2.0
"""Every effect that a scene lacks, scored at the strength that it has: more columns of one arrow.

With the trajectory taken out, what is left of a candidate is one row and column beside those of the
fitted parameters: its step, what it would add to the likelihood, and by leaving out one recording
after another, or one stretch of a long one, whether that may be chance. Flights and contacts of
each recording count by what they leave (`anew.trusted`): one that went another way would else
outweigh all others.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pneu_sysid.contacts.anew import left, trusted
from pneu_sysid.contacts.arrow import inverse, jackknife
from pneu_sysid.contacts.estimate import Parameter, Problem, State

Floats = NDArray[np.float64]

SEEN = 1e-6
"""Share of a candidate's column that must be left beside the fitted parameters."""


@dataclass(frozen=True)
class SceneScore:
    """What a candidate would do, to first order.

    Attributes:
        parameter: The candidate.
        step: By how much its coordinate would change.
        std_error: Of that, by leaving out one recording after another.
        gain: What it would add to the logarithm of the likelihood.
        share: Part of its column that is its own.
    """

    parameter: Parameter
    step: float
    std_error: float
    gain: float
    share: float

    @property
    def t(self) -> float:
        """Step over its standard error."""
        return abs(self.step) / self.std_error if self.std_error > 0.0 else 0.0


@dataclass(frozen=True)
class Seen:
    """What recordings say of parameters and candidates, trajectories taken out, to second order.

    Attributes:
        hessian: (recordings, c + K, c + K) of minus the logarithm of the likelihood.
        slope: (recordings, c + K).
        fitted: c, how many parameters are fitted; candidates follow.
        labels: Of the candidates.
        known: (c + K, c + K) what was known of them beforehand.
        pull: (c + K,) its slope.
    """

    hessian: Floats
    slope: Floats
    fitted: int
    labels: list[str]
    known: Floats
    pull: Floats

    def step(self, label: str | None) -> tuple[NDArray[np.int64], Floats]:
        """What they would change to, all together, with one candidate or none.

        Args:
            label: The candidate.

        Returns:
            Numbers of the parameters, and (c,) or (c + 1,) their steps.
        """
        more = [] if label is None else [self.fitted + self.labels.index(label)]
        at = np.array([*range(self.fitted), *more], dtype=np.int64)
        block = np.ix_(at, at)
        whole = self.hessian.sum(axis=0)[block] + self.known[block]
        return at, -inverse(whole) @ (self.slope.sum(axis=0)[at] + self.pull[at])

    def rise(self, at: NDArray[np.int64], step: Floats) -> Floats:
        """(recordings,) what a step adds to the logarithm of each one's likelihood.

        Args:
            at: Numbers of the parameters.
            step: Their steps.
        """
        bend = self.hessian[:, at][:, :, at]
        return np.asarray(
            -self.slope[:, at] @ step - 0.5 * np.einsum("i,rij,j->r", step, bend, step)
        )


@dataclass(frozen=True)
class Scores:
    """All candidates.

    Attributes:
        scores: Each, the one of largest gain first.
        alike: (K, K) cosines between what is left of their columns.
        gain: What the fitted parameters alone would still add to it.
        seen: What it was told by.
    """

    scores: list[SceneScore]
    alike: Floats
    gain: float
    seen: Seen


def seen(problem: Problem, state: State, candidates: Sequence[Parameter]) -> Seen:
    """What recordings say of parameters and candidates.

    Args:
        problem: The problem, its parameters fitted, to these recordings or to others.
        state: Trajectories and parameters.
        candidates: Effects that it does not fit.
    """
    wider = problem.fitting([*problem.parameters, *candidates])
    wider.chains = trusted(problem.chains, problem.kinds(state))
    gone = left(wider.arrows(State(state.q, wider.start())))
    _, prior_slope, prior_bend = problem.prior(state.x)
    none = np.zeros(len(candidates))
    return Seen(
        np.array([e.hessian for e in gone]),
        np.array([e.slope for e in gone]),
        len(problem.parameters),
        [p.label for p in candidates],
        np.diag(np.append(prior_bend, none)),
        np.append(prior_slope, none),
    )


def scored(problem: Problem, state: State, candidates: Sequence[Parameter]) -> Scores:
    """Scores candidates beside the parameters that a problem fits.

    Args:
        problem: The problem, its parameters fitted.
        state: Trajectories and parameters.
        candidates: Effects that it does not fit.

    Returns:
        Their scores.
    """
    c = len(problem.parameters)
    told = seen(problem, state, candidates)
    x = problem.fitting([*problem.parameters, *candidates]).start()
    H, g, known, pull = told.hessian, told.slope, told.known, told.pull
    whole, slope = H.sum(axis=0) + known, g.sum(axis=0) + pull
    base = _gain(whole[:c, :c], slope[:c])
    own = whole[c:, c:] - whole[c:, :c] @ inverse(whole[:c, :c]) @ whole[:c, c:]
    scores = []
    for k, candidate in enumerate(candidates):
        at = [*range(c), c + k]
        block = np.ix_(at, at)
        here = whole[block]
        step = -inverse(here) @ slope[at]
        errors = jackknife(H[:, at][:, :, at], g[:, at], known[block], pull[at])
        share = float(own[k, k] / whole[c + k, c + k]) if whole[c + k, c + k] > 0.0 else 0.0
        gain = _gain(here, slope[at]) - base if share > SEEN else 0.0
        if step[-1] < 0.0 and not candidate.effect.logarithmic and x[c + k] <= candidate.lower:
            gain = 0.0  # what is nothing cannot be less
        scores.append(SceneScore(candidate, float(step[-1]), float(errors[-1]), gain, share))
    scale = np.sqrt(np.maximum(np.diag(own), 1e-300))
    order = np.argsort([-s.gain for s in scores])
    alike = (own / np.outer(scale, scale))[np.ix_(order, order)]
    return Scores([scores[i] for i in order], alike, base, told)


def _gain(hessian: Floats, slope: Floats) -> float:
    return float(0.5 * slope @ inverse(hessian) @ slope) if len(slope) else 0.0
