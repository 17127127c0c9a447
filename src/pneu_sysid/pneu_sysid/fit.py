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
from pneu_sysid.curves import mirrors_of, with_own_curves
from pneu_sysid.fit_step import Job, Key, Taken, key_of, taken
from pneu_sysid.gauss_newton import Estimate
from pneu_sysid.last_steps import ended
from pneu_sysid.parameters import (
    estimated_parameters,
    joined,
    one_each,
    rig_at,
    variables_of,
)
from pneu_sysid.problem import Problem, make_problem
from pneu_sysid.records import Recording
from pneu_sysid.sensor_units import apart
from pneu_sysid.shortfall import ENOUGH, Shortfall, effects_that_help, shortfall_of
from pneu_sysid.slopes import jacobian
from pneu_sysid.spool_position import fit_spools
from pneu_sysid.spool_starts import limits_missed, try_limits, try_spools
from pneu_sysid.stages import (
    Step,
    Work,
    at_noise,
    brought_back,
    is_slow,
    problem_of,
    residual_function,
    settled,
    start_of,
    steps_of,
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
    job = Job(
        recordings=recordings,
        given=bool(given),
        hold_out=hold_out,
        robust=robust,
        workers=workers,
        work=_work(drawn, steps, recordings, len(every), progress),
        measured=measured,
        mirrors=mirrors_of(rig),
    )
    every = _as_known(job, drawn, every)
    last: Taken | None = None
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
            and key_of(p) not in unseen
            and (not step.slow or job.given or is_slow(p))
        ]
        if not fitted:
            if last is None:
                continue  # of what is to be fitted nothing is slow
            fitted = last.fitted
        after = taken(job, now, step, fitted, last)
        used = job.used(after.problem)
        if last is not None and limits_missed(last.rig, after.rig, after.problem, used):
            now = last.rig
            every = _as_known(job, now, _list_of(now, given, recordings)[0])
            job.work.finish(step)
            continue
        last = after
        if not step.slow:
            last, hidden = _brought_back(job, last, _unseen(job, last.fitted, last.estimate))
            unseen |= hidden
        now = last.rig
        job.work.finish(step)
    assert last is not None
    free = [p for p in every if p.path not in held and p.path not in measured]
    return _outcome(job, every, held, ended(job, last, free))


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
    job: Job, rig: Rig, step: Step, every: list[FitParameter], last: Taken | None
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
    return rig, _as_known(job, rig, every)


def _as_known(job: Job, rig: Rig, listed: list[FitParameter]) -> list[FitParameter]:
    """Parameters with the bounds and spreads that they were first listed with.

    A list made on the way has them about where the numbers then are. New ones are kept in the job.
    """
    for p, value in zip(listed, _inner(listed, start_of(rig, listed)), strict=True):
        if key_of(p) not in job.known:
            job.known[key_of(p)], job.centres[key_of(p)] = p, value
    return [job.known[key_of(p)] for p in listed]


def _unseen(job: Job, fitted: list[FitParameter], estimate: Estimate) -> set[Key]:
    """Parameters whose whole uncertainty would not move the predictions by one noise deviation."""
    norms = np.sqrt(np.einsum("smp,smp->p", estimate.jacobian, estimate.jacobian))
    return {key_of(p) for p, norm in zip(fitted, norms, strict=True) if norm * job.spread(p) < 1.0}


def _brought_back(job: Job, last: Taken, hidden: set[Key]) -> tuple[Taken, set[Key]]:
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
        deviations = job.off(p, value)
        if key_of(p) in hidden and abs(deviations) > FAR_OFF:
            far.append(p)
            off.append(deviations)
    if not far:
        return last, hidden
    centres = [job.centres[key_of(p)] for p in far]
    used = job.used(last.problem)
    rig, seen = brought_back(last.rig, last.problem, used, far, centres, off)
    return replace(last, rig=rig, back=rig is not last.rig), hidden - {key_of(p) for p in seen}


def _outcome(job: Job, every: list[FitParameter], held: list[str], last: Taken) -> FitOutcome:
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
    began = [(p, job.centres[key_of(p)]) for p in every]
    return FitOutcome(
        rig=now,
        parameters=listed,
        start=[float(np.exp(c)) if p.log else c for p, c in began],
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
    problem: Problem, rmse: dict[str, float], cells: dict[str, float], last: Taken, job: Job
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
    rig: Rig, every: list[FitParameter], held: list[str], last: Taken, job: Job
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
    return np.moveaxis(j, -1, 0) * np.array([job.spread(p) for p in kept])[:, None, None]


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


def _inner(parameters: list[FitParameter], values: list[float]) -> list[float]:
    """Values as they are estimated: logarithms where the parameter is logarithmic."""
    return [float(np.log(v)) if p.log else v for p, v in zip(parameters, values, strict=True)]
