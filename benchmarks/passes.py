# SPDX-License-Identifier: Apache-2.0
"""Where the time of a step goes: every pass of the kernel by itself, many times over."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit

from benchmarks.kernel import line, nanoseconds, width
from benchmarks.report import Table
from benchmarks.timing import best_s
from pneu_sim.simulator import Simulator

kernel = importlib.import_module("pneu_sim.kernel.advance")  # the package has a name like it
SIZES = ((30, 1), (30, 64), (200, 1), (200, 64))


def _over_and_over(function: Callable[..., Any]) -> Any:
    """A pass again and again on the same gas, which is put back each time."""

    @njit(error_model="numpy")
    def run(times, args, state, kept):  # type: ignore[no-untyped-def]
        for _ in range(times):
            state[:] = kept
            function(*args)

    return run


@njit(error_model="numpy")
def _nothing() -> None:
    pass


def passes(rigs: Any, dt: float, opening: Any) -> list[tuple[str, Any, tuple[Any, ...], float]]:
    """Name, pass, what it is called with, and how many times in a step.

    Args:
        rigs: The batch, without anything that moves.
        dt: Step, s.
        opening: Openings of all ports.
    """
    gas, scheme, cells, steps, _, ends, ports, reservoirs, chambers, terms, _ = rigs
    second, seldom = scheme.order == 2, 1.0 / kernel.WALL_EVERY
    k = kernel
    found: list[tuple[str, Any, tuple[Any, ...], float]] = [
        ("velocity, pressure, speed of sound", k.find_primitive, (gas, cells), 1.0),
        ("flux through faces", k.cross, (gas, scheme, cells), 1.0),
        ("what faces carry", k.conserve, (scheme.order, dt, cells, cells.par[kernel.L.FACE]), 1.0),
        ("wall coefficients, every fourth step", k.find_coefficients, (gas, cells), seldom),
        ("decay of memory, every fourth step", k.find_decay, (gas, dt, cells), seldom),
        ("wall heat with memory", k.heat_with_memory, (gas, scheme.order, dt, cells), 1.0),
        ("wall friction with memory", k.drag_with_memory, (scheme.order, dt, cells), 1.0),
        ("chambers", k.find_chambers, (gas, chambers), 1.0),
        ("opening of ports", k.open_ports, (0, 0.5, opening, ports), 1.0),
        ("ghosts", k.fill_ghosts, (gas, second, cells, ends, reservoirs, chambers), 1.0),
        ("steps of area", k.cross_steps, (gas, scheme, dt, cells, steps), 1.0),
        ("ports of the step before", k.recall_ports, (cells, ends, ports), 1.0),
        (
            "ports",
            k.cross_ports,
            (gas, scheme.order, cells, ends, ports, reservoirs, chambers),
            1.0,
        ),
        (
            "chambers, middle of the step",
            k.find_middle,
            (gas, scheme.order, dt, cells, ends, ports, chambers, None),
            1.0,
        ),
        (
            "ends",
            k.cross_ends,
            (gas, scheme.order, dt, cells, ends, ports, reservoirs, chambers),
            1.0,
        ),
        ("heat of chambers", k.heat_chambers, (gas, dt, chambers), 1.0),
        ("terms", k.act_terms, (gas, dt, cells, chambers, terms), 1.0),
    ]
    if second:
        found += [
            ("slopes and half a step", k.reconstruct, (gas, True, dt, cells), 1.0),
            ("outermost slots", k.close_outermost, (cells,), 1.0),
            ("beside steps of area", k.flatten_steps, (cells, steps), 1.0),
            ("mirrored faces", k.mirror_faces, (cells, ends), 1.0),
        ]
    return found


def profile(cells: int, batch: int, order: int, budget_s: float = 0.1) -> dict[str, float]:
    """Nanoseconds per cell and step of each pass.

    Args:
        cells: Of the line, see `benchmarks.kernel.line`.
        batch: Rigs.
        order: Of the scheme.
        budget_s: Time for each pass.
    """
    together = width(cells, batch, order)
    simulator = Simulator([line(cells, order)] * together)
    simulator.run(0.005, {"voltage": 7.5})
    tile = simulator.plant.solver.tiles[0][0]
    opening = np.full((2, tile.plan.ports.shape[0], together), 0.5)
    times = max(20, 50_000 // (cells * together))
    state, kept = tile.state.ravel(), tile.state.ravel().copy()

    def taken(function: Any, args: tuple[Any, ...]) -> float:
        run = _over_and_over(function)
        return best_s(lambda: run(times, args, state, kept), budget_s=budget_s)

    put_back = taken(_nothing, ())
    return {
        name: often * (taken(function, args) - put_back) / (times * cells * together) * 1e9
        for name, function, args, often in passes(tile.free, tile.plan.dt_s, opening)
    }


def measure() -> list[Table]:
    """Measures all sizes, first and second order."""
    found = []
    for order, name in ((1, "first order"), (2, "second order")):
        columns = {"pass": "pass"}
        columns |= {f"{c}_{b}": f"{c} cells, {b} rig{'s' * (b > 1)}, ns" for c, b in SIZES}
        table = Table(
            f"Kernel: where a step's time goes, {name}",
            "Every pass by itself, many times over, nanoseconds per cell and step; the line of the"
            " table before. What is left of a whole step are the calls and what caches cost.",
            columns,
        )
        each = {f"{c}_{b}": profile(c, b, order) for c, b in SIZES}
        for key in next(iter(each.values())):
            table.rows.append({"pass": key} | {size: told[key] for size, told in each.items()})
        whole = {f"{c}_{b}": nanoseconds(c, b, order, 0.5) for c, b in SIZES}
        sums = {size: sum(told.values()) for size, told in each.items()}
        table.rows.append({"pass": "all of these"} | sums)
        table.rows.append({"pass": "a whole step"} | whole)
        found.append(table)
    return found
