# SPDX-License-Identifier: Apache-2.0
"""Who publishes commands, and whether that is somebody to be followed.

Messages may arrive before the graph lists their publisher, with rmw_fastrtps by seconds. So that
the graph lists one publisher is no proof that there is no other: the subscription itself counts the
publishers whose messages it can deliver, and while these are more than the graph lists, nobody is
followed.
"""

import time
from collections.abc import Mapping, Sequence
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSCompatibility, qos_check_compatible
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from pneu_graph.nodes.common import COMMAND_QOS
from pneu_hw_bridge.safety.lateness import Lateness

NO_NODES = ("_NODE_NAME_UNKNOWN_", "_CREATED_BY_BARE_DDS_APP_")
"""What ROS 2 says in place of a node's name (rmw_dds_common, rmw_cyclonedds)."""

UNLISTED = "a publisher of commands is not known to the graph yet"
"""Reason not to follow anybody."""


class Writers:
    """The publishers of commands, as subscriptions, messages and the graph show them."""

    def __init__(
        self, node: Node, subscriptions: Mapping[str, Subscription], commander: str
    ) -> None:
        """Knows of nobody until `look` is called.

        Args:
            node: The node that looks at the graph.
            subscriptions: To the topics with commands, by their names in the code.
            commander: The node that may command, with its namespace; empty for any.
        """
        self._node = node
        self._subscriptions = subscriptions
        self._commander = commander
        self._gids: dict[str, list[bytes]] = {}
        self._lateness = Lateness()

    def is_known(self, topic: str, info: Mapping[str, Any]) -> bool:
        """Whether a message is of the only publisher that the latest look found on its topic.

        Args:
            topic: Its topic.
            info: What the middleware tells of the message.
        """
        gids = self._gids.get(topic, [])
        return (
            len(gids) == 1
            and self._subscriptions[topic].get_publisher_count() == 1
            and _gid(info) in (None, gids[0])
        )

    def look(self, info: Mapping[str, Any] | None = None) -> tuple[int, str]:
        """Looks who may command: one node, and the one that is named where one is.

        Args:
            info: What the middleware tells of a message whose publisher is in question.

        Returns:
            How many publish commands, and why they are not followed; empty where one may be.
        """
        listed = {
            topic: self._node.get_publishers_info_by_topic(topic) for topic in self._subscriptions
        }
        gids = {topic: [bytes(one.endpoint_gid) for one in of] for topic, of in listed.items()}
        if gids != self._gids:  # whoever comes next has a clock of its own
            self._lateness = Lateness()
        self._gids = gids
        topics = [
            (of, self._subscriptions[topic].get_publisher_count()) for topic, of in listed.items()
        ]
        count, wrong = competing(topics, self._commander)
        gid = None if info is None else _gid(info)
        if gid is not None and not any(gid in of for of in gids.values()):
            wrong = UNLISTED
        return count, wrong

    def sent_s(self, info: Mapping[str, Any]) -> float:
        """When a command was sent, by the steady clock of this machine, s.

        Args:
            info: What the middleware tells of the message, of the publisher that is followed.
        """
        received_s = time.monotonic()
        sent_ns = info.get("source_timestamp", 0)  # 0 where the middleware does not tell
        return received_s - (self._lateness.of(1e-9 * sent_ns, received_s) if sent_ns > 0 else 0.0)


def _gid(info: Mapping[str, Any]) -> bytes | None:
    """Identity of a message's publisher as the graph has it; None where it is not told.

    rclpy of Jazzy does not tell it, and rmw_cyclonedds tells a number of its own, which leaves the
    last bytes, the entity of a DDS GUID, at zero.
    """
    told = info.get("publisher_gid")
    gid = b"" if told is None else bytes(told["data"])
    return gid if any(gid[12:]) else None


def wrong_writer(writers: Sequence[TopicEndpointInfo], commander: str) -> str:
    """Says why the writers of the command topic are not followed; empty where one is.

    Args:
        writers: They.
        commander: The node that may command, with its namespace; empty for any.
    """
    if len(writers) != 1:
        return ""  # told by their number
    one = writers[0]
    if one.node_name in NO_NODES:
        return "the publisher on the command topic belongs to no node"
    name = f"{one.node_namespace.rstrip('/')}/{one.node_name}"
    if commander and name != f"/{commander.lstrip('/')}":
        return f"{name} publishes commands, only {commander} may (commander)"
    assert one.qos_profile is not None  # as it is of an endpoint that nobody has found
    compatible, why = qos_check_compatible(one.qos_profile, COMMAND_QOS)
    if compatible == QoSCompatibility.ERROR:  # so what is heard is somebody else's
        return f"commands of {name} are not heard: {why}"
    return ""


def competing(
    topics: Sequence[tuple[Sequence[TopicEndpointInfo], int]], commander: str
) -> tuple[int, str]:
    """How many publish commands, and why the one that does is not followed.

    Args:
        topics: Of each topic with commands the writers that the graph lists, and how many
            publishers the subscription receives from; one node may have a writer on each topic.
        commander: The node that may command; see `wrong_writer`.

    Returns:
        Their number; and why the one is not followed, empty where it is.
    """
    nodes = {(one.node_namespace, one.node_name): one for of, _ in topics for one in of}
    count = max([len(nodes), *(max(len(of), heard) for of, heard in topics)])
    if any(heard > len(of) for of, heard in topics):
        return count, UNLISTED
    return count, wrong_writer(list(nodes.values()), commander) if count == 1 else ""
