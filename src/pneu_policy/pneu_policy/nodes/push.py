# SPDX-License-Identifier: Apache-2.0
"""The push node: a learned policy drives arms that push a thing along a path on a plane.

It first brings the arms to rest around the thing, then goes the path by the time that readings are
stamped with: an emulated plant that stands still on a busy machine is waited for. It reads each
``<arm>/joint_states`` and ``<thing>/pose``, and gives each ``<arm>/command`` and
``<thing>/target``, where the thing should be. The node ends when it has gone all of the path.
"""

import math
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from geometry_msgs.msg import PoseStamped
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.task import Future

from pneu_common.errors import InputError
from pneu_graph.nodes import common
from pneu_graph.nodes.parameters import Parameters, parameter
from pneu_policy.control.push_policy import PushPolicy
from pneu_policy.control.pusher import Pusher
from pneu_policy.nodes.arms import Arm, Every, all_heard
from pneu_policy.task.push_paths import PATH_KINDS, PathKind, PushPath
from pneu_sim.hand.loading import Hand
from pneu_sim.hand.paths import eased

Floats = NDArray[np.float64]

APPROACH_S = 1.0
"""From where the arms are to their places at rest."""


@dataclass
class PushParameters(Parameters):
    """What the push node is told."""

    hand: str = parameter("", "hand file (YAML)", read_only=True)
    policy: str = parameter("", "file of the policy (.npz)", read_only=True)
    thing: str = parameter("object", "what is pushed, a pose of the hand file", read_only=True)
    path: str = parameter("circle", "kind of path", choices=PATH_KINDS, read_only=True)
    reach_m: float = parameter(
        0.03, "furthest that the path goes from the middle", within=(0.001, 0.2), read_only=True
    )
    path_period_s: float = parameter(
        5.0, "of a round, or of the quickest sine of a wandering path", within=(0.5, 600.0),
        read_only=True,
    )  # fmt: skip
    seconds: float = parameter(10.0, "how long it pushes", within=(1.0, 600.0), read_only=True)
    seed: int = parameter(0, "seed of the path", within=(0, 2**31 - 1), read_only=True)
    rate_hz: float = parameter(
        500.0, "commands per second of the arms' time", within=(50.0, 2000.0), read_only=True
    )


class PushNode(Node):
    """The node.

    Attributes:
        done: Set once all of the path was gone.
    """

    def __init__(self, **options: Any) -> None:
        """Reads policy and hand.

        Args:
            **options: For the node.

        Raises:
            InputError: A parameter or a file is wrong, or the policy is not of this hand.
        """
        super().__init__("push", **options)
        self.done: Future = Future()
        try:
            self._set_up()
        except InputError:
            self.destroy_node()
            raise

    def _set_up(self) -> None:
        params = self._params = PushParameters.declare(self)
        for name in ("hand", "policy"):
            if not getattr(params, name):
                raise InputError(f"parameter {name}: found nothing, a file is needed")
        hand = Hand(params.hand)
        if params.thing not in hand.settings.poses:
            known = ", ".join(hand.settings.poses) or "none"
            raise InputError(
                f"parameter thing: found {params.thing!r}, poses of {params.hand} are {known}"
            )
        path = PushPath(
            cast(PathKind, params.path), params.reach_m, params.path_period_s, params.seed
        )
        self._pusher = Pusher(PushPolicy.load(params.policy), hand, path)
        self._thing_m: Floats = np.full(2, math.nan)
        self._seen_s = -math.inf
        self._begun_s = self._step_s = math.nan
        self._torque: Floats | None = None
        self._squares, self._steps = 0.0, 0
        self._every = Every(params.rate_hz)
        self._arms = [
            Arm(self, name, list(its.joints), self._on_readings)
            for name, its in hand.settings.arms.items()
        ]
        self._from = self._angles()
        self._target = self.create_publisher(
            PoseStamped, f"{params.thing}/target", common.READINGS_QOS
        )
        self.create_subscription(
            PoseStamped, f"{params.thing}/pose", self._on_pose, qos_profile_sensor_data
        )

    def _on_pose(self, message: PoseStamped) -> None:
        self._thing_m = np.array([message.pose.position.x, message.pose.position.y])
        self._seen_s = 1e-9 * common.from_stamp(message.header.stamp)

    def _angles(self) -> Floats:
        return np.array([arm.angles_rad for arm in self._arms])

    def _on_readings(self, now_s: float, stamp: Any) -> None:
        heard_s = {arm.name: arm.heard_s for arm in self._arms}
        heard_s[self._params.thing] = self._seen_s
        if not self._every.due(now_s) or not all_heard(self, heard_s, now_s):
            return
        if math.isnan(self._begun_s):
            self._begun_s, self._from = now_s, self._angles()
        self._go(now_s - self._begun_s - APPROACH_S, stamp)

    def _go(self, since_s: float, stamp: Any) -> None:
        """Commands all arms, so long after the path began."""
        if since_s < 0.0:
            share = float(eased(np.array(1.0 + since_s / APPROACH_S)))
            for arm, begin in zip(self._arms, self._from, strict=True):
                self._send(arm, stamp, position=((1.0 - share) * begin).tolist())
            return
        if math.isnan(self._step_s):
            self._step_s = since_s
        if since_s >= self._step_s - 1e-6:
            period_s = self._pusher.policy.recipe.period_s
            self._step_s = max(self._step_s + period_s, since_s)
            self._torque = self._step(since_s, stamp)
        if self._torque is None:
            return
        for arm, torque in zip(self._arms, self._torque, strict=True):
            self._send(arm, stamp, effort=torque.tolist())
        if since_s > self._params.seconds and not self.done.done():
            rms = math.sqrt(self._squares / max(self._steps, 1))
            self.get_logger().info(f"pushed: {1e3 * rms:.2f} mm off the path, root mean square")
            self.done.set_result(True)  # and the node ends

    def _step(self, since_s: float, stamp: Any) -> Floats | None:
        """Torques for the period that begins; None where a reading is no number."""
        speeds = np.array([arm.speed_rad_s for arm in self._arms])
        try:
            torque = self._pusher.step(since_s, self._angles(), speeds, self._thing_m)
        except ValueError as error:
            self.get_logger().warning(
                f"a reading is no number ({error}): no arm is commanded meanwhile",
                throttle_duration_sec=1.0,
            )
            return None
        self._squares += float(self._pusher.error_m @ self._pusher.error_m)
        self._steps += 1
        self._tell_target(since_s, stamp)
        return torque

    def _send(self, arm: Arm, stamp: Any, **what: list[float]) -> None:
        # where there is a velocity, the loop of the motors damps to it
        arm.command(stamp, velocity=[0.0] * len(arm.joints), **what)

    def _tell_target(self, since_s: float, stamp: Any) -> None:
        target = PoseStamped()
        target.header.stamp, target.header.frame_id = stamp, "world"
        place = self._pusher.path.at(np.array(since_s))
        target.pose.position.x, target.pose.position.y = float(place[0]), float(place[1])
        target.pose.orientation.w = 1.0
        self._target.publish(target)


def main(args: list[str] | None = None) -> None:
    """Runs the node.

    Args:
        args: Command line; None is the process's own.
    """
    common.run_node(PushNode, args)


if __name__ == "__main__":
    main()
