# SPDX-License-Identifier: Apache-2.0
"""Friction of bearings by what they carry, which MuJoCo does not have."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_sim.mechanism.loading import mujoco_module
from pneu_sysid.contacts.names import load_name

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

CREEPS = 0.1
"""Velocity below which friction fades, rad/s or m/s: it has one value at each velocity."""


@dataclass(frozen=True)
class Bearings:
    """Joints whose friction grows with their load.

    Attributes:
        by: (b,) torque per force through the joint, m; of a joint that slides without unit.
        along: (b,) their directions of motion.
        load: (b,) where the force through each begins in sensor data.
    """

    by: Floats
    along: Ints
    load: Ints

    def torque(self, sensors: Floats, v: Floats) -> Floats:
        """(..., b) what friction takes, against the motion positive.

        Args:
            sensors: (..., ns) sensor data.
            v: (..., nv) velocities.
        """
        size = np.linalg.norm(self._force(sensors), axis=-1)
        return np.asarray(self.by * size * np.tanh(v[..., self.along] / CREEPS))

    def slopes(self, sensors: Floats, v: Floats, by: Floats) -> Floats:
        """(3, n, nv, b) what `torque` changes by with position, velocity and acceleration.

        Args:
            sensors: (n, ns) sensor data.
            v: (n, nv) velocities.
            by: (3, n, nv, ns) what sensor data change by.
        """
        force = self._force(sensors)
        size = np.linalg.norm(force, axis=-1)
        towards = force / np.maximum(size, 1e-12)[..., None]
        fades = np.tanh(v[:, self.along] / CREEPS)
        out = np.einsum("knvbi,nbi,nb->knvb", self._force(by), towards, self.by * fades)
        faster = self.by * size * (1.0 - fades**2) / CREEPS
        for b, direction in enumerate(self.along):
            out[1, :, direction, b] += faster[:, b]
        return np.asarray(out)

    def _force(self, sensors: Floats) -> Floats:
        """(..., b, 3) forces through the joints."""
        return sensors[..., self.load[:, None] + np.arange(3)]

    def slowing(self, model: Any, data: Any, step_s: float) -> Floats:
        """(b,) what friction takes, and no more than brings a joint to rest within a step.

        Args:
            model: An ``MjModel``.
            data: Its ``MjData``, after forward dynamics.
            step_s: The step, s.
        """
        torque = self.torque(data.sensordata, data.qvel)
        push = np.zeros((len(self.by), model.nv))
        push[np.arange(len(self.by)), self.along] = 1.0
        moves = np.empty_like(push)
        mujoco_module().mj_solveM(model, data, moves, push)
        gives = moves[np.arange(len(self.by)), self.along]  # acceleration per torque
        stops = np.abs(data.qvel[self.along]) / (gives * step_s)
        return np.asarray(np.clip(torque, -stops, stops))


def bearings_of(model: Any, by: dict[str, float]) -> Bearings | None:
    """A model's joints that have such friction; None where there are none.

    Args:
        model: An ``MjModel``.
        by: Torque per force, by the joint's name.
    """
    joints = [(model.joint(name).id, value) for name, value in by.items() if value != 0.0]
    if not joints:
        return None
    at = np.array([j for j, _ in joints])
    load = np.array([model.sensor_adr[model.sensor(load_name(model.joint(j).name)).id] for j in at])
    return Bearings(np.array([v for _, v in joints]), model.jnt_dofadr[at], load)


def feel_load(spec: Any, joint: str) -> None:
    """Adds a sensor of the force through a joint, last of all, where there is none.

    Args:
        spec: An ``MjSpec``, changed in place.
        joint: Name of the joint.
    """
    name = load_name(joint)
    if spec.sensor(name) is not None:
        return
    kinds = mujoco_module()
    spec.joint(joint).parent.add_site(name=name)
    spec.add_sensor(
        name=name,
        type=kinds.mjtSensor.mjSENS_FORCE,
        objtype=kinds.mjtObj.mjOBJ_SITE,
        objname=name,
    )
