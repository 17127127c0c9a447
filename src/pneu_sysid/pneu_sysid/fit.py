# SPDX-License-Identifier: Apache-2.0
"""Fitting a rig's base parameters to a recording, and saying what the recording cannot tell."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from pneu_sim.errors import InputError
from pneu_sim.rig.schema import Calibration, FitParameter, Rig
from pneu_sysid.gauss_newton import Estimate, Variable, minimise
from pneu_sysid.parameters import (
    curve_ties,
    default_parameters,
    joined,
    one_each,
    rig_at,
    variables_of,
)
from pneu_sysid.problem import Problem, make_problem
from pneu_sysid.records import Recording

Floats = NDArray[np.float64]

STAGES_S = (0.1, 0.25)
"""Short horizons come first: over them the response is closer to linear in the parameters."""
COARSEN = 2.0
"""The short stages run on cells this much longer."""
UNSTABLE = 1e4
"""Residual, in noise deviations, that a simulation counts with once it is unstable."""
CONDITION_LIMIT = 1e6
STRANGE = 3.0
"""A recording with so many times the error of the best one is told to be another's."""


@dataclass(frozen=True)
class FitOutcome:
    """A fitted rig and what is known about its parameters.

    Attributes:
        rig: Fitted rig, with ``calibration`` and standard errors filled in.
        parameters: What was fitted.
        start: Value of each before.
        estimate: The estimation in its own variables.
        warnings: What the recording cannot identify, in plain words.
        rmse_pa: Residual per tap on the part used.
        held_out_rmse_pa: Residual per tap on the part kept aside.
    """

    rig: Rig
    parameters: list[FitParameter]
    start: list[float]
    estimate: Estimate
    warnings: list[str]
    rmse_pa: dict[str, float]
    held_out_rmse_pa: dict[str, float]


