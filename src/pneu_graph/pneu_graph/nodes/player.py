# SPDX-License-Identifier: Apache-2.0
"""Node that plays a bag: the recorded bytes, on the recorded topics, with the recorded QoS.

Services: ``~/pause``, ``~/resume``, ``~/toggle_paused``, ``~/play_next`` (std_srvs/Trigger).
"""

import dataclasses
import functools
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import rclpy
from rclpy.duration import Duration
from rclpy.node import Node
from rosgraph_msgs.msg import Clock as ClockMessage
from std_srvs.srv import Trigger

from pneu_common.errors import InputError
from pneu_graph.bag.playback import Pacer
from pneu_graph.bag.qos import adapt_to_recorded
from pneu_graph.bag.reader import BagMessage, BagReader
from pneu_graph.nodes.common import other_clocks, steady_clock
from pneu_graph.nodes.lifetime import initialised
from pneu_graph.nodes.type_support import interface_class

CLOCK = "/clock"
ACKNOWLEDGE_S = 2.0
"""How long the end waits for reliable subscriptions to have everything, s."""


@dataclasses.dataclass(frozen=True)
class PlayOptions:
    """How to play.

    Attributes:
        rate: Recorded seconds per second, > 0.
        loop: Begin again at the end.
        start_offset_s: Where to begin, after the first message, s.
        duration_s: How much to play, s; 0: all.
        clock_hz: How often to publish /clock; 0: not at all.
        topics: Only these; empty: all.
        exclude: Not these.
        paused: Begin paused.
        delay_s: Wait before the first message, s.
    """

    rate: float = 1.0
    loop: bool = False
    start_offset_s: float = 0.0
    duration_s: float = 0.0
    clock_hz: float = 0.0
    topics: tuple[str, ...] = ()
    exclude: tuple[str, ...] = ()
    paused: bool = False
    delay_s: float = 0.0

    def check(self) -> None:
        """Checks the numbers.

        Raises:
            InputError: One is out of range.
        """
        if not 0.0 < self.rate < 1e6:
            raise InputError(f"--rate: is more than 0, found {self.rate:g}")
        for name in ("start_offset_s", "duration_s", "clock_hz", "delay_s"):
            if not getattr(self, name) >= 0.0:
                option = name.removesuffix("_s").removesuffix("_hz").replace("_", "-")
                raise InputError(f"--{option}: is 0 or more, found {getattr(self, name):g}")


