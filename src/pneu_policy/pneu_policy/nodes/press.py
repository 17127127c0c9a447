# SPDX-License-Identifier: Apache-2.0
"""The press node: an arm presses on what is in front of it with a force that is wanted.

The tip is led along a line toward the thing; where it is led to follows the force that is missing
(admittance control). The force is that of the estimate (``estimate/touch``), or what the sensor at
the wrist says with the tip's weight taken out (``<arm>/wrench``). It gives ``<arm>/command``, and
``<arm>/force_target``, what is wanted along the line.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.task import Future

from pneu_common.errors import InputError
from pneu_graph.nodes import common
from pneu_graph.nodes.parameters import Parameters, parameter
from pneu_policy.nodes.arms import Arm, Every
from pneu_sim.hand.loading import Hand
from pneu_sim.hand.paths import Kinematics, eased
from pneu_sim.hand.press import Press, PressSettings
from pneu_sim.hand.wrist import Wrist

SETTLE_S = 1.0
"""From where the arm is to where the line begins."""


@dataclass
class PressParameters(Parameters):
    """What the press node is told."""

    hand: str = parameter("", "hand file (YAML)", read_only=True)
    arm: str = parameter("phantom", "arm of the hand file", read_only=True)
    tip: str = parameter("phantom_tip", "geom of the tip", read_only=True)
    source: str = parameter(
        "estimate", "what tells the force", choices=("estimate", "wrench"), read_only=True
    )
    mean_n: float = parameter(0.35, "force that is wanted, mean", within=(0.0, 5.0), read_only=True)
    swing_n: float = parameter(
        0.15, "how far it swings about the mean", within=(0.0, 5.0), read_only=True
    )
    swing_hz: float = parameter(0.5, "how often it swings", within=(0.01, 20.0), read_only=True)
    gain_m_s_n: float = parameter(
        0.1, "how fast the tip is led on for each newton that is missing", within=(0.0, 10.0),
        read_only=True,
    )  # fmt: skip
    lead_m_n: float = parameter(
        0.01, "how far it is led on at once for each newton that is missing", within=(0.0, 1.0),
        read_only=True,
    )  # fmt: skip
    seconds: float = parameter(8.0, "how long it presses, s", within=(1.0, 600.0), read_only=True)
    rate_hz: float = parameter(
        500.0, "commands per second of the arm's time", within=(50.0, 2000.0), read_only=True
    )


class PressNode(Node):
    """The node.

    Attributes:
        done: Set once it has pressed for as long as it was told.
    """

    def __init__(self, **options: Any) -> None:
        """Plans the line.

        Args:
            **options: For the node.

        Raises:
            InputError: A parameter or a file is wrong, or the line cannot be reached.
        """
        super().__init__("press", **options)
        self.done: Future = Future()
        try:
            params = self._params = PressParameters.declare(self)
            if not params.hand:
                raise InputError("hand: found nothing, a hand file is needed")
            hand = Hand(params.hand)
            if params.arm not in hand.settings.arms:
                known = ", ".join(hand.settings.arms)
                raise InputError(f"arm: found {params.arm!r}, {params.hand} has {known}")
            self._kinematics = Kinematics(hand, params.arm, params.tip)
            self._wrist = Wrist(hand, params.arm) if params.source == "wrench" else None
        except InputError:
            self.destroy_node()
            raise
        joints = list(hand.settings.arms[params.arm].joints)
        self._begin = np.zeros(len(joints))
        self._along = np.array([1.0, 0.0, 0.0])
        settings = PressSettings(
            params.mean_n, params.swing_n, params.swing_hz, params.gain_m_s_n, params.lead_m_n
        )
        self._press = Press(settings, self._kinematics, self._along)
        self._from = self._begin
        self._begun_s = self._last_s = math.nan
        self._force_n = 0.0
        self._every = Every(params.rate_hz)
        self._arm = Arm(self, params.arm, joints, self._on_readings)
        self._wanted = self.create_publisher(
            WrenchStamped, f"{params.arm}/force_target", common.READINGS_QOS
        )
        if self._wrist is None:
            self.create_subscription(
                WrenchStamped, "estimate/touch", self._on_touch, qos_profile_sensor_data
            )
        else:
            self.create_subscription(
                WrenchStamped, f"{params.arm}/wrench", self._on_wrench, qos_profile_sensor_data
            )

    def _on_touch(self, message: WrenchStamped) -> None:
        force = message.wrench.force
        self._force_n = float(self._along @ np.array([force.x, force.y, force.z]))

    def _on_wrench(self, message: WrenchStamped) -> None:
        assert self._wrist is not None
        if not math.isfinite(self._arm.heard_s):
            return  # how the sensor is turned is not known yet
        force = message.wrench.force
        push = self._wrist.push(self._arm.angles_rad, np.array([force.x, force.y, force.z]))
        self._force_n = float(self._along @ push)

    def _on_readings(self, now_s: float, stamp: Any) -> None:
        if not self._every.due(now_s):
            return
        if math.isnan(self._begun_s):
            self._begun_s, self._last_s, self._from = now_s, now_s, self._arm.angles_rad
        step_s, self._last_s = now_s - self._last_s, now_s
        since_s = now_s - self._begun_s
        wanted = self._press.settings.wanted_n(since_s - SETTLE_S)
        if since_s < SETTLE_S:
            share = eased(np.array(since_s / SETTLE_S))
            angles = self._from + share * (self._begin - self._from)
            wanted = 0.0
        else:
            angles = self._press.angles(since_s - SETTLE_S, step_s, self._force_n)
        self._arm.command(stamp, position=angles.tolist())
        target = WrenchStamped()
        target.header.stamp, target.header.frame_id = stamp, "world"
        target.wrench.force.x, target.wrench.force.y, target.wrench.force.z = (
            float(x) for x in wanted * self._along
        )
        self._wanted.publish(target)
        if since_s > SETTLE_S + self._params.seconds:
            self.done.set_result(True)  # and the node ends


def main(args: list[str] | None = None) -> None:
    """Runs the node.

    Args:
        args: Command line; None is the process's own.
    """
    common.run_node(PressNode, args)


if __name__ == "__main__":
    main()
