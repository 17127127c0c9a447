# SPDX-License-Identifier: Apache-2.0
"""Commands and readings of a rig as they come in over the graph, each with its time."""

import math
from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data

from pneu_graph.nodes import common
from pneu_sim import topics
from pneu_sim.rig.schema import Rig

AHEAD_S, BEHIND_S = 0.02, 0.2
"""A command whose stamp is further from the newest reading's is on another clock, or that of the
readings lags (a simulator that cannot keep time): it counts from the newest reading on."""

Heard = Callable[[bool, str, float, float], None]
"""Told whether it is a command, its name, its time, s, and its value."""


class Listening:
    """Subscribes to all signals of a rig."""

    def __init__(self, node: Node, rig: Rig, heard: Heard) -> None:
        """Begins.

        Args:
            node: The node.
            rig: The rig.
            heard: Told of each command and reading, in the thread of the executor.
        """
        self._node, self._heard = node, heard
        self._latest_s = math.nan
        for topic in (*topics.tap_topics(rig), *topics.encoder_topics(rig)):
            node.create_subscription(
                topics.message_class(topic.type),
                topic.name,
                lambda message, topic=topic: self._on_readings(topic, message),
                qos_profile_sensor_data,
            )
        # What took effect, and when, tells more than what was asked for.
        applied = {
            command.channel.topic: command.channel.applied
            for command in rig.commands.values()
            if command.channel is not None
        }
        for topic in topics.command_topics(rig):
            node.create_subscription(
                topics.message_class(topic.type),
                applied.get(topic.name) or topic.name,
                lambda message, topic=topic: self._on_command(topic, message),
                10,
            )

    def _time_s(self, message: Any) -> float:
        header = getattr(message, "header", None)
        stamp_ns = common.from_stamp(header.stamp) if header is not None else 0
        return (stamp_ns or self._node.get_clock().now().nanoseconds) * 1e-9

    def _on_readings(self, topic: topics.Topic, message: Any) -> None:
        time_s = self._latest_s = self._time_s(message)
        for name, value in topic.read(message).items():
            self._heard(False, name, time_s, value)

    def _on_command(self, topic: topics.Topic, message: Any) -> None:
        if math.isnan(self._latest_s):
            return
        time_s = self._time_s(message)
        if not -BEHIND_S <= time_s - self._latest_s <= AHEAD_S:
            time_s = self._latest_s
        for name, value in topic.read(message).items():
            self._heard(True, name, time_s, value)
