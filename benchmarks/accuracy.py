# SPDX-License-Identifier: Apache-2.0
"""Error against cost: first order and MUSCL at several cell lengths, on Sod's tube and on rig A."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmarks import sod
from benchmarks.report import Table
from benchmarks.rig import SAMPLE_S, command, rig_a
from benchmarks.timing import best_s
from pneu_sim.simulator import Simulator

SCHEMES = {1: "first order", 2: "MUSCL"}
FINE_M = 0.01


def shock_tube() -> Table:
    """Sod's tube against its exact solution."""
    table = Table(
        "Error against cost: Sod's shock tube",
        "Mean absolute error of the density at t = 0.2 against the exact solution, one tube.",
        {"scheme": "scheme", "cells": "cells", "error": "L1 error", "time_ms": "run, ms"},
    )
    for order, name in SCHEMES.items():
        for cells in (50, 100, 200, 400, 800, 1600):
            tube = sod.Tube(cells, order)
            time_s = best_s(tube.run, tube.prepare, budget_s=0.3)
            error = float(np.abs(tube.density() - sod.exact_density(cells)).mean())
            table.rows.append(
                {"scheme": name, "cells": cells, "error": error, "time_ms": 1e3 * time_s}
            )
    return table


def rig(duration_s: float = 0.5) -> Table:
    """Rig A against itself on a fine grid."""

    def pressures(order: int, dx_m: float) -> tuple[NDArray[np.float64], float]:
        simulator = Simulator(rig_a(order), dx_m=dx_m)
        taps: dict[str, NDArray[np.float64]] = {}

        def run() -> None:
            taps.update(simulator.run(duration_s, volts, sample_s=SAMPLE_S).pressures)

        time_s = best_s(run, simulator.reset, budget_s=0.3, least=2)
        return np.stack(list(taps.values())), time_s

    volts = command(duration_s)
    fine, fine_s = pressures(2, FINE_M)
    table = Table(
        "Error against cost: rig A",
        f"Pressures at the taps against MUSCL at dx = {100 * FINE_M:g} cm, under random steps of"
        " the voltage between no and full opening: root mean square over time, of all taps and of"
        " the worst tap.",
        {
            "scheme": "scheme",
            "dx_cm": "dx, cm",
            "rmse_pa": "error, Pa",
            "worst_pa": "worst tap, Pa",
            "cost": "seconds per simulated second",
        },
    )
    for order, name in SCHEMES.items():
        for dx_m in (0.1, 0.05, 0.02, FINE_M):
            if order == 2 and dx_m == FINE_M:
                row = {"rmse_pa": None, "worst_pa": None, "cost": fine_s / duration_s}
            else:
                taps, time_s = pressures(order, dx_m)
                square = ((taps - fine) ** 2).mean(axis=1)
                row = {
                    "rmse_pa": float(np.sqrt(square.mean())),
                    "worst_pa": float(np.sqrt(square.max())),
                    "cost": time_s / duration_s,
                }
            table.rows.append({"scheme": name, "dx_cm": 100.0 * dx_m, **row})
    return table


def measure() -> list[Table]:
    """Measures both."""
    return [shock_tube(), rig()]
