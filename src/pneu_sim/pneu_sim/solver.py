# SPDX-License-Identifier: Apache-2.0
"""What a kind of model is to be stepped by: the gas of rigs side by side, advanced in time."""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sim.rig.model import Model
from pneu_sim.rig.plan import Plan

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Series:
    """What was recorded of rigs side by side, beginning with the state it started from.

    Attributes:
        taps: (samples, n_taps, lanes) pressures, Pa.
        flows: (samples, n_ports, lanes) flows of ports, kg/s.
        chambers: (samples, n_chambers, lanes) pressures, Pa.
        temperatures: (samples, n_chambers, lanes) of the gas in chambers, K; not finite where the
            model knows none.
        cylinders: (samples, n_cylinders, 3, lanes) extension, m, its speed, m/s, and force of gas
            and room on the piston, N.
        joints: (samples, n_joints, 2, lanes) positions and velocities of the joints of bodies.
    """

    taps: Floats
    flows: Floats
    chambers: Floats
    temperatures: Floats
    cylinders: Floats
    joints: Floats

    @classmethod
    def empty(cls, plan: Plan, samples: int, lanes: int) -> "Series":
        """Room for what will be recorded.

        Args:
            plan: The rigs' grid.
            samples: How many.
            lanes: Rigs.
        """
        chambers = len(plan.chambers)
        return cls(
            np.zeros((samples, len(plan.taps), lanes)),
            np.zeros((samples, plan.ports.shape[0], lanes)),
            np.zeros((samples, chambers, lanes)),
            np.zeros((samples, chambers, lanes)),
            np.zeros((samples, len(plan.cylinders), 3, lanes)),
            np.zeros((samples, len(plan.joints), 2, lanes)),
        )

    def last(self) -> "Series":
        """Returns the last sample alone."""
        return Series(*(getattr(self, name.name)[-1:] for name in fields(self)))

    def put(self, first: int, part: "Series", lanes: Ints | slice = slice(None)) -> None:
        """Takes over what was recorded of a part of the time, or of some rigs.

        Args:
            first: Number of its first sample.
            part: What was recorded.
            lanes: Its rigs.
        """
        for name in fields(self):
            of = getattr(part, name.name)
            getattr(self, name.name)[first : first + len(of), ..., lanes] = of


