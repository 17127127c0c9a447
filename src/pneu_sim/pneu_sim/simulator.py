# SPDX-License-Identifier: Apache-2.0
"""A rig that is simulated step by step and keeps its state: for nodes, controllers and studies."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pneu_common.errors import InputError
from pneu_sim.gas import AIR, Gas
from pneu_sim.models import FromRest
from pneu_sim.plant import Plant
from pneu_sim.rig.cells import middles
from pneu_sim.rig.schema import Rig
from pneu_sim.stepping import unstable

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
        chambers: Per chamber its pressure, Pa; the well-mixed sides of cylinders are chambers named
            after their nodes, or ``cylinder.head`` and ``cylinder.rod`` where these are closed.
        temperatures: Per chamber that of its gas, K.
        extensions: Per cylinder its extension, m, or rad of a rotary one.
        forces: Per cylinder the force of gas and room on its piston, N, or the torque, N m.
        joints: Per joint of a body its position, rad or m.
        speeds: Per joint its velocity.
        encoders: Per encoder its readings, rad or m.
    """

    time_s: Floats
    taps: dict[str, Floats]
    pressures: dict[str, Floats]
    flows: dict[str, Floats]
    chambers: dict[str, Floats]
    temperatures: dict[str, Floats]
    extensions: dict[str, Floats]
    forces: dict[str, Floats]
    joints: dict[str, Floats]
    speeds: dict[str, Floats]
    encoders: dict[str, Floats]


