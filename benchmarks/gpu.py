# SPDX-License-Identifier: Apache-2.0
"""Many rigs at once: all cores of the processor, and a GPU where there is one."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from benchmarks.kernel import line
from benchmarks.report import Table
from benchmarks.timing import best_s
from pneu_sim import simulate, stepping
from pneu_sim import tile as tiles
from pneu_sim.cuda import launch
from pneu_sim.device import Device
from pneu_sim.rig.build import build
from pneu_sim.valve import KNOTS_PER_SAMPLE

RIGS = (1, 16, 256, 4096)
CELLS = 200
STEPS = {1: 2000, 16: 2000, 256: 640, 4096: 128}
"""Steps of a run on the processor, by the number of rigs."""
MANY = 1000
"""Rigs above which a run is so long that one is enough, after one that does not count."""
LONG = 1000
"""Steps of a run on a GPU, one launch."""
RUNS = 3
"""So many of those are timed, and the shortest counts."""


def rate(
    rigs: int,
    order: int,
    device: Device,
    steps: int,
    cells: int = CELLS,
    threads: int | None = None,
) -> float:
    """Cells times steps per second, all that a call has to copy included.

    Args:
        rigs: How many, side by side.
        order: Of the scheme.
        device: On what.
        steps: Of a run.
        cells: Of each rig.
        threads: Of the processor; None is all.
    """
    batch = _batch(rigs, order, device, cells)

    def one(tile: tiles.Tile) -> None:
        stepping.advance(tile, steps, tile.plan.dt_s, _half_open(tile))

    with ThreadPoolExecutor(threads or os.cpu_count()) as pool:
        least, budget_s = (1, 0.0) if rigs > MANY else (3, 0.5)
        taken = best_s(lambda: list(pool.map(one, batch)), budget_s=budget_s, least=least)
    return steps * cells * rigs / taken


def rate_of_steps(rigs: int, order: int, device: Device, steps: int, cells: int = CELLS) -> float:
    """Cells times steps per second on a GPU as it times them, without what is copied.

    Args:
        rigs: How many, side by side.
        order: Of the scheme.
        device: Which precision.
        steps: Of a run.
        cells: Of each rig.
    """
    (tile,) = _batch(rigs, order, device, cells)
    taken = []
    for _ in range(RUNS):
        _, given = stepping.arguments(tile, steps, tile.plan.dt_s, _half_open(tile))
        taken.append(launch.advance(tile.acts, device == Device.CUDA32, *given))
    return steps * cells * rigs / min(taken)


def _batch(rigs: int, order: int, device: Device, cells: int) -> list[tiles.Tile]:
    """Rigs under pressure, in tiles as wide as the device takes them."""
    model = build(line(cells, order))
    width = simulate.width_of(model.plan.slots) if device == Device.CPU else rigs
    batch = []
    for begin in range(0, rigs, width):
        tile = tiles.pack([model] * min(width, rigs - begin), device=device)
        shape = (tile.plan.slots, tile.lanes)
        tiles.fill_pipes(tile, np.full(shape, 3e5), np.full(shape, 293.0))
        chambers = np.full((len(tile.plan.chambers), tile.lanes), 2e5)
        tiles.fill_chambers(tile, chambers, np.full_like(chambers, 293.0))
        batch.append(tile)
    return batch


def _half_open(tile: tiles.Tile) -> np.ndarray:
    """Openings of one interval."""
    return np.full((1, KNOTS_PER_SAMPLE + 1, tile.plan.ports.shape[0], tile.lanes), 0.5)


def measure() -> list[Table]:
    """Measures all numbers of rigs; where there is no GPU its columns stay empty."""
    table = Table(
        "Many rigs at once: cells times steps per second",
        f"The rig of the kernel's table with {CELLS} cells, all physics. The processor has all its"
        " cores, tiles of rigs in threads; a GPU has a rig in each block of threads. `All` is a"
        f" call of {LONG} steps with what is copied to the GPU and back, `steps` the steps alone,"
        " as the GPU times them.",
        {
            "order": "scheme",
            "rigs": "rigs",
            "cpu": "processor",
            "cuda": "GPU, double, all",
            "cuda_steps": "steps",
            "cuda32": "GPU, single, all",
            "cuda32_steps": "steps",
        },
    )
    why = launch.missing()
    for order, name in ((1, "first order, HLLC"), (2, "MUSCL-Hancock, HLLC")):
        for rigs in RIGS:
            table.rows.append({"order": name, **row_of(rigs, order, not why)})
    if why:
        table.notes.append(f"No GPU was measured: {why}.")
    else:
        table.notes.append(f"The GPU: {device_name()}.")
    return [table]


def row_of(rigs: int, order: int, there: bool) -> dict[str, float | None]:
    """What a number of rigs gives, on the processor and on a GPU.

    Args:
        rigs: How many.
        order: Of the scheme.
        there: Whether there is a GPU.
    """
    row: dict[str, float | None] = {"rigs": rigs}
    row["cpu"] = rate(rigs, order, Device.CPU, STEPS[rigs])
    for device in (Device.CUDA, Device.CUDA32):
        row[device] = row[f"{device}_steps"] = None
        if there:
            row[device] = rate(rigs, order, device, LONG)
            row[f"{device}_steps"] = rate_of_steps(rigs, order, device, LONG)
    return row


def device_name() -> str:
    """What the GPU calls itself."""
    from numba import cuda

    name = cuda.get_current_device().name
    return name.decode() if isinstance(name, bytes) else str(name)
