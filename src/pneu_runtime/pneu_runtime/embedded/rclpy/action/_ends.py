# SPDX-License-Identifier: Apache-2.0
"""The three services and two topics that an action consists of, at the level of the transport."""

from typing import TYPE_CHECKING, Any

from pneu_runtime import interfaces
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.qos import QoSProfile

if TYPE_CHECKING:
    from rclpy.node import Node

SERVICES = {
    "send_goal": "SendGoalService",
    "get_result": "GetResultService",
    "cancel_goal": "CancelGoalService",
}
TOPICS = {"feedback": "FeedbackMessage", "status": "GoalStatusMessage"}


def service_of(action_type: Any, name: str) -> tuple[Any, str]:
    """Return the class of a service of an action, and the name of its type.

    Args:
        action_type: Class of the action.
        name: One of `SERVICES`.
    """
    cls = getattr(action_type.Impl, SERVICES[name])
    return cls, interfaces.type_name(cls)


def topic_of(action_type: Any, name: str) -> tuple[Any, str]:
    """Return the class of the messages of a topic of an action, and the name of its type.

    Args:
        action_type: Class of the action.
        name: One of `TOPICS`.
    """
    cls = getattr(action_type.Impl, TOPICS[name])
    return cls, interfaces.type_name(cls)


def check_action_type(action_type: Any) -> None:
    """Check that something is the class of an action.

    Args:
        action_type: What was given as one; TypeError where it is none.
    """
    if not hasattr(action_type, "Impl") or not hasattr(action_type, "Goal"):
        raise TypeError(f"{action_type!r} is not the class of an action")


def create_end(
    node: "Node", kind: str, action_type: Any, action_name: str, name: str, qos: QoSProfile
) -> Any:
    """Create one endpoint of an action.

    Args:
        node: Node it belongs to.
        kind: "server", "client", "publication" or "subscription".
        action_type: Class of the action.
        action_name: Name of the action as the user gave it.
        name: One of `SERVICES` or `TOPICS`.
        qos: Its QoS.
    """
    full = f"{action_name}/_action/{name}"
    if name in SERVICES:
        full = node.resolve_service_name(full)
        _, type_name = service_of(action_type, name)
    else:
        full = node.resolve_topic_name(full)
        _, type_name = topic_of(action_type, name)
    create = getattr(node._session, f"create_{kind}")
    return create(node._handle, full, type_name, qos)


def decode(data: bytes, message_type: type, logger: RcutilsLogger) -> Any:
    """Read a message; one that cannot be read is logged and dropped.

    Args:
        data: Its bytes.
        message_type: Its class.
        logger: Where a malformed message is reported.

    Returns:
        object: the message, or None.
    """
    try:
        return interfaces.deserialize(data, message_type)
    except interfaces.DecodeError as error:
        logger.error(f"dropped a message that cannot be read: {error}")
        return None
