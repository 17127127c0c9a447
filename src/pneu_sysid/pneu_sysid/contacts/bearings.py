# SPDX-License-Identifier: Apache-2.0
"""Friction of bearings by what they carry, which MuJoCo does not have."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_sim.mechanism.loading import mujoco_module

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
        body: (b,) the bodies that they carry.
    """

    by: Floats
    along: Ints
    body: Ints

    def torque(self, model: Any, data: Any) -> Floats:
        """(b,) what friction takes, against the motion positive.

        Args:
            model: An ``MjModel``.
            data: Its ``MjData`` whose accelerations and contacts are known.
        """
        mujoco_module().mj_rnePostConstraint(model, data)
        load = np.linalg.norm(data.cfrc_int[self.body, 3:], axis=1)
        return np.asarray(self.by * load * np.tanh(data.qvel[self.along] / CREEPS))

    def slowing(self, model: Any, data: Any, step_s: float) -> Floats:
        """(b,) the same, and no more than brings a joint to rest within a step.

        Args:
            model: An ``MjModel``.
            data: Its ``MjData``.
            step_s: The step, s.
        """
        torque = self.torque(model, data)
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
    return Bearings(np.array([v for _, v in joints]), model.jnt_dofadr[at], model.jnt_bodyid[at])
