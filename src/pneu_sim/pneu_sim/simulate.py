# SPDX-License-Identifier: Apache-2.0
"""Running models: one rig along a recording, or many parameter sets over many roll-outs at once."""

import math
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pneu_sim import layout as L
from pneu_sim import sensors
from pneu_sim.rig.build import Model, Plan
from pneu_sim.rig.schema import Rig
from pneu_sim.tile import advance, fill_chambers, fill_pipes, lanes, pack
from pneu_sim.valve import KNOTS_PER_SAMPLE, openings

Floats = NDArray[np.float64]

TILE = 8
"""Rigs advanced together: one vector register of doubles, and a working set that stays in cache."""


@dataclass(frozen=True)
class InitialField:
    """Initial pressures as a linear map of tap readings: ``p = weight @ taps + constant``.

    Attributes:
        weight: (slots, n_taps).
        constant: (slots,).
        chamber_weight: (n_chambers, n_taps).
        chamber_constant: (n_chambers,).
    """

    weight: Floats
    constant: Floats
    chamber_weight: Floats
    chamber_constant: Floats


def initial_field(rig: Rig, plan: Plan) -> InitialField:
    """Linear interpolation of tap readings along each pipe, as thesis 8.1.2 starts its roll-outs.

    A reservoir's pressure counts as known at its pipe end. A pipe without any known point takes the
    pressure of its nearest neighbour that has one, else the room's.

    Args:
        rig: The rig.
        plan: Its grid.
    """
    n_taps = len(rig.taps)
    weight = np.zeros((plan.slots, n_taps))
    constant = np.zeros(plan.slots)
    names = list(rig.pipes)
    known: dict[str, list[tuple[float, Floats, float]]] = {}
    tap_names = list(rig.taps)
    for name, pipe in rig.pipes.items():
        points: list[tuple[float, Floats, float]] = []
        for t, tap in enumerate(rig.taps.values()):
            if tap.pipe == name or (
                tap.chamber is not None and tap.chamber in (pipe.from_node, pipe.to_node)
            ):
                x = (
                    tap.position_m
                    if tap.pipe == name
                    else (0.0 if tap.chamber == pipe.from_node else pipe.length_m)
                )
                points.append((x, np.eye(n_taps)[t], 0.0))
        for x, node in ((0.0, pipe.from_node), (pipe.length_m, pipe.to_node)):
            if node in rig.reservoirs:
                points.append((x, np.zeros(n_taps), rig.reservoirs[node].pressure_pa))
        known[name] = sorted(points, key=lambda point: point[0])
    for _ in names:  # spread to neighbours that share a node
        for name, pipe in rig.pipes.items():
            if known[name]:
                continue
            for other, neighbour in rig.pipes.items():
                shared = {pipe.from_node, pipe.to_node} & {neighbour.from_node, neighbour.to_node}
                if other != name and known[other] and shared - {"closed"}:
                    at_start = neighbour.from_node in shared
                    point = known[other][0 if at_start else -1]
                    known[name] = [(0.0, point[1], point[2])]
                    break
    for name, pipe in rig.pipes.items():
        first, n = plan.pipes[name]
        points = known[name] or [(0.0, np.zeros(n_taps), rig.ambient.pressure_pa)]
        xs = np.array([point[0] for point in points])
        centres = (np.arange(n) + 0.5) * pipe.length_m / n
        for t in range(n_taps):
            weight[first : first + n, t] = np.interp(centres, xs, [p[1][t] for p in points])
        constant[first : first + n] = np.interp(centres, xs, [p[2] for p in points])
        for ghost, cell in ((first - 1, first), (first + n, first + n - 1)):
            weight[ghost] = weight[cell]
            constant[ghost] = constant[cell]
    chamber_weight = np.zeros((len(plan.chambers), n_taps))
    chamber_constant = np.zeros(len(plan.chambers))
    for c, chamber in enumerate(plan.chambers):
        direct = [t for t, name in enumerate(tap_names) if rig.taps[name].chamber == chamber]
        if direct:
            chamber_weight[c, direct] = 1.0 / len(direct)
            continue
        chamber_constant[c] = rig.ambient.pressure_pa
        for name, pipe in rig.pipes.items():
            if chamber in (pipe.from_node, pipe.to_node):
                first, n = plan.pipes[name]
                slot = first if chamber == pipe.from_node else first + n - 1
                chamber_weight[c] = weight[slot]
                chamber_constant[c] = constant[slot]
                break
    return InitialField(weight, constant, chamber_weight, chamber_constant)


@dataclass(frozen=True)
class Rollouts:
    """What a batch of roll-outs predicts.

    Attributes:
        readings: (n_models, n_starts, n_samples, n_taps) sensor readings, Pa.
        flows: (n_models, n_starts, n_samples, n_ports) port flows, kg/s.
        chambers: (n_models, n_starts, n_samples, n_chambers) pressures, Pa.
    """

    readings: Floats
    flows: Floats
    chambers: Floats


def _tile_width(count: int) -> int:
    return TILE if count > 2 else count


