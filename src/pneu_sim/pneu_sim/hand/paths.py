# SPDX-License-Identifier: Apache-2.0
"""Paths of an arm's tip, and the joint angles that follow them, by the kinematics of its MJCF."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sim.hand.loading import Hand
from pneu_sim.mechanism.loading import mujoco_module

Floats = NDArray[np.float64]

TRIES = 60
"""Steps of Newton to a point, at most."""
NEAR_M = 1e-5
"""So near a point is reached."""
DAMPING = 1e-6
"""Of these steps, m^2."""


class Kinematics:
    """Where an arm's tip is, by its joints' angles.

    Attributes:
        arm: Name of the arm.
        lower_rad: Ranges of its joints.
        upper_rad: Likewise.
        joints: (j,) MuJoCo's numbers of the joints that its motors move.
        by: (j, j) angles that encoders read, by these joints' coordinates.
    """

    def __init__(self, hand: Hand, arm: str, tip: str) -> None:
        """Takes the MJCF as it is.

        Args:
            hand: The hand.
            arm: Name of the arm.
            tip: Its geom or site that is to be somewhere.

        Raises:
            InputError: There is none of that name, or a joint that no coordinate moves.
        """
        self.arm = arm
        self._mujoco = mujoco_module()
        self._model: Any = hand.spec().compile()
        self._data: Any = self._mujoco.MjData(self._model)
        model, kinds = self._model, self._mujoco.mjtObj
        self._geom = self._mujoco.mj_name2id(model, kinds.mjOBJ_GEOM, tip)
        self._site = self._mujoco.mj_name2id(model, kinds.mjOBJ_SITE, tip)
        if self._geom < 0 and self._site < 0:
            raise InputError(f"{hand.mjcf}: no geom or site {tip!r}")
        joints = hand.settings.arms[arm].joints
        self.lower_rad = np.array([j.lower_rad for j in joints.values()])
        self.upper_rad = np.array([j.upper_rad for j in joints.values()])
        # an encoder's angle is the sum of coordinates times what its transmission says
        by = np.zeros((len(joints), model.nv))
        for row, joint in enumerate(joints.values()):
            motor = model.actuator(joint.motor).id
            kind, target = int(model.actuator_trntype[motor]), int(model.actuator_trnid[motor, 0])
            if kind == self._mujoco.mjtTrn.mjTRN_JOINT:
                by[row, int(model.jnt_dofadr[target])] = 1.0
            elif kind == self._mujoco.mjtTrn.mjTRN_TENDON:
                first, count = int(model.tendon_adr[target]), int(model.tendon_num[target])
                for at in range(first, first + count):
                    dof = int(model.jnt_dofadr[int(model.wrap_objid[at])])
                    by[row, dof] = float(model.wrap_prm[at])
            else:
                raise InputError(f"{hand.mjcf}: motor {joint.motor!r} drives no joint or tendon")
        self._moves = np.flatnonzero(by.any(axis=0))
        self.by = by[:, self._moves]
        self.joints = np.array(model.dof_jntid[self._moves])
        self._qpos = model.jnt_qposadr[self.joints]

    def tip(self, angles_rad: Floats) -> Floats:
        """(3,) where the tip is, m.

        Args:
            angles_rad: (j,) what encoders read.
        """
        self._data.qpos[self._qpos] = np.linalg.solve(self.by, angles_rad)
        self._mujoco.mj_kinematics(self._model, self._data)
        self._mujoco.mj_comPos(self._model, self._data)
        at = (
            self._data.site_xpos[self._site] if self._geom < 0 else self._data.geom_xpos[self._geom]
        )
        return np.array(at)

    def turn(self, angles_rad: Floats, site: int) -> Floats:
        """(3, 3) how a site is turned: its axes as columns.

        Args:
            angles_rad: (j,) what encoders read.
            site: Number of the site.
        """
        self.tip(angles_rad)
        return np.array(self._data.site_xmat[site]).reshape(3, 3)

    def slope(self, angles_rad: Floats) -> Floats:
        """(3, j) what the tip moves by with each angle, m/rad.

        Args:
            angles_rad: (j,) what encoders read.
        """
        self.tip(angles_rad)
        by = np.zeros((3, self._model.nv))
        jacobian = self._mujoco.mj_jacGeom if self._geom >= 0 else self._mujoco.mj_jacSite
        jacobian(self._model, self._data, by, None, max(self._geom, self._site))
        return np.asarray(by[:, self._moves] @ np.linalg.inv(self.by))

    def angles(self, place_m: Floats, near_rad: Floats) -> Floats:
        """(j,) angles that bring the tip somewhere.

        Args:
            place_m: (3,) where.
            near_rad: (j,) angles to start from.

        Raises:
            InputError: It cannot be reached within the joints' ranges.
        """
        at = np.array(near_rad, dtype=float)
        for _ in range(TRIES):
            off = place_m - self.tip(at)
            if np.linalg.norm(off) < NEAR_M:
                return at
            J = self.slope(at)
            step = J.T @ np.linalg.solve(J @ J.T + DAMPING * np.eye(3), off)
            at = np.clip(at + np.clip(step, -0.2, 0.2), self.lower_rad, self.upper_rad)
        told = ", ".join(f"{x:.3f}" for x in place_m)
        raise InputError(f"arm {self.arm!r}: its tip cannot reach ({told}) m")


@dataclass(frozen=True)
class Path:
    """Angles over time.

    Attributes:
        time_s: (n,).
        angles_rad: (n, j).
    """

    time_s: Floats
    angles_rad: Floats

    def at(self, time_s: float) -> tuple[Floats, Floats]:
        """Angles and their velocities.

        Args:
            time_s: When; before the beginning and after the end it rests there.
        """
        k = int(np.clip(np.searchsorted(self.time_s, time_s) - 1, 0, len(self.time_s) - 2))
        step = self.time_s[k + 1] - self.time_s[k]
        share = (time_s - self.time_s[k]) / step
        if not 0.0 <= share <= 1.0:
            rest = self.angles_rad[0 if share < 0.0 else -1]
            return rest, np.zeros(len(rest))
        change = self.angles_rad[k + 1] - self.angles_rad[k]
        return self.angles_rad[k] + share * change, change / step


EVERY_S = 0.004
"""Between points of a path."""


def eased(share: Floats) -> Floats:
    """How far along a way is that begins and ends at rest with least jerk, by its share of time.

    Args:
        share: (...,) of the time, 0 to 1.
    """
    return np.asarray(share**3 * (10.0 - 15.0 * share + 6.0 * share**2))


def way(begin: Floats, end: Floats, seconds: float) -> Floats:
    """(n, k) places on a straight way from rest to rest, `EVERY_S` apart, the first left out.

    Args:
        begin: (k,) where it begins.
        end: (k,) where it ends.
        seconds: How long it takes.
    """
    count = max(2, round(seconds / EVERY_S))
    share = eased(np.arange(1, count + 1)[:, None] / count)
    return np.asarray(begin + share * (end - begin))


def through(kinematics: Kinematics, points_m: Floats) -> Path:
    """A path through points at even times.

    Args:
        kinematics: The arm's.
        points_m: (n, 3), `EVERY_S` apart.

    Raises:
        InputError: One cannot be reached.
    """
    near = np.clip(np.zeros(len(kinematics.lower_rad)), kinematics.lower_rad, kinematics.upper_rad)
    rows = []
    for point in points_m:
        near = kinematics.angles(point, near)
        rows.append(near)
    time_s: Floats = EVERY_S * np.arange(len(rows), dtype=float)
    return Path(time_s, np.array(rows))
