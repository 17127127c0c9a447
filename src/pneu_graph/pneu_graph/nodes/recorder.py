# SPDX-License-Identifier: Apache-2.0
"""Node that records topics into a rosbag2 MCAP bag.

It subscribes without decoding, with a QoS that matches every publisher, takes up topics that appear
later, and hands messages to a thread that writes them. Beside the messages it keeps the files it is
told to attach (the rig file), the parameters of every node, and the revision of the source.

Services: ``~/snapshot``, ``~/split`` (std_srvs/Trigger). /diagnostics tells how it goes.
"""

import contextlib
import dataclasses
import functools
import re
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_msgs.msg import String
from std_srvs.srv import Trigger

from pneu_common.errors import InputError
from pneu_graph.bag.bag_writer import Attachment, BagWriter
from pneu_graph.bag.losses import Losses
from pneu_graph.bag.metadata import Topic
from pneu_graph.bag.qos import OfferedQos, adapt_to_publishers
from pneu_graph.bag.recording import Recording
from pneu_graph.nodes.lifetime import initialised
from pneu_graph.nodes.parameter_collector import ParameterCollector
from pneu_graph.nodes.parameters import Parameters, parameter
from pneu_graph.nodes.provenance import provenance
from pneu_graph.nodes.type_support import definition_text, interface_class, type_hash
from pneu_runtime.transport.sent import TOPIC, decode

HISTORY_DEPTH = 10_000
"""Messages a subscription holds while the executor is busy."""

LATE_S = 2.0
"""A writer that comes round this much too late is reported as slow, s."""


@dataclass
class RecorderParameters(Parameters):
    """What the recorder is told."""

    uri: str = parameter("", "Folder of the bag; empty: named by the time.", read_only=True)
    topics: list[str] = parameter([""], "Topics to record.", read_only=True)
    all: bool = parameter(
        False, "Record every topic; also so where no topic is named.", read_only=True
    )
    regex: str = parameter("", "Record topics whose whole name matches.", read_only=True)
    exclude: str = parameter("", "Leave out topics whose whole name matches.", read_only=True)
    include_hidden_topics: bool = parameter(
        False, "Record topics with a part that begins with _.", read_only=True
    )
    max_bag_size: int = parameter(
        0, "Size of a file, bytes; 0: no limit.", within=(0, 2**62), read_only=True
    )
    max_bag_duration: float = parameter(
        0.0, "Duration of a file, s; 0: no limit.", within=(0.0, 1e9), read_only=True
    )
    snapshot_mode: bool = parameter(
        False, "Keep messages in memory until ~/snapshot is called.", read_only=True
    )
    max_cache_size: int = parameter(
        100 * 1024 * 1024,
        "Messages that may wait in memory, bytes.",
        within=(1, 2**62),
        read_only=True,
    )
    polling_interval: float = parameter(
        0.2, "Time between looks for new topics, s.", within=(0.01, 60.0), read_only=True
    )
    attachments: list[str] = parameter(
        [""], "Files kept in the bag, such as the rig file.", read_only=True
    )
    operator: str = parameter("", "Who recorded.", read_only=True)