def rollouts(
    models: Sequence[Model],
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
    strict: bool = True,
) -> Rollouts:
    """Rolls every model out from every start, in one batch.

    Each roll-out begins at rest with pressures interpolated from the taps (thesis 8.1.2). In its
    first ``warm_up`` samples the state is drawn to the measured taps, so that velocities and
    temperatures settle to what the recorded history implies; after that it runs free.

    Args:
        models: Parameter sets on one common plan.
        field: Map from taps to the initial pressures.
        commands: Per command its (T,) volts.
        dt_s: Sample interval, s.
        starts: First sample of each roll-out, warm-up included.
        samples: Samples per roll-out, warm-up included.
        taps_pa: (T, n_taps) measured pressures, smoothed, for the initial state and the warm-up;
            NaN where there are none.
        warm_up: Samples of warm-up.
        nudge_s: Time constant of the pull to the taps.
        workers: Threads; None is one per core.
        progress: Called with the fraction done.
        strict: Whether an unstable roll-out is an error; else its predictions are not finite.

    Returns:
        The predictions.

    Raises:
        InputError: A prediction is not finite, and ``strict``.
    """
    plan = models[0].plan
    n_models, n_starts = len(models), len(starts)
    count = n_models * n_starts
    width = _tile_width(count)
    # A rig without valves still has orifices, open for the length of the recording.
    volts = commands or {"": np.zeros(taps_pa.shape[0])}
    opened = [openings(model, volts, dt_s) for model in models]
    n_sub = max(1, math.ceil(dt_s / plan.dt_s - 1e-9))
    taps = np.empty((n_models, n_starts, samples, len(plan.taps)))
    flows = np.empty((n_models, n_starts, samples, plan.ports.shape[0]))
    chambers = np.empty((n_models, n_starts, samples, len(plan.chambers)))
    order = [(m, s) for s in range(n_starts) for m in range(n_models)]
    tiles = [order[i : i + width] for i in range(0, count, width)]
    compliant = any(model.compliant for model in models)
    memory = any(model.memory for model in models)
    done = [0]

    def run(tile: list[tuple[int, int]]) -> None:
        padded = tile + [tile[-1]] * (width - len(tile))
        chosen = [models[m] for m, _ in padded]
        begin = [starts[s] for _, s in padded]
        out = _run_tile(
            chosen,
            begin,
            [opened[m] for m, _ in padded],
            field,
            taps_pa,
            samples,
            n_sub,
            dt_s / n_sub,
            compliant,
            memory,
            warm_up,
            1.0 / nudge_s,
            strict,
        )
        for j, (m, s) in enumerate(tile):
            taps[m, s] = out[0][:, :, j]
            flows[m, s] = out[1][:, :, j]
            chambers[m, s] = out[2][:, :, j]
        done[0] += 1
        if progress is not None:
            progress(done[0] / len(tiles))

    threads = workers or os.cpu_count() or 1
    if threads > 1 and len(tiles) > 1:
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(run, tiles))
    else:
        for tile in tiles:
            run(tile)
    readings = np.empty_like(taps)
    for m, model in enumerate(models):
        shaped = np.moveaxis(taps[m], 0, -1)  # (samples, taps, starts)
        readings[m] = np.moveaxis(sensors.read(model, shaped, dt_s), -1, 0)
    return Rollouts(readings, flows, chambers)


def _run_tile(
    models: list[Model],
    starts: list[int],
    opened: list[Floats],
    field: InitialField,
    taps_pa: Floats,
    samples: int,
    n_sub: int,
    dt: float,
    compliant: bool,
    memory: bool,
    warm_up: int,
    nudge_rate: float,
    strict: bool,
) -> tuple[Floats, Floats, Floats]:
    """Runs one tile of roll-outs; see `rollouts`."""
    tile = pack(models, compliant, memory)
    w, knots = tile.lanes, KNOTS_PER_SAMPLE
    opening = lanes(
        [o[s * knots : (s + samples - 1) * knots + 1] for o, s in zip(opened, starts, strict=True)]
    )
    at_start = np.stack([_filled(taps_pa, s, models[0].ambient[0]) for s in starts], axis=-1)
    fill_pipes(tile, field.weight @ at_start + field.constant[:, None], tile.ambient[1])
    fill_chambers(
        tile,
        field.chamber_weight @ at_start + field.chamber_constant[:, None],
        tile.chamber[:, L.C_WALL_T],
    )
    nudged = min(warm_up, samples - 1)
    nudge = np.full((nudged + 1, len(tile.plan.taps), w), np.nan)
    if nudged:
        for j, s in enumerate(starts):
            nudge[:, :, j] = taps_pa[s : s + nudged + 1]
    return advance(
        tile,
        samples,
        n_sub,
        dt,
        opening,
        nudge,
        nudge_rate,
        (field.weight, field.chamber_weight),
        strict,
    )


def _filled(taps_pa: Floats, sample: int, room: float) -> Floats:
    """Tap readings at one sample; a missing one takes the next there is, else the room's."""
    row = taps_pa[sample].copy()
    for t in np.flatnonzero(~np.isfinite(row)):
        later = taps_pa[sample:, t]
        later = later[np.isfinite(later)]
        row[t] = later[0] if later.size else room
    return row
