# SPDX-License-Identifier: Apache-2.0
"""Publishing readings: taps on their topics and as a set, encoders on theirs, and their time."""

import math
from collections.abc import Sequence

from pneu_msgs.msg import TapPressures
from rclpy.node import Node
from rosgraph_msgs.msg import Clock as ClockMessage

from pneu_graph.nodes.common import CLOCK_TOPIC, COMMAND_QOS, READINGS_QOS, to_stamp
from pneu_hw_bridge.link import Sample
from pneu_hw_bridge.registers.schema import RegisterMap
from pneu_sim import topics


class ReadingsPublisher:
    """Publishers of taps and encoders; what cannot be true is left out, NaN in the set of taps."""

    def __init__(
        self,
        node: Node,
        registers: RegisterMap,
        topics_of_readings: Sequence[topics.Topic],
        frame_id: str,
        with_clock: bool = False,
    ) -> None:
        """Creates the publishers.

        Args:
            node: The node.
            registers: What is read.
            topics_of_readings: Where each tap and encoder is told.
            frame_id: Frame of the set.
            with_clock: Whether the time of the newest sample is published on ``/clock``.
        """
        self._node = node
        self._sampled = registers.sampled
        self._set = TapPressures(name=list(registers.taps))
        self._set.header.frame_id = frame_id
        self._to_set = node.create_publisher(TapPressures, topics.TAPS_TOPIC, READINGS_QOS)
        self._frame_id = frame_id
        self._to_topics = [
            (
                topic,
                node.create_publisher(topics.message_class(topic.type), topic.name, READINGS_QOS),
            )
            for topic in topics_of_readings
            if topic.name != topics.TAPS_TOPIC
        ]
        self._to_clock = (
            node.create_publisher(ClockMessage, CLOCK_TOPIC, COMMAND_QOS) if with_clock else None
        )

    def publish_clock(self, stamp_ns: int) -> None:
        """Publishes the time of the newest sample, where that is wanted.

        Args:
            stamp_ns: The time, ns.
        """
        if self._to_clock is not None:
            self._to_clock.publish(ClockMessage(clock=to_stamp(stamp_ns)))

    def publish(self, sample: Sample) -> None:
        """Publishes one sample.

        Args:
            sample: What was read.
        """
        stamp = to_stamp(sample.stamp_ns)
        values = {
            name: sample.values[name]
            for name, channel in self._sampled.items()
            if channel.range[0] <= sample.values[name] <= channel.range[1]  # false for NaN
        }
        for topic, publisher in self._to_topics:
            message = topic.message(values, stamp)
            if message is not None:
                if topic.type == topics.JOINT_STATE:
                    message.header.frame_id = self._frame_id
                publisher.publish(message)
        self._set.header.stamp = stamp
        self._set.pressure_pa = [values.get(name, math.nan) for name in self._set.name]
        self._to_set.publish(self._set)

    def destroy(self) -> None:
        """Destroys the publishers."""
        clocks = [self._to_clock] if self._to_clock is not None else []
        for publisher in (self._to_set, *(one for _, one in self._to_topics), *clocks):
            self._node.destroy_publisher(publisher)