class Recorder(Node):
    """Records topics into a bag.

    Args:
        **options: Handed to `rclpy.node.Node`.

    Raises:
        InputError: The bag exists or cannot be made, or a parameter is no regular expression.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__("recorder", **options)
        params = self._rec_params = RecorderParameters.declare(self)
        self._rec_names = {self.resolve_topic_name(name) for name in params.topics if name}
        self._rec_everything = params.all or (not self._rec_names and not params.regex)
        self._rec_regex = self._pattern("regex")
        self._rec_exclude = self._pattern("exclude")
        self._rec_hidden = params.include_hidden_topics
        self._rec_sim_time = self.get_parameter("use_sim_time").value
        self._rec_subscriptions_by_topic: dict[str, Any] = {}
        self._rec_left_out: set[str] = set()
        self._rec_missing_before = 0
        self._rec_losses = Losses()
        self._rec_alone: set[str] = set()
        uri = params.uri or time.strftime("rosbag2_%Y_%m_%d-%H_%M_%S")
        attachments = [_attachment(path) for path in params.attachments if path]
        writer = BagWriter(Path(uri), params.max_bag_size, float(params.max_bag_duration))
        self._rec_recording = Recording(
            writer,
            params.max_cache_size,
            params.snapshot_mode,
            report=self._report,
        )
        self._rec_recording.add_record("pneu", provenance(params.operator))
        for attachment in attachments:
            self._rec_recording.attach(attachment)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        group = MutuallyExclusiveCallbackGroup()
        self._rec_collector = ParameterCollector(self, self._rec_recording.attach)
        self._rec_diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.create_subscription(
            String, TOPIC, self._on_counts, QoSProfile(depth=1000), callback_group=group
        )
        self._discover()
        self.create_timer(
            params.polling_interval, self._discover, callback_group=group, clock=steady
        )
        self.create_timer(1.0, self._diagnose, callback_group=group, clock=steady)
        self.create_service(
            Trigger, "~/snapshot", functools.partial(self._serve, self._rec_recording.snapshot)
        )
        self.create_service(
            Trigger, "~/split", functools.partial(self._serve, self._rec_recording.split)
        )
        self.get_logger().info(f"recording into {uri}")

    def close(self) -> bool:
        """Ends the bag.

        Returns:
            Whether everything that was sent was written.
        """
        lost = self._rec_losses.by_topic(time.monotonic(), ended=True)
        if lost:
            self._rec_recording.tell_lost(lost)
        faults = self._rec_recording.close()
        status = self._rec_recording.status()
        for fault in faults:
            print(f"[recorder] {fault}", file=sys.stderr)
        if status.dropped:
            print(f"[recorder] {status.dropped} messages were lost", file=sys.stderr)
        for topic, count in sorted(lost.items()):
            print(f"[recorder] {topic}: {count} messages never came", file=sys.stderr)
        return not (faults or lost or status.dropped)

    def _report(self, sentence: str) -> None:
        self.get_logger().error(sentence)

    def _pattern(self, name: str) -> re.Pattern[str] | None:
        text = getattr(self._rec_params, name)
        try:
            return re.compile(text) if text else None
        except re.error as error:
            raise InputError(
                f"parameter {name}: {text!r} is no regular expression ({error})"
            ) from None

    def _wanted(self, topic: str) -> bool:
        if self._rec_exclude is not None and self._rec_exclude.fullmatch(topic):
            return False
        if topic in self._rec_names:
            return True
        if self._rec_regex is not None and self._rec_regex.fullmatch(topic):
            return True
        hidden = any(part.startswith("_") for part in topic.split("/"))
        return bool(self._rec_everything) and (self._rec_hidden or not hidden)

    def _discover(self) -> None:
        for topic, types in self.get_topic_names_and_types():
            known = topic in self._rec_subscriptions_by_topic or topic in self._rec_left_out
            if not known and self._wanted(topic):
                self._take_up(topic, types)
        self._rec_alone = {
            topic
            for topic, subscription in self._rec_subscriptions_by_topic.items()
            if subscription.get_publisher_count() == 1
        }
        self._rec_collector.look()

    def _take_up(self, topic: str, types: list[str]) -> None:
        publishers = self.get_publishers_info_by_topic(topic)
        if not publishers:
            return
        try:
            if len(types) != 1:
                raise InputError(f"has several types: {', '.join(types)}")
            message_type = interface_class(types[0])
        except InputError as error:
            self._rec_left_out.add(topic)
            self.get_logger().warning(f"{topic} is not recorded: {error}")
            return
        offers = [OfferedQos.from_profile(info.qos_profile) for info in publishers]
        announced = str(getattr(publishers[0], "topic_type_hash", ""))
        entry = Topic(
            topic,
            types[0],
            announced if announced.startswith("RIHS") else type_hash(types[0]),
            offers,
        )
        definition = definition_text(types[0])
        if not definition:
            self.get_logger().warning(f"{topic}: no definition of {types[0]} found for the bag")
        self._rec_recording.add_topic(entry, definition)
        self._rec_subscriptions_by_topic[topic] = self.create_subscription(
            message_type,
            topic,
            self._receiver(topic),
            adapt_to_publishers(offers, HISTORY_DEPTH).profile(),
            raw=True,
        )
        self.get_logger().info(f"subscribed to {topic}")

    def _on_counts(self, message: String) -> None:
        """Takes note of what a participant tells of its publications."""
        with contextlib.suppress(ValueError):
            self._rec_losses.told(decode(message.data), time.monotonic())

    def _receiver(self, topic: str) -> Callable[[bytes, Any], None]:
        write, seen = self._rec_recording.write, self._rec_losses.seen
        clock = self.get_clock() if self._rec_sim_time else None

        def receive(data: bytes, info: Any) -> None:
            if clock is None:
                log_time_ns = info["received_timestamp"] or time.time_ns()
            else:
                log_time_ns = clock.now().nanoseconds
            source_ns = info["source_timestamp"] or log_time_ns
            sender = info.get("publisher_gid")
            number = info.get("publication_sequence_number")
            # (without knowing whose it is, a number tells something of one publisher only)
            alone = sender is not None or topic in self._rec_alone
            seen(
                topic,
                bytes(sender["data"]).hex() if sender else "",
                source_ns,
                number if alone and isinstance(number, int) else None,
            )
            write(topic, data, log_time_ns, source_ns)

        return receive

    def _serve(self, act: Callable[[], str], request: Any, response: Any) -> Any:
        response.message = act()
        response.success = not response.message
        return response

    def _diagnose(self) -> None:
        status = self._rec_recording.status()
        lost = self._rec_losses.by_topic(time.monotonic())
        missing = status.dropped + sum(lost.values())
        level, message = DiagnosticStatus.OK, "recording"
        if status.fault:
            level, message = DiagnosticStatus.ERROR, f"cannot write: {status.fault}"
        elif missing > self._rec_missing_before:
            level, message = DiagnosticStatus.WARN, "messages were lost"
        elif status.lag_s > LATE_S:
            level, message = DiagnosticStatus.WARN, "the disk is slow"
        self._rec_missing_before = missing
        told = {f"never came of {topic}": count for topic, count in sorted(lost.items())}
        values = {
            **dataclasses.asdict(status),
            **told,
            "topics": len(self._rec_subscriptions_by_topic),
        }
        array = DiagnosticArray()
        array.header.stamp = self.get_clock().now().to_msg()
        array.status = [
            DiagnosticStatus(
                level=level,
                name=f"{self.get_name()}: bag",
                message=message,
                values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
            )
        ]
        self._rec_diagnostics.publish(array)


def _attachment(path: str) -> Attachment:
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be attached ({error.strerror})") from None
    media_type = {".yaml": "application/yaml", ".json": "application/json"}.get(
        Path(path).suffix, "application/octet-stream"
    )
    return Attachment(Path(path).name, data, media_type, time.time_ns())


def main(args: list[str] | None = None) -> None:
    """Records until it is stopped.

    Args:
        args: Command line, with `--ros-args`; None: that of the process.
    """
    node = None
    complete = True
    try:
        with initialised(args):
            node = Recorder()
            try:
                rclpy.spin(node)
            finally:
                node.destroy_node()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass  # the usual end of a recording
    except InputError as error:
        sys.exit(f"recorder: {error}")
    finally:
        if node is not None:
            complete = node.close()
    if not complete:
        sys.exit(1)


if __name__ == "__main__":
    main()
