# SPDX-License-Identifier: Apache-2.0
"""Simulated seconds per second for robots: gas, cylinders and what they move."""

from __future__ import annotations

import importlib.util

import numpy as np
from numpy.typing import NDArray

from benchmarks.report import ROOT, Table
from benchmarks.timing import best_s
from pneu_sim.plant import Plant
from pneu_sim.rig.load import load_rig
from pneu_sim.rig.schema import Rig

INTERVAL_S = 5e-3
INTERVALS = 40
BATCH = 64


def kokoro(dx_m: float, order: int, gas: str = "chamber") -> Rig:
    """The joint of `rigs/kokoro.yaml` on another grid."""
    rig = load_rig(ROOT / "rigs" / "kokoro.yaml").model_copy(deep=True)
    rig.grid.dx_m, rig.grid.order = dx_m, order
    forearm = rig.cylinders["forearm"]
    if gas == "cells":
        rig.cylinders["forearm"] = forearm.model_copy(update={"gas": gas, "dx_m": 0.006})
    return rig


def waving(plant: Plant) -> NDArray[np.float64]:
    """Commands that wave about the voltage that shuts the valves, each its own way."""
    time = INTERVAL_S * np.arange(INTERVALS)
    valves = len(plant.plan.commands)
    phase = 2.0 * np.pi * np.arange(valves) / valves
    return 5.0 + 2.0 * np.sin(2.0 * np.pi * time + phase[:, None])[None]


def factor(rigs: list[Rig]) -> tuple[float, int]:
    """Simulated seconds of all rigs per second, and the cells of one."""
    plant = Plant(rigs)
    volts = waving(plant)
    time_s = best_s(lambda: plant.advance(volts, INTERVAL_S), budget_s=2.0)
    cells = sum(n for _, n in plant.plan.pipes.values())
    return len(rigs) * INTERVALS * INTERVAL_S / time_s, cells


def measure() -> list[Table]:
    """Measures the joint, alone and in a batch, and the arm in MuJoCo."""
    table = Table(
        "Robots: simulated seconds per second",
        "`rigs/kokoro.yaml` (two 2.5 m lines, cylinder, slider-crank, link) as environments step"
        f" it, {1e3 * INTERVAL_S:g} ms at a time, on one core; and `rigs/arm4.yaml`: its four"
        " cylinders on eight lines move an arm in MuJoCo with physics steps of 1 ms. Of a batch all"
        " rigs together.",
        {
            "robot": "robot",
            "order": "order",
            "cells": "cells",
            "rigs": "rigs",
            "factor": "times real time",
        },
    )
    for order, dx_m, gas, count in (
        (2, 0.05, "chamber", 1),
        (2, 0.025, "chamber", 1),
        (2, 0.05, "cells", 1),
        (1, 2.5 / 30, "chamber", BATCH),
        (2, 2.5 / 30, "chamber", BATCH),
    ):
        reached, cells = factor([kokoro(dx_m, order, gas)] * count)
        name = "Kokoro" if gas == "chamber" else "Kokoro, its cylinder's gas in cells"
        table.rows.append(
            {"robot": name, "order": order, "cells": cells, "rigs": count, "factor": reached}
        )
    if importlib.util.find_spec("mujoco") is None:
        table.notes.append("MuJoCo is not installed here: the arm was left out.")
        return [table]
    reached, cells = factor([load_rig(ROOT / "rigs" / "arm4.yaml")])
    table.rows.append(
        {"robot": "arm of four cylinders", "order": 2, "cells": cells, "rigs": 1, "factor": reached}
    )
    return [table]
