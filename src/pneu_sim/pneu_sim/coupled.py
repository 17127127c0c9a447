# SPDX-License-Identifier: Apache-2.0
"""The model in full whose pistons move a mechanism in MuJoCo: gas and mechanism step by step."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sim import layout as L
from pneu_sim import tile as tiles
from pneu_sim.full_solver import FullSolver
from pneu_sim.kernel.bodies import hold
from pneu_sim.mechanism.coupling import Coupling
from pneu_sim.mechanism.mechanism import Mechanism
from pneu_sim.rig.model import Model
from pneu_sim.rig.schema import Rig
from pneu_sim.solver import Series

Floats = NDArray[np.float64]


class CoupledSolver(FullSolver):
    """Rigs whose mechanisms MuJoCo moves, see ``pneu_sim.mechanism.coupling``.

    Attributes:
        mechanism: The mechanisms.
    """

    def __init__(self, models: Sequence[Model], rigs: Sequence[Rig]) -> None:
        """Lays the rigs out and builds their mechanisms.

        Args:
            models: The rigs in numbers, on one plan.
            rigs: The rigs.

        Raises:
            InputError: MuJoCo is missing, or the MJCF does not fit the rig.
        """
        super().__init__(models)
        settings = [rig.mechanism for rig in rigs if rig.mechanism is not None]
        names = list(settings[0].cylinders)
        self._of = np.array([self.plan.cylinders.index(name) for name in names])
        stroke = np.array([m.cylinder[self._of, L.PY_STROKE] for m in self.models]).T
        self.mechanism = Mechanism(
            settings, self.lanes, stroke_m=dict(zip(names, stroke, strict=True))
        )
        self._coupling = Coupling(self.mechanism)
        self._rows = np.stack([m.cylinder[self._of] for m in self.models], axis=-1)
        self._give = np.broadcast_to(self.mechanism.give(), self._rows[:, 0].shape)
        self._forget()

    @property
    def unit_s(self) -> float:
        """The physics step, s, of which an interval is a whole number."""
        return float(self.mechanism.step_s)

    @property
    def joint_names(self) -> list[str]:
        """Names of the mechanism's joints of one coordinate."""
        return self.mechanism.joints

    def fill(
        self,
        pressure_pa: Floats,
        chamber_pressure_pa: Floats,
        temperature_k: Floats,
        chamber_temperature_k: Floats,
    ) -> None:
        """Fills all with gas at rest, mechanisms at their start; see `Solver.fill`.

        Args:
            pressure_pa: (slots, lanes).
            chamber_pressure_pa: (n_chambers, lanes).
            temperature_k: (slots, lanes).
            chamber_temperature_k: (n_chambers, lanes).
        """
        self.mechanism.reset()
        self._coupling.reset()
        self._forget()
        start = self.mechanism.extension()
        for tile, of in self.tiles:
            tile.cylinder[self._of, L.PY_START] = start[:, of]
        super().fill(pressure_pa, chamber_pressure_pa, temperature_k, chamber_temperature_k)

    def advance(self, opening: Floats, interval_s: float) -> Series:
        """Advances gas and mechanisms; see `Solver.advance`.

        Args:
            opening: (intervals, knots + 1, n_ports, lanes).
            interval_s: Length of an interval, s; a whole number of physics steps.

        Raises:
            InputError: The interval is no whole number of physics steps.
        """
        out = replace(
            Series.empty(self.plan, len(opening) + 1, self.lanes),
            joints=np.zeros((len(opening) + 1, len(self.joint_names), 2, self.lanes)),
        )
        now = super().advance(opening[:0], interval_s)
        for n in range(len(opening) + 1):
            if n > 0:
                now = self._interval(opening[n - 1], interval_s)
            out.put(n, replace(now.last(), joints=self.joints()[None]))
        return out

    def _interval(self, opening: Floats, interval_s: float) -> Series:
        """Advances by one interval, physics step by physics step; what it ended with."""
        steps = self.mechanism.steps(interval_s)
        done, last = 0.0, None

        def gas(speed_m_s: Floats, duration_s: float) -> Floats:
            nonlocal done, last
            if duration_s == 0.0:
                return self._force() + self._held_by_springs(speed_m_s)
            speed = np.zeros((len(self.plan.cylinders), self.lanes))
            speed[self._of] = speed_m_s
            self.drive(speed)
            share = duration_s / interval_s
            ends = np.stack([_between(opening, done), _between(opening, done + share)])
            last = super(CoupledSolver, self).advance(ends[None], duration_s)
            done += share
            mean = self.impulse()[self._of] / duration_s
            return mean + self._held_by_springs(speed_m_s)

        for _ in range(steps):
            grip = self._grip()
            if grip is None or not (self._rows[:, L.PY_SOFT] > 0.0).any():
                self._coupling.step(gas, grip)
            else:
                self._coupling.step(gas, *self._bend(grip))
                self._bent = self._bent_by(self.mechanism.speed(), grip)
        assert last is not None
        return last

    def _forget(self) -> None:
        """Has soft seals straight, at rest."""
        shape = self._rows[:, 0].shape
        self._bent, self._impulse, self._before = (np.zeros(shape) for _ in range(3))

    def _bend(self, grip: Floats) -> tuple[Floats, Floats]:
        """Dry friction for MuJoCo's constraint, and the force of seals with presliding, N.

        MuJoCo's friction holds rigidly. Soft seals are bristles as those of bodies (`hold`), by the
        speed that the step before foresees.
        """
        row, h, speed = self._rows, self.mechanism.step_s, self.mechanism.speed()
        free = 2.0 * speed - self._before - self._give * self._impulse
        soft = np.where(grip > 0.0, row[:, L.PY_SOFT], 0.0)
        for c, j in np.ndindex(*grip.shape):
            self._impulse[c, j] = 0.0
            if soft[c, j] > 0.0:
                self._impulse[c, j] = hold(
                    free[c, j],
                    self._give[c, j],
                    h * grip[c, j],
                    self._bent[c, j],
                    h,
                    soft[c, j],
                    row[c, L.PY_SOFT_DAMPING, j],
                )
        self._before = speed
        return np.where(soft > 0.0, 0.0, grip), self._impulse / h

    def _bent_by(self, speed: Floats, grip: Floats) -> Floats:
        """Deflections of soft seals after a step, m."""
        h, soft = self.mechanism.step_s, self._rows[:, L.PY_SOFT]
        most = np.where((soft > 0.0) & (grip > 0.0), soft * grip, 1.0)
        after = (self._bent + h * speed) / (1.0 + h * np.abs(speed) / most)
        return np.asarray(np.where((soft > 0.0) & (grip > 0.0), after, 0.0))

    def _extension(self) -> Floats:
        """(n_cyl, lanes) extensions of the mechanism's cylinders, as the gas has them."""
        return self._whole(lambda tile: tile.cylinder_state[self._of, L.SY_EXTENSION])

    def _force(self) -> Floats:
        """(n_cyl, lanes) force of the gas on its pistons now, waves on their way left out."""
        return self._whole(lambda tile: tiles.force_at_rest(tile)[self._of])

    def _held_by_springs(self, speed_m_s: Floats) -> Floats:
        """(n_cyl, lanes) what springs and viscous friction of the cylinders add to that."""
        row = self._rows
        drawn = row[:, L.PY_PRELOAD] + row[:, L.PY_SPRING] * self._extension()
        return np.asarray(-drawn - row[:, L.PY_VISCOUS] * speed_m_s)

    def _grip(self) -> Floats | None:
        """(n_cyl, lanes) dry friction of the seals, N; None where there is none."""
        row = self._rows
        if not row[:, [L.PY_COULOMB, L.PY_PER_PA, L.PY_BREAKAWAY]].any():
            return None
        for tile, _ in self.tiles:
            tiles.force_at_rest(tile)  # of the present, so that no call before it matters
        both = slice(L.WY_FACE, L.WY_FACE + 2)
        faces = self._whole(lambda tile: tile.cylinder_work[self._of, both])
        gauge = np.maximum(faces.mean(axis=1) - row[:, L.PY_ROOM_P], 0.0)
        x = self.mechanism.speed() / row[:, L.PY_STRIBECK]
        return np.asarray(
            row[:, L.PY_COULOMB]
            + row[:, L.PY_PER_PA] * gauge
            + row[:, L.PY_BREAKAWAY] * np.exp(-(x**2))
        )

    def joints(self) -> Floats:
        """Positions and velocities of all joints; see `Solver.joints`."""
        return np.stack(
            [self.mechanism.joint_positions(), self.mechanism.joint_velocities()], axis=1
        )

    def place(self, position: Floats, velocity: Floats) -> None:
        """Refuses: a mechanism stands where its settings have it; see `Solver.place`.

        Args:
            position: (n_joints, lanes).
            velocity: (n_joints, lanes).

        Raises:
            InputError: Always.
        """
        raise InputError("joints: a mechanism starts from mechanism.start or its keyframe")

    def state(self) -> list[NDArray[Any]]:
        """Returns copies of all that the future depends on; see `Solver.state`."""
        own = [self._bent, self._impulse, self._before]
        return [*super().state(), *(part.copy() for part in own), *self._coupling.state()]

    def set_state(self, parts: Sequence[NDArray[Any]]) -> None:
        """Goes back to a state; see `Solver.set_state`.

        Args:
            parts: As of `state`.
        """
        of_gas = len(tiles.CHANGING) + 1
        super().set_state(parts[:of_gas])
        self._bent, self._impulse, self._before = (p.copy() for p in parts[of_gas : of_gas + 3])
        self._coupling.set_state(parts[of_gas + 3 :])


def _between(opening: Floats, share: float) -> Floats:
    """Openings some way through an interval, linear between its knots.

    Args:
        opening: (knots + 1, n_ports, lanes).
        share: How far, 0 to 1.
    """
    at = min(max(share, 0.0), 1.0) * (len(opening) - 1)
    k = min(int(at), len(opening) - 2)
    return np.asarray(opening[k] + (at - k) * (opening[k + 1] - opening[k]))
