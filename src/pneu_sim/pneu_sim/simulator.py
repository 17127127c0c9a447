# SPDX-License-Identifier: Apache-2.0
"""A rig that is simulated step by step and keeps its state: for nodes, controllers and studies."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pneu_common.errors import InputError
from pneu_sim import layout as L
from pneu_sim import sensors
from pneu_sim import tile as tiles
from pneu_sim.gas import AIR, Gas
from pneu_sim.models import kind_of
from pneu_sim.rig.build import build
from pneu_sim.rig.model import S_LAG, S_OFFSET
from pneu_sim.rig.plan import common_plan, reservoir_of_pipes
from pneu_sim.rig.schema import Rig
from pneu_sim.valve import SpoolState, openings

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Readings:
    """What was recorded during a run, beginning with the state it started from.

    Series have the shape (T,) for one rig, (T, rigs) for a batch.

    Attributes:
        time_s: (T,) times, s.
        taps: Per tap the sensor's readings, Pa.
        pressures: Per tap the pressure of the gas there, Pa.
        flows: Per port (``valve.port``, or an orifice's name) the mass flow from its ``from`` node,
            kg/s.
        chambers: Per chamber its pressure, Pa.
    """

    time_s: Floats
    taps: dict[str, Floats]
    pressures: dict[str, Floats]
    flows: dict[str, Floats]
    chambers: dict[str, Floats]


class Simulator:
    """One rig, or several alike that run side by side, advanced as commands come in.

    Rigs of a batch share one structure (pipes, nodes, cells) and differ in parameters.

    Attributes:
        rigs: The rigs.
        time_s: Simulated time since the last reset, s.
    """

    def __init__(self, rig: Rig | Sequence[Rig], dx_m: float | None = None, gas: Gas = AIR) -> None:
        """Builds the grid and starts from rest.

        Args:
            rig: The rig, or the rigs of a batch.
            dx_m: Cell length that replaces the rig's.
            gas: The gas.

        Raises:
            InputError: The rigs do not share one structure, ask for an unstable time step, or are
                of a kind of model that knows no gas along lines.
        """
        self._single = isinstance(rig, Rig)
        for one in [rig] if isinstance(rig, Rig) else rig:
            if not kind_of(one).along_lines:
                raise InputError(
                    f"rig {one.name!r}: model: found {one.model}, which knows no gas along lines;"
                    " `pneu_sim.run.run_rig` runs it"
                )
        self.rigs: list[Rig] = [rig] if isinstance(rig, Rig) else list(rig)
        self._plan = common_plan(self.rigs, dx_m)
        self._models = [build(r, self._plan, gas) for r in self.rigs]
        self._gas = gas
        self.reset()

    def reset(self, pressures_pa: Mapping[str, float | ArrayLike] | None = None) -> None:
        """Fills the rig with gas at rest at the room's temperature, valves closed, at time zero.

        Args:
            pressures_pa: Pressures of pipes and chambers, a number or one per rig. A pipe that is
                not named has the pressure of a reservoir it meets without a valve between, any
                other part the room's.

        Raises:
            InputError: A name is no pipe and no chamber.
        """
        given = dict(pressures_pa or {})
        first = self.rigs[0]
        for name in given:
            if name not in first.pipes and name not in first.chambers:
                known = ", ".join([*first.pipes, *first.chambers])
                raise InputError(
                    f"initial pressure of {name!r}: the rig has no such part ({known})"
                )
        self._tile = tiles.pack(self._models)
        # At rest with the room: a valve that stood open would not leave the rig at rest.
        self._spools = [SpoolState(at_null=True) for _ in self.rigs]
        self._history: Floats | None = None
        self._history_dt = 0.0
        self.time_s = 0.0
        w = self._tile.lanes
        room = self._tile.ambient[0]
        p = np.tile(room, (self._plan.slots, 1))
        pc = np.tile(room, (len(self._plan.chambers), 1))
        nodes = reservoir_of_pipes(first, self._plan)
        for name in first.pipes:
            start, n = self._plan.pipes[name]
            value = given.get(name)
            if value is None and name in nodes:
                value = self._tile.reservoir[nodes[name], L.R_PRESSURE]
            if value is not None:
                p[start - 1 : start + n + 1] = np.broadcast_to(np.asarray(value, dtype=float), (w,))
        for c, name in enumerate(self._plan.chambers):
            if name in given:
                pc[c] = np.broadcast_to(np.asarray(given[name], dtype=float), (w,))
        tiles.fill_pipes(self._tile, p, self._tile.ambient[1])
        tiles.fill_chambers(self._tile, pc, np.tile(self._tile.ambient[1], (pc.shape[0], 1)))

    def set_state(
        self, pipe: str, density: ArrayLike, velocity: ArrayLike, pressure: ArrayLike
    ) -> None:
        """Sets the gas in the cells of one pipe; its walls forget what they remember.

        Args:
            pipe: Name of the pipe.
            density: kg/m^3; a number, (cells,), or (cells, rigs) for a batch.
            velocity: m/s, positive from the pipe's ``from`` node.
            pressure: Absolute, Pa.

        Raises:
            InputError: There is no such pipe, or the shapes or values do not fit.
        """
        start, n = self._span(pipe)
        w = self._tile.lanes
        values: list[Floats] = []
        for what, value in (("density", density), ("velocity", velocity), ("pressure", pressure)):
            array = np.asarray(value, dtype=float)
            if array.ndim == 1:
                array = array[:, None]
            if array.ndim > 2 or any(
                have not in (1, want) for have, want in zip(array.shape, (n, w), strict=False)
            ):
                raise InputError(
                    f"pipe {pipe!r}, {what}: found shape {np.shape(value)}, it has {n} cells"
                )
            array = np.broadcast_to(array, (n, w))
            if not np.isfinite(array).all() or (what != "velocity" and array.min() <= 0.0):
                raise InputError(
                    f"pipe {pipe!r}, {what}: must be finite, and positive but velocity"
                )
            values.append(np.pad(array, ((1, 1), (0, 0)), mode="edge"))
        rho, u, p = values
        span = slice(start - 1, start + n + 1)
        cell, state = self._tile.cell[:, span], self._tile.state[:, span]
        k, rest = cell[L.COMPLIANCE], cell[L.REST_P]
        stretch = 1.0 + k * (p - rest)
        state[:] = 0.0
        state[L.RHO] = rho * stretch
        state[L.MOM] = rho * stretch * u
        state[L.ENE] = (
            p * stretch / (self._gas.gamma - 1.0)
            + 0.5 * k * (p**2 - rest**2)
            + 0.5 * rho * stretch * u**2
        )

    def set_chamber(self, chamber: str, pressure: ArrayLike, temperature: ArrayLike) -> None:
        """Sets the gas in one chamber.

        Args:
            chamber: Name of the chamber.
            pressure: Absolute, Pa; a number, or one per rig.
            temperature: K; likewise.

        Raises:
            InputError: There is no such chamber, or a value is not positive.
        """
        if chamber not in self._plan.chambers:
            known = ", ".join(self._plan.chambers) or "none"
            raise InputError(f"the rig has no chamber {chamber!r} ({known})")
        for what, value in (("pressure", pressure), ("temperature", temperature)):
            if not (np.isfinite(value).all() and np.min(value) > 0.0):
                raise InputError(f"chamber {chamber!r}, {what}: found {value!r}, must be positive")
        c = self._plan.chambers.index(chamber)
        w = self._tile.lanes
        others = self._tile.chamber_state.copy()
        p = np.ones((len(self._plan.chambers), w))
        t = np.ones_like(p)
        p[c], t[c] = pressure, temperature
        tiles.fill_chambers(self._tile, p, t)
        others[c] = self._tile.chamber_state[c]
        self._tile.chamber_state[:] = others

    def set_reservoir(self, reservoir: str, pressure: ArrayLike) -> None:
        """Changes the pressure of a reservoir from now on, until the next reset.

        Args:
            reservoir: Name of the reservoir.
            pressure: Pressure at no flow, absolute, Pa; a number, or one per rig.

        Raises:
            InputError: There is no such reservoir, or the pressure is not positive.
        """
        if reservoir not in self._plan.reservoirs:
            known = ", ".join(self._plan.reservoirs) or "none"
            raise InputError(f"the rig has no reservoir {reservoir!r} ({known})")
        if not (np.isfinite(pressure).all() and np.min(pressure) > 0.0):
            raise InputError(
                f"reservoir {reservoir!r}, pressure: found {pressure!r}, must be positive"
            )
        # The present pressure follows within the time constant of the reservoir's sag.
        self._tile.reservoir[self._plan.reservoirs.index(reservoir), L.R_PRESSURE] = pressure

    def state(self, pipe: str) -> dict[str, Floats]:
        """Gas in the cells of one pipe.

        Args:
            pipe: Name of the pipe.

        Returns:
            ``x_m`` (cells,) and ``density``, ``velocity``, ``pressure``, ``temperature``, each
            (cells,) or (cells, rigs).

        Raises:
            InputError: There is no such pipe.
        """
        start, n = self._span(pipe)
        rho, u, p = tiles.gas_in(self._tile, slice(start, start + n))
        length = self.rigs[0].pipes[pipe].length_m
        table = {
            "density": rho,
            "velocity": u,
            "pressure": p,
            "temperature": p / (rho * self._gas.r_specific),
        }
        if self._single:
            table = {name: value[:, 0] for name, value in table.items()}
        return {"x_m": (np.arange(n) + 0.5) * length / n, **table}

    def run(
        self,
        duration_s: float,
        commands: Mapping[str, float | ArrayLike] | None = None,
        sample_s: float = 1e-3,
    ) -> Readings:
        """Advances the rig.

        Args:
            duration_s: How long, s; a whole number of samples.
            commands: Volts per command: a number, or one per sample, each held until the next.
            sample_s: Interval of commands and readings, s.

        Returns:
            Readings, the first at the present time, the last at the new present time.

        Raises:
            InputError: A command is missing or does not fit, or the simulation became unstable.
        """
        steps = round(duration_s / sample_s)
        if steps < 1 or abs(steps * sample_s - duration_s) > 1e-6 * duration_s:
            raise InputError(
                f"duration_s: found {duration_s:g}, it must be a whole number of samples of"
                f" {sample_s:g} s"
            )
        held = self._held(commands or {}, steps)
        opening = tiles.lanes(
            [
                openings(model, held, sample_s, spools=spools)
                if held
                else openings(model, {"": np.zeros(steps + 1)}, sample_s)
                for model, spools in zip(self._models, self._spools, strict=True)
            ]
        )
        n_sub = max(1, math.ceil(sample_s / self._plan.dt_s - 1e-9))
        taps, flows, chambers = tiles.advance_safely(
            self._tile, steps + 1, n_sub, sample_s / n_sub, opening
        )
        time: Floats = self.time_s + np.arange(steps + 1, dtype=np.float64) * sample_s
        self.time_s += steps * sample_s
        return Readings(
            time,
            self._named(self._plan.taps, self._sensed(taps, sample_s)),
            self._named(self._plan.taps, taps),
            self._named(self._plan.port_names, flows),
            self._named(self._plan.chambers, chambers),
        )

    def mass_kg(self) -> float | Floats:
        """Returns the mass of all gas in pipes and chambers, kg; one per rig for a batch."""
        return self._total(L.RHO, 0)

    def energy_j(self) -> float | Floats:
        """Returns the energy of all gas (and yielding walls) in pipes and chambers, J."""
        return self._total(L.ENE, 1)

    def _total(self, row: int, column: int) -> float | Floats:
        inverse = self._tile.cell[L.INV_VOLUME]
        volume = np.where(inverse > 0.0, 1.0 / np.where(inverse > 0.0, inverse, 1.0), 0.0)
        total = np.sum(self._tile.state[row] * volume, axis=0)
        total = total + self._tile.chamber_state[:, column].sum(axis=0)
        return float(total[0]) if self._single else np.asarray(total)

    def _span(self, pipe: str) -> tuple[int, int]:
        if pipe not in self._plan.pipes:
            raise InputError(f"the rig has no pipe {pipe!r} ({', '.join(self._plan.pipes)})")
        return self._plan.pipes[pipe]

    def _held(self, commands: Mapping[str, float | ArrayLike], steps: int) -> dict[str, Floats]:
        """Commands as series of one value per recorded sample."""
        missing = [name for name in self._plan.commands if name not in commands]
        if missing:
            raise InputError(f"command {missing[0]!r}: found none, the rig's valve needs one")
        held: dict[str, Floats] = {}
        for name, value in commands.items():
            if name not in self._plan.commands:
                raise InputError(
                    f"command {name!r}: the rig has none of that name"
                    f" ({', '.join(self._plan.commands) or 'no commands at all'})"
                )
            series = np.asarray(value, dtype=float)
            if series.ndim > 1 or (series.ndim == 1 and series.size not in (steps, steps + 1)):
                raise InputError(
                    f"command {name!r}: found shape {series.shape}, needed is one number or"
                    f" {steps} of them"
                )
            if not np.isfinite(series).all():
                raise InputError(f"command {name!r}: found a value that is not finite")
            if series.ndim == 0:
                held[name] = np.full(steps + 1, float(series))
            else:
                held[name] = np.append(series[:steps], series[steps - 1])
        return held

    def _sensed(self, taps: Floats, sample_s: float) -> Floats:
        """Sensor readings, with the past pressures that lagging sensors still show."""
        if self._history is None or self._history_dt != sample_s:
            self._history = taps[:1]
            self._history_dt = sample_s
        whole = np.concatenate([self._history[:-1], taps])
        readings = np.stack(
            [sensors.read(m, whole[:, :, j], sample_s) for j, m in enumerate(self._models)], axis=-1
        )
        slowest = max(
            (float(np.max(20.0 * m.sensor[:, S_LAG] + abs(m.sensor[:, S_OFFSET]), initial=0.0)))
            for m in self._models
        )
        self._history = whole[-(math.ceil(slowest / sample_s) + 1) :]
        return readings[-taps.shape[0] :]

    def _named(self, names: Sequence[str], series: Floats) -> dict[str, Floats]:
        one = 0 if self._single else slice(None)
        return {name: series[:, i, one] for i, name in enumerate(names)}
