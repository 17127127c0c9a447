# SPDX-License-Identifier: Apache-2.0
"""Rigs side by side that are stepped as commands come in: valves, gas and sensors together.

The simulator, its node and all that is trained, tuned or planned on rigs are faces of this one, by
whichever model the rigs name. A plant keeps its state: it is told, taken back and put into other
lanes. How a run is cut into calls changes no bit of it.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pneu_common.errors import InputError
from pneu_sim import layout as L
from pneu_sim.gas import AIR, Gas
from pneu_sim.models import kind_of
from pneu_sim.rig.expand import gas_of_sides, with_cylinders
from pneu_sim.rig.model import S_OFFSET
from pneu_sim.rig.network import reservoir_of_pipes
from pneu_sim.rig.plan import common_plan
from pneu_sim.rig.schema import Rig
from pneu_sim.sensors import Sensors
from pneu_sim.simulate import TICK_S
from pneu_sim.solver import Series
from pneu_sim.valve import Spools

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SENSED_S = 1e-3
"""Likewise where a sensor lags or is late, s."""
SAMPLES_AT_ONCE = 4096
"""That are kept of a run of which fewer are asked for."""


@dataclass(frozen=True)
class Clock:
    """A time that is told in whole intervals since an origin.

    Attributes:
        origin_s: The origin, s.
        interval_s: Length of an interval, s.
        count: How many there were.
    """

    origin_s: float = 0.0
    interval_s: float = 0.0
    count: int = 0

    @property
    def now_s(self) -> float:
        """The time, s."""
        return self.origin_s + self.count * self.interval_s

    def by(self, interval_s: float) -> "Clock":
        """The same time, told in intervals of a length.

        Args:
            interval_s: The length, s.
        """
        return self if interval_s == self.interval_s else Clock(self.now_s, interval_s, 0)

    def after(self, count: int) -> "Clock":
        """The time some intervals later.

        Args:
            count: How many.
        """
        return Clock(self.origin_s, self.interval_s, self.count + count)


@dataclass(frozen=True)
class State:
    """All that the future of a plant depends on, but what its reservoirs were set to.

    The rig is the last index of every array but that of the times of commands.

    Attributes:
        clock: The time.
        spools: Where the spools stand, and the commands on their way to them.
        sensors: What pressure sensors and encoders still show.
        gas: The gas.
    """

    clock: Clock
    spools: list[Floats]
    sensors: list[Floats]
    gas: list[NDArray[Any]]

    def of(self, lanes: Ints) -> "State":
        """The state of other rigs, each that of one of these.

        Args:
            lanes: The one that each takes.
        """
        told, *spools = self.spools  # when commands were told is the same for all
        moved = ([part[..., lanes] for part in parts] for parts in (spools, self.sensors, self.gas))
        spools, sensors, gas = moved
        return State(self.clock, [told, *spools], sensors, gas)


class Plant:
    """Rigs of one structure side by side, that differ in parameters.

    Attributes:
        rigs: The rigs.
        plan: What they have in common: names and order of parts.
        solver: Their gas.
        spools: Their valves.
        taps: Their pressure sensors.
        encoder_of: (n_encoders,) joint of the solver that each encoder is on, or -1 - cylinder.
        clock: Time since the last reset.
    """

    def __init__(
        self,
        rigs: Sequence[Rig],
        dx_m: float | None = None,
        gas: Gas = AIR,
        fewest_cells: int = 2,
    ) -> None:
        """Builds the rigs, and begins with all at rest.

        Args:
            rigs: The rigs, of one structure and by one kind of model.
            dx_m: Cell length that replaces the rigs' own, m; models without cells have none.
            gas: The gas.
            fewest_cells: Cells that the shortest pipe has at least.

        Raises:
            InputError: The rigs do not share one structure or model, or cannot be stepped.
        """
        self.rigs = list(rigs)
        first = self.rigs[0]
        for other in self.rigs:
            if other.model != first.model:
                raise InputError(
                    f"rig {other.name!r}: model: found {other.model}, {first.name!r} beside it has"
                    f" {first.model}"
                )
        self.plan = common_plan(self.rigs, dx_m, fewest_cells)
        self.solver = kind_of(first).solver(self.rigs, self.plan, gas)
        self.spools = Spools(self.solver.models)
        self.taps = Sensors.of_taps(self.solver.models)
        self._encoders = Sensors.of_encoders(self.solver.models)
        self.encoder_of = self._places_of_encoders()
        self.reset()

    def refuse_early_clocks(self) -> None:
        """Refuses sensors whose clock is ahead, where the plant is asked sample by sample.

        They show what is still to come, which only a run of known length has.

        Raises:
            InputError: There is one.
        """
        for model in self.solver.models:
            offsets = [*model.sensor[:, S_OFFSET], *model.encoder[:, S_OFFSET]]
            names = [*self.plan.taps, *self.plan.encoders]
            for name, offset_s in zip(names, offsets, strict=True):
                if offset_s < 0.0:
                    raise InputError(
                        f"rig {self.rigs[0].name!r}: clock of {name!r}: found"
                        f" {-offset_s * 1e3:g} ms early; a plant that is stepped cannot show what"
                        " is to come; give the other sensors a late clock instead"
                    )

    @property
    def lanes(self) -> int:
        """Number of rigs."""
        return len(self.rigs)

    @property
    def joint_names(self) -> Sequence[str]:
        """Names of the joints of bodies."""
        return self.solver.joint_names

    def joints(self) -> Floats:
        """Returns (joints, 2, lanes) places, rad or m, and speeds of the joints of bodies."""
        return self.solver.joints()

    @property
    def time_s(self) -> float:
        """Time since the last reset, s."""
        return self.clock.now_s

    def reset(
        self,
        pressures_pa: Mapping[str, float | ArrayLike] | None = None,
        long_closed: bool = False,
    ) -> None:
        """Fills the rigs with gas at rest at the room's temperature, valves closed, at time zero.

        Args:
            pressures_pa: Pressures of pipes, chambers and sides of cylinders (by their node, or as
                ``cylinder.head`` and ``cylinder.rod``), a number or one per rig. A pipe that is not
                named has the pressure of a reservoir it meets without a valve between, any
                other part the room's.
            long_closed: Whether the first command is under way for as long as any other; else it
                counts as having been there before.

        Raises:
            InputError: A name is no pipe and no chamber.
        """
        own = {*self.rigs[0].pipes, *self.rigs[0].chambers}
        sides = {n: part for n, part in gas_of_sides(self.rigs[0]).items() if n not in own}
        given = {sides.get(name, name): value for name, value in (pressures_pa or {}).items()}
        plan, models = self.plan, self.solver.models
        first = with_cylinders(self.rigs[0])
        for name in given:
            if name not in first.pipes and name not in first.chambers:
                known = ", ".join([*first.pipes, *first.chambers])
                raise InputError(
                    f"initial pressure of {name!r}: the rig has no such part ({known})"
                )
        room_pa, room_k = np.stack([m.ambient for m in models], axis=-1)
        p = np.tile(room_pa, (plan.slots, 1))
        chambers_pa = np.tile(room_pa, (len(plan.chambers), 1))
        fed = reservoir_of_pipes(first, plan.reservoirs)
        for name, (start, n) in plan.pipes.items():
            value = given.get(name)
            if value is None and name in fed:
                value = [m.reservoir[fed[name], L.R_PRESSURE] for m in models]
            if value is not None:
                p[start - 1 : start + n + 1] = np.asarray(value, dtype=float)
        for c, name in enumerate(plan.chambers):
            if name in given:
                chambers_pa[c] = np.asarray(given[name], dtype=float)
        warm, chambers_warm = (np.tile(room_k, (len(of), 1)) for of in (p, chambers_pa))
        self.solver.fill(p, chambers_pa, warm, chambers_warm)
        self.spools.close(long_closed)
        self.clock = Clock()
        self._sense_anew()

    def _sense_anew(self) -> None:
        """Has the sensors show the gas as it now is."""
        nothing = np.zeros((0, 2, self.plan.ports.shape[0], self.lanes))
        series = self.solver.advance(nothing, self.solver.step_s)
        self.taps.begin(series.taps[0])
        self._encoders.begin(self._positions(series)[0])

    def _places_of_encoders(self) -> Ints:
        """(n_encoders,) joint of the solver that each is on, or -1 - cylinder.

        Raises:
            InputError: A mechanism has no such joint.
        """
        rig, places = self.rigs[0], self.plan.encoder_of.copy()
        for e, (name, encoder) in enumerate(rig.encoders.items()):
            if encoder.cylinder is None:
                joint, known = encoder.on(name), self.solver.joint_names
                if joint not in known:
                    raise InputError(
                        f"rig {rig.name!r}: encoders.{name}.joint: {joint!r} is not among joints"
                        f" ({', '.join(known) or 'its model moves none'})"
                    )
                places[e] = list(known).index(joint)
        return places

    def _positions(self, series: Series) -> Floats:
        """(samples, n_encoders, lanes) positions of what the encoders are on."""
        on = [
            series.joints[:, at, 0] if at >= 0 else series.cylinders[:, -1 - at, 0]
            for at in self.encoder_of.tolist()
        ]
        return np.stack(on, axis=1) if on else np.zeros((len(series.taps), 0, self.lanes))

    def advance(self, volts: Floats, interval_s: float) -> tuple[Series, Floats]:
        """Advances all rigs.

        Args:
            volts: (lanes, valves, intervals) commands, each held for an interval; 1 lane or valve
                is for all.
            interval_s: Length of an interval, s.

        Returns:
            What was recorded, the first of intervals + 1 samples of the present state; and
            (intervals + 1, n_taps + n_encoders, lanes) what the sensors then showed, without noise:
            taps, Pa, and after them encoders, rad or m. A rig that becomes unstable is not finite
            from then on.
        """
        # Openings, and what sensors with a lag see, are linear over an interval: so it is no longer
        # than this, however seldom somebody looks.
        longest_s = SENSED_S if self.taps.remembers or self._encoders.remembers else TICK_S
        parts = max(math.ceil(interval_s / longest_s - 1e-9), 1)
        if self.solver.unit_s > 0.0:
            units = max(round(interval_s / self.solver.unit_s), 1)
            parts = next(n for n in range(min(parts, units), units + 1) if units % n == 0)
        if parts == 1 or volts.shape[2] == 0:
            return self._advance(volts, interval_s)
        done, some = [], max(SAMPLES_AT_ONCE // parts, 1)
        for first in range(0, volts.shape[2], some):
            held = np.repeat(volts[:, :, first : first + some], parts, axis=2)
            series, readings = self._advance(held, interval_s / parts)
            begin = parts if first else 0  # the last sample of those before is the same
            cut = [getattr(series, f.name)[begin::parts] for f in fields(series)]
            done.append((*cut, readings[begin::parts]))
        *cut, told = (np.concatenate(part) for part in zip(*done, strict=True))
        return Series(*cut), told

    def _advance(self, volts: Floats, interval_s: float) -> tuple[Series, Floats]:
        """Advances all rigs by intervals over which all is linear."""
        self.clock = self.clock.by(interval_s)
        opening = self.spools.follow(volts, self.clock.origin_s, self.clock.count, interval_s)
        before = self.readings()
        series = self.solver.advance(opening, interval_s)
        taps = self.taps.follow(series.taps[1:], interval_s)
        encoders = self._encoders.follow(self._positions(series)[1:], interval_s)
        readings = np.concatenate([taps, encoders], axis=1)
        self.clock = self.clock.after(len(opening))
        return series, np.concatenate([before[None], readings])

    def readings(self) -> Floats:
        """Returns what the sensors show now, without noise, as of `advance`: (n, lanes)."""
        return np.concatenate([self.taps.readings(), self._encoders.readings()])

    def state(self) -> State:
        """Returns all that the future depends on, to come back to it with `set_state`."""
        shown = [*self.taps.state(), *self._encoders.state()]
        return State(self.clock, self.spools.state(), shown, self.solver.state())

    def set_state(self, state: State) -> None:
        """Goes back to a state.

        Args:
            state: A state of this plant, or of one of the same structure and as many rigs.
        """
        self.clock = state.clock
        self.spools.set_state(state.spools)
        half = len(state.sensors) // 2
        self.taps.set_state(state.sensors[:half], state.clock.interval_s)
        self._encoders.set_state(state.sensors[half:], state.clock.interval_s)
        self.solver.set_state(state.gas)

    def gas_in(self, pipe: str) -> tuple[Floats, Floats, Floats]:
        """Density, kg/m^3, velocity, m/s, and pressure, Pa, in the cells of a pipe.

        Args:
            pipe: Name of the pipe.

        Returns:
            Each (cells, lanes).

        Raises:
            InputError: There is no such pipe, or the model knows no gas along its lines.
        """
        self._cells(pipe)
        return self.solver.gas_in(pipe)

    def gas_along(self, points: Sequence[tuple[str, int]]) -> Floats:
        """Gas at evenly spaced points of pipes.

        Args:
            points: Pipes with their numbers of points.

        Returns:
            (3 points, lanes): per pipe densities, kg/m^3, velocities, m/s, and pressures, Pa.

        Raises:
            InputError: There is no such pipe, or the model knows no gas along its lines.
        """
        rows = []
        for pipe, n in points:
            gas = np.stack(self.gas_in(pipe))
            cells = gas.shape[1]
            at = np.minimum(((np.arange(n) + 0.5) * cells / n).astype(int), cells - 1)
            rows.append(gas[:, at].reshape(3 * n, gas.shape[2]))
        return np.concatenate(rows)

    def set_gas(
        self, pipe: str, density: ArrayLike, velocity: ArrayLike, pressure: ArrayLike
    ) -> None:
        """Sets the gas in the cells of one pipe; its walls forget what they remember.

        Sensors then show what is there, as if it had been for long.

        Args:
            pipe: Name of the pipe.
            density: kg/m^3; a number, (cells,), or (cells, lanes).
            velocity: m/s, positive from the pipe's ``from`` node.
            pressure: Absolute, Pa.

        Raises:
            InputError: There is no such pipe, the model knows no gas along it, or the shapes or
                values do not fit.
        """
        n = self._cells(pipe)
        values: list[Floats] = []
        for what, value in (("density", density), ("velocity", velocity), ("pressure", pressure)):
            array = np.asarray(value, dtype=float)
            if array.ndim == 1:
                array = array[:, None]
            if array.ndim > 2 or any(
                have not in (1, want)
                for have, want in zip(array.shape, (n, self.lanes), strict=False)
            ):
                raise InputError(
                    f"pipe {pipe!r}, {what}: found shape {np.shape(value)}, it has {n} cells"
                )
            array = np.broadcast_to(array, (n, self.lanes))
            if not np.isfinite(array).all() or (what != "velocity" and array.min() <= 0.0):
                raise InputError(
                    f"pipe {pipe!r}, {what}: must be finite, and positive but velocity"
                )
            values.append(array)
        self.solver.set_gas(pipe, *values)
        self._sense_anew()

    def set_chamber(self, chamber: str, pressure: ArrayLike, temperature: ArrayLike) -> None:
        """Sets the gas in one chamber; sensors then show what is there, as if it had been for long.

        Args:
            chamber: Name of the chamber.
            pressure: Absolute, Pa; a number, or one per rig.
            temperature: K; likewise.

        Raises:
            InputError: There is no such chamber, it has no gas of its own, or a value is not
                positive.
        """
        index = self._index("chamber", chamber, self.plan.chambers)
        values = []
        for what, value in (("pressure", pressure), ("temperature", temperature)):
            array = np.asarray(value, dtype=float)
            if not (np.isfinite(array).all() and array.min() > 0.0):
                raise InputError(f"chamber {chamber!r}, {what}: found {value!r}, must be positive")
            values.append(np.broadcast_to(array, (self.lanes,)))
        self.solver.set_chamber(index, *values)
        self._sense_anew()

    def place(
        self,
        positions: Mapping[str, ArrayLike],
        velocities: Mapping[str, ArrayLike] | None = None,
    ) -> None:
        """Moves joints of bodies, and pistons with them; gas keeps its pressure and temperature.

        Args:
            positions: By joint, rad or m; a number, or one per rig. Others stay where they are.
            velocities: By joint; others rest.

        Raises:
            InputError: There is no such joint, a value is not finite, a piston would stand beyond
                its stroke, or the model moves no bodies.
        """
        names, velocities = self.solver.joint_names, velocities or {}
        place = np.array(self.solver.joints()[:, 0])
        speed = np.zeros_like(place)
        for what, given, into in (("position", positions, place), ("velocity", velocities, speed)):
            for name, value in given.items():
                array = np.asarray(value, dtype=float)
                if not np.isfinite(array).all():
                    raise InputError(f"joint {name!r}, {what}: found {value!r}, must be finite")
                into[self._index("joint", name, names)] = array
        self.solver.place(place, speed)
        self._sense_anew()

    def set_reservoir(self, reservoir: str, pressure: ArrayLike) -> None:
        """Changes the pressure of a reservoir from now on, until the next reset.

        Args:
            reservoir: Name of the reservoir.
            pressure: Pressure at no flow, absolute, Pa; a number, or one per rig.

        Raises:
            InputError: There is no such reservoir, or the pressure is not positive.
        """
        index = self._index("reservoir", reservoir, self.plan.reservoirs)
        array = np.asarray(pressure, dtype=float)
        if not (np.isfinite(array).all() and array.min() > 0.0):
            raise InputError(
                f"reservoir {reservoir!r}, pressure: found {pressure!r}, must be positive"
            )
        self.solver.set_reservoir(index, array)

    def _cells(self, pipe: str) -> int:
        if pipe not in self.rigs[0].pipes:
            raise InputError(
                f"the rig has no pipe {pipe!r} ({', '.join(self.rigs[0].pipes) or 'none'})"
            )
        return self.plan.pipes[pipe][1]

    def _index(self, what: str, name: str, known: Sequence[str]) -> int:
        if name not in known:
            raise InputError(f"the rig has no {what} {name!r} ({', '.join(known) or 'none'})")
        return list(known).index(name)
