# SPDX-License-Identifier: Apache-2.0
"""Sod's shock tube on our solver: what `peers` and `accuracy` run."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from pneu_sim import riemann
from pneu_sim.gas import Gas
from pneu_sim.rig.schema import Rig
from pneu_sim.simulator import Simulator

Floats = NDArray[np.float64]
LEFT, RIGHT = (1.0, 0.0, 1.0), (0.125, 0.0, 0.1)  # density, velocity, pressure
DIAPHRAGM, END = 0.5, 0.2
FASTEST = 2.2  # velocity plus speed of sound behind the shock, rounded up
COURANT = 0.9
UNITS = Gas(gamma=1.4, r_specific=1.0, mu_ref=1e-12, prandtl=0.7, t_ref=1.0, name="unit gas")
SMOOTH = dict.fromkeys(
    ("laminar", "turbulent", "unsteady", "nusselt", "heat_turbulent", "heat_unsteady"), 0.0
)


def exact_density(cells: int) -> Floats:
    """Cell means of the exact solution, by five points per cell."""
    x = (np.arange(5 * cells) + 0.5) / (5 * cells) - DIAPHRAGM
    return np.asarray(riemann.solve(LEFT, RIGHT, x / END)[0]).reshape(cells, 5).mean(axis=1)


class Tube:
    """A tube of unit length; until `END` no wave reaches its closed ends.

    Attributes:
        steps: Time steps of a run.
    """

    def __init__(self, cells: int, order: int) -> None:
        rig = Rig.model_validate(
            {
                "name": "sod",
                "grid": {
                    "dx_m": 1.0 / cells,
                    "order": order,
                    "wave_speed_m_s": FASTEST,
                    "cfl": COURANT,
                    "memory": False,
                },
                "ambient": {"pressure_pa": 1.0, "temperature_k": 1.0},
                "pipes": {
                    "tube": {
                        "from": "closed",
                        "to": "closed",
                        "length_m": 1.0,
                        "area_m2": 1.0,
                        "wall": SMOOTH,
                    }
                },
                "taps": {"tap": {"pipe": "tube", "position_m": 0.5}},
            }
        )
        self._simulator = Simulator(rig, gas=UNITS)
        left = (np.arange(cells) + 0.5) / cells < DIAPHRAGM
        self._start = np.where(left, np.array(LEFT)[:, None], np.array(RIGHT)[:, None])
        self.steps = math.ceil(END * FASTEST * cells / COURANT - 1e-9)

    def prepare(self) -> None:
        """Puts the diaphragm back."""
        self._simulator.set_state("tube", *self._start)

    def run(self) -> None:
        """Runs to `END`."""
        self._simulator.run(END, sample_s=END)

    def density(self) -> Floats:
        """Density of the cells."""
        return self._simulator.state("tube")["density"]
