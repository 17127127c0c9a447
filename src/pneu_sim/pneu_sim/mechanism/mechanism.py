# SPDX-License-Identifier: Apache-2.0
"""Mechanisms of rigs side by side, moved by MuJoCo under the forces of their cylinders.

They run as one `mujoco.batch.Batch`: a row of state for each rig, and threads over the rigs that
change no bit of what comes out. Of all ways to step small models that was the fastest measured.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numba import get_num_threads
from numpy.typing import ArrayLike, NDArray

from pneu_common.errors import InputError
from pneu_sim.mechanism.loading import id_of, limit, load, mujoco_module, scalar_joint
from pneu_sim.mechanism.settings import MechanismSettings

Floats = NDArray[np.float64]

LEAST_PER_THREAD = 4
"""Rigs below which a thread of its own is not worth waking."""


class Mechanism:
    """Mechanisms of one MJCF side by side, that differ in parameters.

    A rig that becomes unstable, or is given a force that is not finite, is not finite from then on,
    and is stepped no more.

    Attributes:
        cylinders: Names of the cylinders, in the order of all rows.
        joints: Names of the joints of one coordinate, in the order of all rows.
        step_s: Physics step, s.
        settings: What the first rig says.
        stroke_m: (n_cyl, lanes) strokes, m; not finite where none is known.
    """

    def __init__(
        self,
        settings: MechanismSettings | Sequence[MechanismSettings],
        lanes: int | None = None,
        folder: str | Path = ".",
        stroke_m: Mapping[str, ArrayLike] | None = None,
        threads: int | None = None,
    ) -> None:
        """Compiles the MJCF, binds the cylinders and begins at the start.

        Args:
            settings: What the rigs say: one for all, or one each, that differ in parameters,
                offsets and starts alone.
            lanes: Number of rigs; None is as many as there are settings.
            folder: Folder that the MJCF's path is relative to.
            stroke_m: Strokes of the cylinders by name, a number or one per rig, m. A piston stops
                at extensions of 0 and of its stroke; one without a stroke goes anywhere.
            threads: Most threads; None is as many as Numba has. They change no result.

        Raises:
            InputError: MuJoCo is missing, or the settings do not fit the MJCF or one another.
        """
        each = [settings] if isinstance(settings, MechanismSettings) else list(settings)
        lanes = len(each) if lanes is None else lanes
        if len(each) not in (1, lanes):
            raise InputError(f"mechanism: found {len(each)} settings, 1 or {lanes} are needed")
        self._each = each * lanes if len(each) == 1 else each
        self.settings = first = self._each[0]
        for other in each[1:]:
            _check_alike(first, other)
        self._loaded = load(first, folder)
        model = self._loaded.model
        self.cylinders = list(first.cylinders)
        self.joints = self._loaded.joints
        self.step_s = float(model.opt.timestep)
        self._offset = np.array(
            [[s.cylinders[name].offset_m for s in self._each] for name in self.cylinders]
        )
        self._gear = np.array([[first.cylinders[name].gear] for name in self.cylinders])
        self.stroke_m = np.full((len(self.cylinders), lanes), np.inf)
        for name, stroke in (stroke_m or {}).items():
            if name not in self.cylinders:
                raise InputError(
                    f"{self._loaded.path}: stroke of {name!r}: the mechanism has"
                    f" {', '.join(self.cylinders)}"
                )
            self.stroke_m[self.cylinders.index(name)] = stroke
        ranges = self._ranges()
        self._mujoco = mujoco_module()
        most = get_num_threads() if threads is None else threads
        self._batch = self._mujoco.batch.Batch(
            model, lanes, max(1, min(most, lanes // LEAST_PER_THREAD))
        )
        for tendon, rows in ranges.items():
            self._batch.expand("tendon_range")[:, tendon] = rows
        self._own_friction = model.tendon_frictionloss[self._loaded.tendons].copy()
        self._friction: Floats | None = None
        self._set_parameters()
        self._length, self._velocity, self._qpos, self._qvel, self._control = (
            self._batch.bind(name)
            for name in ("actuator_length", "actuator_velocity", "qpos", "qvel", "ctrl")
        )
        # The stages that lengths and speeds come from.
        self._current = self._mujoco.mjtStage.mjSTAGE_VEL.value
        self._alive = np.ones(lanes, bool)
        self._start = self._starts()
        self.reset()
        self._check_start()

    @property
    def lanes(self) -> int:
        """Number of rigs."""
        return len(self._each)

    @property
    def model(self) -> Any:
        """MuJoCo's model (`mujoco.MjModel`) of all rigs but for their parameters."""
        return self._batch.model

    def data(self, lane: int = 0) -> Any:
        """MuJoCo's data (`mujoco.MjData`) of a rig, all computed, to draw it or look into it.

        Args:
            lane: Which rig.
        """
        data = self._batch.get_data(lane)
        self._mujoco.mj_forward(self._batch.get_model(lane), data)
        return data

    def reset(self) -> None:
        """Goes back to the start, at time zero."""
        self._alive[:] = True
        self._batch.reset(keyframe=self._start[0], stage=self._mujoco.mjtStage.mjSTAGE_NONE.value)
        self._qpos[...] = self._start[1]
        self._refresh()

    def extension(self) -> Floats:
        """Returns extensions of the cylinders: (n_cyl, lanes), m."""
        return self._extension.copy()

    def speed(self) -> Floats:
        """Returns speeds of the pistons, positive where they extend: (n_cyl, lanes), m/s."""
        return self._speed.copy()

    def give(self) -> Floats:
        """Returns how fast an impulse makes the pistons at the start: (n_cyl, 1), 1/kg."""
        inverse = self._loaded.model.tendon_invweight0[self._loaded.tendons]
        return np.asarray(self._gear**2 * inverse[:, None])

    def joint_positions(self) -> Floats:
        """Returns positions of the joints of one coordinate: (n_joints, lanes), rad or m."""
        return self._known(self._qpos[:, self._loaded.positions].T)

    def joint_velocities(self) -> Floats:
        """Returns their velocities: (n_joints, lanes), rad/s or m/s."""
        return self._known(self._qvel[:, self._loaded.velocities].T)

    def steps(self, duration_s: float) -> int:
        """Physics steps in a duration.

        Args:
            duration_s: The duration, s.

        Raises:
            InputError: It is no whole number of steps.
        """
        n = round(duration_s / self.step_s)
        if n < 1 or abs(duration_s - n * self.step_s) > 1e-6 * self.step_s:
            raise InputError(
                f"{self._loaded.path}: step_s: found {self.step_s:g} s in an interval of"
                f" {duration_s:g} s, a whole number of steps is needed"
            )
        return n

    def advance(
        self, force_n: Floats, duration_s: float, friction_n: Floats | None = None
    ) -> Floats:
        """Moves the mechanisms by whole physics steps.

        Args:
            force_n: (n_cyl, lanes) forces of the gas on the pistons, N, positive where they extend
                the cylinders; constant over the duration.
            duration_s: How long, s; a whole number of steps.
            friction_n: (n_cyl, lanes) dry friction of the pistons, N, each no less than 0; None is
                none. It holds what sticks, and comes to what the MJCF gives a tendon.

        Returns:
            (n_cyl, lanes) by how much the extensions grew, m.

        Raises:
            InputError: The duration is no whole number of steps.
        """
        n = self.steps(duration_s)
        before = self._extension
        self._set_friction(friction_n)
        fine = np.isfinite(force_n)
        if not fine.all():
            self._alive &= fine.all(axis=0)
            force_n = np.where(self._alive, force_n, 0.0)
        self._control[:, self._loaded.cylinders] = force_n.T
        self._batch.step(self._ids(), n, self._current)
        self._read()
        return self._extension - before

    def state(self) -> list[NDArray[Any]]:
        """Returns copies of all that the future depends on, the rig as the last index."""
        return [self._batch.state.T.copy(), self._alive.copy()]

    def set_state(self, parts: Sequence[NDArray[Any]]) -> None:
        """Goes back to a state.

        Args:
            parts: As of `state`, of a mechanism of the same structure and step.
        """
        rows, alive = parts
        self._batch.state[...] = rows.T
        self._alive[:] = alive
        self._refresh()

    def _refresh(self) -> None:
        """Has lengths and speeds follow from the state."""
        self._batch.forward(self._ids(), self._current)
        self._read()

    def _read(self) -> None:
        """Takes over where the pistons are; gives up rigs whose motion is past all bounds."""
        # MuJoCo refuses what is beyond mjMAXVAL; what is not finite does not compare.
        bound = self._mujoco.mjMAXVAL
        fine = (np.abs(self._qpos) < bound).all(axis=1) & (np.abs(self._qvel) < bound).all(axis=1)
        self._alive &= fine
        self._extension = self._known(self._length[:, self._loaded.cylinders].T - self._offset)
        self._speed = self._known(self._velocity[:, self._loaded.cylinders].T)

    def _ids(self) -> NDArray[np.int64] | None:
        """The rigs that are still to be stepped."""
        return None if self._alive.all() else np.flatnonzero(self._alive)

    def _known(self, values: Floats) -> Floats:
        """Values, none of rigs that have become unstable."""
        return values if self._alive.all() else np.where(self._alive, values, np.nan)

    def _set_friction(self, friction_n: Floats | None) -> None:
        """Gives the tendons the friction of the pistons, besides their own."""
        if friction_n is None:
            if self._friction is not None:
                self._friction[:, self._loaded.tendons] = self._own_friction
            return
        if self._friction is None:
            self._friction = self._batch.expand("tendon_frictionloss")
        self._friction[:, self._loaded.tendons] = (
            self._own_friction + (np.abs(self._gear) * friction_n).T
        )

    def _ranges(self) -> dict[int, Floats]:
        """Limits the tendons of pistons with a stroke; returns (lanes, 2) ranges where they differ.

        By number of the tendon; what is the same for all rigs stands in the model.
        """
        differ = {}
        for c, stroke in enumerate(self.stroke_m):
            if np.isfinite(stroke).all():
                low, high = (
                    (self._offset[c] + end) / self._gear[c] for end in (0.0 * stroke, stroke)
                )
                rows = limit(self._loaded, c, low, high)
                tendon = self._loaded.tendons[c]
                self._loaded.model.tendon_range[tendon] = rows[0]
                if (rows != rows[0]).any():
                    differ[tendon] = rows
        return differ

    def _set_parameters(self) -> None:
        """Gives the rigs their masses and dampings."""
        loaded, batch = self._loaded, self._batch
        weighed = False
        for lane, settings in enumerate(self._each):
            for name, mass in settings.masses_kg.items():
                body = id_of(loaded, "body", "masses_kg", name)
                was = loaded.model.body_mass[body]
                if was <= 0.0:
                    raise InputError(
                        f"{loaded.path}: masses_kg: found {name!r}, which has no mass in the MJCF"
                    )
                batch.expand("body_mass")[lane, body] = mass
                own = loaded.model.body_inertia[body]
                batch.expand("body_inertia")[lane, body] = own * (mass / was)
                weighed = True
            for name, damping in settings.damping.items():
                joint = scalar_joint(loaded, "damping", name)
                batch.expand("dof_damping")[lane, loaded.velocities[joint]] = damping
        if weighed:
            batch.set_const()

    def _starts(self) -> tuple[NDArray[np.int32], Floats]:
        """Keyframes, (lanes,), and coordinates, (lanes, nq), that the rigs start from."""
        loaded, model = self._loaded, self._loaded.model
        keys, qpos = [], []
        for settings in self._each:
            key = -1
            if settings.keyframe is not None:
                key = id_of(loaded, "key", "keyframe", settings.keyframe)
            q = (model.qpos0 if key < 0 else model.key_qpos[key]).copy()
            for name, position in settings.start.items():
                q[loaded.positions[scalar_joint(loaded, "start", name)]] = position
            keys.append(key)
            qpos.append(q)
        return np.array(keys, np.int32), np.array(qpos)

    def _check_start(self) -> None:
        """Refuses a start at which a piston would be outside of its cylinder."""
        extension = self.extension()
        outside = np.isfinite(self.stroke_m) & ~(
            (extension >= -1e-9) & (extension <= self.stroke_m + 1e-9)
        )
        for c, lane in np.argwhere(outside)[:1]:
            raise InputError(
                f"{self._loaded.path}: cylinders.{self.cylinders[c]}: found an extension of"
                f" {extension[c, lane]:g} m at the start, 0 to its stroke of"
                f" {self.stroke_m[c, lane]:g} m is allowed"
            )


def _check_alike(first: MechanismSettings, other: MechanismSettings) -> None:
    """Refuses rigs side by side whose mechanisms differ in more than parameters."""
    for name in ("mjcf", "step_s", "coupling"):
        one, two = getattr(first, name), getattr(other, name)
        if one != two:
            raise InputError(f"mechanism.{name}: found {two!r}, a rig beside it has {one!r}")
    grips = [{n: (g.held, g.gear) for n, g in s.cylinders.items()} for s in (first, other)]
    if list(grips[0].items()) != list(grips[1].items()):
        raise InputError(
            f"mechanism.cylinders: found {', '.join(other.cylinders)}, which are not bound as"
            f" {', '.join(first.cylinders)} of a rig beside it"
        )
