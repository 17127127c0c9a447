# SPDX-License-Identifier: Apache-2.0
"""Stepping a batch of rigs: as it comes, or with more steps where it goes wrong."""

import functools
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sim import kernel
from pneu_sim.device import Device
from pneu_sim.solver import Series
from pneu_sim.tile import CHANGING, Tile, Watch, arrays, moving, settle

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

MORE_STEPS = (2, 4, 8)
"""A run that goes wrong is tried again with this many times as many steps, one after the other."""


def advance(
    tile: Tile,
    n_sub: int,
    dt_s: float,
    opening: Floats,
    watch: Watch | None = None,
    closing: bool = True,
    fastest: Floats | None = None,
) -> Series:
    """Advances a batch in place, whatever comes of it.

    Args:
        tile: The batch.
        n_sub: Steps between samples.
        dt_s: Step, s.
        opening: (intervals, knots + 1, n_ports, lanes) openings between the samples, linear from
            knot to knot; both ends of an interval are its own.
        watch: Taps that are read at times of their own, brought up to the new state.
        closing: Whether they are read at the very end too, no further call taking up from here.
        fastest: (intervals + 1, lanes) written: cells that the fastest wave crosses, 1/s.

    Returns:
        What was recorded, intervals + 1 samples.
    """
    out, given = arguments(tile, n_sub, dt_s, opening, watch, closing, fastest)
    _run(tile)(*given)
    if watch is not None:
        watch.step += len(opening) * n_sub
    tile.clock[1] += len(opening) * n_sub
    return out


def arguments(
    tile: Tile,
    n_sub: int,
    dt_s: float,
    opening: Floats,
    watch: Watch | None = None,
    closing: bool = True,
    fastest: Floats | None = None,
) -> tuple[Series, tuple[Any, ...]]:
    """What `pneu_sim.kernel.advance` is given of a batch, and where it writes down.

    Args:
        tile: The batch.
        n_sub: Steps between samples.
        dt_s: Step, s.
        opening: See `advance`.
        watch: Likewise.
        closing: Likewise.
        fastest: Likewise.

    Returns:
        What will be recorded, intervals + 1 samples; and rigs, what moves, clock, openings, record.
    """
    tile.count_by(dt_s)
    intervals, knots, ports, w = opening.shape
    out = Series.empty(tile.plan, intervals + 1, tile.lanes)
    record = kernel.Record(
        out.taps,
        out.flows,
        out.chambers,
        out.temperatures,
        out.cylinders,
        out.joints,
        np.zeros((0, w)) if fastest is None else fastest,
    )
    rigs, moves, step = tile.free, tile.moving, 0
    if watch is not None:
        rigs, step = arrays(tile, watch), watch.step
        moves = moving(tile, watch) if tile.plan.cylinders else None
    clock = kernel.Clock(intervals + 1, n_sub, dt_s, knots - 1, tile.clock, step, closing)
    flat = np.ascontiguousarray(opening).reshape(intervals * knots, ports, w)
    return out, (rigs, moves, clock, flat, record)


def _run(tile: Tile) -> Any:
    """What advances a batch, on its device."""
    if tile.device == Device.CPU:
        return kernel.advancing(tile.acts)
    from pneu_sim.cuda import launch  # nothing else needs a driver

    return functools.partial(launch.advance, tile.acts, tile.device == Device.CUDA32)


