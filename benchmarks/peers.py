# SPDX-License-Identifier: Apache-2.0
"""Sod's shock tube on our solver, PyClaw and aeolus1d: the same cells, one core, one run.

A peer that is not installed is left out with a note; clawpack needs a Fortran compiler to install.
"""

from __future__ import annotations

import contextlib
import logging
import shutil
import tempfile
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from benchmarks import sod
from benchmarks.report import Table
from benchmarks.timing import best_s

CELLS = (200, 2000)
SYSTEM = {"PyClaw": "gfortran"}
"""System package that building a peer needs, where it is none of Python's."""


class Solver(Protocol):
    """Sod's shock tube on one solver.

    Attributes:
        steps: Time steps that the last run took.
    """

    steps: int

    def prepare(self) -> None:
        """Puts the diaphragm back."""

    def run(self) -> None:
        """Runs to the end."""

    def density(self) -> NDArray[np.float64]:
        """Density of the cells."""


class PyClaw:
    """Clawpack's wave propagation with compiled HLLE, van Leer's limiter; its usual Courant 0.9."""

    kernel_language = "Fortran"

    def __init__(self, cells: int, order: int) -> None:
        with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
            from clawpack import pyclaw, riemann  # opens a log file where it is imported

        logging.getLogger("pyclaw").setLevel(logging.ERROR)
        self._pyclaw, self._order, self._cells = pyclaw, order, cells
        compiled = self.kernel_language == "Fortran"
        self._riemann = riemann.euler_hlle_1D if compiled else riemann.euler_1D_py.euler_hll_1D
        self._limiter = pyclaw.limiters.tvd.vanleer
        self.steps = 0

    def prepare(self) -> None:
        pyclaw = self._pyclaw
        solver = pyclaw.ClawSolver1D(self._riemann)
        solver.kernel_language = self.kernel_language
        solver.order = self._order
        solver.limiters = self._limiter
        solver.cfl_desired, solver.cfl_max = sod.COURANT, 1.0
        solver.dt_initial = sod.COURANT / (sod.FASTEST * self._cells)
        solver.bc_lower[0] = solver.bc_upper[0] = pyclaw.BC.extrap
        domain = pyclaw.Domain([pyclaw.Dimension(0.0, 1.0, self._cells, name="x")])
        state = pyclaw.State(domain, 3)
        state.problem_data.update(gamma=1.4, gamma1=0.4, efix=False)
        left = state.grid.x.centers < sod.DIAPHRAGM
        state.q[0] = np.where(left, sod.LEFT[0], sod.RIGHT[0])
        state.q[1] = 0.0
        state.q[2] = np.where(left, sod.LEFT[2], sod.RIGHT[2]) / 0.4
        self._solution = pyclaw.Solution(state, domain)
        self._solver = solver
        solver.setup(self._solution)

    def run(self) -> None:
        status = self._solver.evolve_to_time(self._solution, sod.END)
        self.steps = int(status["numsteps"])

    def density(self) -> NDArray[np.float64]:
        return np.array(self._solution.q[0])


class Aeolus:
    """aeolus1d with HLLC and two Runge-Kutta stages, van Leer's limiter; its usual Courant 0.5."""

    def __init__(self, cells: int, order: int) -> None:
        from aeolus1d._types import Limiter
        from aeolus1d.components.pipe import Pipe
        from aeolus1d.solver import timeloop

        self._scheme = timeloop.SCHEME_FIRST_ORDER if order == 1 else timeloop.SCHEME_MUSCL
        self._advance = timeloop.advance_single_pipe
        self._limiter = Limiter.VAN_LEER
        self._pipe = Pipe(L=1.0, N=cells, gamma=1.4, Ng=timeloop.ng_for_scheme(self._scheme))
        self.prepare()
        times: list[float] = []
        self._run(on_step=times.append)
        self.steps = len(times)

    def prepare(self) -> None:
        self._pipe.set_riemann(sod.LEFT, sod.RIGHT, x0=sod.DIAPHRAGM)

    def _run(self, **more: Any) -> None:
        self._advance(
            self._pipe,
            t_end=sod.END,
            cfl=0.5,
            apply_ghosts=self._pipe.apply_transmissive_ends,
            scheme=self._scheme,
            limiter=self._limiter,
            **more,
        )

    def run(self) -> None:
        self._run()

    def density(self) -> NDArray[np.float64]:
        return np.array(self._pipe.primitives()[0])


SOLVERS = {"pneu": sod.Tube, "PyClaw": PyClaw, "aeolus1d": Aeolus}


def measure() -> list[Table]:
    """Measures every solver that is installed."""
    table = Table(
        "Beside other solvers: Sod's shock tube",
        "Until t = 0.2 on a tube of unit length without friction or heat, one tube at a time."
        " `cells x steps / s` counts full time steps (aeolus1d takes two stages in each). The"
        " last two columns are times as large as ours: of a cell and step, and of the whole run.",
        {
            "order": "order",
            "cells": "cells",
            "solver": "solver",
            "steps": "steps",
            "time_ms": "run, ms",
            "rate": "million cells x steps / s",
            "error": "L1 error of density",
            "step_ratio": "cell and step / ours",
            "run_ratio": "run / ours",
        },
    )
    missing: set[str] = set()
    for order in (1, 2):
        for cells in CELLS:
            exact = sod.exact_density(cells)
            ours: dict[str, Any] = {}
            for name, make in SOLVERS.items():
                try:
                    solver: Solver = make(cells, order)
                except ImportError as problem:
                    if name not in missing:
                        table.notes.append(f"{name} is not installed here ({problem}): left out.")
                        if name in SYSTEM and shutil.which(SYSTEM[name]) is None:
                            table.notes.append(
                                f"{name} is built with {SYSTEM[name]}, a system package that is"
                                f" missing: install it (apt install {SYSTEM[name]}), remove"
                                " .venv-bench, and run `make bench` again."
                            )
                    missing.add(name)
                    continue
                time_s = best_s(solver.run, solver.prepare)
                row = {
                    "order": order,
                    "cells": cells,
                    "solver": name,
                    "steps": solver.steps,
                    "time_ms": 1e3 * time_s,
                    "rate": 1e-6 * cells * solver.steps / time_s,
                    "error": float(np.abs(solver.density() - exact).mean()),
                }
                ours = ours or row
                row["step_ratio"] = ours["rate"] / row["rate"]
                row["run_ratio"] = row["time_ms"] / ours["time_ms"]
                table.rows.append(row)
    return [table]
