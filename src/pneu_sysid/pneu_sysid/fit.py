# SPDX-License-Identifier: Apache-2.0
"""Calibrating a rig: fitting its base parameters to recordings, and what is then known of them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_common.progress import Tell
from pneu_sim.models import kind_of
from pneu_sim.rig.schema import Calibration, FitParameter, Rig
from pneu_sysid.cells import error_of_cells, words_on_cells
from pneu_sysid.curves import Bends, Mirrors, mirrors_of, with_own_curves
from pneu_sysid.gauss_newton import Estimate, jacobian
from pneu_sysid.parameters import (
    estimated_parameters,
    joined,
    one_each,
    rig_at,
    variables_of,
)
from pneu_sysid.problem import Problem, make_problem
from pneu_sysid.records import Recording
from pneu_sysid.scale import off_scale, rescaled
from pneu_sysid.sensor_units import apart
from pneu_sysid.shortfall import ENOUGH, Shortfall, effects_that_help, shortfall_of
from pneu_sysid.spool_position import fit_spools
from pneu_sysid.spool_starts import try_limits, try_spools
from pneu_sysid.stages import (
    WORKS,
    Step,
    Work,
    at_noise,
    brought_back,
    centred,
    gained_little,
    is_slow,
    only_noise,
    problem_of,
    residual_function,
    runs_of,
    settled,
    start_of,
    steps_of,
    take,
    weight_of,
)
from pneu_sysid.uncertainty import Known, known_of, warnings_of
from pneu_sysid.visited import never_wide, words_on_openings

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

SPOOL_NUMBERS = (
    "bandwidth_hz",
    "damping",
    "delay_s",
    "closing_delay_s",
    "max_speed_v_s",
    "max_acceleration_v_s2",
)
"""Numbers of a spool that its measured position tells."""
DRIFTED = 2.0
"""Sizes that are, all together, so many standard deviations from what was known of them are looked
at again from there ..."""
STEPS_THERE = 4
"""... in so many steps at most; from a valley of the drawn rigs that was 13 % off three led out."""
ALONG = "all, along what is hardly shown"
SHORTER_CELLS = "all, on shorter cells"
STEPS_SHORTER = 4
"""Steps on cells half as long as those before at most: each may cost four on these."""
OWN_CELLS = "all, on the rig's own cells"
STEPS_OWN = 3
"""Steps on the rig's own cells at most: each may cost sixteen on long ones."""
TELLS_MORE = 0.01
"""A step on them that gained less of the cost has shown that long ones will do."""
FAR_OFF = 0.5
"""A parameter that is not seen and is off by so many standard deviations of what was known of it is
brought back."""
STRANGE = 3.0
"""A recording with so many times the error of the best one is told to be another's."""


@dataclass(frozen=True)
class FitOutcome:
    """A fitted rig and what is known about its parameters.

    Attributes:
        rig: Fitted rig, with ``calibration`` and standard errors filled in.
        parameters: What was fitted, or would have been had the recordings shown it.
        start: Value of each before.
        values: Value of each after.
        known: What is known of each.
        fitted: Those that were estimated last.
        estimate: Their estimation, in its own variables (see `rig_at`).
        warnings: What the recordings cannot tell or never visit, and recordings that differ, in
            plain words.
        shortfall: Where the fitted rig stops short of the noise; None where it does not.
        rmse: Residual per tap and encoder on the part used, each in its unit.
        held_out_rmse: The same on the part kept aside.
    """

    rig: Rig
    parameters: list[FitParameter]
    start: list[float]
    values: list[float]
    known: Known
    fitted: list[FitParameter]
    estimate: Estimate
    warnings: list[str]
    shortfall: Shortfall | None
    rmse: dict[str, float]
    held_out_rmse: dict[str, float]


def sensor_rmse(problem: Problem, readings: Floats, chosen: Mask) -> dict[str, float]:
    """Root mean square error per tap and encoder over chosen stretches, each in its unit.

    Args:
        problem: The problem.
        readings: (n_stretches, horizon, n_taps) predictions.
        chosen: (n_stretches,) stretches to count.
    """
    if not chosen.any():
        return {}
    e = problem.target()[chosen] - readings[chosen]
    return {
        tap: float(np.sqrt(np.nanmean(e[:, :, k] ** 2)))
        for k, tap in enumerate(problem.taps)
        if np.isfinite(e[:, :, k]).any()
    }


