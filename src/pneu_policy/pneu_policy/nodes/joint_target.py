# SPDX-License-Identifier: Apache-2.0
"""The joint_target node: random targets of joints, with preview, the same for the same seed.

It publishes `trajectory_msgs/JointTrajectory`, whose points tell what lies ahead. Parameters and
topics: see ``ros_ws/README.md``.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from rclpy.duration import Duration
from rclpy.node import Node
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from pneu_common.errors import InputError
from pneu_graph.nodes import common
from pneu_graph.nodes.parameters import Parameters, parameter
from pneu_policy.nodes.robot import TARGET_TOPIC
from pneu_policy.task.waves import KINDS, Kind, Wave


@dataclass
class JointTargetParameters(Parameters):
    """What the joint_target node is told."""

    joint: str = parameter("elbow", "Encoder of the joint that targets are for.", read_only=True)
    kind: Kind = parameter(
        "mixed",
        "Sums of sines, straight lines between random points, random levels, or all in turn.",
        choices=KINDS,
        read_only=True,
    )
    low: float = parameter(-0.7, "Lowest target, rad or m.", within=(-100.0, 100.0), read_only=True)
    high: float = parameter(
        0.7, "Highest target, rad or m.", within=(-100.0, 100.0), read_only=True
    )
    period_s: float = parameter(
        0.6,
        "Typical time from one extreme or level to the next, s.",
        within=(0.01, 100.0),
        read_only=True,
    )
    turn_s: float = parameter(
        4.0,
        "How long each kind lasts where they take turns, s.",
        within=(0.1, 1000.0),
        read_only=True,
    )
    jitter: float = parameter(
        0.6,
        "Share of the period by which corners of jagged targets are moved at random.",
        within=(0.0, 0.9),
        read_only=True,
    )
    start_s: float = parameter(
        0.0, "Where in the target's own time it begins, s.", within=(0.0, 1e6), read_only=True
    )
    seed: int = parameter(0, "Seed.", within=(0, 2**31 - 1), read_only=True)
    rate_hz: float = parameter(50.0, "Messages per second.", within=(1.0, 1000.0), read_only=True)
    preview_s: float = parameter(
        0.4, "How far ahead a message tells, s.", within=(0.0, 10.0), read_only=True
    )
    step_s: float = parameter(0.01, "Time between points, s.", within=(0.0005, 1.0), read_only=True)


class JointTargetNode(Node):
    """A seeded target on the topic ``joint_target``."""

    def __init__(self, **options: Any) -> None:
        """Starts to publish.

        Args:
            options: Keywords of ``rclpy.node.Node``.

        Raises:
            InputError: The parameters make no target.
        """
        super().__init__("joint_target", **options)
        try:
            self._set_up()
        except InputError:
            self.destroy_node()
            raise

    def _set_up(self) -> None:
        p = self._params = JointTargetParameters.declare(self)
        self._wave = Wave(p.kind, p.low, p.high, p.period_s, p.seed, p.turn_s, p.jitter)
        self._ahead = np.arange(round(p.preview_s / p.step_s) + 1) * p.step_s
        self._due = [Duration(seconds=float(at)).to_msg() for at in self._ahead]
        self._start_ns: int | None = None
        self._publisher = self.create_publisher(JointTrajectory, TARGET_TOPIC, common.COMMAND_QOS)
        self._timer = self.create_timer(1.0 / p.rate_hz, self._tick)

    def _tick(self) -> None:
        now = self.get_clock().now()
        if self._start_ns is None or now.nanoseconds < self._start_ns:
            self._start_ns = now.nanoseconds  # the first time, or time was set back
        at_s = self._params.start_s + (now.nanoseconds - self._start_ns) * 1e-9
        values = self._wave.at(at_s + self._ahead)
        message = JointTrajectory(
            joint_names=[self._params.joint],
            points=[
                JointTrajectoryPoint(positions=[float(value)], time_from_start=due)
                for value, due in zip(values, self._due, strict=True)
            ],
        )
        message.header.stamp = now.to_msg()
        self._publisher.publish(message)


def main(args: list[str] | None = None) -> None:
    """Runs the node.

    Args:
        args: Command line; None is the process's own.
    """
    common.run_node(JointTargetNode, args)


if __name__ == "__main__":
    main()
