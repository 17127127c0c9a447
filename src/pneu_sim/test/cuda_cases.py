# SPDX-License-Identifier: Apache-2.0
"""What the GPU's passes do beside the processor's, on rigs that have all passes between them.

Run as a program, for Numba's simulator of CUDA has to be asked for before Numba is imported. Prints
a JSON object: for each case, the largest difference of anything that steps change, relative to the
largest of its kind.
"""

import json
import sys
from collections.abc import Iterable, Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_sim import layout as L
from pneu_sim import tile as tiles
from pneu_sim.cuda import launch
from pneu_sim.device import Device
from pneu_sim.effects import registry
from pneu_sim.rig import Rig, load_rig
from pneu_sim.rig.build import build
from pneu_sim.rig.schema import AttachedEffect
from pneu_sim.stepping import advance

Floats = NDArray[np.float64]
Worst = tuple[float, str]

HOUSE = Path(__file__).parents[3]
KNOTS = 4
LANES = 2
EFFECTS = {
    "walls": (
        "rig_a",
        2.0,
        (
            "wall_compliance",
            "supply_ripple",
            "leak",
            "porous_leak",
            "relief_valve",
            "local_loss",
            "chamber_convection",
        ),
    ),
    "joint": ("rig_j", 3.0, ("junction_loss", "chamber_heat")),
    "regulator": ("lab", 1.0, ("regulator_droop",)),
    "finger": ("kokoro", 0.5, ("piston_leak", "piston_friction", "backlash", "end_cushion")),
    "cart": ("cart_pole", 1.0, ("seal_friction", "rod_leak")),
    "legs": ("dog", 1.0, ()),
    "small": ("closed_chamber", 20.0, ()),
    "cells": ("closed_chamber", 0.5, ("blockage",)),
}
"""Rig, length of its cells, and effects that are attached where they can be."""


def rig_of(case: str, order: int, flux: str) -> Rig:
    """The rig of a case, coarse, with its effects.

    Args:
        case: Its name.
        order: Of the scheme.
        flux: Its flux.
    """
    name, dx_m, effects = EFFECTS[case]
    rig = load_rig(HOUSE / "rigs" / f"{name}.yaml")
    # at the step of finer cells: no chamber is small for it but in "small"
    wanted = {"order": order, "flux": flux, "dx_m": dx_m, "memory": True}
    if case != "small":
        wanted["dt_s"] = 1e-4
    grid = rig.grid.model_copy(update=wanted)
    attached = list(rig.effects)
    for effect in effects:
        kind = registry()[effect]
        for place, shape in list(kind.sites(rig))[:1]:
            values = {kind.strength.name: kind.strength.typical, **shape}
            attached.append(AttachedEffect(effect=effect, place=place, parameters=values))
    return rig.model_copy(update={"grid": grid, "effects": attached})