def sensor_times_noise(problem: Problem, readings: Floats, chosen: Mask) -> dict[str, float]:
    """The same over the noise of each.

    Args:
        problem: The problem.
        readings: (n_stretches, horizon, n_taps) predictions.
        chosen: (n_stretches,) stretches to count.
    """
    noise = dict(zip(problem.taps, problem.noise_pa.tolist(), strict=True))
    rmse = sensor_rmse(problem, readings, chosen)
    return {name: value / noise[name] for name, value in rmse.items()}


def fit_rig(
    rig: Rig,
    recording: Recording | Sequence[Recording],
    parameters: list[FitParameter] | None = None,
    hold_out: bool = False,
    robust: bool = False,
    approach: bool = True,
    iterations: int = 8,
    workers: int | None = None,
    progress: Tell | None = None,
) -> FitOutcome:
    """Fits a rig to recordings by bounded Gauss-Newton on its predictions (thesis 8.1.1, 8.1.2).

    A rig that is only known from datasheets is approached in steps, as an engineer would: what
    flows, then how fast valves and waves are, then everything. Its ports get opening curves of
    their own, its spools limits where the recordings show them. What the recordings do not show is
    left as it is.

    Args:
        rig: Start values; its ``fit`` section says what may change, else the list that follows
            from the rig (`calibrated_parameters`).
        recording: The recording, or several: parameters are shared but those that have one value
            each.
        parameters: Replaces the list.
        hold_out: Keep every third stretch aside; of three recordings or more every third one.
        robust: Huber loss.
        approach: Whether the rig has to come near first; else it is nearly right.
        iterations: Gauss-Newton iterations of a step at most.
        workers: Threads of a batch.
        progress: Called with a stage, the fraction done and a note.

    Returns:
        The outcome.

    Raises:
        InputError: The rig has nothing to fit.
    """
    recordings = [recording] if isinstance(recording, Recording) else list(recording)
    given = parameters or rig.fit.parameters
    drawn, measured = _with_measured_spools(rig, recordings)
    if kind_of(rig).along_lines and approach and not given:
        drawn = with_own_curves(drawn, never_wide(drawn, recordings))
    every, held = _list_of(drawn, given, recordings)
    if all(p.path in held or p.path in measured for p in every):
        raise InputError(
            f"rig {rig.name!r}: nothing is to be fitted, at least one parameter is needed; fit.drop"
            " and fit.hold leave none, or fit.parameters is empty and a"
            f" {rig.model} model of this rig has none by default"
        )
    steps = steps_of(drawn, approach, iterations)
    job = _Job(
        recordings=recordings,
        given=bool(given),
        hold_out=hold_out,
        robust=robust,
        workers=workers,
        work=_work(drawn, steps, recordings, len(every), progress),
        centres=dict(zip(map(_key, every), _inner(every, start_of(drawn, every)), strict=True)),
        measured=measured,
        mirrors=mirrors_of(rig),
    )
    last: _Taken | None = None
    now = drawn
    unseen: set[Key] = set()
    for step in steps:
        if step.again and last is not None and settled(last.estimate) and not last.back:
            # what was computed anew and gained little is done; a limit may be found all the same
            done = at_noise(last.estimate, last.problem, job.used(last.problem))
            if (done or last.fresh) and not step.limits:
                continue
        tried, every = _tried(job, now, step, every, last)
        if step.again and step.limits and tried is now:
            continue  # there is none, and nothing else to be done in this step
        now = tried
        fitted = [
            p
            for p in every
            if p.path not in held
            and p.path not in measured
            and _key(p) not in unseen
            and (not step.slow or job.given or is_slow(p))
        ]
        if not fitted:
            if last is None:
                continue  # of what is to be fitted nothing is slow
            fitted = last.fitted
        last = _taken(job, now, step, fitted, last)
        if not step.slow:
            last, hidden = _brought_back(job, last, _unseen(last.fitted, last.estimate))
            unseen |= hidden
        now = last.rig
        job.work.finish(step)
    assert last is not None
    last = _along_what_hardly_shows(job, _at_known_scale(job, last))
    return _outcome(job, every, held, _on_own_cells(job, _on_shorter_cells(job, last)))


def parameters_of(rig: Rig) -> list[FitParameter]:
    """What `fit_rig` would fit of a rig, without the limits of spools that it may find.

    Args:
        rig: The rig.
    """
    return _list_of(as_fitted(rig), rig.fit.parameters, [])[0]


