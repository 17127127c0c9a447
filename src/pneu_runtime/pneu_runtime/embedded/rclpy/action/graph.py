# SPDX-License-Identifier: Apache-2.0
"""Which actions there are in the graph, seen by the feedback topics they have."""

from collections.abc import Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rclpy.node import Node

_TOPIC_SUFFIX = "/_action/feedback"
_TYPE_SUFFIX = "_FeedbackMessage"

NamesAndTypes = list[tuple[str, list[str]]]


def _actions(topics: Iterable[tuple[str, list[str]]]) -> NamesAndTypes:
    return [
        (name.removesuffix(_TOPIC_SUFFIX), [one.removesuffix(_TYPE_SUFFIX) for one in types])
        for name, types in topics
        if name.endswith(_TOPIC_SUFFIX)
    ]


def get_action_client_names_and_types_by_node(
    node: "Node", remote_node_name: str, remote_node_namespace: str
) -> NamesAndTypes:
    """Return the actions a node is a client of, each with its types.

    Args:
        node: Node that looks.
        remote_node_name: Name of the node that is looked at.
        remote_node_namespace: Its namespace.
    """
    return _actions(
        node.get_subscriber_names_and_types_by_node(remote_node_name, remote_node_namespace)
    )


def get_action_server_names_and_types_by_node(
    node: "Node", remote_node_name: str, remote_node_namespace: str
) -> NamesAndTypes:
    """Return the actions a node serves, each with its types.

    Args:
        node: Node that looks.
        remote_node_name: Name of the node that is looked at.
        remote_node_namespace: Its namespace.
    """
    return _actions(
        node.get_publisher_names_and_types_by_node(remote_node_name, remote_node_namespace)
    )


def get_action_names_and_types(node: "Node") -> NamesAndTypes:
    """Return all actions of the graph, each with its types.

    Args:
        node: Node that looks.
    """
    return _actions(node.get_topic_names_and_types())
