# SPDX-License-Identifier: Apache-2.0
"""A policy that pushes, on arms: encoders and the thing's place in, torques of motors out.

It is stepped once per control period and knows nothing of clocks, topics or plants.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_policy.control.push import PushObserver
from pneu_policy.control.push_policy import PushPolicy
from pneu_policy.task.push_paths import PushPath
from pneu_sim.hand.loading import Hand
from pneu_sim.hand.reach import Reach
from pneu_sim.mechanism.loading import mujoco_module

Floats = NDArray[np.float64]


class Pusher:
    """A policy with what it needs of a hand.

    Attributes:
        policy: The policy.
        path: Where the thing shall go.
        joints: How many each arm has.
        error_m: (2,) path less thing at the last step.
    """

    def __init__(self, policy: PushPolicy, hand: Hand, path: PushPath) -> None:
        """Starts without a past.

        Args:
            policy: The policy.
            hand: The hand.
            path: Where the thing shall go.

        Raises:
            InputError: The hand has other arms than the policy was trained with.
        """
        self.policy, self.path = policy, path
        self._reach = Reach(hand)
        if self._reach.arms != policy.arms:
            raise InputError(
                f"{policy.path or 'policy'}: trained with arms {', '.join(policy.arms)},"
                f" {hand.path} has {', '.join(self._reach.arms)}"
            )
        self.joints = self._reach.joints
        self._mujoco = mujoco_module()
        self._model: Any = hand.spec().compile()
        self._data: Any = self._mujoco.MjData(self._model)
        arms = hand.settings.arms.values()
        self._limits = np.array([[j.torque_limit_n_m for j in a.joints.values()] for a in arms])
        self._observer = PushObserver(policy.recipe, len(policy.arms))
        self._ahead = np.array(policy.recipe.preview_s)
        self.error_m: Floats = np.zeros(2)

    def step(
        self, time_s: float, angles_rad: Floats, speed_rad_s: Floats, thing_m: Floats
    ) -> Floats:
        """(arms, joints) torques for the next period, N m.

        Args:
            time_s: Since the path began.
            angles_rad: (arms, joints) what encoders read.
            speed_rad_s: (arms, joints) how fast that changes.
            thing_m: (2,) where the thing is on the plane.

        Raises:
            ValueError: A number is not finite.
        """
        self._reach.put(self._data, angles_rad, speed_rad_s)
        self._mujoco.mj_kinematics(self._model, self._data)
        tips, speeds, slope = self._reach.tips([self._data])
        features = self._observer.observe(
            tips, speeds, thing_m[None], self.path.at(time_s + self._ahead)[None]
        )
        self.error_m = self._observer.error_m[0]
        action = self.policy.act(features[0])[None]
        self._observer.acted(action)
        force = self.policy.recipe.forces(action, tips, self._reach.home_m)
        torque = np.einsum("aij,ai->aj", slope[0], force[0])
        return np.asarray(np.clip(torque, -self._limits, self._limits))