def as_fitted(rig: Rig) -> Rig:
    """A rig as `fit_rig` begins with it: ports with opening curves of their own.

    Points are those of recordings that open all ports wide.

    Args:
        rig: The rig.
    """
    if rig.fit.parameters or not kind_of(rig).along_lines:
        return rig
    return with_own_curves(rig)


Key = tuple[str, str | None]


@dataclass(frozen=True)
class _Job:
    """What does not change from step to step of a fit.

    Attributes:
        recordings: The recordings.
        given: Whether the list of parameters was given.
        hold_out: Whether a part is kept aside.
        robust: Whether outliers weigh less.
        workers: Threads of a batch.
        work: How much is done.
        centres: Centre of the prior of each parameter; those that come up on the way are added.
        measured: Standard errors of the numbers of spools that were fitted to their positions.
        mirrors: Opening curves that the file calls mirrors of others.
    """

    recordings: list[Recording]
    given: bool
    hold_out: bool
    robust: bool
    workers: int | None
    work: Work
    centres: dict[Key, float]
    measured: dict[str, float | None]
    mirrors: Mirrors

    def used(self, problem: Problem) -> Mask:
        """(n_stretches,) stretches that are fitted."""
        return ~problem.held_out if self.hold_out else np.ones(problem.stretches, dtype=bool)


@dataclass(frozen=True)
class _Taken:
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


def _list_of(
    rig: Rig, given: list[FitParameter], recordings: list[Recording]
) -> tuple[list[FitParameter], list[str]]:
    """Parameters of a rig, those with one value in each recording once for each; held paths."""
    listed, held = estimated_parameters(rig, given)
    return one_each(listed, [r.name for r in recordings]), held


def _with_measured_spools(
    rig: Rig, recordings: list[Recording]
) -> tuple[Rig, dict[str, float | None]]:
    """The rig with the spools whose positions were recorded, and what is known of their numbers."""
    if not any(r.positions for r in recordings):
        return rig, {}
    found = fit_spools(rig, recordings)
    out = rig.model_copy(deep=True)
    measured: dict[str, float | None] = {}
    for name, fitted in found.items():
        out.valves[name].spool = fitted.spool
        measured |= {f"valves.{name}.spool.{n}": None for n in SPOOL_NUMBERS}
        measured |= fitted.std_error
    return out, measured


def _work(
    rig: Rig, steps: list[Step], recordings: list[Recording], count: int, tell: Tell | None
) -> Work:
    """What a fit has before it."""
    seconds = sum(r.end_s for r in recordings)
    return Work.of_steps(
        [(step, weight_of(rig, step, seconds), count, len(rig.valves)) for step in steps],
        tell or (lambda stage, fraction=None, note="": None),
    )


def _tried(
    job: _Job, rig: Rig, step: Step, every: list[FitParameter], last: _Taken | None
) -> tuple[Rig, list[FitParameter]]:
    """The rig with spools that were tried before a step, and the list of parameters it then has."""
    if job.given or not (step.tries or step.limits):
        return rig, every
    told = job.work.begin(step)
    done = {path.split(".")[1] for path in job.measured}
    if step.limits and last is not None:
        rig, changed = try_limits(
            rig, last.problem, job.used(last.problem), last.estimate, last.fitted, done, told
        )
        if not changed:
            return rig, every
    else:
        problem = problem_of(rig, job.recordings, step, job.workers)
        rig = try_spools(rig, problem, done, told)
    every, _ = _list_of(rig, [], job.recordings)
    for p, value in zip(every, _inner(every, start_of(rig, every)), strict=True):
        job.centres.setdefault(_key(p), value)
    return rig, every


def _taken(
    job: _Job,
    rig: Rig,
    step: Step,
    fitted: list[FitParameter],
    before: _Taken | None,
) -> _Taken:
    """Takes a step."""
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
    return _Taken(
        step,
        now,
        fitted,
        problem,
        estimate,
        fresh=slope is None,
        bends=None if step.part else bends,
    )


def _taken_besides(job: _Job, last: _Taken, step: Step) -> _Taken:
    """Takes a step that nobody knew of beforehand, from where the last one ended."""
    weight = weight_of(last.rig, step, sum(r.end_s for r in job.recordings))
    job.work.add(step, weight, runs_of(step, len(last.fitted), 0))
    return _taken(job, last.rig, step, last.fitted, None)


