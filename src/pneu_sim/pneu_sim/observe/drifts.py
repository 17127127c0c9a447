# SPDX-License-Identifier: Apache-2.0
"""What of a rig is not known well enough to be taken as it is, and wanders: nulls, flows, loads.

Each is a first-order Markov process about what the rig file says. The members of an ensemble differ
in it, and what the sensors read says where it is.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pneu_sim import layout as L
from pneu_sim.full_solver import FullSolver
from pneu_sim.observe.leaks import Leaks, with_room_for_leaks
from pneu_sim.observe.loads import Loads
from pneu_sim.observe.settings import Drift, ObserverSettings
from pneu_sim.plant import Plant
from pneu_sim.rig import model as M
from pneu_sim.rig.schema import Rig

Floats = NDArray[np.float64]

ROOM_PA = 1e3
"""A reservoir within this of the room is the room."""
SPOOL = {
    "delay": (M.V_DELAY, "s"),
    "dead_band": (M.V_DEAD, "V"),
    "hysteresis": (M.V_HYSTERESIS, "V"),
    "bandwidth": (M.V_FREQUENCY, "share"),
}
"""Columns of a valve's row that drift, none of which may be negative."""
KINDS = ("command", "null", *SPOOL, "supply", "flow", "gain", "lag", "leak", "load", "load_at")
LASTING_S = 0.5
"""What forgets sooner says nothing of a plan's horizon."""
MOST = 6.0
"""No number wanders farther than so many of its standard deviations, whatever is read."""
LEAST_FLOW = 0.05
"""Least share that a port lets through, whatever a member thinks."""


@dataclass(frozen=True)
class Unknown:
    """One number that wanders.

    Attributes:
        name: Its path in the rig, and what of it.
        unit: Its unit.
        kind: Which of the drifts of the settings it is.
        index: Valve, port, reservoir, tap, pipe, or joint of those that may carry something.
        std: Standard deviation about zero.
        time_s: Over which it forgets, s.
    """

    name: str
    unit: str
    kind: str
    index: int
    std: float
    time_s: float


def that_may_drift(rig: Rig, settings: ObserverSettings) -> Rig:
    """A rig as members are of it: it does as before, with room for what may come about.

    Args:
        rig: The rig.
        settings: How it is followed.
    """
    return with_room_for_leaks(rig) if settings.leak.std > 0.0 else rig