def filled(rig: Rig, device: Device) -> tuple[tiles.Tile, tiles.Watch]:
    """Rigs side by side, in motion, read and corrected by what was read.

    Args:
        rig: The rig; the second differs in what its supply and room have.
        device: On what it will run.
    """
    rng = np.random.default_rng(5)
    tile = tiles.pack([build(rig) for _ in range(LANES)], device=device)
    slots, taps = tile.plan.slots, len(tile.plan.taps)
    chambers, sensors = len(tile.plan.chambers), taps + len(tile.plan.encoders)
    pressure = np.full((slots, LANES), 1.2e5)
    pressure[: slots // 2] = np.array([3e5, 2e5])
    tiles.fill_pipes(tile, pressure, np.full((slots, LANES), 293.0), rng.uniform(-5.0, 5.0, LANES))
    tiles.fill_chambers(
        tile, np.tile([2.5e5, 1.5e5], (chambers, 1)), np.full((chambers, LANES), 290.0)
    )
    tile.set_time(0.3)
    time = np.sort(rng.uniform(0.0, 60.0, (sensors, 12, LANES)), axis=1)
    sensor = np.zeros((sensors, L.SENSOR_ROWS, LANES))
    sensor[:, L.SENSE_KEEP], sensor[:, L.SENSE_NEW], sensor[:, L.SENSE_GAIN] = 0.5, 0.5, 1.0
    pressures = rng.uniform(1e5, 3e5, (taps, 12, LANES))
    positions = rng.uniform(0.0, 0.1, (sensors - taps, 12, LANES))
    watch = tiles.Watch(
        time,
        np.concatenate([pressures, positions]),
        np.full(time.shape, 0.05),
        sensor,
        rng.uniform(0.0, 0.5, (slots, taps)),
        rng.uniform(0.0, 0.5, (chambers, taps)),
        np.full(time.shape, 0.1),
    )
    return tile, watch


def changed(tile: tiles.Tile, watch: tiles.Watch, series: Any) -> Iterator[tuple[str, Floats]]:
    """All that steps change, kind by kind.

    Args:
        tile: The batch.
        watch: Its sensors.
        series: What was recorded.
    """
    for name in tiles.CHANGING:
        rows = getattr(tile, name)
        if name in ("state", "wall"):
            yield from ((f"{name} {k}", row) for k, row in enumerate(rows))
        else:
            yield name, rows
    yield "readings", watch.readings
    yield from ((f.name, getattr(series, f.name)) for f in fields(series))


def ran(rig: Rig, steps: int, device: Device, more: float = 0.0) -> list[tuple[str, Floats]]:
    """All that steps change, after some of them.

    Args:
        rig: The rig.
        steps: How many, in two intervals.
        device: On what.
        more: How much more gas there is at the start, of one.
    """
    tile, watch = filled(rig, device)
    tile.state *= 1.0 + more
    ports = tile.plan.ports.shape[0]
    opening = np.random.default_rng(6).uniform(0.0, 1.0, (2, KNOTS + 1, ports, LANES))
    series = advance(tile, steps // 2, tile.plan.dt_s, opening, watch)
    return list(changed(tile, watch, series))


def furthest(found: Iterable[tuple[str, Floats]], other: Iterable[tuple[str, Floats]]) -> Worst:
    """The largest difference of two runs relative to the largest of its kind, and of what it is.

    Args:
        found: What steps changed.
        other: The same of the other run.
    """
    worst, of = 0.0, ""
    for (name, a), (_, b) in zip(found, other, strict=True):
        if not np.array_equal(np.isnan(a), np.isnan(b)):
            return float("inf"), name
        scale = float(np.nanmax(np.abs(a), initial=0.0))
        most = float(np.nanmax(np.abs(a - b), initial=0.0)) / (scale or 1.0)
        if most > worst:
            worst, of = most, name
    return worst, of


def difference(case: str, order: int, flux: str, steps: int, device: Device) -> Worst:
    """The largest difference of a case, and of what it is.

    Args:
        case: The case.
        order: Of the scheme.
        flux: Its flux.
        steps: How many, in two intervals.
        device: What is compared with the processor.
    """
    rig = rig_of(case, order, flux)
    return furthest(ran(rig, steps, Device.CPU), ran(rig, steps, device))


def sensitivity(case: str, order: int, flux: str, steps: int) -> float:
    """What the processor's own answer changes by where the start changes by a part in 1e15.

    Args:
        case: The case.
        order: Of the scheme.
        flux: Its flux.
        steps: How many, in two intervals.
    """
    rig = rig_of(case, order, flux)
    return furthest(ran(rig, steps, Device.CPU), ran(rig, steps, Device.CPU, 1e-15))[0]


def main() -> None:
    """Runs cases: ``device steps case/order/flux[/another device] ...``."""
    device, steps, *cases = sys.argv[1:]
    found = {}
    for words in cases:
        case, order, flux, *other = words.split("/")
        on = Device(other[0] if other else device)
        found[words] = difference(case, int(order), flux, int(steps), on)
    if launch._kernel.cache_info().currsize == 0:
        sys.exit("nothing was computed on the device")
    print(json.dumps(found))


if __name__ == "__main__":
    main()
