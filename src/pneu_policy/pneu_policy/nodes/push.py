# SPDX-License-Identifier: Apache-2.0
"""The push node: a learned policy drives arms that push a thing along a path on a plane.

It first brings the arms to rest around the thing, then goes the path by the time that readings are
stamped with: an emulated plant that stands still on a busy machine is waited for. It reads each
``<arm>/joint_states`` and ``<thing>/pose``, and gives each ``<arm>/command`` and
``<thing>/target``, where the thing should be. The node ends when it has gone all of the path.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.task import Future
from sensor_msgs.msg import JointState

from pneu_common.errors import InputError
from pneu_graph.nodes import common
from pneu_graph.nodes.parameters import Parameters, parameter
from pneu_policy.control.push_policy import PushPolicy
from pneu_policy.control.pusher import Pusher
from pneu_policy.task.push_paths import PATH_KINDS, PushPath
from pneu_sim.hand.loading import Hand
from pneu_sim.hand.paths import eased

Floats = NDArray[np.float64]

APPROACH_S = 1.0
"""From where the arms are to their places at rest."""
STALE_S = 0.05
"""Readings that are older by so much than the newest stop the arms."""


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
        kind = next(one for one in PATH_KINDS if one == params.path)
        path = PushPath(kind, params.reach_m, params.path_period_s, params.seed)
        self._pusher = Pusher(PushPolicy.load(params.policy), hand, path)
        arms = hand.settings.arms
        self._joint_names = {arm: list(its.joints) for arm, its in arms.items()}
        shape = (len(arms), self._pusher.joints)
        self._at, self._speed = np.full(shape, math.nan), np.zeros(shape)
        self._thing_m: Floats = np.full(2, math.nan)
        self._heard_s = {name: -math.inf for name in (*arms, "thing")}
        self._begun_s = self._step_s = math.nan
        self._sent_s = -math.inf
        self._from = self._at
        self._torque: Floats = np.zeros(shape)
        self._squares, self._steps = 0.0, 0
        self._to = {
            arm: self.create_publisher(JointState, f"{arm}/command", common.COMMAND_QOS)
            for arm in arms
        }
        self._target = self.create_publisher(
            PoseStamped, f"{params.thing}/target", common.READINGS_QOS
        )
        for number, arm in enumerate(arms):
            self.create_subscription(
                JointState,
                f"{arm}/joint_states",
                lambda message, number=number, arm=arm: self._on_joints(number, arm, message),
                qos_profile_sensor_data,
            )
        self.create_subscription(
            PoseStamped, f"{params.thing}/pose", self._on_pose, qos_profile_sensor_data
        )

    def _on_pose(self, message: PoseStamped) -> None:
        self._thing_m = np.array([message.pose.position.x, message.pose.position.y])
        self._heard_s["thing"] = 1e-9 * common.from_stamp(message.header.stamp)

    def _on_joints(self, number: int, arm: str, message: JointState) -> None:
        told = list(message.name)
        try:
            order = [told.index(name) for name in self._joint_names[arm]]
            self._at[number] = [message.position[k] for k in order]
            self._speed[number] = [message.velocity[k] for k in order]
        except (ValueError, IndexError):
            self.get_logger().warning(
                f"{arm}/joint_states tells {', '.join(told)} with {len(message.velocity)}"
                f" velocities, wanted are {', '.join(self._joint_names[arm])} with theirs",
                throttle_duration_sec=5.0,
            )
            return
        now_s = 1e-9 * common.from_stamp(message.header.stamp)
        self._heard_s[arm] = now_s
        if now_s - self._sent_s < 1.0 / self._params.rate_hz - 1e-6:
            return
        oldest = min(self._heard_s, key=lambda name: self._heard_s[name])
        if now_s - self._heard_s[oldest] > STALE_S:
            if math.isfinite(self._heard_s[oldest]):  # not only not there yet
                self.get_logger().warning(
                    f"nothing of {oldest} for {now_s - self._heard_s[oldest]:.2f} s: the arms are"
                    " not commanded meanwhile",
                    throttle_duration_sec=1.0,
                )
            return
        self._sent_s = now_s
        if math.isnan(self._begun_s):
            self._begun_s, self._from = now_s, self._at.copy()
        self._go(now_s - self._begun_s - APPROACH_S, message.header.stamp)

    def _go(self, since_s: float, stamp: Any) -> None:
        """Commands all arms, so long after the path began."""
        if since_s < 0.0:
            share = float(eased(np.array(1.0 + since_s / APPROACH_S)))
            for number, arm in enumerate(self._joint_names):
                self._send(arm, stamp, position=((1.0 - share) * self._from[number]).tolist())
            return
        if math.isnan(self._step_s):
            self._step_s = since_s
        if since_s >= self._step_s - 1e-6:
            period_s = self._pusher.policy.recipe.period_s
            self._step_s = max(self._step_s + period_s, since_s)
            try:
                self._torque = self._pusher.step(since_s, self._at, self._speed, self._thing_m)
            except ValueError as error:
                self.get_logger().warning(
                    f"a reading is no number ({error}): the arms are not commanded meanwhile",
                    throttle_duration_sec=1.0,
                )
                return
            self._squares += float(self._pusher.error_m @ self._pusher.error_m)
            self._steps += 1
            self._tell_target(since_s, stamp)
        for number, arm in enumerate(self._joint_names):
            self._send(arm, stamp, effort=self._torque[number].tolist())
        if since_s > self._params.seconds and not self.done.done():
            rms = math.sqrt(self._squares / self._steps)
            self.get_logger().info(f"pushed: {1e3 * rms:.2f} mm off the path, root mean square")
            self.done.set_result(True)  # and the node ends

    def _send(self, arm: str, stamp: Any, **what: list[float]) -> None:
        names = self._joint_names[arm]
        # where there is a velocity, the loop of the motors damps to it
        command = JointState(name=names, velocity=[0.0] * len(names), **what)
        command.header.stamp = stamp
        self._to[arm].publish(command)

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
