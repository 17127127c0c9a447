# SPDX-License-Identifier: Apache-2.0
"""MuJoCo over a whole trajectory at once: inverse dynamics, sensors and what they change by.

Threads share the knots; MuJoCo lets go of the interpreter while it computes. Inverse dynamics is in
closed form, contacts included (Todorov, 2014), so that nothing here iterates or remembers.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from joblib import cpu_count
from numpy.typing import NDArray

from pneu_sim.mechanism.loading import mujoco_module
from pneu_sysid.contacts.bearings import Bearings

Floats = NDArray[np.float64]
T = TypeVar("T")

STEP = 1e-6
"""Of a finite difference of a knot's coordinates, velocities and accelerations, in their units."""
CHUNK = 64
"""Knots that a thread takes at a time."""


@dataclass(frozen=True)
class Motion:
    """Where a mechanism is at some instants, how fast, and what drives it.

    Attributes:
        q: (n, nq).
        v: (n, nv).
        a: (n, nv).
        control: (n, nu) of the actuators.
    """

    q: Floats
    v: Floats
    a: Floats
    control: Floats

    @property
    def there(self) -> NDArray[np.bool_]:
        """(n,) whether it is known at each instant, or ran away."""
        return np.asarray(np.isfinite(self.q).all(axis=1) & np.isfinite(self.v).all(axis=1))

    def whole(self, q: Floats) -> "Motion":
        """The same with another configuration where it is not known.

        Args:
            q: (n, nq).
        """
        known = np.where(self.there[:, None], self.q, q)
        return Motion(known, np.nan_to_num(self.v), np.nan_to_num(self.a), self.control)


@dataclass(frozen=True)
class Slopes:
    """What forces and sensors change by, output last.

    Attributes:
        force: (3, n, nv, nv) of `Physics.evaluate`'s forces by position, velocity, acceleration.
        sensors: (3, n, nv, ns) of its sensors.
    """

    force: Floats
    sensors: Floats


class Physics:
    """Threads that evaluate MuJoCo models.

    Args:
        workers: How many; all cores by default.
    """

    def __init__(self, workers: int | None = None) -> None:
        self.workers = workers or cpu_count()
        self._mujoco = mujoco_module()
        self._pool = ThreadPoolExecutor(self.workers)

    def evaluate(
        self, model: Any, motion: Motion, bearings: Bearings | None = None
    ) -> tuple[Floats, Floats]:
        """Forces that nobody applied, and what sensors read.

        Args:
            model: An ``MjModel``.
            motion: The motion.
            bearings: Joints whose friction grows with their load.

        Returns:
            (n, nv) generalised forces that the motion takes beyond those of actuators,
            and (n, ns) sensor data.
        """
        n = len(motion.q)
        force = np.empty((n, model.nv))
        sensors = np.empty((n, model.nsensordata))
        inverse, actuation = self._mujoco.mj_inverse, self._mujoco.mj_fwdActuation

        def some(first: int, last: int) -> None:
            data = self._mujoco.MjData(model)
            q, v, a, u = data.qpos, data.qvel, data.qacc, data.ctrl
            told, read = data.qfrc_inverse, data.sensordata
            for i in range(first, last):
                q[:] = motion.q[i]
                v[:] = motion.v[i]
                a[:] = motion.a[i]
                if model.nu:
                    u[:] = motion.control[i]
                inverse(model, data)
                force[i] = told
                sensors[i] = read
                if model.nu:
                    actuation(model, data)
                    force[i] -= data.qfrc_actuator

        self._over(n, some)
        if bearings is not None:
            force[:, bearings.along] += bearings.torque(sensors, motion.v)
        return force, sensors

    def slopes(
        self, model: Any, motion: Motion, centred: bool = True, bearings: Bearings | None = None
    ) -> Slopes:
        """What `evaluate` changes by with position, velocity and acceleration.

        Args:
            model: An ``MjModel``.
            motion: The motion.
            centred: Whether differences are taken both ways, at twice the time: their error is then
                of second order, which matters where contacts are stiff.
            bearings: Joints whose friction grows with their load.
        """
        n, nv, ns = len(motion.q), int(model.nv), int(model.nsensordata)
        force = np.empty((3, n, nv, nv))
        sensors = np.empty((3, n, nv, ns))
        differences = self._mujoco.mjd_inverseFD

        def some(first: int, last: int) -> None:
            data = self._mujoco.MjData(model)
            q, v, a, u = data.qpos, data.qvel, data.qacc, data.ctrl
            f = [np.empty((nv, nv)) for _ in range(3)]
            s: list[Floats | None] = [np.empty((nv, ns)) if ns else None for _ in range(3)]
            for i in range(first, last):
                for way in (STEP, -STEP) if centred else (STEP,):
                    q[:] = motion.q[i]
                    v[:] = motion.v[i]
                    a[:] = motion.a[i]
                    if model.nu:
                        u[:] = motion.control[i]
                    differences(model, data, way, bool(model.nu), *f, *s, None)
                    for k in range(3):
                        read = s[k]
                        if way > 0.0:
                            force[k, i] = f[k]
                            if read is not None:
                                sensors[k, i] = read
                        else:
                            force[k, i] = 0.5 * (force[k, i] + f[k])
                            if read is not None:
                                sensors[k, i] = 0.5 * (sensors[k, i] + read)

        self._over(n, some)
        if bearings is not None:
            read = self.evaluate(model, motion)[1]
            force[:, :, :, bearings.along] += bearings.slopes(read, motion.v, sensors)
        return Slopes(force, sensors)

    def contact_forces(self, model: Any, motion: Motion) -> Floats:
        """Generalised forces of contacts and other constraints.

        Args:
            model: An ``MjModel``.
            motion: The motion.

        Returns:
            (n, nv).
        """
        out = np.empty((len(motion.q), model.nv))

        def some(first: int, last: int) -> None:
            data = self._mujoco.MjData(model)
            for i in range(first, last):
                data.qpos[:] = motion.q[i]
                data.qvel[:] = motion.v[i]
                data.qacc[:] = motion.a[i]
                self._mujoco.mj_inverse(model, data)
                out[i] = data.qfrc_constraint

        self._over(len(out), some)
        return out

    def each(self, one: Callable[..., T], *of: Sequence[Any]) -> list[T]:
        """Calls a function for each of several things, in threads; MuJoCo lets them run together.

        Args:
            one: The function; it must not call what waits for these threads.
            of: Its arguments, one list each.
        """
        if self.workers == 1:
            return [one(*these) for these in zip(*of, strict=True)]
        with ThreadPoolExecutor(self.workers) as pool:
            return list(pool.map(one, *of))

    def _over(self, n: int, some: Callable[[int, int], None]) -> None:
        if self.workers == 1 or n <= CHUNK:
            some(0, n)
            return
        starts = range(0, n, CHUNK)
        tasks = [self._pool.submit(some, k, min(k + CHUNK, n)) for k in starts]
        for task in tasks:
            task.result()
