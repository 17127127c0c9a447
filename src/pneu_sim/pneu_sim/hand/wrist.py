# SPDX-License-Identifier: Apache-2.0
"""What a force sensor at a wrist says of the force at the tip, the tip's weight taken out."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sim.hand.loading import Hand
from pneu_sim.hand.paths import Kinematics
from pneu_sim.mechanism.loading import mujoco_module

Floats = NDArray[np.float64]


class Wrist:
    """The sensor of an arm, at rest: what moves beyond it pushes too, and is not known of."""

    def __init__(self, hand: Hand, arm: str) -> None:
        """Takes the MJCF as it is.

        Args:
            hand: The hand.
            arm: Name of the arm.

        Raises:
            InputError: It has no force sensor.
        """
        settings = hand.settings.arms[arm].wrench
        if settings is None:
            raise InputError(f"{hand.path}: arms.{arm}: has no wrench")
        mujoco = mujoco_module()
        model: Any = hand.spec().compile()
        site = int(model.sensor_objid[model.sensor(settings.force).id])
        name = model.site(site).name
        self._kinematics = Kinematics(hand, arm, name)
        beyond = int(model.site_bodyid[site])
        self._weight = float(model.body_subtreemass[beyond]) * np.array(model.opt.gravity)
        self._site, self._mujoco = site, mujoco

    def push(self, angles_rad: Floats, force_n: Floats) -> Floats:
        """(3,) force of the tip on others, N, in the world's frame.

        The sensor tells what the arm gives to all that is beyond it; at rest that is what the tip
        gives to others, less what its weight does.

        Args:
            angles_rad: (j,) what encoders read.
            force_n: (3,) what the sensor reads.
        """
        turn = self._kinematics.turn(angles_rad, self._site)
        return np.asarray(turn @ force_n + self._weight)
