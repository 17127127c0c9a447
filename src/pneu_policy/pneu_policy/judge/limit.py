# SPDX-License-Identifier: Apache-2.0
"""The physical limit of a rig: the smallest error that any controller could reach on a target.

The plant is known, the whole target is known ahead, and nothing is noisy. The voltage is found by
direct single shooting in a receding horizon: piecewise constant voltages within the valve's range,
a Gauss-Newton step with box constraints on the error over the horizon (Nocedal and Wright,
Numerical Optimization, 2nd ed. 2006, ch. 10), of which the beginning is carried out before the
horizon moves on. Derivatives are differences between rigs that run side by side.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from pneu_common.errors import InputError
from pneu_common.validation import Settings
from pneu_policy.control.shooting import LANES, SCALE_PA, cost, differences, steps_of
from pneu_policy.judge.evaluate import target_series
from pneu_policy.judge.metrics import Track
from pneu_policy.judge.results import LIMIT, Evaluation, Run
from pneu_policy.judge.tasks import Tasks
from pneu_policy.task.plants import ControlPlant
from pneu_policy.task.targets import Target
from pneu_sim.plant import State
from pneu_sim.rig.schema import Rig

Floats = NDArray[np.float64]

DAMPING = (1e-4, 1e-2, 1.0, 100.0)
"""Levenberg-Marquardt terms that are tried, relative to the mean square of the derivatives."""


class LimitSettings(Settings):
    """How the limit is computed.

    Attributes:
        dx_m: Cell length, m; None is a thirtieth of the longest line.
        period_s: Interval at which the error counts, s: that of the readings of a rig, so that
            what happens while a voltage is held counts as well.
        knot_s: How long a voltage is held, s, as by a controller of that period; a multiple of the
            interval.
        horizon_s: How far is planned, s; a multiple of the knots.
        commit_s: How much of a plan is carried out, s; a multiple of the knots.
        iterations: Gauss-Newton steps per plan; each plan goes on from the last.
        first_iterations: Gauss-Newton steps of the first plan, which goes on from a closed valve.
        low_v: Lowest voltage, V.
        high_v: Highest voltage, V.
        null_v: Voltage at which the valve closes, V.
        smooth_pa_per_v: What a volt of change from knot to knot counts as, Pa: just enough to
            settle what the error leaves open.
    """

    dx_m: float | None = None
    period_s: float = 0.002
    knot_s: float = 0.01
    horizon_s: float = 0.15
    commit_s: float = 0.02
    iterations: int = 1
    first_iterations: int = 24
    low_v: float = 0.0
    high_v: float = 10.0
    null_v: float = 5.0
    smooth_pa_per_v: float = 10.0

    @model_validator(mode="after")
    def _divide(self) -> Self:
        for name, part in (
            ("knot_s", self.period_s),
            ("horizon_s", self.knot_s),
            ("commit_s", self.knot_s),
        ):
            whole = getattr(self, name) / part
            if not (math.isfinite(whole) and whole >= 1.0 and abs(whole - round(whole)) < 1e-6):
                raise ValueError(
                    f"{name}: found {getattr(self, name):g}, it must be a multiple of {part:g} s"
                )
        if self.commit_s > self.horizon_s:
            raise ValueError(
                f"commit_s: found {self.commit_s:g}, at most the horizon of {self.horizon_s:g} s"
            )
        return self


@dataclass(frozen=True)
class Limit:
    """The best run that was found.

    Attributes:
        time_s: (n,) times, s, one period apart; the first is the start.
        pressure_pa: (n,) what the tap shows there, Pa.
        target_pa: (n,) the target there, Pa.
        volts: (n - 1,) the voltage of each period.
        dx_m: Cell length of the plant, m.
    """

    time_s: Floats
    pressure_pa: Floats
    target_pa: Floats
    volts: Floats
    dx_m: float


def longest_line_m(rig: Rig) -> float:
    """Length of the longest pipe of a rig, m.

    Args:
        rig: The rig.
    """
    return max(pipe.length_m for pipe in rig.pipes.values())


def physical_limit(
    rig: Rig,
    tap: str,
    target: Callable[[Floats], Floats],
    duration_s: float,
    start_pa: float,
    settings: LimitSettings | None = None,
    progress: Callable[[float], None] | None = None,
) -> Limit:
    """The run with the smallest error, found with the plant and the whole target known.

    Args:
        rig: The plant, all its effects included.
        tap: Tap that shall follow.
        target: Target over time since the start, Pa; also beyond the end.
        duration_s: How long the run is, s.
        start_pa: Pressure behind the valve at the start, Pa.
        settings: How it is computed.
        progress: Called with the fraction done.

    Returns:
        The run.

    Raises:
        InputError: The rig has no such tap, or cannot be simulated so.
    """
    s = settings or LimitSettings()
    if tap not in rig.taps:
        raise InputError(f"tap {tap!r}: rig {rig.name!r} has {', '.join(rig.taps)}")
    dx_m = s.dx_m or longest_line_m(rig) / 30.0
    search = _Search(rig, tap, dx_m, s)
    one = ControlPlant([rig], s.period_s, dx_m)
    at = one.taps.index(tap)
    pressure = [float(one.reset(start_pa)[0, at])]
    volts: list[float] = []
    plan = np.full(search.knots, s.null_v)
    held, committed = round(s.knot_s / s.period_s), round(s.commit_s / s.knot_s)
    steps = round(duration_s / s.period_s)
    while len(volts) < steps:
        ahead = (len(volts) + 1 + np.arange(search.knots * held, dtype=np.float64)) * s.period_s
        last = volts[-1] if volts else s.null_v
        rounds = s.iterations if volts else s.first_iterations
        plan = search.improve(one.state(), plan, target(ahead), last, rounds)
        for volt in np.repeat(plan[:committed], held)[: steps - len(volts)]:
            pressure.append(float(one.step(float(volt))[0, at]))
            volts.append(float(volt))
        plan = np.concatenate([plan[committed:], np.full(committed, plan[-1])])
        if progress is not None:
            progress(len(volts) / steps)
    time = np.arange(steps + 1, dtype=np.float64) * s.period_s
    return Limit(time, np.array(pressure), target(time), np.array(volts), dx_m)


class _Search:
    """Plans over one horizon, on rigs that run side by side."""

    def __init__(self, rig: Rig, tap: str, dx_m: float, settings: LimitSettings) -> None:
        self._s = settings
        self.knots = round(settings.horizon_s / settings.knot_s)
        self._held = round(settings.knot_s / settings.period_s)
        count = -(-(self.knots + 1) // LANES) * LANES
        self._plant = ControlPlant([rig] * count, settings.period_s, dx_m)
        self._at = self._plant.taps.index(tap)
        self._lanes = np.zeros(count, dtype=np.int64)
        self._count = 0

    def _roll(self, state: State, plans: Floats) -> Floats:
        """(steps, lanes) pressures of (lanes, knots) plans from one state."""
        self._plant.set_state(state, self._lanes)
        out = np.empty((self.knots * self._held, plans.shape[0]))
        for step in range(out.shape[0]):
            out[step] = self._plant.step(plans[:, step // self._held])[:, self._at]
        return out

    def improve(
        self, state: State, plan: Floats, target: Floats, last_v: float, rounds: int
    ) -> Floats:
        """A better plan from a state, or the same."""
        s, count = self._s, self._lanes.size
        for _ in range(rounds):
            plans, signed = differences(plan, self._count, count, s.low_v, s.high_v)
            self._count += 1
            seen = self._roll(state, plans)
            weight = s.smooth_pa_per_v / SCALE_PA
            error, steps = steps_of(
                plan, seen, signed, target, last_v, (s.low_v, s.high_v), weight, DAMPING
            )
            # steps of several dampings and lengths, one per lane
            lengths = range(count // len(DAMPING))
            tried = np.stack(
                [np.clip(plan + 0.6**k * d, s.low_v, s.high_v) for d in steps for k in lengths]
            )
            brought = (self._roll(state, tried) - target[:, None]) / SCALE_PA
            costs = cost(brought, tried, last_v, weight)
            best = int(np.argmin(costs))
            if costs[best] < float(cost(error[:, None], plan[None], last_v, weight)[0]):
                plan = tried[best]
        return plan


def limit_track(
    rig: Rig, tap: str, target: Target, duration_s: float, settings: LimitSettings | None = None
) -> Track:
    """The best run there could be, for one target.

    Args:
        rig: The plant, its effects known.
        tap: Tap that shall follow.
        target: The target.
        duration_s: Length of the run, s.
        settings: How it is computed.

    Raises:
        InputError: The rig has no such tap, or cannot be simulated so.
    """
    best = physical_limit(rig, tap, target.at, duration_s, rig.ambient.pressure_pa, settings)
    return Track(
        best.time_s,
        best.pressure_pa,
        *target_series(target, duration_s),
        best.time_s[:-1],
        best.volts,
    )


def evaluate_limit(
    evaluation: Evaluation,
    plants: Mapping[str, Rig],
    tap: str,
    tasks: Tasks,
    settings: LimitSettings | None = None,
    workers: int = 1,
    progress: Callable[[str, float], None] | None = None,
) -> None:
    """The physical limit of each rig on each target, as runs of a controller called ``limit``.

    Args:
        evaluation: Where the runs go.
        plants: The rigs by name, their effects known.
        tap: Tap that shall follow.
        tasks: The targets.
        settings: How it is computed.
        workers: Processes.
        progress: Called with what is run and the fraction of it that is done.
    """
    from joblib import Parallel, delayed

    wanted = [
        run
        for plant in plants
        for kind in tasks.kinds
        for seed in tasks.seeds
        if not evaluation.has((run := Run(LIMIT, plant, kind, seed, None)).key)
    ]
    jobs = (
        delayed(limit_track)(
            plants[run.plant],
            tap,
            tasks.target(run.kind, run.seed),
            tasks.duration_s,
            settings,
        )
        for run in wanted
    )
    found = Parallel(n_jobs=workers, return_as="generator")(jobs)
    for done, (run, track) in enumerate(zip(wanted, found, strict=True)):
        figures = tasks.judge(track)
        evaluation.add(replace(run, metrics=figures), track)
        if progress is not None:
            progress("physical limit", (done + 1) / len(wanted))
