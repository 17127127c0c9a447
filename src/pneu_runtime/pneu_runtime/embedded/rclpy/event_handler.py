# SPDX-License-Identifier: Apache-2.0
"""Events of publishers and subscriptions: matches, missed deadlines, liveliness, unfit QoS."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from pneu_runtime.transport import EventKind
from rclpy._rclpy_pybind11 import UnsupportedEventTypeError
from rclpy.callback_groups import CallbackGroup
from rclpy.logging import get_logger
from rclpy.qos import QoSPolicyKind, qos_policy_name_from_kind
from rclpy.waitable import NumberOfEntities, Waitable

__all__ = [
    "EventHandler",
    "PublisherEventCallbacks",
    "QoSEventHandler",
    "QoSPublisherEventType",
    "QoSSubscriptionEventType",
    "SubscriptionEventCallbacks",
    "UnsupportedEventTypeError",
]


class QoSPublisherEventType(IntEnum):
    """Events a publisher can have."""

    RCL_PUBLISHER_OFFERED_DEADLINE_MISSED = 0
    RCL_PUBLISHER_LIVELINESS_LOST = 1
    RCL_PUBLISHER_OFFERED_INCOMPATIBLE_QOS = 2
    RCL_PUBLISHER_INCOMPATIBLE_TYPE = 3
    RCL_PUBLISHER_MATCHED = 4


class QoSSubscriptionEventType(IntEnum):
    """Events a subscription can have."""

    RCL_SUBSCRIPTION_REQUESTED_DEADLINE_MISSED = 0
    RCL_SUBSCRIPTION_LIVELINESS_CHANGED = 1
    RCL_SUBSCRIPTION_REQUESTED_INCOMPATIBLE_QOS = 2
    RCL_SUBSCRIPTION_MESSAGE_LOST = 3
    RCL_SUBSCRIPTION_INCOMPATIBLE_TYPE = 4
    RCL_SUBSCRIPTION_MATCHED = 5


@dataclass(frozen=True)
class QoSRequestedDeadlineMissedInfo:
    """A subscription got no message in time.

    Attributes:
        total_count: Times it happened so far.
        total_count_change: Times since the last event.
    """

    total_count: int = 0
    total_count_change: int = 0


@dataclass(frozen=True)
class QoSOfferedDeadlineMissedInfo:
    """A publisher sent no message in time.

    Attributes:
        total_count: Times it happened so far.
        total_count_change: Times since the last event.
    """

    total_count: int = 0
    total_count_change: int = 0


@dataclass(frozen=True)
class QoSLivelinessChangedInfo:
    """Publishers of a subscription's topic came to life or were lost.

    Attributes:
        alive_count: Publishers that are alive.
        not_alive_count: Publishers that are not, though still matched.
        alive_count_change: Change of the first since the last event.
        not_alive_count_change: Change of the second since the last event.
    """

    alive_count: int = 0
    not_alive_count: int = 0
    alive_count_change: int = 0
    not_alive_count_change: int = 0


@dataclass(frozen=True)
class QoSLivelinessLostInfo:
    """A publisher has not said in time that it is alive.

    Attributes:
        total_count: Times it happened so far.
        total_count_change: Times since the last event.
    """

    total_count: int = 0
    total_count_change: int = 0


@dataclass(frozen=True)
class QoSMessageLostInfo:
    """Messages did not reach a subscription.

    Attributes:
        total_count: Messages lost so far.
        total_count_change: Messages since the last event.
    """

    total_count: int = 0
    total_count_change: int = 0


@dataclass(frozen=True)
class QoSRequestedIncompatibleQoSInfo:
    """A publisher and a subscription do not match because of their QoS.

    Attributes:
        total_count: Times it happened so far.
        total_count_change: Times since the last event.
        last_policy_kind: Policy that did not fit the last time.
    """

    total_count: int = 0
    total_count_change: int = 0
    last_policy_kind: QoSPolicyKind = QoSPolicyKind.INVALID


QoSOfferedIncompatibleQoSInfo = QoSRequestedIncompatibleQoSInfo


@dataclass(frozen=True)
class QoSSubscriptionMatchedInfo:
    """A publisher or subscription found or lost a counterpart.

    Attributes:
        total_count: Counterparts found so far.
        total_count_change: Counterparts found since the last event.
        current_count: Counterparts there are now.
        current_count_change: Change of these since the last event.
    """

    total_count: int = 0
    total_count_change: int = 0
    current_count: int = 0
    current_count_change: int = 0


QoSPublisherMatchedInfo = QoSSubscriptionMatchedInfo


@dataclass(frozen=True)
class IncompatibleTypeInfo:
    """A counterpart has another type. This runtime never sees it: such topics stay apart.

    Attributes:
        total_count: Times it happened so far.
        total_count_change: Times since the last event.
    """

    total_count: int = 0
    total_count_change: int = 0


# Kind of each event in the transport, and what a callback gets.
_EVENTS: dict[str, tuple[EventKind, type]] = {
    "RCL_PUBLISHER_OFFERED_DEADLINE_MISSED": (
        EventKind.DEADLINE_MISSED,
        QoSOfferedDeadlineMissedInfo,
    ),
    "RCL_PUBLISHER_LIVELINESS_LOST": (EventKind.LIVELINESS, QoSLivelinessLostInfo),
    "RCL_PUBLISHER_OFFERED_INCOMPATIBLE_QOS": (
        EventKind.INCOMPATIBLE_QOS,
        QoSOfferedIncompatibleQoSInfo,
    ),
    "RCL_PUBLISHER_MATCHED": (EventKind.MATCHED, QoSPublisherMatchedInfo),
    "RCL_SUBSCRIPTION_REQUESTED_DEADLINE_MISSED": (
        EventKind.DEADLINE_MISSED,
        QoSRequestedDeadlineMissedInfo,
    ),
    "RCL_SUBSCRIPTION_LIVELINESS_CHANGED": (EventKind.LIVELINESS, QoSLivelinessChangedInfo),
    "RCL_SUBSCRIPTION_REQUESTED_INCOMPATIBLE_QOS": (
        EventKind.INCOMPATIBLE_QOS,
        QoSRequestedIncompatibleQoSInfo,
    ),
    "RCL_SUBSCRIPTION_MESSAGE_LOST": (EventKind.MESSAGE_LOST, QoSMessageLostInfo),
    "RCL_SUBSCRIPTION_MATCHED": (EventKind.MATCHED, QoSSubscriptionMatchedInfo),
}


class EventHandler(Waitable):
    """Calls a function for one kind of event of one publisher or subscription."""

    def __init__(
        self,
        *,
        callback_group: CallbackGroup,
        callback: Callable[[Any], Any],
        event_type: IntEnum,
        parent_impl: Any,
    ) -> None:
        """Start to listen.

        Args:
            callback_group: Group the callback runs in.
            callback: Called with the status of the event.
            event_type: Kind of event; UnsupportedEventTypeError where there is no such.
            parent_impl: Endpoint of the transport.
        """
        super().__init__(callback_group)
        self.event_type = event_type
        self.callback = callback
        if event_type.name not in _EVENTS:
            raise UnsupportedEventTypeError(f"{event_type.name} is not available")
        kind, self._info = _EVENTS[event_type.name]
        self._source = parent_impl.event_source(kind)
        self._sources = (self._source,)
        self._destroyed = False
        # For the default warnings; the publisher or subscription puts its node's here.
        self.logger_name = "rclpy"

    def is_ready(self, wait_set: Any) -> bool:
        """Return whether an event may be there; taking tells.

        Args:
            wait_set: Not used.
        """
        return not self._destroyed

    def take_data(self) -> Any:
        """Take the status, or None where nothing has changed."""
        if self._destroyed:
            return None
        status = self._source.take()
        if not status:
            return None
        fields: dict[str, Any] = dict(status)
        if "last_policy_kind" in fields:
            fields["last_policy_kind"] = QoSPolicyKind(fields["last_policy_kind"])
        return self._info(**fields)

    async def execute(self, taken_data: Any) -> None:
        """Call the callback.

        Args:
            taken_data: What `take_data` returned.
        """
        from rclpy.executors import await_or_execute  # not at the top: that module needs this one

        if taken_data is not None:
            await await_or_execute(self.callback, taken_data)

    def get_num_entities(self) -> NumberOfEntities:
        """Return how many endpoints there are to wait for."""
        return NumberOfEntities(num_events=1)

    def add_to_wait_set(self, wait_set: Any) -> None:
        """Add the event to a wait set.

        Args:
            wait_set: The wait set.
        """
        wait_set.add_source(self._source)

    def destroy(self) -> None:
        """Stop listening."""
        self._destroyed = True


QoSEventHandler = EventHandler


def _handlers(
    callback_group: CallbackGroup, endpoint: Any, wanted: list[tuple[IntEnum, Any]]
) -> list[EventHandler]:
    return [
        EventHandler(
            callback_group=callback_group,
            callback=callback,
            event_type=event_type,
            parent_impl=endpoint,
        )
        for event_type, callback in wanted
        if callback is not None
    ]


class SubscriptionEventCallbacks:
    """Functions to call on events of a subscription."""

    def __init__(
        self,
        *,
        deadline: Callable[[QoSRequestedDeadlineMissedInfo], Any] | None = None,
        incompatible_qos: Callable[[QoSRequestedIncompatibleQoSInfo], Any] | None = None,
        liveliness: Callable[[QoSLivelinessChangedInfo], Any] | None = None,
        message_lost: Callable[[QoSMessageLostInfo], Any] | None = None,
        incompatible_type: Callable[[IncompatibleTypeInfo], Any] | None = None,
        matched: Callable[[QoSSubscriptionMatchedInfo], Any] | None = None,
        use_default_callbacks: bool = True,
    ) -> None:
        """Say what to call.

        Args:
            deadline: No message came within the requested deadline.
            incompatible_qos: A publisher was found that offers less than is requested.
            liveliness: Publishers came to life or were lost.
            message_lost: Messages were lost.
            incompatible_type: A publisher has another type.
            matched: A publisher was connected or disconnected.
            use_default_callbacks: Whether unfit QoS is logged where no function is given for it.
        """
        self.deadline = deadline
        self.incompatible_qos = incompatible_qos
        self.liveliness = liveliness
        self.message_lost = message_lost
        self.incompatible_type = incompatible_type
        self.matched = matched
        self.use_default_callbacks = use_default_callbacks

    def create_event_handlers(
        self,
        callback_group: CallbackGroup,
        subscription: Any,
        topic_name: str,
    ) -> list[EventHandler]:
        """Make the handlers, which a node adds to its waitables.

        Args:
            callback_group: Group the callbacks run in.
            subscription: Endpoint of the transport.
            topic_name: Name for the default messages.
        """

        def warn(event: QoSRequestedIncompatibleQoSInfo) -> None:
            policy = qos_policy_name_from_kind(event.last_policy_kind)
            get_logger(handlers[0].logger_name).warning(
                f"New publisher discovered on topic '{topic_name}', offering incompatible QoS. "
                f"No messages will be received from it. Last incompatible policy: {policy}"
            )

        kinds = QoSSubscriptionEventType
        default = warn if self.use_default_callbacks else None
        wanted: list[tuple[IntEnum, Any]] = [
            (kinds.RCL_SUBSCRIPTION_REQUESTED_DEADLINE_MISSED, self.deadline),
            (
                kinds.RCL_SUBSCRIPTION_REQUESTED_INCOMPATIBLE_QOS,
                self.incompatible_qos or default,
            ),
            (kinds.RCL_SUBSCRIPTION_LIVELINESS_CHANGED, self.liveliness),
            (kinds.RCL_SUBSCRIPTION_MESSAGE_LOST, self.message_lost),
            (kinds.RCL_SUBSCRIPTION_INCOMPATIBLE_TYPE, self.incompatible_type),
            (kinds.RCL_SUBSCRIPTION_MATCHED, self.matched),
        ]
        handlers = _handlers(callback_group, subscription, wanted)
        return handlers


class PublisherEventCallbacks:
    """Functions to call on events of a publisher."""

    def __init__(
        self,
        *,
        deadline: Callable[[QoSOfferedDeadlineMissedInfo], Any] | None = None,
        liveliness: Callable[[QoSLivelinessLostInfo], Any] | None = None,
        incompatible_qos: Callable[[QoSOfferedIncompatibleQoSInfo], Any] | None = None,
        incompatible_type: Callable[[IncompatibleTypeInfo], Any] | None = None,
        matched: Callable[[QoSPublisherMatchedInfo], Any] | None = None,
        use_default_callbacks: bool = True,
    ) -> None:
        """Say what to call.

        Args:
            deadline: No message was sent within the offered deadline.
            liveliness: The publisher has not said in time that it is alive.
            incompatible_qos: A subscription was found that requests more than is offered.
            incompatible_type: A subscription has another type.
            matched: A subscription was connected or disconnected.
            use_default_callbacks: Whether unfit QoS is logged where no function is given for it.
        """
        self.deadline = deadline
        self.liveliness = liveliness
        self.incompatible_qos = incompatible_qos
        self.incompatible_type = incompatible_type
        self.matched = matched
        self.use_default_callbacks = use_default_callbacks

    def create_event_handlers(
        self,
        callback_group: CallbackGroup,
        publisher: Any,
        topic_name: str,
    ) -> list[EventHandler]:
        """Make the handlers, which a node adds to its waitables.

        Args:
            callback_group: Group the callbacks run in.
            publisher: Endpoint of the transport.
            topic_name: Name for the default messages.
        """

        def warn(event: QoSOfferedIncompatibleQoSInfo) -> None:
            policy = qos_policy_name_from_kind(event.last_policy_kind)
            get_logger(handlers[0].logger_name).warning(
                f"New subscription discovered on topic '{topic_name}', requesting incompatible "
                f"QoS. No messages will be sent to it. Last incompatible policy: {policy}"
            )

        kinds = QoSPublisherEventType
        default = warn if self.use_default_callbacks else None
        wanted: list[tuple[IntEnum, Any]] = [
            (kinds.RCL_PUBLISHER_OFFERED_DEADLINE_MISSED, self.deadline),
            (kinds.RCL_PUBLISHER_LIVELINESS_LOST, self.liveliness),
            (kinds.RCL_PUBLISHER_OFFERED_INCOMPATIBLE_QOS, self.incompatible_qos or default),
            (kinds.RCL_PUBLISHER_INCOMPATIBLE_TYPE, self.incompatible_type),
            (kinds.RCL_PUBLISHER_MATCHED, self.matched),
        ]
        handlers = _handlers(callback_group, publisher, wanted)
        return handlers
