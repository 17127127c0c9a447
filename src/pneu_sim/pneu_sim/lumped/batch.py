# SPDX-License-Identifier: Apache-2.0
"""Running lumped models: many parameter sets over many roll-outs in one batch."""

import math
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from pneu_sim import sensors
from pneu_sim.lumped.filling import fill, port_flow
from pneu_sim.lumped.model import V_VOLUME, LumpedModel
from pneu_sim.simulate import InitialField, Rollouts
from pneu_sim.valve import KNOTS_PER_SAMPLE, openings

Floats = NDArray[np.float64]

STEP = 1.5
"""Step times the fastest rate of any volume; the Runge-Kutta method is stable up to 2.8."""


def rollouts(
    models: Sequence[LumpedModel],
    field: InitialField,
    commands: dict[str, Floats],
    dt_s: float,
    starts: Sequence[int],
    samples: int,
    taps_pa: Floats,
    warm_up: int = 0,
    nudge_s: float = 0.002,
    workers: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> Rollouts:
    """Rolls every model out from every start, like ``pneu_sim.simulate.rollouts``.

    A volume starts at the mean of the readings of its taps, or where it has none at the mean of the
    initial field along its pipes. During the warm-up it is drawn to the mean of its taps.

    Args:
        models: Parameter sets of one rig.
        field: Map from taps to the initial pressures, for volumes without a tap.
        commands: Per command its (T,) volts.
        dt_s: Sample interval, s.
        starts: First sample of each roll-out, warm-up included.
        samples: Samples per roll-out, warm-up included.
        taps_pa: (T, n_taps) measured pressures for the initial state and the warm-up; NaN where
            there are none.
        warm_up: Samples of warm-up.
        nudge_s: Time constant of the pull to the taps.
        workers: Threads; None is one per core.
        progress: Called with the fraction done.

    Returns:
        The predictions.
    """
    plan = models[0].plan
    n_models, n_starts = len(models), len(starts)
    # A rig without valves still has orifices, open for the length of the recording.
    volts = commands or {"": np.zeros(taps_pa.shape[0])}
    begin = np.asarray(starts, dtype=np.int64)
    nudged = min(warm_up, samples - 1)
    rate = max(fastest(model) for model in models)
    if nudged:
        rate = max(rate, 1.0 / nudge_s)
    # In powers of two, so that the step is the same for parameters that differ a little.
    n_sub = max(KNOTS_PER_SAMPLE, 2 ** math.ceil(math.log2(max(dt_s * rate / STEP, 1.0))))
    goals = np.ascontiguousarray(taps_pa, dtype=float)
    taps = np.empty((n_models, n_starts, samples, len(plan.taps)))
    flows = np.empty((n_models, n_starts, samples, plan.ports.shape[0]))
    chambers = np.empty((n_models, n_starts, samples, len(plan.chambers)))
    done = [0]

    def run(m: int) -> None:
        model = models[m]
        gas = model.base.gas
        opened = openings(model.base, volts, dt_s)
        if opened.shape[0] == 1:
            opened = np.repeat(opened, 2, axis=0)
        base = np.array([_start(model, field, goals, s) for s in starts])
        fill(
            samples, n_sub, dt_s / n_sub, KNOTS_PER_SAMPLE, gas.gamma, gas.r_specific,
            model.exponent, model.side, model.area, model.linear, model.source, model.volume,
            model.tap, model.chamber, model.tap_delay_s, model.side_delay_s, model.drag,
            model.base.ambient, begin, base, opened, nudged, 1.0 / nudge_s, goals,
            taps[m], flows[m], chambers[m],
        )  # fmt: skip
        done[0] += 1
        if progress is not None:
            progress(done[0] / n_models)

    threads = min(workers or os.cpu_count() or 1, n_models)
    if threads > 1:
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(run, range(n_models)))
    else:
        for m in range(n_models):
            run(m)
    readings = np.empty_like(taps)
    for m, model in enumerate(models):
        shaped = np.moveaxis(taps[m], 0, -1)  # (samples, taps, starts)
        readings[m] = np.moveaxis(sensors.read(model.base, shaped, dt_s), -1, 0)
    return Rollouts(readings, flows, chambers)


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


def _start(model: LumpedModel, field: InitialField, goals: Floats, sample: int) -> Floats:
    """Initial pressures of the volumes; a missing reading takes the next one there is."""
    row = goals[sample].copy()
    for t in np.flatnonzero(~np.isfinite(row)):
        later = goals[sample:, t]
        later = later[np.isfinite(later)]
        row[t] = later[0] if later.size else np.nan
    room = model.base.ambient[0]
    spread = np.where(np.isfinite(row), row, room)
    base = np.full(len(model.volume), room)
    for v, cells in enumerate(model.cells):
        own = row[model.tap == v]
        if np.isfinite(own).any():
            base[v] = np.nanmean(own)
        elif cells.size:
            base[v] = np.mean(field.weight[cells] @ spread + field.constant[cells])
        else:
            chambers = np.flatnonzero(model.chamber == v)
            at = field.chamber_weight[chambers] @ spread + field.chamber_constant[chambers]
            base[v] = at.mean()
    return base
