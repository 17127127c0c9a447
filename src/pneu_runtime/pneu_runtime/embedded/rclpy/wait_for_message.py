# SPDX-License-Identifier: Apache-2.0
"""Waiting for one message, without spinning the node."""

import time
from typing import TYPE_CHECKING, Any

from pneu_runtime import interfaces, transport
from rclpy.qos import QoSProfile

if TYPE_CHECKING:
    from rclpy.node import Node


def wait_for_message(
    msg_type: type,
    node: "Node",
    topic: str,
    *,
    qos_profile: QoSProfile | int = 1,
    time_to_wait: float = -1,
) -> tuple[bool, Any]:
    """Wait for the next message of a topic.

    Args:
        msg_type: Class of the message.
        node: The node that subscribes for that time.
        topic: Name of the topic.
        qos_profile: Quality of service, or the depth of the history alone.
        time_to_wait: How long to wait at most [s]; negative for as long as it takes.

    Returns:
        tuple[bool, object]: Whether one came, and the message or None.
    """
    context = node.context
    deadline_s = time.monotonic() + time_to_wait if time_to_wait >= 0 else None
    full_name = node.resolve_topic_name(topic)
    # An endpoint of its own, which no executor that spins the node takes the message from.
    end = context.session.create_subscription(
        node.handle,
        full_name,
        interfaces.type_name(msg_type),
        node._validate_qos_or_depth_parameter(qos_profile),
    )
    waiter = transport.Waiter()
    context._add_waker(waiter.wake)
    try:
        waiter.attach(end)
        while context.ok():
            sample = end.take()
            if sample is not None:
                return True, interfaces.deserialize(sample.data, msg_type)
            remaining_s = None if deadline_s is None else deadline_s - time.monotonic()
            if remaining_s is not None and remaining_s <= 0:
                break
            waiter.wait(remaining_s)
        return False, None
    finally:
        context._remove_waker(waiter.wake)
        waiter.close()
        end.close()