class Player(Node):
    """Plays a bag.

    Args:
        bag: The bag.
        options: How to play.
        **node_options: Handed to `rclpy.node.Node`.

    Raises:
        InputError: A topic is not in the bag, or /clock has a publisher already.
    """

    def __init__(self, bag: BagReader, options: PlayOptions, **node_options: Any) -> None:
        super().__init__("player", **node_options)
        options.check()
        self._play_bag = bag
        self._play_options = options
        self.pacer = Pacer(options.rate, options.paused)
        self.published = 0
        recorded = {topic.name for topic in bag.metadata.topics}
        for name in (*options.topics, *options.exclude):
            if name not in recorded:
                raise InputError(
                    f"{bag.path}: has no topic {name!r}; it has {', '.join(sorted(recorded))}"
                )
        self._play_topics = (set(options.topics) or recorded) - set(options.exclude)
        if options.clock_hz:
            self._play_topics.discard(CLOCK)  # there is one clock, and it is ours
        self._play_publishers_by_topic = self._make_publishers()
        self._play_time_publisher = self._make_clock() if options.clock_hz else None
        for name, act in (
            ("pause", self.pacer.pause),
            ("resume", self.pacer.resume),
            ("toggle_paused", self._toggle),
            ("play_next", self.pacer.step),
        ):
            self.create_service(Trigger, f"~/{name}", functools.partial(self._serve, act))

    def play(self) -> bool:
        """Publishes until the end of the bag; to be called beside the executor's thread.

        Returns:
            Whether the end was reached.
        """
        first = self._play_bag.metadata.start_ns + round(self._play_options.start_offset_s * 1e9)
        if not self._play_bag.metadata.message_count:
            return True
        last = self._play_bag.metadata.end_ns
        if self._play_options.duration_s:
            last = min(last, first + round(self._play_options.duration_s * 1e9))
        if self._play_options.delay_s:
            self.pacer.begin(
                first - round(self._play_options.delay_s * self._play_options.rate * 1e9)
            )
            if not self.pacer.wait_until(first):
                return False
        while True:
            self.pacer.begin(first)
            if not self._play_once(first, last):
                return False
            if not self._play_options.loop:
                break
        for publisher in self._play_publishers_by_topic.values():
            publisher.wait_for_all_acked(Duration(seconds=ACKNOWLEDGE_S))
        return True

    def _play_once(self, first: int, last: int) -> bool:
        for due_ns, message in self._events(first, last):
            if message is None:
                if self.pacer.wait_until(due_ns, steppable=False):
                    self._tell_time(due_ns)
                elif not rclpy.ok():
                    return False
                continue
            if not self.pacer.wait_until(due_ns) or not rclpy.ok():
                return False
            if self.pacer.paused:
                self._tell_time(due_ns)  # a step moves the time too
            self._play_publishers_by_topic[message.topic].publish(message.data)
            self.published += 1
        return True

    def _events(self, first: int, last: int) -> Iterator[tuple[int, BagMessage | None]]:
        """Messages and, between them, ticks of the clock."""
        tick = first
        step = (
            round(1e9 * self._play_options.rate / self._play_options.clock_hz)
            if self._play_time_publisher
            else 0
        )
        for message in self._play_bag.messages(set(self._play_publishers_by_topic), first):
            if message.log_time_ns > last:
                return
            while self._play_time_publisher and tick <= message.log_time_ns:
                yield tick, None
                tick += step
            yield message.log_time_ns, message

    def _make_publishers(self) -> dict[str, Any]:
        publishers = {}
        for topic in self._play_bag.metadata.topics:
            if topic.name not in self._play_topics or not topic.message_count:
                continue
            try:
                cls = interface_class(topic.type)
            except InputError as error:
                self.get_logger().warning(f"{topic.name} is not played: {error}")
                continue
            if topic.name == CLOCK:
                self._be_the_only_clock()
            publishers[topic.name] = self.create_publisher(
                cls, topic.name, adapt_to_recorded(topic.profiles).profile()
            )
        return publishers

    def _make_clock(self) -> Any:
        self._be_the_only_clock()
        return self.create_publisher(ClockMessage, CLOCK, 1)

    def _be_the_only_clock(self) -> None:
        """Refuses to be a second publisher of the clock, and reports one that is found later."""
        others = self.get_publishers_info_by_topic(self.resolve_topic_name(CLOCK))
        if others:
            names = ", ".join(
                f"{info.node_namespace.rstrip('/')}/{info.node_name}" for info in others
            )
            raise InputError(f"{CLOCK} is published by {names} already, allowed is one publisher")
        self.create_timer(1.0, self._look_for_other_clocks, clock=steady_clock())

    def _look_for_other_clocks(self) -> None:
        if other_clocks(self, own=1):
            self.get_logger().error(
                f"{CLOCK} has another publisher, allowed is one", throttle_duration_sec=10.0
            )

    def _tell_time(self, time_ns: int) -> None:
        if self._play_time_publisher is not None:
            message = ClockMessage()
            message.clock.sec, message.clock.nanosec = divmod(time_ns, 10**9)
            self._play_time_publisher.publish(message)

    def _toggle(self) -> None:
        (self.pacer.resume if self.pacer.paused else self.pacer.pause)()

    def _serve(self, act: Callable[[], Any], request: Any, response: Any) -> Any:
        response.success = act() is not False
        response.message = "" if response.success else "the player is not paused"
        return response


def play_bag(path: Path, options: PlayOptions, ros_arguments: list[str]) -> int:
    """Plays a bag to its end.

    Args:
        path: Folder of a bag, or one MCAP file.
        options: How to play.
        ros_arguments: `--ros-args` for the node, such as remaps.

    Returns:
        Exit status: 0 where the end was reached, 130 where playing was interrupted.

    Raises:
        InputError: The bag cannot be played.
    """
    from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor

    from pneu_graph.tools.session import settle

    bag = BagReader(path)
    outcome: list[bool | BaseException] = []
    with initialised(ros_arguments):
        looking = rclpy.create_node("_player_looking", use_global_arguments=False)
        try:
            settle(looking)
            # With its last node a participant of Fast DDS ends, and all that it has found.
            node = Player(bag, options)
        finally:
            looking.destroy_node()
        executor = SingleThreadedExecutor()
        executor.add_node(node)

        def run() -> None:
            try:
                outcome.append(node.play())
            except BaseException as error:  # handed to the main thread, which reports it
                # A shutdown that overtakes a publication makes it fail: an ordinary end.
                outcome.append(error if rclpy.ok() else False)
            executor.wake()

        thread = threading.Thread(target=run, name="player", daemon=True)
        thread.start()
        try:
            while not outcome and rclpy.ok():
                executor.spin_once(timeout_sec=0.2)
        except (KeyboardInterrupt, ExternalShutdownException):
            pass  # stopped by the user
        finally:
            node.pacer.stop()
            thread.join()
            executor.shutdown()
            node.destroy_node()
    if outcome and isinstance(outcome[0], BaseException):
        raise outcome[0]
    return 0 if outcome and outcome[0] else 130


def main(args: list[str] | None = None) -> None:
    """Plays the bag that the first argument names.

    Args:
        args: Command line: path, then `--ros-args`; None: that of the process.
    """
    words = sys.argv[1:] if args is None else args
    if not words:
        sys.exit("player: a bag is needed")
    sys.exit(play_bag(Path(words[0]), PlayOptions(), words[1:]))
