# SPDX-License-Identifier: Apache-2.0
"""Running lumped models along recordings: many parameter sets in one batch."""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from pneu_common.tally import Tally
from pneu_sim import layout as L
from pneu_sim import sensors
from pneu_sim.lumped.model import LumpedModel
from pneu_sim.lumped.solver import LumpedSolver
from pneu_sim.simulate import TICK_S as RUN_TICK_S
from pneu_sim.simulate import Course, Prediction, RunOptions
from pneu_sim.spool import MEMORY
from pneu_sim.valve import openings_along

Floats = NDArray[np.float64]

TICKS = 4
"""Ticks of a lumped model in one of the full model's; without ports to open, one is enough."""
GAP = 3.0
"""Readings further apart than this many periods have a gap between them."""


def predict(
    models: Sequence[Sequence[LumpedModel]],
    courses: Sequence[Course],
    options: RunOptions = RunOptions(),
) -> list[Prediction]:
    """Runs every model along every recording, like ``pneu_sim.simulate.predict``.

    A volume starts at the mean of its start along its pipes and chambers, and is drawn to the mean
    of its taps as the course asks. Between ticks readings are linear.

    Args:
        models: (n_courses, n_models) parameter sets of one rig.
        courses: The recordings.
        options: How.

    Returns:
        The predictions, one per course.
    """
    count = len(models[0])
    tasks = [(c, m) for c in range(len(courses)) for m in range(count)]
    found: dict[tuple[int, int], tuple[Floats, Floats, Floats, Floats]] = {}

    tally = Tally([courses[c].ticks for c, _ in tasks], options.progress)

    def run(k: int) -> None:
        c, m = tasks[k]
        found[c, m] = _along(models[c][m], courses[c])
        tally.reached(k, 1.0)

    threads = min(options.workers or os.cpu_count() or 1, len(tasks))
    if threads > 1:
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(run, range(len(tasks))))
    else:
        for k in range(len(tasks)):
            run(k)
    out = []
    every = ticks_of(models[0][0]) if options.flows else 0
    for c, course in enumerate(courses):
        series = [
            np.stack(column) for column in zip(*(found[c, m] for m in range(count)), strict=True)
        ]
        kept = [s[:, ::every] if every else s[:, :0] for s in series[1:]]
        tick_s = course.begin_s + RUN_TICK_S * np.arange(course.ticks, dtype=np.float64)
        flow, chamber, tap = kept
        out.append(Prediction(series[0], tick_s, flow, chamber, tap))
    return out


def ticks_of(model: LumpedModel) -> int:
    """Ticks of a model in one of the full model's.

    Args:
        model: The model.
    """
    return TICKS if model.plan.ports.shape[0] else 1


def _along(model: LumpedModel, course: Course) -> tuple[Floats, Floats, Floats, Floats]:
    """Readings of one model along a course, and its flows, chambers and taps at every tick."""
    plan, base = model.plan, model.base
    ticks = ticks_of(model)
    intervals, step_s = (course.ticks - 1) * ticks, RUN_TICK_S / ticks
    at = course.begin_s + step_s * np.arange(intervals + 1, dtype=np.float64)
    solver = LumpedSolver([model], pull := _pull(course))
    start = course.start
    solver.fill(
        start.pressure[:, None],
        start.chamber_pressure[:, None],
        np.broadcast_to(base.ambient[1], (plan.slots, 1)),
        np.broadcast_to(base.ambient[1], (len(plan.chambers), 1)),
    )
    memory = np.full((len(plan.valves), MEMORY), np.nan)
    opened = openings_along(
        base, course.commands, course.begin_s, 0, (intervals, 1), step_s, memory, start.at_null
    )
    goals = _goals(model, course, at)[None] if pull > 0.0 else None
    out = solver.advance(opened[..., None], step_s, goals)
    taps, flows, chambers = (of[:, :, 0] for of in (out.taps, out.flows, out.chambers))
    shown = sensors.read(base, taps, step_s)
    readings = np.full(course.time_s.shape, np.nan)
    for t in range(len(plan.taps)):
        due = np.isfinite(course.time_s[t])
        readings[t, due] = np.interp(course.time_s[t, due], at, shown[:, t])
    # its pistons are locked, and what they move stands
    for e, (on, (_, gain, bias, _)) in enumerate(zip(plan.encoder_of, base.encoder, strict=True)):
        t = len(plan.taps) + e
        if t < len(readings):
            stands = base.joint[:, L.PJ_START] if start.joints is None else start.joints[:, 0]
            at_rest = stands[on] if on >= 0 else base.cylinder[-1 - on, L.PY_START]
            readings[t, np.isfinite(course.time_s[t])] = gain * at_rest + bias
    return readings, flows, chambers, taps


def _pull(course: Course) -> float:
    """Rate with which the gas is drawn to the taps, 1/s: what the gains amount to over time."""
    rates = []
    for time, gain in zip(course.time_s, course.gain, strict=True):
        due = np.isfinite(time)
        if due.sum() > 1 and gain[due].any():
            rates.append(-np.log1p(-gain[due]).sum() / (time[due][-1] - time[due][0]))
    return float(np.mean(rates)) if rates else 0.0


def _goals(model: LumpedModel, course: Course, at: Floats) -> Floats:
    """(ticks, n_taps) pressures that the readings ask for; NaN where there are none around."""
    goals = np.full((at.size, len(model.plan.taps)), np.nan)
    room = model.base.ambient[0]
    for t, (_, gain, bias, late) in enumerate(model.base.sensor):
        due = np.isfinite(course.measured[t])
        if due.sum() < 2:
            continue
        time = course.time_s[t, due] - late
        pressure = room + (course.measured[t, due] - bias - room) / gain
        goals[:, t] = np.interp(at, time, pressure, left=np.nan, right=np.nan)
        usual = float(np.median(np.diff(time)))
        right = np.clip(np.searchsorted(time, at), 1, time.size - 1)
        goals[time[right] - time[right - 1] > GAP * usual, t] = np.nan
    return goals
