# SPDX-License-Identifier: Apache-2.0
"""Where a fitted rig stops short of the noise, and what would help."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pneu_sim.rig.schema import FitParameter, Rig
from pneu_sysid.candidates import best_per_place, residual_matrix, scores_of, sensitivities
from pneu_sysid.gauss_newton import Estimate
from pneu_sysid.nuisance import Nuisance
from pneu_sysid.parameter_units import strength_unit
from pneu_sysid.problem import Problem, Rollouts
from pneu_sysid.regimes import Operation, operation
from pneu_sysid.sites import all_sites
from pneu_sysid.thresholds import Thresholds

Floats = NDArray[np.float64]

ENOUGH = 2.0
"""Times the noise that a calibration may leave at a tap."""
TELLS = 0.15
"""Share of what is left that an effect has to explain to be worth a word."""
RIDGE = 1e-3
"""What the fitted parameters can make good is taken out with a ridge that hardly holds them."""


@dataclass(frozen=True)
class Shortfall:
    """Where a fitted rig stops short of the noise.

    Attributes:
        by_tap: Times the noise at each tap where it is too much.
        sentence: That it stops short, and how far.
        where: Per tap the regime and the time in which most of it is left.
        help: What would help.
    """

    by_tap: dict[str, float]
    sentence: str
    where: list[str]
    help: list[str]

    @property
    def lines(self) -> list[str]:
        """All of it, line by line."""
        return [self.sentence, *self.where, *self.help]


def shortfall_of(
    rig: Rig,
    problem: Problem,
    out: Rollouts,
    times: dict[str, float],
    at_bound: list[FitParameter],
    effects: list[str],
) -> Shortfall | None:
    """Says where a rig stops short of the noise; None where it does not.

    Args:
        rig: The fitted rig.
        problem: The problem, on its own cells.
        out: Its predictions, flows included.
        times: Times the noise per tap that is to be expected.
        at_bound: Parameters that ended at a bound beyond which they may lie.
        effects: What the catalogue's effects would explain, as `effects_that_help` tells.
    """
    r = problem.residual(out.readings[0])
    short = {tap: value for tap, value in times.items() if value > ENOUGH}
    if not short:
        return None
    named = ", ".join(f"{tap} {value:.1f}" for tap, value in short.items())
    sentence = (
        f"The calibration stops short: where it has not been fitted it is to be expected to leave"
        f" more than {ENOUGH:g} times the noise at {named} (times)."
    )
    work = operation(problem, rig, out)
    where = [_where(problem, r, work, tap) for tap in short]
    more = [
        f"{p.path} ended at its bound of {p.lower:g} to {p.upper:g}: look whether it may lie"
        " beyond, and say so with fit.add"
        for p in at_bound[:2]
    ]
    more += effects
    if not effects:
        more.append(
            "No effect of the catalogue explains what is left; look at the worst stretches with"
            " `pneu compare --report`, and at the geometry in the rig file."
        )
    return Shortfall(short, sentence, where, more)


def _where(problem: Problem, r: Floats, work: Operation, tap: str) -> str:
    """The regime and the second in which most of a tap's error is left."""
    t = problem.taps.index(tap)
    total = float(np.sum(r[:, :, t] ** 2))
    found: dict[bool, tuple[float, str]] = {}
    for one in work.sets(tap):
        inside = r[:, :, t][one.mask]
        excess = float(np.sum(inside**2)) / np.sqrt(one.mask.sum())
        is_time = one.kind == "time"
        share = float(np.sum(inside**2)) / total
        text = f"{one.label} ({np.sqrt(np.mean(inside**2)):.1f} times, {100 * share:.0f} % of it)"
        if excess > found.get(is_time, (0.0, ""))[0]:
            found[is_time] = (excess, text)
    words = [text for _, text in found.values()]
    return f"{tap}: most with {' and at '.join(words)}" if words else f"{tap}: everywhere"


def effects_that_help(
    rig: Rig,
    problem: Problem,
    used: NDArray[np.bool_],
    estimate: Estimate,
    progress: Callable[[float], None] | None = None,
) -> list[str]:
    """What the catalogue's effects would explain of what a fit leaves, to first order.

    What the fitted parameters could make of it is taken out first.

    Args:
        rig: The fitted rig.
        problem: The problem that it was fitted on, on long cells.
        used: (n_stretches,) stretches that it was fitted on; of the others nothing is asked.
        estimate: The estimation.
        progress: Called with the fraction done.
    """
    norms = RIDGE * np.sqrt(np.einsum("smp,smp->p", estimate.jacobian, estimate.jacobian))
    change = np.zeros((problem.stretches, *estimate.jacobian.shape[1:]))
    change[used] = estimate.jacobian / np.maximum(norms, 1e-12)
    take_out = Nuisance(change).without(used)

    def project(r: Floats) -> Floats:
        return np.where(used[:, None], take_out(r), 0.0)

    known = sensitivities(problem, rig, all_sites(rig), Thresholds(), progress)
    scores = scores_of(residual_matrix(problem, problem.predict([rig])[0]), known, project)
    best = [s for s in best_per_place(scores) if s.explained > TELLS and s.t > 3.0][:2]
    return [
        f"{s.site.label} would explain {100.0 * s.explained:.0f} % of it (about"
        f" {s.strength:.2g} {strength_unit(rig, s.site.effect, s.site.place)}): see"
        " `pneu diagnose`, or add it with `pneu add`"
        for s in best
    ]