def _alike(one: Step, other: Step) -> bool:
    """Whether a Jacobian of one step serves another."""
    return (one.dx_m, one.pull_s) == (other.dx_m, other.pull_s)


def _at_known_scale(job: _Job, last: _Taken) -> _Taken:
    """The calibration, or a better one that begins where sizes are as known beforehand.

    Only where they have drifted from there together.
    """
    centres = [job.centres[_key(p)] for p in last.fitted]
    shift, deviations = off_scale(last.fitted, last.estimate.values, centres)
    if not kind_of(last.rig).along_lines or abs(deviations) < DRIFTED:
        return last
    now = rig_at(last.rig, last.fitted, rescaled(last.fitted, last.estimate.values, shift))
    for _ in range(STEPS_THERE):
        there = _taken(job, now, last.step, last.fitted, None)
        now = there.rig
        if settled(there.estimate):
            break
    (here_left, here_off), (there_left, there_off) = _worth(job, last), _worth(job, there)
    # a model that is not at the noise anyway says less against what was known beforehand
    count = int(np.isfinite(last.problem.measured[job.used(last.problem)]).sum())
    mean_square = max(1.0, min(here_left, there_left) / max(count, 1))
    return there if there_left - here_left < mean_square * (here_off - there_off) else last


def _along_what_hardly_shows(job: _Job, last: _Taken) -> _Taken:
    """The calibration, after steps along the combinations that the recordings hardly show.

    Steps before have left these where they were by chance, and take them for known. Of a lumped
    model so few parameters are fitted that there are none: on thin-plate labs nothing changed.
    """
    if not last.step.corrected:
        return last
    step = replace(last.step, words=ALONG, iterations=1, along=True)
    return _taken_besides(job, last, step)


def _on_shorter_cells(job: _Job, last: _Taken) -> _Taken:
    """The calibration, after steps on cells half as long, until they gain less than is known.

    What long cells make of a parameter is not what the rig's own do: steps on them end where their
    slopes, not its own, are at right angles to what is left. The sum of squares hardly shows that:
    of a plan for rig B it was 2.4 of its standard deviations above its mean, with three parameters
    off by three to seven of their own.
    """
    dx_m = max(last.rig.grid.dx_m, 0.5 * last.step.dx_m)
    # of a model that lacks something more is wrong than what cells make of it
    near = at_noise(last.estimate, last.problem, job.used(last.problem))
    if not last.step.corrected or last.step.dx_m <= dx_m or not near:
        return last
    step = replace(last.step, words=SHORTER_CELLS, dx_m=dx_m, corrected=dx_m > last.rig.grid.dx_m)
    for _ in range(STEPS_SHORTER):
        last = _taken_besides(job, last, step)
        if gained_little(last.estimate):
            break
    return last


def _on_own_cells(job: _Job, last: _Taken) -> _Taken:
    """The calibration, after steps on the rig's own cells where others leave a bit beyond noise.

    With steep fronts they end elsewhere (see above): on a drawn rig 1 cm for the places of taps,
    and squares of 12980, of 11880 on its own cells.
    """
    used, dx_m = job.used(last.problem), last.rig.grid.dx_m
    # of a model that lacks something more is wrong than what cells make of it
    near = at_noise(last.estimate, last.problem, used)
    if last.step.dx_m <= dx_m or not near or only_noise(last.estimate, last.problem, used):
        return last
    step = replace(last.step, words=OWN_CELLS, dx_m=dx_m, corrected=False)
    for _ in range(STEPS_OWN):
        last = _taken_besides(job, last, step)
        if last.estimate.gained < TELLS_MORE:
            break
    return last


def _worth(job: _Job, taken: _Taken) -> tuple[float, float]:
    """Squared residual on the rig's own cells, and squared distance from what was known before."""
    step = replace(taken.step, dx_m=taken.rig.grid.dx_m, corrected=False)
    problem = problem_of(taken.rig, job.recordings, step, job.workers)
    r = problem.residual(problem.predict([taken.rig])[0])[job.used(problem)]
    variables = centred(taken.rig, taken.fitted, job.centres)
    apart = [(v.value - (v.centre or 0.0)) / v.std for v in variables if np.isfinite(v.std)]
    return float(np.sum(r**2)), float(np.sum(np.square(apart)))


