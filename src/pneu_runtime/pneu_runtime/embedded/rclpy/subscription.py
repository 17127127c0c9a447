# SPDX-License-Identifier: Apache-2.0
"""Subscriptions to messages."""

import inspect
from collections.abc import Callable
from enum import Enum
from typing import Any, Generic, TypedDict, TypeVar

from pneu_runtime import interfaces
from rclpy import logging
from rclpy._endpoint import Endpoint
from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import QoSProfile
from rclpy.utilities import get_rmw_implementation_identifier

MsgType = TypeVar("MsgType")

# How often a topic that brings broken messages is complained about.
_COMPLAINT_PERIOD_S = 5.0


class PublisherGID(TypedDict):
    """The identity of a publisher."""

    implementation_identifier: str
    data: bytes


class MessageInfo(TypedDict):
    """Where and when a message came from."""

    source_timestamp: int
    received_timestamp: int
    publication_sequence_number: int | None
    reception_sequence_number: int | None
    publisher_gid: PublisherGID | None


class Subscription(Endpoint, Generic[MsgType]):
    """Calls a function with every message. Made by `Node.create_subscription`.

    Args:
        subscription_impl: The endpoint of the transport.
        msg_type: The class of the messages.
        topic: The topic's name as it was given.
        callback: Called with the message, or with it and a `MessageInfo`; may be a coroutine
            function.
        callback_group: The callback group it runs in.
        qos_profile: The quality of service.
        raw: Whether the callback gets bytes instead of messages.
        event_callbacks: What is called on events.
    """

    class CallbackType(Enum):
        """What the callback is called with."""

        MessageOnly = 0
        WithMessageInfo = 1

    def __init__(
        self,
        subscription_impl: Any,
        msg_type: type[MsgType],
        topic: str,
        callback: Callable[..., Any],
        callback_group: CallbackGroup,
        qos_profile: QoSProfile,
        raw: bool,
        event_callbacks: SubscriptionEventCallbacks,
    ) -> None:
        self._start(subscription_impl)
        self.msg_type = msg_type
        self.topic = topic
        self.callback = callback
        self.callback_group = callback_group
        self._executor_event = False
        self.qos_profile = qos_profile
        self.raw = raw
        self.event_handlers = event_callbacks.create_event_handlers(
            callback_group, subscription_impl, topic
        )

    @property
    def callback(self) -> Callable[..., Any]:
        """What is called."""
        return self._callback

    @callback.setter
    def callback(self, value: Callable[..., Any]) -> None:
        self._callback = value
        self._callback_type = _callback_type(value)
        self._with_info = self._callback_type is Subscription.CallbackType.WithMessageInfo

    @property
    def topic_name(self) -> str:
        """The topic's full name."""
        self._check()
        return self._full_name

    def get_publisher_count(self) -> int:
        """Count the publishers that this subscription is matched with.

        Returns:
            int: How many.
        """
        self._check()
        return self._end.matched_count()

    @property
    def is_cft_enabled(self) -> bool:
        """Whether messages are filtered by content, which this runtime cannot."""
        return False

    def set_content_filter(self, filter_expression: str, expression_parameters: list[str]) -> None:
        """Refuse a content filter.

        Args:
            filter_expression: The filter.
            expression_parameters: Its parameters.
        """
        raise NotImplementedError("the embedded runtime has no Subscription.set_content_filter")

    def get_content_filter(self) -> Any:
        """Refuse to return a content filter, since there can be none.

        Returns:
            object: Never.
        """
        raise NotImplementedError("the embedded runtime has no Subscription.get_content_filter")

    def _receive(self) -> Any:
        """Take a sample, or None."""
        with self._lock:
            return None if self._destroyed else self._end.take()

    def _call(self, sample: Any, executor: Any) -> Any:
        """Call the callback with a sample; what it returns."""
        message: Any = sample.data
        if not self.raw:
            try:
                message = interfaces.deserialize(message, self.msg_type)
            except interfaces.DecodeError as error:
                # a peer's fault must not end the node
                logging.get_logger(self._logger_name).error(
                    f"dropped a malformed message on '{self._full_name}': {error}",
                    throttle_duration_sec=_COMPLAINT_PERIOD_S,
                )
                return None
        if self._with_info:
            return self._callback(message, message_info(sample))
        return self._callback(message)


def message_info(sample: Any) -> MessageInfo:
    """Return what callbacks are told about a message.

    Args:
        sample: A sample of the transport.

    Returns:
        MessageInfo: Times in nanoseconds; the sequence numbers are not known.
    """
    return {
        "source_timestamp": sample.source_timestamp_ns,
        "received_timestamp": sample.received_timestamp_ns,
        "publication_sequence_number": None,
        "reception_sequence_number": None,
        "publisher_gid": {
            "implementation_identifier": get_rmw_implementation_identifier(),
            "data": sample.publisher_gid,
        },
    }


def _callback_type(callback: Callable[..., Any]) -> "Subscription.CallbackType":
    try:
        signature = inspect.signature(callback)
    except ValueError:  # a function written in C that does not say
        return Subscription.CallbackType.MessageOnly
    for arguments, found in (
        ((object(),), Subscription.CallbackType.MessageOnly),
        ((object(), object()), Subscription.CallbackType.WithMessageInfo),
    ):
        try:
            signature.bind(*arguments)
            return found
        except TypeError:
            continue
    raise RuntimeError(
        "Subscription.__init__(): callback should be either be callable with one argument "
        "(to get only the message) or two (to get message and message info)"
    )