class Simulator:
    """One rig, or several alike that run side by side, advanced as commands come in.

    Rigs of a batch share one structure (pipes, nodes, cells) and differ in parameters. It is the
    plant (`pneu_sim.plant`) by names, all rigs under the same commands.

    Attributes:
        plant: The plant.
    """

    def __init__(self, rig: Rig | Sequence[Rig], dx_m: float | None = None, gas: Gas = AIR) -> None:
        """Builds the rig by the model that it names, and starts from rest.

        Args:
            rig: The rig, or the rigs of a batch.
            dx_m: Cell length that replaces the rig's.
            gas: The gas.

        Raises:
            InputError: The rigs do not share one structure, ask for an unstable time step, or are
                of a kind of model that runs along recordings only.
        """
        self._single = isinstance(rig, Rig)
        self.plant = Plant([rig] if isinstance(rig, Rig) else rig, dx_m, gas)
        self._gas = gas

    @property
    def rigs(self) -> list[Rig]:
        """The rigs."""
        return self.plant.rigs

    @property
    def time_s(self) -> float:
        """Simulated time since the last reset, s."""
        return self.plant.time_s

    def reset(self, pressures_pa: Mapping[str, float | ArrayLike] | None = None) -> None:
        """Fills the rig with gas at rest at the room's temperature, valves closed, at time zero.

        Args:
            pressures_pa: Pressures of pipes and chambers, a number or one per rig. A pipe that is
                not named has the pressure of a reservoir it meets without a valve between, any
                other part the room's.

        Raises:
            InputError: A name is no pipe and no chamber.
        """
        self.plant.reset(pressures_pa)

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
            InputError: As `Plant.set_gas`.
        """
        self.plant.set_gas(pipe, density, velocity, pressure)

    def set_chamber(self, chamber: str, pressure: ArrayLike, temperature: ArrayLike) -> None:
        """Sets the gas in one chamber.

        Args:
            chamber: Name of the chamber.
            pressure: Absolute, Pa; a number, or one per rig.
            temperature: K; likewise.

        Raises:
            InputError: As `Plant.set_chamber`.
        """
        self.plant.set_chamber(chamber, pressure, temperature)

    def set_reservoir(self, reservoir: str, pressure: ArrayLike) -> None:
        """Changes the pressure of a reservoir from now on, until the next reset.

        Args:
            reservoir: Name of the reservoir.
            pressure: Pressure at no flow, absolute, Pa; a number, or one per rig.

        Raises:
            InputError: There is no such reservoir, or the pressure is not positive.
        """
        self.plant.set_reservoir(reservoir, pressure)

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
        rho, u, p = self.plant.gas_in(pipe)
        length = self.rigs[0].pipes[pipe].length_m
        table = {
            "density": rho,
            "velocity": u,
            "pressure": p,
            "temperature": p / (rho * self._gas.r_specific),
        }
        if self._single:
            table = {name: value[:, 0] for name, value in table.items()}
        n = rho.shape[0]
        return {"x_m": middles(length, n), **table}

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
        clock, plan = self.plant.clock.by(sample_s), self.plant.plan
        series, readings = self.plant.advance(self._held(commands or {}, steps), sample_s)
        fine = np.isfinite(readings).all() and np.isfinite(series.joints).all()
        where = self._broken(series.chambers)
        if where or not fine:
            raise unstable(min(sample_s, self.plant.solver.step_s), where=where)
        return Readings(
            clock.origin_s
            + sample_s * np.arange(clock.count, clock.count + steps + 1, dtype=np.float64),
            self._named(plan.taps, readings[:, : len(plan.taps)]),
            self._named(plan.taps, series.taps),
            self._named(plan.port_names, series.flows),
            self._named(plan.chambers, series.chambers),
            self._named(plan.chambers, series.temperatures),
            self._named(plan.cylinders, series.cylinders[:, :, 0]),
            self._named(plan.cylinders, series.cylinders[:, :, 2]),
            self._named(self.plant.solver.joint_names, series.joints[:, :, 0]),
            self._named(self.plant.solver.joint_names, series.joints[:, :, 1]),
            self._named(plan.encoders, readings[:, len(plan.taps) :]),
        )

    def mass_kg(self) -> float | Floats:
        """Returns the mass of all gas in pipes and chambers, kg; one per rig for a batch."""
        return self._one(self.plant.solver.held()[0])

    def energy_j(self) -> float | Floats:
        """Returns the energy of all gas (and yielding walls) in pipes and chambers, J."""
        return self._one(self.plant.solver.held()[1])

    def _one(self, of_rigs: Floats) -> float | Floats:
        return float(of_rigs[0]) if self._single else of_rigs

    def _broken(self, chambers: Floats) -> str:
        """The first part whose gas has no positive pressure and density; none is an empty string.

        Args:
            chambers: (samples, n_chambers, lanes) pressures, Pa.
        """
        for c, name in enumerate(self.plant.plan.chambers):
            if not (chambers[:, c] > 0.0).all():
                return f"in chamber {name!r}"
        if self.plant.solver.sound():
            return ""
        for name in self.plant.rigs[0].pipes:  # those of cylinders have cells that nobody uses
            density, _, pressure = self.plant.gas_in(name)
            if not ((density > 0.0) & (pressure > 0.0) & np.isfinite(pressure)).all():
                return f"in pipe {name!r}"
        return ""

    def _held(self, commands: Mapping[str, float | ArrayLike], steps: int) -> Floats:
        """(1, valves, steps) commands, one value per interval of the samples."""
        plan = self.plant.plan
        missing = [name for name in plan.commands if name not in commands]
        if missing:
            raise InputError(f"command {missing[0]!r}: found none, the rig's valve needs one")
        held = np.empty((1, len(plan.commands), steps))
        for name, value in commands.items():
            if name not in plan.commands:
                raise InputError(
                    f"command {name!r}: the rig has none of that name"
                    f" ({', '.join(plan.commands) or 'no commands at all'})"
                )
            series = np.asarray(value, dtype=float)
            if series.ndim > 1 or (series.ndim == 1 and series.size not in (steps, steps + 1)):
                raise InputError(
                    f"command {name!r}: found shape {series.shape}, needed is one number or"
                    f" {steps} of them"
                )
            if not np.isfinite(series).all():
                raise InputError(f"command {name!r}: found a value that is not finite")
            for v, command in enumerate(plan.commands):  # several valves may share one
                if command == name:
                    held[0, v] = series if series.ndim == 0 else series[:steps]
        return held

    def _named(self, names: Sequence[str], series: Floats) -> dict[str, Floats]:
        one = 0 if self._single else slice(None)
        return {name: series[:, i, one] for i, name in enumerate(names)}


def run_from_rest(
    rig: Rig, commands: Mapping[str, Floats], sample_s: float, samples: int
) -> FromRest:
    """Runs a rig that starts from rest, by whichever model steps it; see `ModelKind.from_rest`.

    Args:
        rig: The rig.
        commands: (T,) volts per command.
        sample_s: Interval of commands and readings, s.
        samples: How many there are.
    """
    seen = Simulator(rig).run((samples - 1) * sample_s, commands, sample_s)
    return FromRest(seen.taps, seen.joints, seen.speeds, seen.encoders)