class Drifts:
    """All that wanders, in the members of an ensemble.

    Attributes:
        unknowns: What wanders.
        values: (unknowns, members) by how much each is off what the rig file says.
    """

    def __init__(self, plant: Plant, settings: ObserverSettings, used: Sequence[str]) -> None:
        """Finds what wanders in a rig.

        Args:
            plant: The members, each of a rig that may drift so (`that_may_drift`).
            settings: How it is followed.
            used: Sensors whose readings are taken.
        """
        self._plant, solver, plan = plant, plant.solver, plant.plan
        found: list[Unknown] = []

        def add(kind: str, index: int, name: str, unit: str, drift: Drift, size: float) -> None:
            if drift.std > 0.0:
                found.append(Unknown(name, unit, kind, index, drift.std * size, drift.time_s))

        for v, name in enumerate(plan.valves):
            add("command", v, f"valves.{name}: command", "V", settings.command, 1.0)
            add("null", v, f"valves.{name}: null", "V", settings.null, 1.0)
            for kind, (_, unit) in SPOOL.items():
                add(kind, v, f"valves.{name}: {kind}", unit, getattr(settings, kind), 1.0)
        self._room = plant.rigs[0].ambient.pressure_pa
        self._supply = np.array([m.reservoir[:, L.R_PRESSURE] for m in solver.models]).T
        for r, name in enumerate(plan.reservoirs):
            pressure = float(self._supply[r, 0])
            if abs(pressure - self._room) > ROOM_PA:
                add("supply", r, f"reservoirs.{name}: pressure", "Pa", settings.supply, pressure)
        for t, name in enumerate(plan.taps):
            if name in used:
                add("lag", t, f"taps.{name}: lag", "s", settings.lag, 1.0)
        self._lag = plant.taps.lag_s.copy()
        self._spool = plant.spools.spool.copy()
        self._tiles = solver.tiles if isinstance(solver, FullSolver) else []
        if self._tiles:
            for q, name in enumerate(plan.port_names):
                if plan.port_valve[q] >= 0:
                    valve, port = name.split(".", 1)
                    path = f"valves.{valve}.ports.{port}: flow"
                    add("flow", q, path, "share", settings.flow, 1.0)
                    add("gain", q, f"{path}, slowly", "share", settings.gain, 1.0)
            # all members are of one rig
            self._port = self._tiles[0][0].port[:, [L.Q_CONDUCTANCE, L.Q_AREA], :1].copy()
        self._leaks = None
        if settings.leak.std > 0.0 and isinstance(solver, FullSolver):
            self._leaks = Leaks(solver, plant.rigs[0])
            for k, name in enumerate(plant.rigs[0].pipes):
                add("leak", k, f"pipes.{name}: leak", "m^2", settings.leak, 1.0)
        self._loads = None
        if settings.load.std > 0.0 and isinstance(solver, FullSolver):
            self._loads = Loads(solver, plant.rigs[0])
            for k, name in enumerate(self._loads.joints):
                add("load", k, f"joints.{name}: load", "kg", settings.load, 1.0)
                if self._loads.rotary[k]:
                    add("load_at", k, f"joints.{name}: load's place", "m", settings.load_at, 1.0)
        self._load_at_m = settings.load_at_m
        self.unknowns = found
        self.values = np.zeros((len(found), plant.lanes))
        self._std = np.array([u.std for u in found])
        self._time_s = np.array([u.time_s for u in found])
        self._of = {kind: [k for k, u in enumerate(found) if u.kind == kind] for kind in KINDS}

    def begin(self, rng: np.random.Generator) -> None:
        """Draws all anew.

        Args:
            rng: Source of the draws.
        """
        self.values = self._std[:, None] * centred(rng, self.values.shape)
        self.apply()

    def wander(self, interval_s: float, rng: np.random.Generator) -> None:
        """Lets all wander on for a while.

        Args:
            interval_s: How long, s.
            rng: Source of the draws.
        """
        keep = np.exp(-interval_s / self._time_s)[:, None]
        new = self._std[:, None] * np.sqrt(1.0 - keep**2)
        self.values = keep * self.values + new * centred(rng, self.values.shape)
        self.apply()

    def apply(self) -> None:
        """Has the members be as their numbers say, none of which is beyond what is possible."""
        most = MOST * self._std[:, None]
        np.clip(self.values, -most, most, out=self.values)
        solver = self._plant.solver
        for k in self._of["supply"]:
            index = self.unknowns[k].index
            solver.set_reservoir(index, self._supply[index] + self.values[k])
        self._turn()
        if self._leaks is not None:
            self._leaks.set(self.values[self._of["leak"]])
        if self._loads is not None:
            self._carry(self._loads)
        if not self._tiles:
            return
        share = np.ones((len(self._port), self._plant.lanes))
        for kind in ("flow", "gain"):
            for k in self._of[kind]:
                share[self.unknowns[k].index] += self.values[k]
        if self._of["flow"] or self._of["gain"]:
            factor = np.maximum(share, LEAST_FLOW)[:, None]
            for tile, of in self._tiles:
                tile.port[:, [L.Q_CONDUCTANCE, L.Q_AREA]] = self._port * factor[..., of]

    def _carry(self, loads: Loads) -> None:
        """Has the joints of the members carry what their numbers say."""
        far = np.full((len(loads.joints), self._plant.lanes), self._load_at_m)
        for k in self._of["load_at"]:
            far[self.unknowns[k].index] += self.values[k]
        loads.set(self.values[self._of["load"]], far)

    def _turn(self) -> None:
        """Has the valves and the taps of the members be as their numbers say."""
        plant = self._plant
        for kind, (column, unit) in SPOOL.items():
            for k in self._of[kind]:
                v = self.unknowns[k].index
                base = self._spool[:, v, column]
                share = unit == "share"
                off = base * self.values[k] if share else self.values[k]
                least = LEAST_FLOW * base if share else 0.0
                plant.spools.spool[:, v, column] = np.maximum(base + off, least)
        plant.spools.reach()
        if self._of["lag"]:
            lag = self._lag.copy()
            for k in self._of["lag"]:
                lag[self.unknowns[k].index] += self.values[k]
            plant.taps.set_lag(np.maximum(lag, 0.0))

    def drifted(self) -> list[float]:
        """Returns by how much each is off on the mean, in its standard deviations."""
        return [float(v) for v in self.values.mean(axis=1) / self._std]

    def slow(self, slow_s: float) -> list[tuple[Unknown, float, float]]:
        """What forgets slowly, its mean over the members, and their standard deviation.

        Args:
            slow_s: Over so long or longer, s.
        """
        mean, std = self.values.mean(axis=1), self.values.std(axis=1, ddof=1)
        every = zip(self.unknowns, mean.tolist(), std.tolist(), strict=True)
        return [one for one in every if one[0].time_s >= slow_s]

    def off_v(self) -> Floats:
        """Returns (valves, members) by how much the members' commands are off, V."""
        off = np.zeros((len(self._plant.plan.valves), self._plant.lanes))
        for kind in ("command", "null"):
            for k in self._of[kind]:
                off[self.unknowns[k].index] += self.values[k]
        return off

    def lasting(self) -> Floats:
        """Returns (unknowns,) the means of the members, 0 of what forgets soon."""
        return np.where(self._time_s >= LASTING_S, self.values.mean(axis=1), 0.0)

    def take(self, values: Floats) -> None:
        """Has all members be alike.

        Args:
            values: (unknowns,) by how much each is off.
        """
        self.values = np.repeat(values[:, None], self._plant.lanes, axis=1)
        self.apply()


def centred(rng: np.random.Generator, shape: tuple[int, int]) -> Floats:
    """Normal draws of mean 0 and variance 1 over the members, whatever their number.

    Args:
        rng: Source of the draws.
        shape: (numbers, members).
    """
    drawn = rng.standard_normal(shape)
    return drawn - drawn.mean(axis=1, keepdims=True)