def advance_safely(tile: Tile, n_sub: int, dt_s: float, opening: Floats) -> Series:
    """Advances a batch in place; lanes that are too fast for the step take more, for a while.

    The step is chosen before anything flows, for waves of ``grid.wave_speed_m_s`` at most. A lane
    that has faster ones at the end of an interval, or is not finite, takes more steps for that one;
    one that still is not finite stays so.

    Args:
        tile: The batch.
        n_sub: Steps in an interval.
        dt_s: Step, s.
        opening: (intervals, knots + 1, n_ports, lanes) openings, see `advance`.

    Returns:
        As `advance`.
    """
    intervals = len(opening)
    out = None
    tile.count_by(dt_s)
    first, ahead = 0, intervals
    while True:
        piece = opening[first : first + ahead]
        before = {name: getattr(tile, name).copy() for name in CHANGING}
        fastest = np.empty((len(piece) + 1, tile.lanes))
        part = advance(tile, n_sub, dt_s, piece, fastest=fastest)
        wrong = _wrong(part, dt_s * fastest)
        if wrong.any() and len(piece) > 1:
            # as far as all went well once more, then what did not by itself
            for name, array in before.items():
                getattr(tile, name)[:] = array
            ahead = max(int(np.argmax(wrong.any(axis=1))), 1)
            continue
        if out is None:
            if len(piece) == intervals and not wrong.any():
                return part
            out = Series.empty(tile.plan, intervals + 1, tile.lanes)
        out.put(first, part)
        if wrong.any():
            which = np.flatnonzero(wrong[0])
            out.put(first, _with_more_steps(tile, before, which, n_sub, dt_s, piece), which)
        first += len(piece)
        ahead *= 2
        if first >= intervals:
            return out


def _wrong(part: Series, courant: Floats) -> NDArray[np.bool_]:
    """(intervals, lanes) which became too fast for their step, or no numbers, being so before."""
    fine = np.isfinite(part.taps).all(axis=1) & np.isfinite(courant)
    fine &= np.isfinite(part.joints).all(axis=(1, 2))
    return np.asarray(fine[:-1] & ~(fine & (courant <= 1.0))[1:])


def _with_more_steps(
    tile: Tile,
    before: Mapping[str, Floats],
    which: Ints,
    n_sub: int,
    dt_s: float,
    opening: Floats,
) -> Series:
    """Advances some lanes of a batch once more, from what it was before, with more steps."""
    out = Series.empty(tile.plan, len(opening) + 1, which.size)
    left = np.arange(which.size)
    for more in MORE_STEPS:
        mine = which[left]
        part = some_lanes(tile, mine)
        for name, array in before.items():
            getattr(part, name)[:] = array[..., mine]
        fastest = np.empty((len(opening) + 1, mine.size))
        again = advance(part, n_sub * more, dt_s / more, opening[..., mine], fastest=fastest)
        out.put(0, again, left)
        part.count_by(dt_s)
        for name in CHANGING:
            getattr(tile, name)[..., mine] = getattr(part, name)
        left = left[_wrong(again, dt_s / more * fastest).any(axis=0)]
        if left.size == 0:
            break
    settle(tile)
    return out


def some_lanes(tile: Tile, which: Ints) -> Tile:
    """A copy of some lanes of a batch.

    Args:
        tile: The batch.
        which: The lanes.
    """
    own = [(index, np.ascontiguousarray(par[..., which])) for index, par in tile.own]
    common = {"compliant", "memory", "ripple_index", "leak_index", "step_index"}
    common |= {"side_index", "small", "dt_s", "acts", "device"}
    arrays: dict[str, Any] = {
        f.name: np.ascontiguousarray(getattr(tile, f.name)[..., which])
        for f in fields(tile)
        if f.name not in common | {"models", "own"}
    }
    return replace(tile, models=[tile.models[int(j)] for j in which], own=own, **arrays)


def finite_lanes(series: Floats) -> NDArray[np.bool_]:
    """Which lanes of a series are finite throughout.

    Args:
        series: (..., lanes).
    """
    return np.asarray(np.isfinite(series).all(axis=tuple(range(series.ndim - 1))))


def unstable(dt_s: float, tried: Sequence[int] = MORE_STEPS, where: str = "") -> InputError:
    """The error of a run that is not finite, or whose gas has no positive density and pressure.

    Args:
        dt_s: Its step, s.
        tried: With how many times as many steps it was tried besides.
        where: The part that shows it, such as ``in pipe 'tube'``.
    """
    text = f"the simulation became unstable {where}{' ' if where else ''}at a time step of"
    text += f" {dt_s:.3g} s"
    if tried:
        text += f", and with up to {tried[-1]} times as many steps"
    return InputError(
        f"{text}; raise grid.wave_speed_m_s or lower grid.cfl, or look for a number in a wrong unit"
    )
