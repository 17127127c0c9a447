# SPDX-License-Identifier: Apache-2.0
"""Loads that joints may come to carry: point masses, somewhere along what they move.

Equations of motion are linear in mass, first and second moment of every link (Atkeson, An and
Hollerbach 1986), and so are the numbers that bodies have of them: what a load adds is its mass,
mass times distance and mass times distance squared, each times a row that is found once.
"""

import numpy as np
from numpy.typing import NDArray

from pneu_sim import layout as L
from pneu_sim.bodies.base import Body
from pneu_sim.effects.places import joints
from pneu_sim.full_solver import FullSolver
from pneu_sim.rig.schema import Rig

Floats = NDArray[np.float64]

TRIED_KG = 1e-3
TRIED_M = (0.0, 0.5, 1.0)
"""Where a mass is tried: any three distances tell a polynomial of second degree."""


class Loads:
    """What the joints of an ensemble carry.

    Attributes:
        joints: Those that may carry something.
        rotary: Which of them turn: there it matters how far out a load is.
    """

    def __init__(self, solver: FullSolver, rig: Rig) -> None:
        """Finds what a load would change.

        Args:
            solver: The rigs, all alike.
            rig: One of them.
        """
        self._tiles = solver.tiles
        self._known = solver.tiles[0][0].body[:, :, :1].copy()  # all members are of one rig
        order = list(rig.bodies.values())
        found = [
            (name, next(b for b, one in enumerate(order) if one is body), body, field)
            for name, (body, field) in joints(rig).items()
            if field in body.loaded
        ]
        self.joints = [name for name, *_ in found]
        self.rotary = [field not in body.slides for *_, body, field in found]
        self._of = [b for _, b, *_ in found]
        self._rows = [_added(body, field) for *_, body, field in found]

    def set(self, mass_kg: Floats, distance_m: Floats) -> None:
        """Has joints carry something, besides what their file says.

        Args:
            mass_kg: (joints, members) masses; below zero there is none.
            distance_m: (joints, members) how far from a rotary joint.
        """
        body = np.repeat(self._known, mass_kg.shape[1], axis=2)
        # no load lies behind the joint that moves it
        masses, far = np.maximum(mass_kg, 0.0), np.maximum(distance_m, 0.0)
        for b, rows, mass, at in zip(self._of, self._rows, masses, far, strict=True):
            body[b] += rows @ (mass * np.stack([np.ones_like(at), at, at**2]))
        for tile, of in self._tiles:
            tile.body[:] = body[..., of]


def _added(body: Body, field: str) -> Floats:
    """(BODY_PARAMS, 3) what a mass, a first and a second moment add to a body's numbers."""
    before = np.array(body.numbers())
    added = []
    for distance_m in TRIED_M:
        one = body.model_copy(deep=True)
        one.carry(field, TRIED_KG, distance_m)
        added.append((np.array(one.numbers()) - before) / TRIED_KG)
    out = np.zeros((L.BODY_PARAMS, len(TRIED_M)))
    powers = np.vander(TRIED_M, increasing=True)
    out[: before.size] = np.linalg.solve(powers, np.array(added)).T
    return out
