# SPDX-License-Identifier: Apache-2.0
"""Many rigs side by side, one control period at a time: what controllers are trained on.

The same rig file gives a plant by the full model or by a lumped one (thesis 3.2.1): its ``model``
says which. A plant tells what its sensors show, without noise; commands reach the valves after the
delay of each rig. `ControlPlant` is of lines with one valve, `RobotPlant` of what moves.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sim.plant import Plant, State
from pneu_sim.rig.model import S_OFFSET, V_DELAY
from pneu_sim.rig.network import reservoir_of_pipes
from pneu_sim.rig.schema import Rig
from pneu_sim.solver import Series

Floats = NDArray[np.float64]

SAMPLE_S = 2e-3
"""Openings and sensors are followed at least this finely within a period."""


class SteppedPlant:
    """Rigs of one structure side by side, stepped by control periods.

    Attributes:
        rigs: The rigs.
        count: How many.
        taps: Names of their taps.
        encoders: Names of their encoders.
        commands: Names of their commands, one per valve.
        period_s: Control period, s.
    """

    def __init__(self, rigs: Sequence[Rig], period_s: float, dx_m: float | None = None) -> None:
        """Builds the rigs by the model that they name.

        Args:
            rigs: The rigs, of one structure.
            period_s: Control period, s; the time step divides it.
            dx_m: Cell length that replaces the rigs' own, m.

        Raises:
            InputError: The rigs do not share one structure, a tap's clock is off, or they cannot be
                stepped.
        """
        if not (math.isfinite(period_s) and 2e-4 <= period_s <= 1.0):
            raise InputError(f"period_s: found {period_s:g}, allowed are 0.0002 to 1 s")
        self._plant = Plant(rigs, dx_m)
        plan, models = self._plant.plan, self._plant.solver.models
        if any(np.any(m.sensor[:, S_OFFSET] != 0.0) for m in models):
            raise InputError(f"rig {rigs[0].name!r}: a tap's clock is off, a controller's must not")
        self.rigs = self._plant.rigs
        self.count = len(self.rigs)
        self.taps = tuple(plan.taps)
        self.encoders = tuple(plan.encoders)
        self.commands = tuple(plan.commands)
        self.period_s = period_s
        self._samples = max(1, math.ceil(period_s / SAMPLE_S - 1e-9))
        self._own_delay_s = self._plant.spools.spool[:, :, V_DELAY].copy()
        fed = reservoir_of_pipes(self.rigs[0], plan.reservoirs)
        self._behind = [*(name for name in plan.pipes if name not in fed), *plan.chambers]

    @property
    def step_s(self) -> float:
        """Longest time step of the physics that is stable, or the one that was set, s."""
        return self._plant.solver.step_s

    @property
    def cells(self) -> int:
        """How many cells all lines have together."""
        return sum(cells for _, cells in self._plant.plan.pipes.values())

    def set_step(self, step_s: float) -> None:
        """Sets the time step of the physics, from the next reset on.

        Args:
            step_s: Step that divides the period, s; shorter than the stable one.
        """
        steps = round(self.period_s / step_s)
        # Samples hold whole steps: the most samples, up to the usual, that divide the steps.
        usual = max(1, math.ceil(self.period_s / SAMPLE_S - 1e-9))
        self._samples = max(n for n in range(1, usual + 1) if steps % n == 0)
        self._plant.solver.step_s = self.period_s / steps

    def set_delay(self, delay_s: Floats) -> None:
        """Sets how late commands reach the valves, from the next reset on.

        Args:
            delay_s: (count,) delay beyond the rig's own, s.
        """
        self._plant.spools.spool[:, :, V_DELAY] = self._own_delay_s + delay_s[:, None]

    def state(self) -> State:
        """Returns all that the future depends on, to come back to it with `set_state`."""
        return self._plant.state()

    def set_state(self, state: State, lanes: NDArray[np.int64] | None = None) -> None:
        """Goes back to a state, or puts rigs into the states of others.

        Args:
            state: A state of this plant, or of one of the same structure.
            lanes: (count,) the lane of the state that each rig takes; None is its own.
        """
        self._plant.set_state(state if lanes is None else state.of(np.asarray(lanes)))

    def line(self, points: Sequence[tuple[str, int]]) -> Floats:
        """Gas at evenly spaced points of lines.

        Args:
            points: Pipes with their numbers of points.

        Returns:
            (count, 3 points): per pipe densities, kg/m^3, velocities, m/s, and pressures, Pa.

        Raises:
            InputError: There is no such pipe, or the model knows no gas along its lines.
        """
        return self._plant.gas_along(points).T

    def _advance(self, volts: Floats) -> tuple[Series, Floats]:
        """What was recorded of one period, and what the sensors then showed, (n, count).

        Args:
            volts: (count, valves).

        Raises:
            InputError: A simulation became unstable.
        """
        held = np.repeat(volts[:, :, None], self._samples, axis=2)
        series, readings = self._plant.advance(held, self.period_s / self._samples)
        if not np.isfinite(readings[-1]).all():
            raise InputError(f"rig {self.rigs[0].name!r}: the simulation became unstable")
        return series, readings[-1]


class ControlPlant(SteppedPlant):
    """Rigs of one valve, each commanded by its own voltage."""

    def __init__(self, rigs: Sequence[Rig], period_s: float, dx_m: float | None = None) -> None:
        """Builds the rigs; see `SteppedPlant`.

        Args:
            rigs: The rigs, of one structure.
            period_s: Control period, s.
            dx_m: Cell length that replaces the rigs' own, m.

        Raises:
            InputError: As of `SteppedPlant`, or the rigs have another number of valves than one.
        """
        super().__init__(rigs, period_s, dx_m)
        if len(self.commands) != 1:
            raise InputError(
                f"rig {rigs[0].name!r}: found {len(self.commands)} valves, this controls one"
            )

    def reset(self, pressure_pa: Floats | float) -> Floats:
        """Fills what lies behind the valve with gas at rest; the valve has long been closed.

        Args:
            pressure_pa: (count,) pressure there, Pa; all else has its reservoir's.

        Returns:
            Readings as of `readings`.
        """
        self._plant.reset(dict.fromkeys(self._behind, pressure_pa), long_closed=True)
        return self.readings()

    def step(self, volts: Floats | float) -> Floats:
        """Advances by one period under a voltage each.

        Args:
            volts: (count,) voltages.

        Returns:
            Readings at the end of the period, as of `readings`.

        Raises:
            InputError: A simulation became unstable.
        """
        each = np.broadcast_to(volts, (self.count,))
        _, readings = self._advance(each[:, None])
        return np.ascontiguousarray(readings.T)

    def readings(self) -> Floats:
        """Returns what the sensors show now, without noise: (count, taps), Pa."""
        return np.ascontiguousarray(self._plant.readings().T)


class RobotPlant(SteppedPlant):
    """Rigs that move, each under its own voltages.

    Attributes:
        joints: Names of the joints of bodies.
        cylinders: Names of the cylinders.
    """

    def __init__(self, rigs: Sequence[Rig], period_s: float, dx_m: float | None = None) -> None:
        """Builds the rigs; see `SteppedPlant`.

        Args:
            rigs: The rigs, of one structure.
            period_s: Control period, s.
            dx_m: Cell length that replaces the rigs' own, m.

        Raises:
            InputError: As of `SteppedPlant`.
        """
        super().__init__(rigs, period_s, dx_m)
        self.joints = tuple(self._plant.solver.joint_names)
        self.cylinders = tuple(self._plant.plan.cylinders)
        self._force_n = np.zeros((self.count, len(self.cylinders)))

    def reset(
        self,
        pressures_pa: Mapping[str, Floats] | Floats | float,
        positions: Mapping[str, Floats] | None = None,
        velocities: Mapping[str, Floats] | None = None,
    ) -> None:
        """Fills what lies behind valves, and places joints; valves have long been closed.

        Args:
            pressures_pa: (count,) pressure behind all valves, Pa, or by pipe and chamber.
            positions: (count,) by joint; others stand where the rig starts.
            velocities: (count,) by joint; others rest.
        """
        given: dict[str, Floats | float] = (
            {**pressures_pa}
            if isinstance(pressures_pa, Mapping)
            else dict.fromkeys(self._behind, pressures_pa)
        )
        self._plant.reset(given, long_closed=True)
        if positions or velocities:
            self._plant.place(positions or {}, velocities)

    def start_pistons(self, extensions: Floats) -> None:
        """Sets where pistons that move no body stand from the next reset on.

        Args:
            extensions: (count, cylinders) m, or rad.
        """
        self._plant.solver.start_pistons(extensions.T)

    def drive(self, speeds: Floats) -> None:
        """Has pistons that move no body go at some speed from now on.

        Args:
            speeds: (count, cylinders) m/s, or rad/s.
        """
        self._plant.solver.drive(speeds.T)

    def step(self, volts: Floats) -> None:
        """Advances by one period.

        Args:
            volts: (count, valves) in the order of `commands`.

        Raises:
            InputError: A simulation became unstable.
        """
        series, _ = self._advance(volts)
        self._force_n = series.cylinders[-1, :, 2].T

    def seen(self) -> tuple[Floats, Floats]:
        """What the sensors show now, without noise.

        Returns:
            (count, taps) pressures, Pa, and (count, encoders) positions, rad or m.
        """
        readings = self._plant.readings().T
        return readings[:, : len(self.taps)].copy(), readings[:, len(self.taps) :].copy()

    def motion(self) -> tuple[Floats, Floats]:
        """True positions and velocities of joints, each (count, joints)."""
        joints = self._plant.solver.joints()
        return joints[:, 0].T.copy(), joints[:, 1].T.copy()

    def forces(self) -> Floats:
        """(count, cylinders) force of gas and room on pistons at the end of the last step, N."""
        return self._force_n

    def spools(self) -> Floats:
        """(count, 2 valves) positions, V, then speeds, V/s, of the spools."""
        memory = self._plant.spools.memory
        return np.concatenate([memory[:, :, 1], memory[:, :, 2]], axis=1)
