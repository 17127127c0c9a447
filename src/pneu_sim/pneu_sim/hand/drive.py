# SPDX-License-Identifier: Apache-2.0
"""How a motor follows a command: torque, and springs and dampers to a position and a velocity."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from pneu_sim.hand.settings import JointSettings

VELOCITY_HZ = 100.0
"""Corner of the filter of velocities, which are differences of counts."""


@dataclass(frozen=True)
class JointCommand:
    """What is asked of one joint; NaN asks for nothing.

    Attributes:
        position_rad: Where it should be.
        velocity_rad_s: How fast.
        effort_n_m: Torque besides.
    """

    position_rad: float = math.nan
    velocity_rad_s: float = math.nan
    effort_n_m: float = math.nan


def torque_of(
    joint: JointSettings, command: JointCommand, position_rad: float, velocity_rad_s: float
) -> float:
    """Torque that a command asks for, before any limit, N m.

    Without a position nothing holds the joint; without a velocity it is damped to rest where there
    is a position.

    Args:
        joint: The joint.
        command: What is asked of it.
        position_rad: Where it is.
        velocity_rad_s: How fast it moves.
    """
    total = 0.0 if math.isnan(command.effort_n_m) else command.effort_n_m
    held = not math.isnan(command.position_rad)
    if held:
        total += joint.stiffness_n_m_rad * (command.position_rad - position_rad)
    if not math.isnan(command.velocity_rad_s):
        total += joint.damping_n_m_s_rad * (command.velocity_rad_s - velocity_rad_s)
    elif held:
        total -= joint.damping_n_m_s_rad * velocity_rad_s
    return total


class VelocityFilter:
    """Velocities of joints from angles that come in steps of an encoder.

    Attributes:
        velocity_rad_s: Of each.
    """

    def __init__(self, count: int) -> None:
        """Knows nothing yet.

        Args:
            count: Joints.
        """
        self.velocity_rad_s = [0.0] * count
        self._at: list[float] | None = None
        self._time_s = 0.0

    def take(self, position_rad: Sequence[float], time_s: float) -> None:
        """Takes note of angles.

        Args:
            position_rad: They.
            time_s: When; what is not later than before is passed over.
        """
        if self._at is not None and time_s > self._time_s:
            step = time_s - self._time_s
            share = 1.0 - math.exp(-2.0 * math.pi * VELOCITY_HZ * step)
            for k, (now, before) in enumerate(zip(position_rad, self._at, strict=True)):
                self.velocity_rad_s[k] += share * ((now - before) / step - self.velocity_rad_s[k])
        elif self._at is not None:
            return
        self._at = list(position_rad)
        self._time_s = time_s

    def forget(self) -> None:
        """Begins anew, as after a gap."""
        self._at = None
        self.velocity_rad_s = [0.0] * len(self.velocity_rad_s)


class Motors:
    """Motors of an arm that follow commands within their limits, by what its encoders read.

    Attributes:
        position_rad: Of each joint, when they were driven last.
        torque_n_m: What they were given.
        velocity: How fast joints move.
    """

    def __init__(self, joints: Sequence[JointSettings]) -> None:
        """Gives no torque yet.

        Args:
            joints: The arm's.
        """
        self.joints = list(joints)
        self.velocity = VelocityFilter(len(self.joints))
        self.position_rad = [0.0] * len(self.joints)
        self.torque_n_m = [0.0] * len(self.joints)

    def drive(
        self, counts: Sequence[int], time_s: float, commands: Sequence[JointCommand] | None
    ) -> list[float]:
        """Torques that follow commands, N m.

        Args:
            counts: What encoders read.
            time_s: When.
            commands: What is asked of each joint; None gives no torque.
        """
        pairs = zip(counts, self.joints, strict=True)
        self.position_rad = [count / joint.counts_per_rad for count, joint in pairs]
        self.velocity.take(self.position_rad, time_s)
        self.torque_n_m = [0.0] * len(self.joints)
        for k, command in enumerate(commands or ()):
            joint = self.joints[k]
            at, speed = self.position_rad[k], self.velocity.velocity_rad_s[k]
            asked = torque_of(joint, command, at, speed)
            if math.isfinite(asked):
                most = joint.torque_limit_n_m
                self.torque_n_m[k] = min(max(asked, -most), most)
        return self.torque_n_m
