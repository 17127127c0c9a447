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
from pneu_sim.cuda.launch import missing
from pneu_sim.device import Device
from pneu_sim.rig.build import build
from pneu_sim.valve import KNOTS_PER_SAMPLE

RIGS = (1, 16, 256, 4096)
CELLS = 200
STEPS = {1: 2000, 16: 2000, 256: 640, 4096: 128}
"""Steps of a run, by the number of rigs; on a GPU each run is one launch."""


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
    ports = batch[0].plan.ports.shape[0]

    def one(tile: tiles.Tile) -> None:
        opening = np.full((1, KNOTS_PER_SAMPLE + 1, ports, tile.lanes), 0.5)
        stepping.advance(tile, steps, tile.plan.dt_s, opening)

    with ThreadPoolExecutor(threads or os.cpu_count()) as pool:
        taken = best_s(lambda: list(pool.map(one, batch)))
    return steps * cells * rigs / taken


def measure() -> list[Table]:
    """Measures all numbers of rigs; where there is no GPU its columns stay empty."""
    table = Table(
        "Many rigs at once: cells times steps per second",
        f"The rig of the kernel's table with {CELLS} cells, all physics. The processor has all its"
        " cores, tiles of rigs in threads; a GPU has a rig in each block of threads, and its time"
        " includes what is copied to it and back.",
        {
            "order": "scheme",
            "rigs": "rigs",
            "cpu": "processor",
            "cuda": "GPU, double",
            "cuda32": "GPU, single",
        },
    )
    why = missing()
    for order, name in ((1, "first order, HLLC"), (2, "MUSCL-Hancock, HLLC")):
        for rigs in RIGS:
            row = {"order": name, "rigs": rigs, "cpu": rate(rigs, order, Device.CPU, STEPS[rigs])}
            for device in (Device.CUDA, Device.CUDA32):
                row[device] = None if why else rate(rigs, order, device, STEPS[rigs])
            table.rows.append(row)
    if why:
        table.notes.append(f"No GPU was measured: {why}.")
    return [table]
