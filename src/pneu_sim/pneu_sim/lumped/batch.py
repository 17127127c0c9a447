# SPDX-License-Identifier: Apache-2.0
"""Running lumped models along recordings: many parameter sets in one batch."""

import math
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from pneu_common.tally import Tally
from pneu_sim import sensors
from pneu_sim.lumped.filling import fill, port_flow
from pneu_sim.lumped.model import V_VOLUME, LumpedModel
from pneu_sim.simulate import TICK_S as RUN_TICK_S
from pneu_sim.simulate import Course, Prediction, Start
from pneu_sim.valve import openings_along

Floats = NDArray[np.float64]

TICKS = 4
"""Ticks of a lumped model in one of the full model's; without ports to open, one is enough."""
GAP = 3.0
"""Readings further apart than this many periods have a gap between them."""
STEP = 1.5
"""Step times the fastest rate of any volume; the Runge-Kutta method is stable up to 2.8."""


def predict(
    models: Sequence[Sequence[LumpedModel]],
    courses: Sequence[Course],
    workers: int | None = None,
    progress: Callable[[float], None] | None = None,
    flows: bool = False,
) -> list[Prediction]:
    """Runs every model along every recording, like ``pneu_sim.simulate.predict``.

    A volume starts at the mean of its start along its pipes and chambers, and is drawn to the mean
    of its taps as the course asks. Between ticks readings are linear.

    Args:
        models: (n_courses, n_models) parameter sets of one rig.
        courses: The recordings.
        workers: Threads; None is one per core.
        progress: Called with the fraction done.
        flows: Whether flows and pressures are kept from tick to tick.

    Returns:
        The predictions, one per course.
    """
    count = len(models[0])
    tasks = [(c, m) for c in range(len(courses)) for m in range(count)]
    found: dict[tuple[int, int], tuple[Floats, Floats, Floats, Floats]] = {}

    tally = Tally([courses[c].ticks for c, _ in tasks], progress)

    def run(k: int) -> None:
        c, m = tasks[k]
        found[c, m] = _along(models[c][m], courses[c])
        tally.reached(k, 1.0)

    threads = min(workers or os.cpu_count() or 1, len(tasks))
    if threads > 1:
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(run, range(len(tasks))))
    else:
        for k in range(len(tasks)):
            run(k)
    out = []
    every = ticks_of(models[0][0]) if flows else 0
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
    plan, gas = model.plan, model.base.gas
    ticks = ticks_of(model)
    samples, step_s = (course.ticks - 1) * ticks + 1, RUN_TICK_S / ticks
    at = course.begin_s + step_s * np.arange(samples, dtype=np.float64)
    rate = fastest(model)
    pull = _pull(course)
    # In powers of two, so that the step is the same for parameters that differ a little.
    n_sub = 2 ** math.ceil(math.log2(max(step_s * max(rate, pull) / STEP, 1.0)))
    opened = openings_along(
        model.base,
        course.commands,
        course.begin_s,
        step_s,
        samples,
        np.full((len(plan.valves), 4), np.nan),
        course.start.at_null,
    )
    taps = np.empty((1, samples, len(plan.taps)))
    flows = np.empty((1, samples, plan.ports.shape[0]))
    chambers = np.empty((1, samples, len(plan.chambers)))
    fill(
        samples, n_sub, step_s / n_sub, 1, gas.gamma, gas.r_specific,
        model.exponent, model.side, model.area, model.linear, model.source, model.volume,
        model.tap, model.chamber, model.tap_delay_s, model.side_delay_s, model.drag,
        model.base.ambient, np.zeros(1, dtype=np.int64), _start(model, course.start)[None], opened,
        samples if pull > 0.0 else 0, pull, _goals(model, course, at), taps, flows, chambers,
    )  # fmt: skip
    shown = sensors.read(model.base, taps[0], step_s)
    readings = np.full(course.time_s.shape, np.nan)
    for t in range(len(plan.taps)):
        due = np.isfinite(course.time_s[t])
        readings[t, due] = np.interp(course.time_s[t, due], at, shown[:, t])
    return readings, flows[0], chambers[0], taps[0]


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
        due = np.isfinite(course.measured_pa[t])
        if due.sum() < 2:
            continue
        time = course.time_s[t, due] - late
        pressure = room + (course.measured_pa[t, due] - bias - room) / gain
        goals[:, t] = np.interp(at, time, pressure, left=np.nan, right=np.nan)
        usual = float(np.median(np.diff(time)))
        right = np.clip(np.searchsorted(time, at), 1, time.size - 1)
        goals[time[right] - time[right - 1] > GAP * usual, t] = np.nan
    return goals


def fastest(model: LumpedModel) -> float:
    """Returns the fastest rate at which any volume may settle, 1/s: all ports open and linear.

    Args:
        model: The model.
    """
    gas = model.base.gas
    warm = gas.gamma * max(model.base.ambient[1], *model.source[:, 1], 0.0)
    rates = np.zeros(len(model.volume))
    for q, (area, linear) in enumerate(zip(model.area, model.linear, strict=True)):
        edge = port_flow(1.0, warm, linear, warm, area, linear, gas.gamma, gas.r_specific)
        slope = model.base.curve[q].max() * edge / (1.0 - linear)
        for place in model.side[2 * q : 2 * q + 2]:
            if place >= 0:
                row = model.volume[place]
                rates[place] += model.exponent * gas.r_specific * warm * slope / row[V_VOLUME]
    return float(rates.max(initial=0.0))


def _start(model: LumpedModel, start: Start) -> Floats:
    """Initial pressures of the volumes."""
    base = np.full(len(model.volume), model.base.ambient[0])
    for v, cells in enumerate(model.cells):
        chambers = np.flatnonzero(model.chamber == v)
        if cells.size:
            base[v] = np.mean(start.pressure[cells])
        elif chambers.size:
            base[v] = np.mean(start.chamber_pressure[chambers])
    return base