def _slope(
    before: _Taken, fitted: list[FitParameter], problem: Problem, used: Mask
) -> Floats | None:
    """The Jacobian of the step before, where it is one of these parameters and readings."""
    columns = {_key(p): k for k, p in enumerate(before.fitted)}
    j = before.estimate.jacobian
    shape = (int(used.sum()), problem.horizon * len(problem.taps))
    if j.shape[:2] != shape or any(_key(p) not in columns for p in fitted):
        return None
    return j[..., [columns[_key(p)] for p in fitted]]


def _unseen(fitted: list[FitParameter], estimate: Estimate) -> set[Key]:
    """Parameters whose whole uncertainty would not move the predictions by one noise deviation."""
    norms = np.sqrt(np.einsum("smp,smp->p", estimate.jacobian, estimate.jacobian))
    return {
        _key(p)
        for p, norm, value in zip(fitted, norms, estimate.values, strict=True)
        if norm * _spread(p, float(value)) < 1.0
    }


def _brought_back(job: _Job, last: _Taken, hidden: set[Key]) -> tuple[_Taken, set[Key]]:
    """Brings back what was driven to where nothing shows it (`brought_back`).

    Args:
        job: What does not change.
        last: The step.
        hidden: Parameters that are not seen where they are.

    Returns:
        The step, and those of them that are not seen where they were before all either.
    """
    far: list[FitParameter] = []
    off: list[float] = []
    for p, value in zip(last.fitted, last.estimate.values.tolist(), strict=True):
        deviations = (value - job.centres[_key(p)]) / _spread(p, value)
        if _key(p) in hidden and abs(deviations) > FAR_OFF:
            far.append(p)
            off.append(deviations)
    if not far:
        return last, hidden
    centres = [job.centres[_key(p)] for p in far]
    used = job.used(last.problem)
    rig, seen = brought_back(last.rig, last.problem, used, far, centres, off)
    return replace(last, rig=rig, back=rig is not last.rig), hidden - {_key(p) for p in seen}


def _spread(p: FitParameter, value: float) -> float:
    """How uncertain a parameter is beforehand, in the unit that it is estimated in."""
    if p.log:
        span = float(np.log(p.upper / p.lower))
        return span if p.std is None else min(span, p.std / float(np.exp(value)))
    return p.upper - p.lower if p.std is None else min(p.upper - p.lower, p.std)


def _outcome(job: _Job, every: list[FitParameter], held: list[str], last: _Taken) -> FitOutcome:
    """Looks at the fitted rig on its own cells, and says what is known of it."""
    job.work.words = "looking at the result"
    now, fitted = last.rig, last.fitted
    problem = make_problem(now, job.recordings, dx_m=last.problem.dx_m, workers=job.workers)
    if last.problem.dx_m is not None:
        problem.prepare(now)
        problem = problem.with_grid(now.grid.dx_m)
    out = problem.simulate([now], flows=True)
    used = job.used(problem)
    rmse = sensor_rmse(problem, out.readings[0], used)
    held_rmse = sensor_rmse(problem, out.readings[0], ~used)
    cells = _cells_wrong(problem, last.problem.doubt_pa, out.readings[0], used)
    known = known_of(
        every,
        fitted,
        last.estimate,
        held,
        _held_change(now, every, held, last, job),
        job.measured,
    )
    finite = [float(s) if np.isfinite(s) else None for s in known.std_errors]
    listed = [
        p.model_copy(update={"std_error": s or None}) for p, s in zip(every, finite, strict=True)
    ]
    times = _times_noise(problem, rmse, cells, last, job)
    effects: list[str] = []
    if kind_of(now).along_lines and max(times.values(), default=0.0) > ENOUGH:
        effects = effects_that_help(now, last.problem, job.used(last.problem), last.estimate)
    bound = [p for p, beyond in zip(every, known.beyond, strict=True) if beyond]
    shortfall = shortfall_of(now, problem, out, times, bound, effects)
    openings = words_on_openings(now, job.recordings)
    warnings = warnings_of(listed, known) + ([openings] if openings else [])
    noise = {tap: float(n) for tap, n in zip(problem.taps, problem.noise_pa, strict=True)}
    warnings += words_on_cells(now.grid.dx_m, cells)
    (rmse_pa, noise_pa, held_pa), of_encoders = zip(
        *(apart(values, now.encoders) for values in (rmse, noise, held_rmse)), strict=True
    )
    now = now.model_copy(
        update={
            "fit": now.fit.model_copy(update={"parameters": joined(listed), "add": []}),
            "calibration": Calibration(
                recording=job.recordings[0].name,
                recordings=[r.name for r in job.recordings],
                rmse_pa=rmse_pa,
                noise_floor_pa=noise_pa,
                held_out_rmse_pa=held_pa,
                rmse=of_encoders[0],
                noise_floor=of_encoders[1],
                held_out_rmse=of_encoders[2],
            ),
        }
    )
    return FitOutcome(
        rig=now,
        parameters=listed,
        start=[
            float(np.exp(job.centres[_key(p)])) if p.log else job.centres[_key(p)] for p in every
        ],
        values=start_of(now, listed),
        known=known,
        fitted=fitted,
        estimate=last.estimate,
        warnings=warnings + _strangers(problem, out.readings[0]),
        shortfall=shortfall,
        rmse=rmse,
        held_out_rmse=held_rmse,
    )


