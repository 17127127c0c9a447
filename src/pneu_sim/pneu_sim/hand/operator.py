# SPDX-License-Identifier: Apache-2.0
"""An operator's hand on the wrist of an arm that leads another one, for plants that nobody holds.

It follows a path that would have the other arm tap and press what is in front of it, as a spring
and a damper that give way: what the leading arm is driven by is felt (thesis 2.6.2).
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sim.hand.exercise import exercise
from pneu_sim.hand.loading import Hand
from pneu_sim.hand.paths import Kinematics
from pneu_sim.mechanism.loading import mujoco_module

Floats = NDArray[np.float64]

STIFFNESS_N_M = 150.0
DAMPING_N_S_M = 4.0
STRONGEST_N = 6.0
"""A hand that guides holds no harder."""
BEGIN_S = 2.5
"""At rest before, while bridges begin to drive."""


class Operator:
    """The hand.

    Attributes:
        leader: The arm that it holds.
        ends_s: Plant time at which its path has been gone.
    """

    def __init__(
        self, hand: Hand, leader: str, follower: str, thing: str, seconds: float, seed: int
    ) -> None:
        """Plans the path.

        Args:
            hand: The hand file's; both arms are built alike.
            leader: Arm that is held, by a site ``<arm>_wrench`` at its wrist.
            follower: Arm that follows, with a tip ``<arm>_tip``.
            thing: Geom that the follower touches.
            seconds: How long.
            seed: Of the path.

        Raises:
            InputError: There is no such arm, site or geom, or the thing cannot be reached.
        """
        for role, arm in (("leader", leader), ("follower", follower)):
            if arm not in hand.settings.arms:
                known = ", ".join(hand.settings.arms)
                raise InputError(f"{role}: found {arm!r}, {hand.path} has {known}")
        self.leader = leader
        tip = f"{follower}_tip"
        path = exercise(hand, Kinematics(hand, follower, tip), tip, thing, seconds, seed)
        site = f"{leader}_wrench"
        held = Kinematics(hand, leader, site)
        self._time_s = path.time_s
        self._points = np.array([held.tip(angles) for angles in path.angles_rad])
        self.ends_s = BEGIN_S + float(self._time_s[-1])
        self._mujoco = mujoco_module()
        model: Any = hand.spec().compile()
        self._site = int(model.site(site).id)
        self._body = int(model.site_bodyid[self._site])
        self._slope = np.zeros((3, model.nv))

    def wanted(self, time_s: float) -> Floats:
        """(3,) where the hand would have the wrist, m.

        Args:
            time_s: Plant time.
        """
        at = np.clip(time_s - BEGIN_S, 0.0, self._time_s[-1])
        return np.array([np.interp(at, self._time_s, self._points[:, k]) for k in range(3)])

    def pull(self, model: Any, data: Any, time_s: float) -> None:
        """Pulls at the wrist in the step that comes.

        Args:
            model: ``MjModel`` of the plant.
            data: Its ``MjData``; bodies are where its coordinates were a step ago.
            time_s: Plant time.
        """
        place = data.site_xpos[self._site]
        self._mujoco.mj_jac(model, data, self._slope, None, place, self._body)
        force = STIFFNESS_N_M * (self.wanted(time_s) - place)
        force -= DAMPING_N_S_M * (self._slope @ data.qvel)
        strong = float(np.linalg.norm(force))
        if strong > STRONGEST_N:
            force *= STRONGEST_N / strong
        data.qfrc_applied[:] = self._slope.T @ force
