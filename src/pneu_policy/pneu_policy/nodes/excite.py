# SPDX-License-Identifier: Apache-2.0
"""The excite node: random levels on all valves of a rig, the same for the same seed.

It moves a robot about, to try a graph or to record what identification needs; it looks at no
reading. Parameters and topics: see ``ros_ws/README.md``.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from rclpy.node import Node

from pneu_common.errors import InputError
from pneu_graph.nodes import common
from pneu_graph.nodes.parameters import Parameters, parameter
from pneu_sim import topics
from pneu_sim.rig import load_rig


@dataclass
class ExciteParameters(Parameters):
    """What the excite node is told."""

    rig: str = parameter(
        "", "Rig file, whose commands are given on the topics of its channels.", read_only=True
    )
    low_v: float = parameter(2.0, "Lowest level, V.", within=(-24.0, 24.0), read_only=True)
    high_v: float = parameter(8.0, "Highest level, V.", within=(-24.0, 24.0), read_only=True)
    shortest_s: float = parameter(
        0.2, "Shortest time that a level lasts, s.", within=(0.01, 100.0), read_only=True
    )
    longest_s: float = parameter(
        0.8, "Longest time that a level lasts, s.", within=(0.01, 100.0), read_only=True
    )
    opposed: bool = parameter(
        True,
        "Whether every second valve has the level of the one before, mirrored between lowest and"
        " highest, as the two sides of a cylinder need it to move; else each has its own.",
        read_only=True,
    )
    swing: bool = parameter(
        False, "Whether levels are lowest and highest in turn, not random.", read_only=True
    )
    seed: int = parameter(0, "Seed.", within=(0, 2**31 - 1), read_only=True)
    rate_hz: float = parameter(100.0, "Commands per second.", within=(10.0, 1000.0), read_only=True)


class Levels:
    """Random levels one after the other, the same for the same seed."""

    def __init__(self, settings: ExciteParameters, seed: tuple[int, int]) -> None:
        """Begins with the first.

        Args:
            settings: Between what they are, and how long they last.
            seed: Of the draws.
        """
        self._settings = settings
        self._rng = np.random.default_rng(seed)
        self._until_s, self._volts, self._high = 0.0, 0.0, False

    def at(self, time_s: float) -> float:
        """The level at a time, V.

        Args:
            time_s: No earlier than at the call before, s.
        """
        s = self._settings
        while time_s >= self._until_s:
            self._until_s += self._rng.uniform(s.shortest_s, s.longest_s)
            drawn = self._rng.uniform(s.low_v, s.high_v)
            self._high = not self._high
            self._volts = (s.high_v if self._high else s.low_v) if s.swing else float(drawn)
        return self._volts


class ExciteNode(Node):
    """Seeded levels on the command topics of a rig."""

    def __init__(self, **options: Any) -> None:
        """Starts to command.

        Args:
            options: Keywords of ``rclpy.node.Node``.

        Raises:
            InputError: The parameters or the rig file are wrong.
        """
        super().__init__("excite", **options)
        try:
            self._set_up()
        except InputError:
            self.destroy_node()
            raise

    def _set_up(self) -> None:
        p = self._params = ExciteParameters.declare(self)
        if not p.rig:
            raise InputError("parameter rig: found nothing, it must be the path of a rig file")
        for low, high in (("low_v", "high_v"), ("shortest_s", "longest_s")):
            if not getattr(p, low) <= getattr(p, high):
                raise InputError(
                    f"{low}: found {getattr(p, low):g}, allowed is up to {high}"
                    f" {getattr(p, high):g}"
                )
        rig = load_rig(p.rig)
        if not rig.commands:
            raise InputError(f"rig {rig.name!r}: found no commands, there is nothing to excite")
        self._commanded = list(rig.commands)
        self._told_on = [
            (
                topic,
                self.create_publisher(
                    topics.message_class(topic.type), topic.name, common.COMMAND_QOS
                ),
            )
            for topic in topics.command_topics(rig)
        ]
        self._begin(0)
        self._start_ns = -1
        self._timer = self.create_timer(1.0 / p.rate_hz, self._tick)

    def _begin(self, now_ns: int) -> None:
        self._start_ns = now_ns
        self._drawn = [
            Levels(self._params, (self._params.seed, k)) for k in range(len(self._commanded))
        ]

    def _tick(self) -> None:
        p, now = self._params, self.get_clock().now()
        if self._start_ns < 0 or now.nanoseconds < self._start_ns:
            self._begin(now.nanoseconds)  # the first time, or time was set back
        time_s = (now.nanoseconds - self._start_ns) * 1e-9
        volts = [levels.at(time_s) for levels in self._drawn]
        if p.opposed:
            middle = p.low_v + p.high_v
            volts = [middle - volts[k - 1] if k % 2 else v for k, v in enumerate(volts)]
        values = dict(zip(self._commanded, volts, strict=True))
        for topic, publisher in self._told_on:
            message = topic.message(values, now.to_msg())
            if message is not None:
                publisher.publish(message)


def main(args: list[str] | None = None) -> None:
    """Runs the node.

    Args:
        args: Command line; None is the process's own.
    """
    common.run_node(ExciteNode, args)


if __name__ == "__main__":
    main()
