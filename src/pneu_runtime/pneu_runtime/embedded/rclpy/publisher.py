# SPDX-License-Identifier: Apache-2.0
"""Publishers of messages."""

from typing import Any, Generic, TypeVar

from pneu_runtime import interfaces
from rclpy._endpoint import Endpoint
from rclpy._rclpy_pybind11 import RCLError
from rclpy.callback_groups import CallbackGroup
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.qos import QoSProfile

MsgType = TypeVar("MsgType")

_NO_TIMEOUT = Duration(seconds=-1)


class Publisher(Endpoint, Generic[MsgType]):
    """Publishes messages. Made by `Node.create_publisher`.

    Args:
        publisher_impl: The endpoint of the transport.
        msg_type: The class of the messages.
        topic: The topic's name as it was given.
        qos_profile: The quality of service.
        event_callbacks: What is called on events.
        callback_group: The callback group of these.
    """

    def __init__(
        self,
        publisher_impl: Any,
        msg_type: type[MsgType],
        topic: str,
        qos_profile: QoSProfile,
        event_callbacks: PublisherEventCallbacks,
        callback_group: CallbackGroup,
    ) -> None:
        self._start(publisher_impl)
        self.msg_type = msg_type
        self.topic = topic
        self.qos_profile = qos_profile
        self.event_handlers = event_callbacks.create_event_handlers(
            callback_group, publisher_impl, topic
        )

    def publish(self, msg: MsgType | bytes) -> None:
        """Publish a message.

        Args:
            msg: The message, or its bytes as `rclpy.serialization` makes them.
        """
        if isinstance(msg, self.msg_type):
            data = interfaces.serialize(msg)
        elif isinstance(msg, bytes):
            data = msg
        else:
            raise TypeError(f"Expected {self.msg_type}, got {type(msg)}")
        if self._destroyed:
            self._check()
        if not self._context.ok():
            raise RCLError("Failed to publish: publisher's context is invalid")
        self._end.publish(data)

    def get_subscription_count(self) -> int:
        """Count the subscriptions that this publisher is matched with.

        Returns:
            int: How many.
        """
        self._check()
        return self._end.matched_count()

    @property
    def topic_name(self) -> str:
        """The topic's full name."""
        self._check()
        return self._full_name

    def assert_liveliness(self) -> None:
        """Say that this publisher is alive, which LivelinessPolicy.MANUAL_BY_TOPIC asks for."""
        self._check()
        self._end.assert_liveliness()

    def wait_for_all_acked(self, timeout: Duration = _NO_TIMEOUT) -> bool:
        """Wait until all reliable subscriptions have received what was published.

        Args:
            timeout: How long to wait; negative for as long as it takes.

        Returns:
            bool: Whether they have.
        """
        self._check()
        seconds = None if timeout.nanoseconds < 0 else timeout.nanoseconds * 1e-9
        return self._end.wait_for_all_acked(seconds)
