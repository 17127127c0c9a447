# SPDX-License-Identifier: Apache-2.0
"""The target node: random pressures for a tap, with preview, the same for the same seed.

Parameters and topics: see ``ros_ws/README.md``.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from pneu_msgs.msg import PressureTarget
from rclpy.node import Node

from pneu_common.errors import InputError
from pneu_graph.nodes import common
from pneu_graph.nodes.parameters import Parameters, parameter
from pneu_policy.task.targets import KINDS, Kind, Target


@dataclass
class TargetParameters(Parameters):
    """What the target node is told."""

    tap: str = parameter("end", "Tap that the target is for.", read_only=True)
    kind: Kind = parameter(
        "mixed",
        "Sums of sines, straight lines between random points, random levels, or all in turn.",
        choices=KINDS,
        read_only=True,
    )
    low_pa: float = parameter(
        150e3, "Lowest pressure, absolute, Pa.", within=(1.0, 1e7), read_only=True
    )
    high_pa: float = parameter(
        500e3, "Highest pressure, absolute, Pa.", within=(1.0, 1e7), read_only=True
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
        0.0,
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
        0.5, "How far ahead a message tells, s.", within=(0.0, 10.0), read_only=True
    )
    step_s: float = parameter(0.02, "Time between values, s.", within=(0.0005, 1.0), read_only=True)


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
        p = self._params = TargetParameters.declare(self)
        self._target = Target(p.kind, p.low_pa, p.high_pa, p.period_s, p.seed, p.turn_s, p.jitter)
        self._ahead = np.arange(round(p.preview_s / p.step_s) + 1) * p.step_s
        self._start_ns: int | None = None
        self._publisher = self.create_publisher(PressureTarget, "target", common.COMMAND_QOS)
        self._timer = self.create_timer(1.0 / p.rate_hz, self._tick)

    def _tick(self) -> None:
        now = self.get_clock().now()
        if self._start_ns is None or now.nanoseconds < self._start_ns:
            self._start_ns = now.nanoseconds  # the first time, or time was set back
        at_s = self._params.start_s + (now.nanoseconds - self._start_ns) * 1e-9
        message = PressureTarget(
            tap=self._params.tap,
            step_s=self._params.step_s,
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
