# SPDX-License-Identifier: Apache-2.0
"""Who writes to the command topic, and whether that is somebody to be followed."""

from collections.abc import Sequence

from rclpy.topic_endpoint_info import TopicEndpointInfo

NO_NODES = ("_NODE_NAME_UNKNOWN_", "_CREATED_BY_BARE_DDS_APP_")
"""What ROS 2 says in place of a node's name (rmw_dds_common, rmw_cyclonedds)."""


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
    return ""


def competing(by_topic: Sequence[Sequence[TopicEndpointInfo]], commander: str) -> tuple[int, str]:
    """How many publish commands, and why the one that does is not followed.

    Args:
        by_topic: The writers of each topic with commands; one node may have one on each.
        commander: The node that may command; see `wrong_writer`.

    Returns:
        Their number; and what `wrong_writer` says of one, empty where he is followed.
    """
    nodes = {(one.node_namespace, one.node_name): one for of in by_topic for one in of}
    count = max(len(nodes), *(len(of) for of in by_topic))
    return count, wrong_writer(list(nodes.values()), commander) if count == 1 else ""
