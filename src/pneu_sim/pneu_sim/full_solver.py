# SPDX-License-Identifier: Apache-2.0
"""What steps rigs in full side by side: tiles of them, advanced by the kernel."""

from collections.abc import Callable, Sequence
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_sim import layout as L
from pneu_sim import stepping
from pneu_sim import tile as tiles
from pneu_sim.device import Device, chosen
from pneu_sim.rig.model import Model
from pneu_sim.solver import Series, Solver

Floats = NDArray[np.float64]

WIDTH = 64
"""Rigs that the kernel advances together at most: a call of few steps costs as much as they do."""


class FullSolver(Solver):
    """Rigs on one grid, advanced some at a time by the kernel.

    Attributes:
        tiles: Those that are advanced together, and which rigs they are; a last one is filled up.
    """

    def __init__(self, models: Sequence[Model], device: Device | None = None) -> None:
        """Lays the rigs out.

        Args:
            models: The rigs, on one plan.
            device: On what they are computed; None is what the environment asks for.
        """
        self.models, self.plan = list(models), models[0].plan
        self.step_s = self.plan.dt_s
        device = chosen() if device is None else device
        width = WIDTH if device == Device.CPU else self.lanes
        # The last tile is filled up, so that the kernel knows one width or two.
        count = -(-self.lanes // width) * width if self.lanes > width else self.lanes
        compliant, memory = any(m.compliant for m in models), any(m.memory for m in models)
        self.tiles: list[tuple[tiles.Tile, NDArray[np.int64]]] = []
        for begin in range(0, count, width):
            of = np.minimum(np.arange(begin, min(begin + width, count)), self.lanes - 1)
            packed = tiles.pack([self.models[j] for j in of], compliant, memory, device)
            self.tiles.append((packed, of))

    def fill(
        self,
        pressure_pa: Floats,
        chamber_pressure_pa: Floats,
        temperature_k: Floats,
        chamber_temperature_k: Floats,
    ) -> None:
        """Fills all with gas at rest; see `Solver.fill`.

        Args:
            pressure_pa: (slots, lanes).
            chamber_pressure_pa: (n_chambers, lanes).
            temperature_k: (slots, lanes).
            chamber_temperature_k: (n_chambers, lanes).
        """
        for tile, of in self.tiles:
            tiles.forget(tile)
            tiles.fill_pipes(tile, pressure_pa[:, of], temperature_k[:, of])
            tiles.fill_chambers(tile, chamber_pressure_pa[:, of], chamber_temperature_k[:, of])
        self._lean()

    def advance(self, opening: Floats, interval_s: float) -> Series:
        """Advances all; see `Solver.advance`.

        Args:
            opening: (intervals, knots + 1, n_ports, lanes).
            interval_s: Length of an interval, s.
        """
        steps = self.steps(interval_s)
        if len(self.tiles) == 1:
            return stepping.advance_safely(self.tiles[0][0], steps, interval_s / steps, opening)
        out = Series.empty(self.plan, len(opening) + 1, self.lanes)
        for tile, of in self.tiles:
            part = stepping.advance_safely(tile, steps, interval_s / steps, opening[..., of])
            out.put(0, part, of)
        return out

    def state(self) -> list[NDArray[Any]]:
        """Returns copies of all that the future depends on; see `Solver.state`."""
        parts = [self._whole(attrgetter(name)) for name in tiles.CHANGING]
        # Clocks count steps, of this length.
        return [*parts, np.full(self.lanes, self.tiles[0][0].dt_s)]

    def set_state(self, parts: Sequence[NDArray[Any]]) -> None:
        """Goes back to a state; see `Solver.set_state`.

        Args:
            parts: As of `state`.
        """
        *changing, step_s = parts
        for tile, of in self.tiles:
            for name, part in zip(tiles.CHANGING, changing, strict=True):
                getattr(tile, name)[:] = part[..., of]
            tile.dt_s = float(step_s[0])
            tiles.settle(tile)

    def set_reservoir(self, index: int, pressure_pa: Floats | float) -> None:
        """Changes what a reservoir supplies; its own pressure follows within its time constant.

        Args:
            index: Its number.
            pressure_pa: A number or one per rig, Pa.
        """
        every = np.broadcast_to(pressure_pa, (self.lanes,))
        for tile, of in self.tiles:
            tile.reservoir[index, L.R_PRESSURE] = every[of]

    def sound(self) -> bool:
        """Whether all gas has energy and density; see `Solver.sound`."""
        return all(tiles.sound(tile) for tile, _ in self.tiles)

    def gas_in(self, pipe: str) -> tuple[Floats, Floats, Floats]:
        """Gas in the cells of a pipe; see `Solver.gas_in`.

        Args:
            pipe: Name of the pipe.
        """
        start, n = self.plan.pipes[pipe]
        whole = np.empty((3, n, self.lanes))
        for tile, of in self.tiles:
            whole[:, :, of] = tiles.gas_in(tile, slice(start, start + n))
        return whole[0], whole[1], whole[2]

    def set_gas(self, pipe: str, density: Floats, velocity: Floats, pressure: Floats) -> None:
        """Sets the gas in the cells of a pipe; see `Solver.set_gas`.

        Args:
            pipe: Name of the pipe.
            density: (cells, lanes).
            velocity: (cells, lanes).
            pressure: (cells, lanes).
        """
        start, n = self.plan.pipes[pipe]
        ends = [np.pad(v, ((1, 1), (0, 0)), mode="edge") for v in (density, velocity, pressure)]
        for tile, of in self.tiles:
            tiles.hold_gas(tile, slice(start - 1, start + n + 1), *(v[:, of] for v in ends))

    def set_chamber(self, index: int, pressure_pa: Floats, temperature_k: Floats) -> None:
        """Sets the gas in a chamber; see `Solver.set_chamber`.

        Args:
            index: Its number.
            pressure_pa: (lanes,).
            temperature_k: (lanes,).
        """
        for tile, of in self.tiles:
            one = slice(index, index + 1)
            tiles.fill_chambers(tile, pressure_pa[None, of], temperature_k[None, of], one)

    def place(self, position: Floats, velocity: Floats) -> None:
        """Sets joints of bodies and their pistons; see `Solver.place`.

        Args:
            position: (n_joints, lanes).
            velocity: (n_joints, lanes).
        """
        for tile, of in self.tiles:  # refused for one, no other has moved
            tiles.check_place(tile, position[:, of])
        self.shift(position, velocity)

    def shift(self, position: Floats, velocity: Floats) -> None:
        """Moves joints as `place` does; pistons may be pressed into their stops, as steps do it.

        Args:
            position: (n_joints, lanes).
            velocity: (n_joints, lanes).
        """
        for tile, of in self.tiles:
            tiles.rearrange(tile, position[:, of], velocity[:, of])
        self._lean()

    def _lean(self) -> None:
        """Has the forces on pistons be those of the gas as it now is."""
        if not self.plan.cylinders:
            return
        for tile, _ in self.tiles:
            nothing = np.zeros((0, 2, self.plan.ports.shape[0], tile.lanes))
            stepping.advance(tile, 1, tile.dt_s or self.step_s, nothing)
            tiles.force_at_rest(tile)

    def joints(self) -> Floats:
        """Positions and velocities of all joints; see `Solver.joints`."""
        return self._whole(lambda tile: tile.joint_state[:, :2])

    def drive(self, speed: Floats) -> None:
        """Has pistons that move no body go at some speed; see `Solver.drive`.

        Args:
            speed: (n_cylinders, lanes).
        """
        free = self.plan.moves < 0
        for tile, of in self.tiles:
            tile.cylinder_state[free, L.SY_SPEED] = speed[free][:, of]

    def start_pistons(self, extension: Floats) -> None:
        """Sets where pistons that move no body start; see `Solver.start_pistons`.

        Args:
            extension: (n_cylinders, lanes).
        """
        for model, own in zip(self.models, extension.T, strict=True):
            tiles.check_extensions(model, own)
        free = self.plan.moves < 0
        for tile, of in self.tiles:
            tile.cylinder[free, L.PY_START] = extension[free][:, of]

    def impulse(self) -> Floats:
        """Impulse on every piston since this was last asked for; see `Solver.impulse`."""
        impulse = self._whole(lambda tile: tile.cylinder_state[:, L.SY_IMPULSE])
        for tile, _ in self.tiles:
            tile.cylinder_state[:, L.SY_IMPULSE] = 0.0
        return impulse

    def friction_heat(self) -> Floats:
        """Heat that friction and damping made; see `Solver.friction_heat`."""
        return self._whole(attrgetter("friction_heat"))

    def held(self) -> tuple[Floats, Floats]:
        """Mass and energy of all gas; see `Solver.held`."""
        mass, energy = self._whole(lambda tile: np.stack(tiles.held(tile)))
        return mass, energy

    def _whole(self, part: Callable[[tiles.Tile], Floats]) -> Floats:
        """A copy of what every tile has of its own rigs, (..., lanes), for all rigs."""
        parts = [part(tile) for tile, _ in self.tiles]
        return np.concatenate(parts, axis=-1)[..., : self.lanes]
