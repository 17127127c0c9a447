# SPDX-License-Identifier: Apache-2.0
"""The last steps of a calibration: those that show only at its end whether they are needed.

Long cells, and steps that went by secants, have left it near. What that leaves off is looked for
here, each in a step of its own that nobody knew of beforehand.
"""

from dataclasses import replace

import numpy as np

from pneu_sim.models import kind_of
from pneu_sim.rig.schema import FitParameter, Rig
from pneu_sysid.fit_step import Job, Taken, key_of, taken, taken_besides
from pneu_sysid.friction_starts import friction_of, try_friction
from pneu_sysid.parameters import rig_at
from pneu_sysid.scale import off_scale, rescaled
from pneu_sysid.stages import at_noise, centred, gained_little, problem_of, settled
from pneu_sysid.trials import residuals_of

DRIFTED = 2.0
"""Sizes that are, all together, so many standard deviations from what was known of them are looked
at again from there ..."""
STEPS_THERE = 4
"""... in so many steps at most; from a valley of the drawn rigs that was 13 % off three led out."""
FAR = 3.0
"""A parameter that is so many standard deviations from what was known of it is looked at anew from
there, likewise."""
ASTRAY = 10.0
"""Another friction with which so many times as much is left at first was forecast too far off."""
ALONG = "all, along what is hardly shown"
OWN_CELLS = "all, on the rig's own cells"
STEPS_OWN = 2
"""Steps on the rig's own cells at most, but for a last one: each may cost sixteen on long ones."""
ALONG_OWN_CELLS = f"{OWN_CELLS}, along what is hardly shown"


def ended(job: Job, last: Taken, every: list[FitParameter]) -> Taken:
    """The calibration, after its last steps.

    Args:
        job: What does not change.
        last: The step before.
        every: All parameters that may be estimated, be they seen or not.
    """
    if kind_of(last.rig).along_lines:
        last = _with_other_friction(job, last, every)
        last = _far_ones_back(job, _at_known_scale(job, last))
    return _on_own_cells(job, _along_what_hardly_shows(job, last))


def _with_other_friction(job: Job, last: Taken, every: list[FitParameter]) -> Taken:
    """The calibration, or a better one that begins with another friction of seals."""
    used = job.used(last.problem)
    now, changed = try_friction(last.rig, last.problem, used, last.estimate, last.fitted, every)
    if not changed:
        return last
    here, there = np.sum(residuals_of([last.rig, now], last.problem, used) ** 2, axis=(1, 2))
    if there > ASTRAY * here:
        return last
    seen = {key_of(p) for p in last.fitted}
    fitted = [p for p in every if key_of(p) in seen or friction_of(p.path) in changed]
    return _better(job, last, now, fitted)


def _at_known_scale(job: Job, last: Taken) -> Taken:
    """The calibration, or a better one that begins where sizes are as known beforehand.

    Only where they have drifted from there together.
    """
    centres = [job.centres[key_of(p)] for p in last.fitted]
    shift, deviations = off_scale(last.fitted, last.estimate.values, centres)
    if abs(deviations) < DRIFTED:
        return last
    values = rescaled(last.fitted, last.estimate.values, shift)
    return _better(job, last, rig_at(last.rig, last.fitted, values))


def _far_ones_back(job: Job, last: Taken) -> Taken:
    """The calibration, or a better one that begins with what is far off where it was known to be.

    On the way down, while all else was wrong, a place of a tap or a volume at an end may have
    come into a valley of its own, which steps no longer lead out of.
    """
    values = last.estimate.values.tolist()
    far = [p for p, v in zip(last.fitted, values, strict=True) if abs(job.off(p, v)) > FAR]
    if not far:
        return last
    centres = np.array([job.centres[key_of(p)] for p in far])
    return _better(job, last, rig_at(last.rig, far, centres))


def _better(job: Job, last: Taken, now: Rig, fitted: list[FitParameter] | None = None) -> Taken:
    """The calibration, or what steps from another rig lead to where that is better."""
    for _ in range(STEPS_THERE):
        there = taken(job, now, last.step, last.fitted if fitted is None else fitted, None)
        now = there.rig
        if settled(there.estimate):
            break
    (here_left, here_off), (there_left, there_off) = _worth(job, last), _worth(job, there)
    # a model that is not at the noise anyway says less against what was known beforehand
    count = int(np.isfinite(last.problem.measured[job.used(last.problem)]).sum())
    mean_square = max(1.0, min(here_left, there_left) / max(count, 1))
    return there if there_left - here_left < mean_square * (here_off - there_off) else last


def _along_what_hardly_shows(job: Job, last: Taken) -> Taken:
    """The calibration, after steps along the combinations that the recordings hardly show.

    Steps before have left these where they were by chance, and take them for known. Of a lumped
    model so few parameters are fitted that there are none: on thin-plate labs nothing changed.
    """
    if not last.step.corrected:
        return last
    step = replace(last.step, words=ALONG, iterations=1, along=True)
    return taken_besides(job, last, step)


def _on_own_cells(job: Job, last: Taken) -> Taken:
    """The calibration, after steps on the rig's own cells where it is near the noise.

    What long cells make of a parameter is not what the rig's own do: steps on them end where their
    slopes, not its own, are at right angles to what is left. The sum of squares hardly shows that:
    of a plan for rig B it was 2.4 of its standard deviations above its mean, with three parameters
    off by three to seven of their own. The last step looks along what the recordings hardly show,
    where those before have wandered by the errors of their differences. Of rigs with bodies, whose
    slopes to both sides it has computed anyway, it is the only one: they end as low.
    """
    dx_m = last.rig.grid.dx_m
    # of a model that lacks something more is wrong than what cells make of it
    near = at_noise(last.estimate, last.problem, job.used(last.problem))
    if not last.step.corrected or last.step.dx_m <= dx_m or not near:
        return last
    step = replace(last.step, words=OWN_CELLS, dx_m=dx_m, corrected=False, along=False)
    for _ in range(0 if last.rig.bodies else STEPS_OWN):
        last = taken_besides(job, last, step)
        if gained_little(last.estimate):
            break
    return taken_besides(job, last, replace(step, words=ALONG_OWN_CELLS, along=True))


def _worth(job: Job, end: Taken) -> tuple[float, float]:
    """Squared residual on the rig's own cells, and squared distance from what was known before."""
    step = replace(end.step, dx_m=end.rig.grid.dx_m, corrected=False)
    problem = problem_of(end.rig, job.recordings, step, job.workers)
    r = problem.residual(problem.predict([end.rig])[0])[job.used(problem)]
    variables = centred(end.rig, end.fitted, job.centres)
    apart = [(v.value - (v.centre or 0.0)) / v.std for v in variables if np.isfinite(v.std)]
    return float(np.sum(r**2)), float(np.sum(np.square(apart)))
