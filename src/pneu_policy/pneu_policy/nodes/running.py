# SPDX-License-Identifier: Apache-2.0
"""Running a controller as a process whose last word is the safe voltage, however it is told to end.

ROS 2's own handlers of signals shut the graph down at once; nothing could be said after that.
"""

import signal
import sys
from collections.abc import Callable
from types import FrameType

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.logging import get_logger
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from pneu_common.errors import InputError
from pneu_common.log import LOG, hand_on
from pneu_graph.nodes.common import EXIT_BAD_INPUT, say_ready
from pneu_policy.nodes.controlling import ControllingNode


class _ToldToEndError(BaseException):
    """A signal asked the process to end."""


def _end(number: int, frame: FrameType | None) -> None:
    raise _ToldToEndError


def run_controller(make: Callable[[], ControllingNode], args: list[str] | None) -> None:
    """Runs one node until it is told to end. Bad input ends the process with one line and status 2.

    One with something to bring to an end, a future ``done``, ends by itself once that has a result;
    the status is then 0 where that is true, else its attribute ``status``, or 1.

    Args:
        make: Builds the node.
        args: Command line; None is the process's own.
    """
    node: ControllingNode | None = None
    done: Future | None = None
    numbers = [signal.SIGINT, signal.SIGTERM]
    if signal.getsignal(signal.SIGHUP) is signal.SIG_DFL:  # else nohup wants it to go on
        numbers.append(signal.SIGHUP)
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
        for number in numbers:
            signal.signal(number, _end)
        try:
            hand_on(get_logger(LOG).info)
            node = make()
            say_ready(node, "")
            done = getattr(node, "done", None)
            if done is None:
                rclpy.spin(node)
            else:
                rclpy.spin_until_future_complete(node, done)
        finally:
            for number in numbers:
                signal.signal(number, signal.SIG_IGN)  # being asked again does not hurry it
            if node is not None:
                if rclpy.ok():
                    node.end()
                node.destroy_node()
            rclpy.try_shutdown()
    except (_ToldToEndError, KeyboardInterrupt, ExternalShutdownException):
        pass
    except InputError as error:
        print(" ".join(str(error).split()), file=sys.stderr)
        sys.exit(EXIT_BAD_INPUT)
    if done is not None and not (done.done() and done.result()):
        sys.exit(getattr(node, "status", 1))
