# SPDX-License-Identifier: Apache-2.0
"""An arm on the graph, as the nodes that command it see it: what it reads, and its commands."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import JointState

from pneu_graph.nodes import common

Floats = NDArray[np.float64]

STALE_S = 0.05
"""What was heard so long before the newest is no longer known."""


class Arm:
    """An arm that is commanded.

    Attributes:
        name: Its name.
        joints: Names of its joints, in the order of the hand file.
        angles_rad: What its encoders read last; NaN before.
        speed_rad_s: How fast that changed.
        heard_s: When, by the stamps of its readings; minus infinity before.
    """

    def __init__(
        self, node: Node, name: str, joints: list[str], heard: Callable[[float, Any], None]
    ) -> None:
        """Listens to ``<arm>/joint_states``, and is to publish ``<arm>/command``.

        Args:
            node: The node that commands it.
            name: Its name.
            joints: Names of its joints.
            heard: Called after each of its readings with their time, s, and stamp.
        """
        self.name, self.joints = name, joints
        self.angles_rad: Floats = np.full(len(joints), math.nan)
        self.speed_rad_s: Floats = np.zeros(len(joints))
        self.heard_s = -math.inf
        self._node, self._heard = node, heard
        self._publisher = node.create_publisher(JointState, f"{name}/command", common.COMMAND_QOS)
        node.create_subscription(
            JointState, f"{name}/joint_states", self._on_joints, qos_profile_sensor_data
        )

    def command(self, stamp: Any, **what: list[float]) -> None:
        """Commands it.

        Args:
            stamp: When.
            what: ``position``, ``velocity`` and ``effort`` of its joints; what is left out is not
                asked for.
        """
        command = JointState(name=self.joints, **what)
        command.header.stamp = stamp
        self._publisher.publish(command)

    def _on_joints(self, message: JointState) -> None:
        told = list(message.name)
        try:
            order = [told.index(name) for name in self.joints]
            angles = [message.position[k] for k in order]
            speeds = [message.velocity[k] for k in order]
        except (ValueError, IndexError):
            self._node.get_logger().warning(
                f"{self.name}/joint_states tells {', '.join(told)} with {len(message.velocity)}"
                f" velocities, wanted are {', '.join(self.joints)} with theirs",
                throttle_duration_sec=5.0,
            )
            return
        self.angles_rad, self.speed_rad_s = np.array(angles), np.array(speeds)
        self.heard_s = 1e-9 * common.from_stamp(message.header.stamp)
        self._heard(self.heard_s, message.header.stamp)


class Every:
    """Once in so long, by the arms' time."""

    def __init__(self, rate_hz: float) -> None:
        """Is due at once.

        Args:
            rate_hz: How often.
        """
        self._every_s = 1.0 / rate_hz - 1e-6
        self._last_s = -math.inf

    def due(self, now_s: float) -> bool:
        """Whether it is time, and if so takes note of it.

        Args:
            now_s: The arms' time.
        """
        if now_s - self._last_s < self._every_s:
            return False
        self._last_s = now_s
        return True


def all_heard(node: Node, heard_s: dict[str, float], now_s: float) -> bool:
    """Whether everything was heard of lately; says what was not, where it was once.

    Args:
        node: Whose log it goes to.
        heard_s: When each was heard last, minus infinity for never.
        now_s: Now.
    """
    oldest = min(heard_s, key=lambda name: heard_s[name])
    silent_s = now_s - heard_s[oldest]
    if silent_s <= STALE_S:
        return True
    if math.isfinite(silent_s):
        node.get_logger().warning(
            f"nothing of {oldest} for {silent_s:.2f} s: no arm is commanded meanwhile",
            throttle_duration_sec=1.0,
        )
    return False