def tap_rmse(problem: Problem, readings: Floats, chosen: NDArray[np.bool_]) -> dict[str, float]:
    """Root mean square error per tap over chosen stretches, Pa.

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


def residual_function(
    problem: Problem, chosen: NDArray[np.bool_], rig_of: Callable[[Floats], Rig]
) -> Callable[[Sequence[Floats]], Floats]:
    """Batched residuals over chosen stretches for `gauss_newton.minimise`.

    Args:
        problem: The problem.
        chosen: (n_stretches,) stretches to use.
        rig_of: Rig at a parameter vector.
    """
    target = problem.target()[chosen]

    def residuals(points: Sequence[Floats]) -> Floats:
        y = problem.simulate([rig_of(x) for x in points], strict=False).readings[:, chosen]
        r = np.where(np.isfinite(target), (target - y) / problem.noise_pa, 0.0)
        # a trial that no longer can be simulated is only a bad one
        r[~(np.abs(r) < UNSTABLE)] = UNSTABLE
        return r.reshape(len(points), target.shape[0], -1)

    return residuals


def fit_rig(
    rig: Rig,
    recording: Recording | Sequence[Recording],
    parameters: list[FitParameter] | None = None,
    hold_out: bool = False,
    robust: bool = False,
    stages_s: Sequence[float] = STAGES_S,
    iterations: int = 8,
    workers: int | None = None,
    progress: Callable[[str, int, float], None] | None = None,
) -> FitOutcome:
    """Fits a rig to recordings by bounded Gauss-Newton on its predictions (thesis 8.1.1, 8.1.2).

    Args:
        rig: Start values; its ``fit.parameters`` say what may change, else the default list.
        recording: The recording, or several: parameters are shared but those that have one value
            each.
        parameters: Replaces the list.
        hold_out: Keep every third stretch aside; of three recordings or more every third one.
        robust: Huber loss.
        stages_s: Horizons of the preliminary stages.
        iterations: Gauss-Newton iterations of the last stage.
        workers: Threads of a batch.
        progress: Called with stage, iteration and cost.

    Returns:
        The outcome.

    Raises:
        InputError: The rig has nothing to fit.
    """
    chosen_parameters = parameters or rig.fit.parameters or default_parameters(rig)
    if not chosen_parameters:
        raise InputError(
            f"rig {rig.name!r}: fit.parameters is empty and a {rig.model} model of this rig has no"
            " parameters by default, at least one is needed"
        )
    recordings = [recording] if isinstance(recording, Recording) else list(recording)
    listed_before = chosen_parameters
    chosen_parameters = one_each(chosen_parameters, [r.name for r in recordings])
    first = variables_of(rig, chosen_parameters)
    start = [
        float(np.exp(v.value)) if p.log else v.value
        for v, p in zip(first, chosen_parameters, strict=True)
    ]
    horizon = rig.fit.horizon_s
    plan: list[tuple[float | None, float | None, int]] = []
    if rig.model == "pde":
        coarse = COARSEN * rig.grid.dx_m
        plan += [(h, coarse, 5) for h in stages_s if horizon is not None and h < 0.8 * horizon]
        plan += [(None, coarse, iterations)] if plan else []
    if not plan:
        plan.append((None, None, iterations))
    # Each stage finds anew how the recordings began: the last one with a rig that is nearly right.
    plan.append((None, None, max(3, iterations // 2)))
    now = rig
    estimate: Estimate | None = None
    problem = make_problem(rig, recordings, workers=workers)
    for horizon_s, dx_m, steps in plan:
        problem = make_problem(
            rig,
            recordings,
            pull_s=None if horizon_s is None else horizon_s / np.sqrt(3.0),
            dx_m=dx_m,
            workers=workers,
        )
        used = ~problem.held_out if hold_out else np.ones(problem.stretches, dtype=bool)
        at = now
        # The datasheet stays the centre of the prior through all stages.
        variables = [
            Variable(v.name, v.value, v.lower, v.upper, v.step, v.std, centre=f.value)
            for v, f in zip(variables_of(at, chosen_parameters), first, strict=True)
        ]
        label = f"{horizon_s or horizon or recordings[0].end_s:g} s"
        estimate = minimise(
            residual_function(problem, used, partial(rig_at, at, chosen_parameters)),
            variables,
            iterations=steps,
            robust=robust,
            ties=curve_ties(at, chosen_parameters),
            progress=None if progress is None else partial(progress, label),
        )
        now = rig_at(at, chosen_parameters, estimate.values)
    assert estimate is not None
    readings = problem.predict([now])[0]
    used = ~problem.held_out if hold_out else np.ones(problem.stretches, dtype=bool)
    rmse = tap_rmse(problem, readings, used)
    held = tap_rmse(problem, readings, ~used)
    std_errors = [
        float(s * (np.exp(v) if p.log else 1.0))
        for s, v, p in zip(estimate.std_errors, estimate.values, chosen_parameters, strict=True)
    ]
    listed = [
        p.model_copy(update={"std_error": s if np.isfinite(s) else None})
        for p, s in zip(chosen_parameters, std_errors, strict=True)
    ]
    now = now.model_copy(
        update={
            "fit": now.fit.model_copy(update={"parameters": joined(listed, listed_before)}),
            "calibration": Calibration(
                recording=recordings[0].name,
                recordings=[r.name for r in recordings],
                rmse_pa=rmse,
                noise_floor_pa={
                    tap: float(n) for tap, n in zip(problem.taps, problem.noise_pa, strict=True)
                },
                held_out_rmse_pa=held,
            ),
        }
    )
    return FitOutcome(
        rig=now,
        parameters=listed,
        start=start,
        estimate=estimate,
        warnings=warnings_of(listed, estimate) + _strangers(problem, readings),
        rmse_pa=rmse,
        held_out_rmse_pa=held,
    )


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


def warnings_of(parameters: list[FitParameter], estimate: Estimate) -> list[str]:
    """What the recording cannot identify, one sentence each.

    Args:
        parameters: What was fitted.
        estimate: The result.
    """
    out = []
    for p, seen, bound, v in zip(
        parameters, estimate.visible, estimate.at_bound, estimate.values, strict=True
    ):
        if not seen:
            out.append(f"{p.path}: the recording does not depend on it; it keeps its start value")
        elif bound:
            value = float(np.exp(v)) if p.log else float(v)
            out.append(f"{p.path}: at its bound ({value:.4g}); the true value may lie outside")
    c = estimate.correlation
    for a, b in pairs_above(c, 0.98):
        out.append(
            f"{parameters[a].path} and {parameters[b].path} can only be told in combination"
            f" (correlation {c[a, b]:+.3f})"
        )
    if estimate.condition > CONDITION_LIMIT:
        out.append(
            f"the estimation is ill-conditioned ({estimate.condition:.1e}); more varied excitation"
            " or fewer parameters would help"
        )
    return out


def pairs_above(correlation: Floats, limit: float) -> list[tuple[int, int]]:
    """Index pairs whose correlation exceeds a limit in size, largest first.

    Args:
        correlation: (P, P).
        limit: Threshold.
    """
    i, j = np.triu_indices(correlation.shape[0], 1)
    size = np.abs(correlation[i, j])
    order = np.argsort(-size)
    return [(int(i[k]), int(j[k])) for k in order if size[k] >= limit]
