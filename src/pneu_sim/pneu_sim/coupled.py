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
from pneu_sim.kernel.bodies import hold_in_parts
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
            self._coupling.step(gas, self._grip(), self._move)
        assert last is not None
        return last

    def _forget(self) -> None:
        """Has soft seals straight, at rest."""
        shape = self._rows[:, 0].shape
        self._bent, self._impulse = np.zeros(shape), np.zeros(shape)

    def _move(self, force_n: Floats, duration_s: float, grip: Floats | None) -> Floats:
        """Move the mechanisms by a step under the dry friction of their seals.

        MuJoCo's friction holds what sticks, rigidly, but is of first order where speeds change
        their sign. So a step is tried without it; what slides, and soft seals, then have the mean
        of a friction that is resolved in parts of the step.

        Args:
            force_n: (n_cyl, lanes) forces on the pistons besides friction, N.
            duration_s: The step, s.
            grip: (n_cyl, lanes) dry friction, N; None where there is none.

        Returns:
            (n_cyl, lanes) displacements of the pistons, m.
        """
        mechanism = self.mechanism
        if grip is None:
            return mechanism.advance(force_n, duration_s)
        row, kept, before = self._rows, mechanism.state(), mechanism.speed()
        soft = np.where(grip > 0.0, row[:, L.PY_SOFT], 0.0)
        tried = np.where(soft > 0.0, self._impulse, 0.0)
        mechanism.advance(force_n + tried / duration_s, duration_s)
        free, ours = mechanism.speed() - self._give * tried, grip > 0.0
        after, foreseen = self._bent.copy(), np.zeros_like(free)
        for c, j in zip(*np.nonzero(ours), strict=True):
            self._impulse[c, j], speed, after[c, j], foreseen[c, j] = hold_in_parts(
                before[c, j],
                free[c, j],
                self._give[c, j],
                grip[c, j],
                self._bent[c, j],
                duration_s,
                soft[c, j],
                row[c, L.PY_SOFT_DAMPING, j],
            )
            ours[c, j] = soft[c, j] > 0.0 or speed != 0.0
        impulse = np.where(ours, self._impulse, 0.0)
        mechanism.set_state(kept)
        moved = mechanism.advance(
            force_n + impulse / duration_s, duration_s, np.where(ours, 0.0, grip)
        )
        most = soft * grip
        self._bent = np.where(soft > 0.0, np.clip(after + moved - foreseen, -most, most), 0.0)
        return moved

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
        own = [self._bent, self._impulse]
        return [*super().state(), *(part.copy() for part in own), *self._coupling.state()]

    def set_state(self, parts: Sequence[NDArray[Any]]) -> None:
        """Goes back to a state; see `Solver.set_state`.

        Args:
            parts: As of `state`.
        """
        of_gas = len(tiles.CHANGING) + 1
        super().set_state(parts[:of_gas])
        self._bent, self._impulse = (p.copy() for p in parts[of_gas : of_gas + 2])
        self._coupling.set_state(parts[of_gas + 2 :])


def _between(opening: Floats, share: float) -> Floats:
    """Openings some way through an interval, linear between its knots.

    Args:
        opening: (knots + 1, n_ports, lanes).
        share: How far, 0 to 1.
    """
    at = min(max(share, 0.0), 1.0) * (len(opening) - 1)
    k = min(int(at), len(opening) - 2)
    return np.asarray(opening[k] + (at - k) * (opening[k + 1] - opening[k]))
