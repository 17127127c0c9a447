# SPDX-License-Identifier: Apache-2.0
"""Leaks that lines may come to have: room for one in the middle of each, and how large it is.

Where along a short line air is lost hardly shows as long as it is lost slowly.
"""

import numpy as np
from numpy.typing import NDArray

from pneu_sim import layout as L
from pneu_sim.full_solver import FullSolver
from pneu_sim.rig.cells import middles, spread
from pneu_sim.rig.plan import Plan
from pneu_sim.rig.schema import Leak, Rig

Floats = NDArray[np.float64]

NO_LEAK_M2 = 1e-18
"""So little is lost nowhere; of less than nothing the model has no leak."""


def with_room_for_leaks(rig: Rig) -> Rig:
    """A rig each of whose lines may come to leak; it does as before.

    Args:
        rig: The rig.
    """
    out = rig.model_copy(deep=True)
    for pipe in out.pipes.values():
        pipe.leaks.append(Leak(position_m=0.5 * pipe.length_m, area_m2=NO_LEAK_M2))
    return out


class Leaks:
    """The leaks that there is room for, line by line."""

    def __init__(self, solver: FullSolver, rig: Rig) -> None:
        """Finds them.

        Args:
            solver: The rigs, `with_room_for_leaks`.
            rig: One of them.
        """
        self._tiles = solver.tiles
        tile = solver.tiles[0][0]
        self._known = tile.leak[:, L.LEAK_SIZE, :1].copy()  # all members are of one rig
        orifices = np.flatnonzero(tile.leak_index[:, L.K_KIND] == L.ORIFICE)
        row_of = {int(tile.leak_index[q, L.K_SLOT]): int(q) for q in orifices}
        self._rows = [_rows(solver.models[0].plan, rig, name, row_of) for name in rig.pipes]

    def set(self, area_m2: Floats) -> None:
        """Has lines leak, besides what their file says.

        Args:
            area_m2: (pipes, members) effective areas, m^2; below zero there is none.
        """
        size = np.repeat(self._known, area_m2.shape[1], axis=1)
        for rows, area in zip(self._rows, np.maximum(area_m2, 0.0), strict=True):
            for row, share in rows:
                size[row] += share * area
        for tile, of in self._tiles:
            tile.leak[:, L.LEAK_SIZE] = size[:, of]


def _rows(plan: Plan, rig: Rig, name: str, row_of: dict[int, int]) -> list[tuple[int, float]]:
    """Rows of the leak in the middle of a pipe, and its share in each."""
    first, n = plan.pipes[name]
    length_m = rig.pipes[name].length_m
    found = spread(0.5 * length_m, middles(length_m, n))
    return [(row_of[first + i], share) for i, share in found]
