# SPDX-License-Identifier: Apache-2.0
"""What every node of the graph does alike: QoS, stamps, diagnostics, start and end."""

import sys
from collections.abc import Callable, Mapping

import rclpy
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.task import Future

from pneu_common.errors import InputError
from pneu_common.garbage import spare_what_stays
from pneu_common.log import LOG, hand_on
from pneu_graph.nodes.discovery import patience_s
from pneu_graph.nodes.lifetime import initialised

COMMAND_QOS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
)
"""Commands and targets: the newest only, and never one from before the subscription."""

READINGS_QOS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=10,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
)
"""For publishers of readings; subscribers take the profile of sensor data."""

FAST_QOS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1000,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
)
"""For readings at kilohertz, and for those of many steps at once: a recorder that gets no turn for
half a second loses none."""

EXIT_BAD_INPUT = 2
CLOCK_TOPIC = "/clock"
CLOCK_S = 1.0
"""How long another publisher of the clock is looked for once participants know each other, s."""


def from_another_thread(node: Node) -> Future:
    """A future that a callback of a node may await and another thread may complete.

    Completing one wakes no executor; scheduling its done-callbacks does, so this one has one.

    Args:
        node: The node whose executor runs the callback.
    """
    done: Future = Future(executor=node.executor)
    done.add_done_callback(lambda _: None)
    return done


def to_stamp(nanoseconds: int) -> Time:
    """A stamp as a message.

    Args:
        nanoseconds: Time since the clock's zero, ns.
    """
    return Time(sec=nanoseconds // 1_000_000_000, nanosec=nanoseconds % 1_000_000_000)


def from_stamp(stamp: Time) -> int:
    """A stamp in nanoseconds.

    Args:
        stamp: The message.
    """
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def steady_clock() -> Clock:
    """A clock for pauses and watchdogs, which no adjustment of the time of day moves."""
    return Clock(clock_type=ClockType.STEADY_TIME)


def status(
    level: bytes, name: str, message: str, values: Mapping[str, object], hardware: str
) -> DiagnosticStatus:
    """One line of a node's health.

    Args:
        level: ``DiagnosticStatus.OK``, ``WARN``, ``ERROR`` or ``STALE``.
        name: ``node: part``.
        message: In words.
        values: Figures.
        hardware: What it is about.
    """
    pairs = [
        KeyValue(key=key, value=f"{value:.6g}" if isinstance(value, float) else str(value))
        for key, value in values.items()
    ]
    return DiagnosticStatus(
        level=level, name=name, message=message, hardware_id=hardware, values=pairs
    )


class Diagnostics:
    """Publishes a node's health once a second by the steady clock, and at once when asked."""

    def __init__(self, node: Node, report: Callable[[], list[DiagnosticStatus]]) -> None:
        """Starts.

        Args:
            node: The node.
            report: Makes the lines.
        """
        self._node = node
        self._report = report
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._timer = node.create_timer(1.0, self.publish, clock=steady_clock())

    def close(self) -> None:
        """Ends it."""
        self._node.destroy_timer(self._timer)
        self._node.destroy_publisher(self._publisher)

    def publish(self) -> None:
        """Publishes now."""
        message = DiagnosticArray(status=self._report())
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(message)


def other_clocks(node: Node, own: int = 0, wait: bool = False) -> int:
    """How many publishers of the clock there are beside one's own.

    Args:
        node: The node.
        own: Publishers of the clock that the node itself has.
        wait: Wait for others to be discovered. None found is no proof that there is none, so a
            node has to look again as long as it runs.
    """
    clock = steady_clock()
    end = clock.now().nanoseconds + (round(patience_s(CLOCK_S) * 1e9) if wait else 0)
    while True:
        others = node.count_publishers(CLOCK_TOPIC) - own
        left = (end - clock.now().nanoseconds) * 1e-9
        if others > 0 or left <= 0.0:
            return max(others, 0)
        pause(min(left, 0.05))


def pause(seconds: float) -> None:
    """Waits by the steady clock.

    Args:
        seconds: How long, s.
    """
    steady_clock().sleep_for(Duration(seconds=max(seconds, 0.0)))


def say_ready(node: Node, about: str = "") -> None:
    """Logs that a node answers; to be called when it is about to be spun.

    From then on no collection of garbage stops it for long.

    Args:
        node: The node.
        about: What it does, in some words.
    """
    spare_what_stays()
    node.get_logger().info(f"ready: {about}" if about else "ready")


def run_node(make: Callable[[], Node], args: list[str] | None) -> None:
    """Runs one node until it is told to end, or its attribute ``done``, a future, is set.

    Once it answers it says so, with its attribute ``about`` if it has one. Bad input ends the
    process with one line and status 2.

    Args:
        make: Builds the node.
        args: Command line; None is the process's own.
    """
    node: Node | None = None
    try:
        with initialised(args):
            hand_on(get_logger(LOG).info)
            try:
                node = make()
                say_ready(node, getattr(node, "about", ""))
                done = getattr(node, "done", None)
                if done is None:
                    rclpy.spin(node)
                else:
                    rclpy.spin_until_future_complete(node, done)
            finally:
                if node is not None:
                    node.destroy_node()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except InputError as error:
        print(" ".join(str(error).split()), file=sys.stderr)
        sys.exit(EXIT_BAD_INPUT)
