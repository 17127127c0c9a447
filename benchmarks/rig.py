# SPDX-License-Identifier: Apache-2.0
"""Simulated seconds per second for rig A at several cell lengths."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmarks.report import ROOT, Table
from benchmarks.timing import best_s
from pneu_sim.rig.load import load_rig
from pneu_sim.rig.schema import Rig
from pneu_sim.simulator import Simulator

SAMPLE_S = 1e-3
DURATION_S = 0.1


def rig_a(order: int | None = None) -> Rig:
    """Rig A, uncalibrated."""
    rig = load_rig(ROOT / "rigs" / "rig_a.yaml")
    if order is None:
        return rig
    return rig.model_copy(update={"grid": rig.grid.model_copy(update={"order": order})})


def command(duration_s: float, seed: int = 1) -> dict[str, NDArray[np.float64]]:
    """Voltages that step at random every 50 ms, over the valve's whole range."""
    steps = round(duration_s / SAMPLE_S)
    levels = np.random.default_rng(seed).uniform(1.0, 9.0, -(-steps // 50))
    return {"voltage": np.repeat(levels, 50)[:steps]}


def measure() -> list[Table]:
    """Measures one rig and a batch."""
    table = Table(
        "Rig A: simulated seconds per second",
        "`rigs/rig_a.yaml` (supply line, proportional valve, tube, exhaust: 3.7 m of line) under"
        " random steps of the voltage, as `Simulator.run` advances it, on one core.",
        {
            "order": "order",
            "dx_cm": "dx, cm",
            "cells": "cells",
            "single": "one rig",
            "batch": "8 rigs side by side, each",
            "rigs": "8 rigs, together",
        },
    )
    for order in (1, 2):
        for dx_m in (0.05, 0.02, 0.01):
            row: dict[str, float | int] = {"order": order, "dx_cm": 100.0 * dx_m}
            for key, count in (("single", 1), ("batch", 8)):
                rig = rig_a(order)
                simulator = Simulator(rig if count == 1 else [rig] * count, dx_m=dx_m)
                row["cells"] = sum(n for _, n in simulator.plant.plan.pipes.values())
                volts = command(DURATION_S)
                time_s = best_s(
                    lambda s=simulator, v=volts: s.run(DURATION_S, v, sample_s=SAMPLE_S),
                    budget_s=0.7,
                )
                row[key] = DURATION_S / time_s
            row["rigs"] = 8 * row["batch"]
            table.rows.append(row)
    return [table]
