# SPDX-License-Identifier: Apache-2.0
"""The target node: random pressures for a tap, with preview, the same for the same seed.

Parameters and topics: see ``ros_ws/README.md``.
"""

from typing import Any

import numpy as np
from pneu_msgs.msg import PressureTarget
from rclpy.node import Node

from pneu_common.errors import InputError
from pneu_graph.nodes import common
from pneu_policy.targets import KINDS, Target


class TargetNode(Node):
    """A seeded target on the topic ``target``."""

    def __init__(self, **options: Any) -> None:
        """Starts to publish.

        Args:
            options: Keywords of ``rclpy.node.Node``.

        Raises:
            InputError: The parameters make no target.
        """
        super().__init__("target", **options)
        try:
            self._set_up()
        except InputError:
            self.destroy_node()
            raise

    def _set_up(self) -> None:
        self._tap = common.declare(
            self, "tap", "end", "Tap that the target is for.", read_only=True
        )
        kind = common.declare(
            self,
            "kind",
            "mixed",
            "Sums of sines, straight lines between random points, random levels, or all in turn.",
            choices=KINDS,
            read_only=True,
        )
        low = common.declare(
            self, "low_pa", 150e3, "Lowest pressure, absolute, Pa.", (1.0, 1e7), read_only=True
        )
        high = common.declare(
            self, "high_pa", 500e3, "Highest pressure, absolute, Pa.", (1.0, 1e7), read_only=True
        )
        period_s = common.declare(
            self,
            "period_s",
            0.6,
            "Typical time from one extreme or level to the next, s.",
            (0.01, 100.0),
            read_only=True,
        )
        turn_s = common.declare(
            self,
            "turn_s",
            4.0,
            "How long each kind lasts where they take turns, s.",
            (0.1, 1000.0),
            read_only=True,
        )
        jitter = common.declare(
            self,
            "jitter",
            0.0,
            "Share of the period by which corners of jagged targets are moved at random.",
            (0.0, 0.9),
            read_only=True,
        )
        self._offset_s = common.declare(
            self,
            "start_s",
            0.0,
            "Where in the target's own time it begins, s.",
            (0.0, 1e6),
            read_only=True,
        )
        seed = common.declare(self, "seed", 0, "Seed.", (0, 2**31 - 1), read_only=True)
        rate_hz = common.declare(
            self, "rate_hz", 50.0, "Messages per second.", (1.0, 1000.0), read_only=True
        )
        preview_s = common.declare(
            self, "preview_s", 0.5, "How far ahead a message tells, s.", (0.0, 10.0), read_only=True
        )
        self._step_s = common.declare(
            self, "step_s", 0.02, "Time between values, s.", (0.0005, 1.0), read_only=True
        )
        self._target = Target(kind, low, high, period_s, seed, turn_s, jitter)
        self._ahead = np.arange(round(preview_s / self._step_s) + 1) * self._step_s
        self._start_ns: int | None = None
        self._publisher = self.create_publisher(PressureTarget, "target", common.COMMAND_QOS)
        self._timer = self.create_timer(1.0 / rate_hz, self._tick)

    def _tick(self) -> None:
        now = self.get_clock().now()
        if self._start_ns is None or now.nanoseconds < self._start_ns:
            self._start_ns = now.nanoseconds  # the first time, or time was set back
        at_s = self._offset_s + (now.nanoseconds - self._start_ns) * 1e-9
        message = PressureTarget(
            tap=self._tap,
            step_s=self._step_s,
            pressure_pa=self._target.at(at_s + self._ahead).tolist(),
        )
        message.header.stamp = now.to_msg()
        self._publisher.publish(message)


def main(args: list[str] | None = None) -> None:
    """Runs the node.

    Args:
        args: Command line; None is the process's own.
    """
    common.run_node(TargetNode, args)


if __name__ == "__main__":
    main()
