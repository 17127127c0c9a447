# SPDX-License-Identifier: Apache-2.0
"""What a calibration goes by from step to step, and one step of it taken."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pneu_sim.rig.schema import FitParameter, Rig
from pneu_sysid.curves import Bends, Mirrors
from pneu_sysid.gauss_newton import Estimate
from pneu_sysid.parameters import std_inside
from pneu_sysid.problem import Problem
from pneu_sysid.records import Recording
from pneu_sysid.stages import WORKS, Step, Work, problem_of, runs_of, take, weight_of

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

Key = tuple[str, str | None]
"""Path of a parameter, and the recording that it is of where each has a value of its own."""


@dataclass(frozen=True)
class Job:
    """What does not change from step to step of a fit.

    Attributes:
        recordings: The recordings.
        given: Whether the list of parameters was given.
        hold_out: Whether a part is kept aside.
        robust: Whether outliers weigh less.
        workers: Threads of a batch.
        work: How much is done.
        measured: Standard errors of the numbers of spools that were fitted to their positions.
        mirrors: Opening curves that the file calls mirrors of others.
        known: Each parameter as it was first listed, with its bounds and its spread; those that
            come up on the way are added.
        centres: Centre of the prior of each, likewise.
    """

    recordings: list[Recording]
    given: bool
    hold_out: bool
    robust: bool
    workers: int | None
    work: Work
    measured: dict[str, float | None]
    mirrors: Mirrors
    known: dict[Key, FitParameter] = field(default_factory=dict)
    centres: dict[Key, float] = field(default_factory=dict)

    def used(self, problem: Problem) -> Mask:
        """(n_stretches,) stretches that are fitted.

        Args:
            problem: The problem that they are of.
        """
        return ~problem.held_out if self.hold_out else np.ones(problem.stretches, dtype=bool)

    def off(self, p: FitParameter, value: float) -> float:
        """By how many standard deviations of what was known of a parameter it is off that.

        Args:
            p: The parameter.
            value: Where it is.
        """
        return (value - self.centres[key_of(p)]) / self.spread(p)

    def spread(self, p: FitParameter) -> float:
        """How uncertain a parameter is beforehand, in the unit that it is estimated in.

        Args:
            p: The parameter.
        """
        span = float(np.log(p.upper / p.lower)) if p.log else p.upper - p.lower
        return span if p.std is None else min(span, std_inside(p, self.centres[key_of(p)]))


@dataclass(frozen=True)
class Taken:
    """A step that was taken.

    Attributes:
        step: The step.
        rig: The rig after it.
        fitted: The parameters that were fitted.
        problem: Its problem.
        estimate: Its estimate.
        fresh: Whether it began with a Jacobian of its own.
        bends: How much opening curves bend by it; None where it cannot tell, as valves may be off.
        back: Whether parameters were brought back to where they were before all.
    """

    step: Step
    rig: Rig
    fitted: list[FitParameter]
    problem: Problem
    estimate: Estimate
    fresh: bool
    bends: Bends | None = None
    back: bool = False


def taken(
    job: Job,
    rig: Rig,
    step: Step,
    fitted: list[FitParameter],
    before: Taken | None,
) -> Taken:
    """Takes a step.

    Args:
        job: What does not change.
        rig: The rig that it begins with.
        step: The step.
        fitted: What is estimated.
        before: The step before, whose Jacobian may serve; None computes one anew.
    """
    told = job.work.begin(step)
    problem = problem_of(rig, job.recordings, step, job.workers)
    slope = None
    if before is not None and before.estimate.gained > WORKS and _alike(before.step, step):
        slope = _slope(before, fitted, problem, job.used(problem))
    now, estimate, bends = take(
        rig,
        problem,
        fitted,
        job.centres,
        job.used(problem),
        step.iterations,
        job.robust,
        told,
        slope,
        job.mirrors,
        None if before is None else before.bends,
        step.along,
    )
    return Taken(
        step,
        now,
        fitted,
        problem,
        estimate,
        fresh=slope is None,
        bends=None if step.part else bends,
    )


def taken_besides(job: Job, last: Taken, step: Step) -> Taken:
    """Takes a step that nobody knew of beforehand, from where the last one ended.

    Args:
        job: What does not change.
        last: The step before.
        step: The step.
    """
    weight = weight_of(last.rig, step, sum(r.end_s for r in job.recordings))
    job.work.add(step, weight, runs_of(step, len(last.fitted), 0))
    return taken(job, last.rig, step, last.fitted, None)


def _alike(one: Step, other: Step) -> bool:
    """Whether a Jacobian of one step serves another."""
    return (one.dx_m, one.pull_s) == (other.dx_m, other.pull_s)


def _slope(
    before: Taken, fitted: list[FitParameter], problem: Problem, used: Mask
) -> Floats | None:
    """The Jacobian of the step before, where it is one of these parameters and readings."""
    columns = {key_of(p): k for k, p in enumerate(before.fitted)}
    j = before.estimate.jacobian
    shape = (int(used.sum()), problem.horizon * len(problem.taps))
    if j.shape[:2] != shape or any(key_of(p) not in columns for p in fitted):
        return None
    return j[..., [columns[key_of(p)] for p in fitted]]


def key_of(p: FitParameter) -> Key:
    """What tells a parameter, or its value in one recording, from all others.

    Args:
        p: The parameter.
    """
    return p.path, p.recording
