# SPDX-License-Identifier: Apache-2.0
"""Where tips of arms are, and what their motors push there, as far as encoders tell.

For many plants side by side, from what MuJoCo has of each already. A tip that yields is taken where
it would be unbent. One arm alone, from its encoders' angles: `paths.Kinematics`.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sim.hand.loading import Hand
from pneu_sim.hand.paths import Kinematics
from pneu_sim.mechanism.loading import mujoco_module

Floats = NDArray[np.float64]


class Reach:
    """Tips of a hand's arms.

    Attributes:
        arms: Names, in the order of the hand file.
        joints: How many each has.
        motors: (arms, joints) actuators of MuJoCo.
        home_m: (arms, 3) tips with all angles at zero.
    """

    def __init__(self, hand: Hand, tip: str = "{arm}_tip") -> None:
        """Takes the MJCF as it is.

        Args:
            hand: The hand; all its arms have as many joints.
            tip: Geom or site of each arm's tip; ``{arm}`` is its name.

        Raises:
            InputError: There is no such geom, or arms differ.
        """
        arms = hand.settings.arms
        self.arms = list(arms)
        counts = sorted({len(its.joints) for its in arms.values()})
        if len(counts) != 1:
            told = " and ".join(map(str, counts))
            raise InputError(f"{hand.path}: arms: all need as many joints, found {told}")
        self.joints = counts[0]
        mujoco = mujoco_module()
        model: Any = hand.spec().compile()
        data: Any = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        chains = [Kinematics(hand, arm, tip.format(arm=arm)) for arm in arms]
        self.home_m = np.array([chain.tip(np.zeros(self.joints)) for chain in chains])
        self.motors = np.array(
            [[model.actuator(j.motor).id for j in its.joints.values()] for its in arms.values()]
        )
        self._joints = np.array([chain.joints for chain in chains])
        self._qpos = model.jnt_qposadr[self._joints]
        self._dofs = model.jnt_dofadr[self._joints]
        self._by = np.array([chain.by for chain in chains])
        self._into = np.linalg.inv(self._by)
        self._bodies = model.jnt_bodyid[self._joints[:, -1]]
        turn = data.xmat[self._bodies].reshape(-1, 3, 3)
        self._offsets = np.einsum("aji,aj->ai", turn, self.home_m - data.xpos[self._bodies])

    def tips(self, plants: Sequence[Any]) -> tuple[Floats, Floats, Floats]:
        """Places, velocities and slopes of tips.

        Args:
            plants: ``MjData`` whose bodies are where their coordinates say (``mj_kinematics``).

        Returns:
            (plants, arms, 3) places, m; (plants, arms, 3) velocities, m/s; and (plants, arms, 3,
            joints) what tips move by with each angle that encoders read, m/rad: its transpose
            makes torques of motors from forces of tips.
        """
        place = np.array([data.xpos[self._bodies] for data in plants])
        turn = np.array([data.xmat[self._bodies] for data in plants]).reshape(*place.shape, 3)
        anchor = np.array([data.xanchor[self._joints] for data in plants])
        axis = np.array([data.xaxis[self._joints] for data in plants])
        speed = np.array([data.qvel[self._dofs] for data in plants])
        tip = place + np.einsum("paij,aj->pai", turn, self._offsets)
        slope = np.cross(axis, tip[:, :, None, :] - anchor)  # of coordinates: (p, a, joints, 3)
        velocity = np.einsum("paci,pac->pai", slope, speed)
        return tip, velocity, np.einsum("paci,acj->paij", slope, self._into)

    def put(self, data: Any, angles_rad: Floats, speed_rad_s: Floats | None = None) -> None:
        """Puts joints where encoders say; bodies follow with ``mj_kinematics``.

        Args:
            data: ``MjData``.
            angles_rad: (arms, joints).
            speed_rad_s: (arms, joints) how fast they turn; unchanged unless given.
        """
        data.qpos[self._qpos] = np.einsum("acj,aj->ac", self._into, angles_rad)
        if speed_rad_s is not None:
            data.qvel[self._dofs] = np.einsum("acj,aj->ac", self._into, speed_rad_s)
