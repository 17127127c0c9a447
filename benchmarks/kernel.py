# SPDX-License-Identifier: Apache-2.0
"""Nanoseconds per cell and step of the gas kernel with all its physics on, on one core."""

from __future__ import annotations

import numpy as np

from benchmarks.report import Table
from benchmarks.timing import best_s
from pneu_sim import simulate, stepping
from pneu_sim.rig.build import build
from pneu_sim.rig.schema import Rig
from pneu_sim.simulator import Simulator
from pneu_sim.valve import KNOTS_PER_SAMPLE

CELLS = (30, 200, 2000)
BATCHES = (1, 16, 64)
DX_M = 0.01


def line(cells: int, order: int) -> Rig:
    """Supply, line, ISO 6358 valve, line, chamber; walls with friction, heat and their memory."""
    first = cells // 2
    return Rig.model_validate(
        {
            "name": "line",
            "grid": {"dx_m": DX_M, "order": order, "wave_speed_m_s": 450.0, "memory": True},
            "ambient": {"pressure_pa": 101325.0, "temperature_k": 293.15},
            "reservoirs": {"supply": {"pressure_pa": 600e3}},
            "chambers": {"chamber": {"volume_m3": 20e-6}},
            "pipes": {
                "before": {
                    "from": "supply",
                    "to": "valve_in",
                    "length_m": first * DX_M,
                    "area_m2": 20e-6,
                },
                "after": {
                    "from": "valve_out",
                    "to": "chamber",
                    "length_m": (cells - first) * DX_M,
                    "area_m2": 12e-6,
                },
            },
            "valves": {
                "valve": {
                    "command": "voltage",
                    "spool": {"bandwidth_hz": 60.0, "damping": 0.8, "null_v": 5.0},
                    "ports": {
                        "port": {
                            "from": "valve_in",
                            "to": "valve_out",
                            "conductance_m3_s_pa": 1e-8,
                            "critical_ratio": 0.3,
                            "opening": {"voltage_v": [5.0, 10.0], "fraction": [0.0, 1.0]},
                        }
                    },
                }
            },
            "commands": {
                "voltage": {
                    "channel": {
                        "topic": "/voltage",
                        "field": "data",
                        "type": "std_msgs/msg/Float64",
                    }
                }
            },
            "taps": {"tap": {"pipe": "after", "position_m": 0.02}},
        }
    )


def width(cells: int, batch: int, order: int) -> int:
    """How many of a batch of lines `simulate.predict` advances together."""
    return min(batch, simulate.width_of(build(line(cells, order)).plan.slots))


def nanoseconds(cells: int, batch: int, order: int, budget_s: float = 1.0) -> float:
    """Time per cell, step and rig, the ends and the valve included; ghosts do not count as cells.

    A batch runs as `simulate.predict` runs it: tile after tile, each along the whole recording.
    """
    together = width(cells, batch, order)
    rig = line(cells, order)
    tiles = []
    for _ in range(batch // together):
        simulator = Simulator([rig] * together)
        simulator.run(0.005, {"voltage": 7.5})  # gas moves, and the walls remember
        tiles.append(simulator.plant.solver.tiles[0][0])
    plan = tiles[0].plan
    steps = max(20, 200_000 // (cells * together))
    opening = np.full((1, KNOTS_PER_SAMPLE + 1, plan.ports.shape[0], together), 0.5)

    def run() -> None:
        for one in tiles:
            stepping.advance(one, steps, plan.dt_s, opening)

    return best_s(run, budget_s=budget_s) / (steps * cells * batch) * 1e9


def measure() -> list[Table]:
    """Measures all sizes, batches and orders."""
    columns = {"order": "scheme", "cells": "cells"}
    columns |= {f"batch_{b}": "one rig, ns" if b == 1 else f"batch of {b}, ns" for b in BATCHES}
    columns["gain"] = f"one rig / batch of {BATCHES[-1]}"
    table = Table(
        "Kernel: nanoseconds per cell and step",
        "Two lines, a supply, a valve with ISO 6358 flow and a chamber; wall friction and wall heat"
        " over the whole Reynolds range, both with memory. A batch is advanced in tiles of up to"
        f" {simulate.TILE} rigs, as many as the cache holds.",
        columns,
    )
    for order, name in ((1, "first order, HLLC"), (2, "MUSCL-Hancock, HLLC")):
        for cells in CELLS:
            row = {"order": name, "cells": cells}
            row |= {f"batch_{b}": nanoseconds(cells, b, order) for b in BATCHES}
            row["gain"] = row["batch_1"] / row[f"batch_{BATCHES[-1]}"]
            table.rows.append(row)
    return [table]