class Solver(ABC):
    """The gas of rigs of one structure side by side.

    Attributes:
        plan: Their grid; a model without cells takes the names and the order of parts from it.
        models: Their numbers in full: valves, sensors, room.
        step_s: Longest step, s; shorter ones that divide an interval are taken.
    """

    plan: Plan
    models: list[Model]
    step_s: float

    @property
    def lanes(self) -> int:
        """Number of rigs."""
        return len(self.models)

    def steps(self, interval_s: float) -> int:
        """Steps that are taken in an interval.

        Args:
            interval_s: Its length, s.
        """
        return max(1, math.ceil(interval_s / self.step_s - 1e-9))

    @abstractmethod
    def fill(
        self,
        pressure_pa: Floats,
        chamber_pressure_pa: Floats,
        temperature_k: Floats,
        chamber_temperature_k: Floats,
    ) -> None:
        """Fills all with gas at rest; reservoirs stand at their pressures, time at zero.

        Args:
            pressure_pa: (slots, lanes) along the pipes.
            chamber_pressure_pa: (n_chambers, lanes).
            temperature_k: (slots, lanes).
            chamber_temperature_k: (n_chambers, lanes).
        """

    @abstractmethod
    def advance(self, opening: Floats, interval_s: float) -> Series:
        """Advances all; a rig that becomes unstable is not finite from then on.

        How a run is cut into calls changes no bit of it.

        Args:
            opening: (intervals, knots + 1, n_ports, lanes) openings, linear from knot to knot; both
                ends of an interval are its own.
            interval_s: Length of an interval, s.

        Returns:
            intervals + 1 samples, the first of the present state.
        """

    @abstractmethod
    def state(self) -> list[NDArray[Any]]:
        """Returns copies of all that the future depends on, the rig as the last index."""

    @abstractmethod
    def set_state(self, parts: Sequence[NDArray[Any]]) -> None:
        """Goes back to a state.

        Args:
            parts: As of `state`, of a solver of the same structure and step.
        """

    @abstractmethod
    def set_reservoir(self, index: int, pressure_pa: Floats | float) -> None:
        """Changes what a reservoir supplies from now on, until all is filled anew.

        Args:
            index: Its number.
            pressure_pa: A number or one per rig, at no flow, absolute, Pa.
        """

    def gas_in(self, pipe: str) -> tuple[Floats, Floats, Floats]:
        """Density, kg/m^3, velocity, m/s, and pressure, Pa, in the cells of a pipe.

        Args:
            pipe: Name of the pipe.

        Returns:
            Each (cells, lanes).

        Raises:
            InputError: The model knows no gas along its lines.
        """
        raise no_lines(pipe)

    def set_gas(self, pipe: str, density: Floats, velocity: Floats, pressure: Floats) -> None:
        """Sets the gas in the cells of a pipe; its walls forget what they remember.

        Args:
            pipe: Name of the pipe.
            density: (cells, lanes) kg/m^3.
            velocity: (cells, lanes) m/s.
            pressure: (cells, lanes) Pa.

        Raises:
            InputError: The model knows no gas along its lines.
        """
        raise no_lines(pipe)

    def set_chamber(self, index: int, pressure_pa: Floats, temperature_k: Floats) -> None:
        """Sets the gas in a chamber.

        Args:
            index: Its number.
            pressure_pa: (lanes,) Pa.
            temperature_k: (lanes,) K.

        Raises:
            InputError: In the model a chamber has no gas of its own.
        """
        raise InputError(
            f"chamber {self.plan.chambers[index]!r}: the rig's model knows no gas in it but that of"
            " a whole volume"
        )

    def place(self, position: Floats, velocity: Floats) -> None:
        """Sets joints of bodies and their pistons; gas keeps pressure and temperature.

        Args:
            position: (n_joints, lanes) rad or m.
            velocity: (n_joints, lanes) per second.

        Raises:
            InputError: The model has none that move, or a piston would stand beyond its stroke.
        """
        raise InputError("joints: the rig's model moves no bodies")

    def sound(self) -> bool:
        """Returns whether all gas along lines, where the model has any, has energy and density."""
        return True

    @property
    def unit_s(self) -> float:
        """Time of which every interval has to be a whole number, s; 0 where any will do."""
        return 0.0

    @property
    def joint_names(self) -> list[str]:
        """Names of the joints of bodies."""
        return self.plan.joints

    def joints(self) -> Floats:
        """Returns (n_joints, 2, lanes) positions and velocities of the joints of bodies."""
        return np.zeros((0, 2, self.lanes))

    def drive(self, speed: Floats) -> None:
        """Has pistons that move no body go at some speed from now on.

        Args:
            speed: (n_cylinders, lanes) m/s, or rad/s; of those that move bodies it is not used.

        Raises:
            InputError: The model has none that move.
        """
        raise InputError("cylinders: the rig's model moves no pistons")

    def start_pistons(self, extension: Floats) -> None:
        """Sets where pistons that move no body stand from the next filling on.

        Args:
            extension: (n_cylinders, lanes) m, or rad; of those that move bodies it is not used.

        Raises:
            InputError: The model has none that move, or one would stand beyond its stroke.
        """
        raise InputError("cylinders: the rig's model moves no pistons")

    def impulse(self) -> Floats:
        """Impulse of gas and room on every piston since this was last asked for, N s.

        Returns:
            (n_cylinders, lanes).

        Raises:
            InputError: The model does not keep it.
        """
        raise InputError("cylinders: the rig's model moves no pistons")

    def friction_heat(self) -> Floats:
        """Returns what friction and damping made of bodies, (n_bodies, lanes), J."""
        return np.zeros((0, self.lanes))

    def held(self) -> tuple[Floats, Floats]:
        """Mass, kg, and energy, J, of all gas (and yielding walls), each (lanes,).

        Raises:
            InputError: The model does not keep them.
        """
        raise InputError("mass and energy: the rig's model does not keep them")


def no_lines(pipe: str) -> InputError:
    """The error of a model that is asked for gas along a line.

    Args:
        pipe: Name of the line.
    """
    return InputError(f"line {pipe!r}: the rig's model knows no gas along its lines")