def _cells_wrong(
    problem: Problem, doubt: Floats | None, readings: Floats, chosen: Mask
) -> dict[str, float]:
    """Error of the rig's cells over the noise per tap and encoder, as far as it is found."""
    if doubt is None:
        return {}
    seen = np.isfinite(problem.measured)
    d = np.where(seen, doubt / problem.noise_pa, 0.0)[chosen]
    square = error_of_cells(problem.residual(readings)[chosen], d)
    wrong = np.sqrt(square / np.maximum(seen[chosen].sum(axis=(0, 1)), 1))
    return {tap: float(w) for tap, w in zip(problem.taps, wrong, strict=True)}


def _times_noise(
    problem: Problem, rmse: dict[str, float], cells: dict[str, float], last: _Taken, job: _Job
) -> dict[str, float]:
    """Times the noise per tap that is to be expected where nothing was fitted.

    What each stretch leaves when it is left out of the estimate says it; never less than is left
    with all of them. What cells are found to get wrong is not counted.
    """
    mine = last.problem
    count = np.isfinite(mine.measured[job.used(mine)]).sum(axis=(0, 1))
    left = last.estimate.left_out.reshape(-1, mine.horizon, len(mine.taps))
    expected = np.sqrt(np.sum(left**2, axis=(0, 1)) / np.maximum(count, 1))
    return {
        tap: max(np.sqrt(max((rmse[tap] / noise) ** 2 - cells.get(tap, 0.0) ** 2, 0.0)), e)
        for tap, noise, e in zip(problem.taps, problem.noise_pa, expected, strict=True)
        if tap in rmse
    }


def _held_change(
    rig: Rig, every: list[FitParameter], held: list[str], last: _Taken, job: _Job
) -> Floats | None:
    """(K, n_stretches used, m) change of the residual per deviation of each parameter held."""
    kept = [p for p in every if p.path in held]
    if not kept:
        return None
    variables = variables_of(rig, kept)
    residuals = residual_function(
        last.problem, job.used(last.problem), lambda x: rig_at(rig, kept, x)
    )
    at = np.array([v.value for v in variables])
    _, j = jacobian(residuals, at, variables)
    spread = [_spread(p, float(value)) for p, value in zip(kept, at, strict=True)]
    return np.moveaxis(j, -1, 0) * np.array(spread)[:, None, None]


def _strangers(problem: Problem, readings: Floats) -> list[str]:
    """Recordings that the fitted rig does not describe, unlike the others."""
    r = problem.residual(readings)
    times = {}
    for c, recording in enumerate(problem.recordings):
        mine = problem.of == c
        count = int(np.isfinite(problem.measured[mine]).sum())
        times[recording.name] = float(np.sqrt(np.sum(r[mine] ** 2) / max(count, 1)))
    least = max(min(times.values()), 1.0)
    return [
        f"{name}: the fitted rig leaves {value:.1f} times the noise there and {least:.1f} at best;"
        " is that recording of another rig, or is something in it that the others lack?"
        for name, value in times.items()
        if value > STRANGE * least
    ]


def _key(p: FitParameter) -> Key:
    return p.path, p.recording


def _inner(parameters: list[FitParameter], values: list[float]) -> list[float]:
    """Values as they are estimated: logarithms where the parameter is logarithmic."""
    return [float(np.log(v)) if p.log else v for p, v in zip(parameters, values, strict=True)]
