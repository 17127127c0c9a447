# SPDX-License-Identifier: Apache-2.0
"""Readings and commands of a hand as the messages that ROS has for them."""

import math
from collections.abc import Sequence

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped, WrenchStamped
from numpy.typing import NDArray
from sensor_msgs.msg import Imu, JointState

from pneu_sim.hand.drive import JointCommand

Floats = NDArray[np.float64]


def command_of(message: JointState, names: Sequence[str]) -> list[JointCommand] | None:
    """What a message asks of each joint; None where it asks what is none of these joints'.

    Args:
        message: The message.
        names: Of the joints.
    """
    told = list(message.name)
    parts = (message.position, message.velocity, message.effort)
    if any(name not in names for name in told) or any(
        len(part) not in (0, len(told)) for part in parts
    ):
        return None
    out = []
    for name in names:
        if name not in told:
            out.append(JointCommand())
            continue
        at = told.index(name)
        out.append(JointCommand(*(float(part[at]) if part else math.nan for part in parts)))
    return out


def imu_message(name: str, values: Floats, stamp: Time) -> Imu:
    """What an inertial unit reads.

    Args:
        name: Its body, whose frame it tells in.
        values: (6,) angular velocity, rad/s, and acceleration, m/s^2.
        stamp: When.
    """
    message = Imu()
    message.header.stamp, message.header.frame_id = stamp, f"{name}_imu"
    message.orientation_covariance[0] = -1.0  # it tells none (sensor_msgs/Imu)
    turning, pushing = message.angular_velocity, message.linear_acceleration
    turning.x, turning.y, turning.z, pushing.x, pushing.y, pushing.z = values.tolist()
    return message


def pose_message(name: str, values: Floats, stamp: Time) -> PoseStamped:
    """Where motion capture sees a body.

    Args:
        name: The body.
        values: (7,) position, m, and quaternion, scalar first.
        stamp: When.
    """
    del name
    message = PoseStamped()
    message.header.stamp, message.header.frame_id = stamp, "world"
    at, turn = message.pose.position, message.pose.orientation
    at.x, at.y, at.z, turn.w, turn.x, turn.y, turn.z = values.tolist()
    return message


def wrench_message(frame: str, values: Floats, stamp: Time) -> WrenchStamped:
    """What a force sensor reads.

    Args:
        frame: Frame of the sensor.
        values: (6,) force, N, and torque, N m.
        stamp: When.
    """
    message = WrenchStamped()
    message.header.stamp, message.header.frame_id = stamp, frame
    force, torque = message.wrench.force, message.wrench.torque
    force.x, force.y, force.z, torque.x, torque.y, torque.z = values.tolist()
    return message
