# SPDX-License-Identifier: Apache-2.0
"""The state of an ensemble as one table of numbers, that an analysis may move.

Numbers are those of the solver: mass, momentum and energy per volume in every cell with what its
walls remember, mass and energy of chambers, places and speeds of joints. Taps move gas, by how near
it is; encoders move joints, and gas only in that it keeps its pressure as they move.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sim import layout as L
from pneu_sim import tile as tiles
from pneu_sim.full_solver import FullSolver
from pneu_sim.observe.nearness import distances, gaspari_cohn
from pneu_sim.plant import Plant

Floats = NDArray[np.float64]

ROOM = 1e-3
"""Least share of its density and energy that a member keeps in a cell, whatever is read."""


@dataclass(frozen=True)
class Block:
    """A part of the numbers that is one array of the solver.

    Attributes:
        array: The array itself, the member as its last index.
        rows: Which of the numbers.
    """

    array: Floats
    rows: slice


class StateVector:
    """The numbers of an ensemble, and how near each is to every sensor.

    Attributes:
        nearness: (n_taps + n_encoders, numbers) share of the gain of each sensor.
        in_cells: Whether a piston stands in cells, as many as its place needs.
    """

    def __init__(self, plant: Plant, reach_m: float) -> None:
        """Lays the numbers out.

        Args:
            plant: The members.
            reach_m: How far along lines a tap corrects the gas, m.

        Raises:
            InputError: The rig's model keeps no gas along lines.
        """
        if not isinstance(plant.solver, FullSolver):
            raise InputError(f"rig {plant.rigs[0].name!r}: its model keeps no gas along lines")
        self._plant, self._solver = plant, plant.solver
        self._tile = plant.solver.tiles[0][0]
        tile, plan = self._tile, plant.plan
        far_slots, far_chambers = distances(plant.rigs[0], plan)
        taps, encoders = len(plan.taps), len(plan.encoders)
        near_slots = gaspari_cohn(far_slots / reach_m)
        near_chambers = gaspari_cohn(far_chambers / reach_m)
        parts = [
            (tile.state, np.repeat(near_slots[:, None], L.STATE_ROWS, axis=1)),
            (tile.chamber_state, np.repeat(near_chambers[:, :, None], 2, axis=2)),
        ]
        kinds = plan.cylinder[:, [0, L.COLUMNS_PER_SIDE]]
        self.in_cells = bool((kinds == L.GAS_CELLS).any())
        self._blocks: list[Block] = []
        near: list[Floats] = []
        first = 0
        for array, share in parts:
            size = math.prod(array.shape[:-1])
            self._blocks.append(Block(array, slice(first, first + size)))
            near.append(share.reshape(taps, size))
            first += size
        whole = np.concatenate(near, axis=1)
        joints = plant.solver.joints()[..., 0].size
        self._joints = slice(first, first + joints)
        self.count = first + joints
        self.nearness = np.zeros((taps + encoders, self.count))
        self.nearness[:taps, :first] = whole
        self.nearness[taps:, self._joints] = 1.0

    def gather(self) -> Floats:
        """Returns (numbers, members) a copy of the numbers."""
        out = np.empty((self.count, self._plant.lanes))
        for block in self._blocks:
            out[block.rows] = block.array.reshape(-1, self._plant.lanes)
        out[self._joints] = self._plant.solver.joints().reshape(-1, self._plant.lanes)
        return out

    def scatter(self, members: Floats) -> None:
        """Has the members be as the numbers say; densities and energies stay positive.

        Gas beside a piston keeps its pressure as that moves.

        Args:
            members: (numbers, members).
        """
        before = self._tile.state[: L.ENE + 1].copy()
        chambers = self._tile.chamber_state.copy()
        for block in self._blocks:
            block.array[:] = members[block.rows].reshape(block.array.shape)
        state = self._tile.state
        inner = state[L.ENE] - 0.5 * state[L.MOM] ** 2 / np.where(
            state[L.RHO] > 0.0, state[L.RHO], 1.0
        )
        held = before[L.ENE] - 0.5 * before[L.MOM] ** 2 / np.where(
            before[L.RHO] > 0.0, before[L.RHO], 1.0
        )
        wrong = (state[L.RHO] < ROOM * before[L.RHO]) | (inner < ROOM * held)
        state[: L.ENE + 1] = np.where(wrong, before, state[: L.ENE + 1])
        bad = (self._tile.chamber_state < ROOM * chambers).any(axis=1, keepdims=True)
        self._tile.chamber_state[:] = np.where(bad, chambers, self._tile.chamber_state)
        tiles.settle(self._tile)
        self._place(members[self._joints])

    def _place(self, numbers: Floats) -> None:
        """Moves joints; a member whose piston would stand beyond its stroke stays where it is."""
        before = self._solver.joints()
        if before.size == 0:
            return
        after = numbers.reshape(before.shape)
        beyond = ~tiles.reachable(self._tile, after[:, 0])
        after = np.where(beyond, before, after)
        self._solver.shift(after[:, 0], after[:, 1])
