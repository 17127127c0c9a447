# SPDX-License-Identifier: Apache-2.0
"""Callbacks for changes of parameters, of this node or of others, from /parameter_events."""

import threading
from collections.abc import Callable, Iterator
from itertools import chain
from typing import TYPE_CHECKING, Any

from rcl_interfaces.msg import Parameter, ParameterEvent

from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import QoSProfile, qos_profile_parameter_events
from rclpy.qos_overriding_options import QoSOverridingOptions

if TYPE_CHECKING:
    from rclpy.node import Node

ParameterCallback = Callable[[Parameter], Any]
EventCallback = Callable[[ParameterEvent], Any]


class ParameterCallbackHandle:
    """Stands for one callback on one parameter, so that it can be removed."""

    def __init__(self, parameter_name: str, node_name: str, callback: ParameterCallback) -> None:
        """Remember what the callback is for.

        Args:
            parameter_name: Full name of the parameter.
            node_name: Full name of its node.
            callback: Called with each new value.
        """
        self.parameter_name = parameter_name
        self.node_name = node_name
        self.callback = callback


class ParameterEventCallbackHandle:
    """Stands for one callback on all events, so that it can be removed."""

    def __init__(self, callback: EventCallback) -> None:
        """Remember the callback.

        Args:
            callback: Called with each event.
        """
        self.callback = callback


class ParameterEventHandler:
    """Watches /parameter_events and calls what has been registered, the newest first."""

    def __init__(
        self,
        node: "Node",
        qos_profile: QoSProfile = qos_profile_parameter_events,
        callback_group: CallbackGroup | None = None,
        event_callbacks: SubscriptionEventCallbacks | None = None,
        qos_overriding_options: QoSOverridingOptions | None = None,
        raw: bool = False,
    ) -> None:
        """Subscribe.

        Args:
            node: Node that subscribes.
            qos_profile: QoS of the subscription.
            callback_group: Group of the subscription; the node's default one where it is None.
            event_callbacks: Callbacks for middleware events.
            qos_overriding_options: Which policies parameters may override.
            raw: Has to be False here: the handler reads the events.
        """
        if raw:
            raise ValueError("ParameterEventHandler cannot look into raw messages")
        self.node = node
        self.qos_profile = qos_profile
        self._lock = threading.RLock()
        self._parameter_callbacks: list[ParameterCallbackHandle] = []
        self._event_callbacks: list[ParameterEventCallbackHandle] = []
        self.parameter_event_subscription = node.create_subscription(
            ParameterEvent,
            "/parameter_events",
            self._on_event,
            qos_profile,
            callback_group=callback_group,
            event_callbacks=event_callbacks,
            qos_overriding_options=qos_overriding_options,
        )

    def destroy(self) -> None:
        """End the subscription."""
        self.node.destroy_subscription(self.parameter_event_subscription)

    def _on_event(self, event: ParameterEvent) -> None:
        with self._lock:
            parameter_callbacks = list(self._parameter_callbacks)
            event_callbacks = list(self._event_callbacks)
        for handle in parameter_callbacks:
            parameter = self.get_parameter_from_event(
                event, handle.parameter_name, handle.node_name
            )
            if parameter is not None:
                handle.callback(parameter)
        for event_handle in event_callbacks:
            event_handle.callback(event)

    @staticmethod
    def get_parameter_from_event(
        event: ParameterEvent, parameter_name: str, node_name: str
    ) -> Parameter | None:
        """Return the new value of a parameter, or None where the event is not about it.

        Args:
            event: The event.
            parameter_name: Full name of the parameter.
            node_name: Full name of its node.
        """
        if event.node != node_name:
            return None
        for parameter in ParameterEventHandler.get_parameters_from_event(event):
            if parameter.name == parameter_name:
                return parameter
        return None

    @staticmethod
    def get_parameters_from_event(event: ParameterEvent) -> Iterator[Parameter]:
        """Yield all parameters an event gives a value.

        Args:
            event: The event.
        """
        yield from chain(event.new_parameters, event.changed_parameters)

    def add_parameter_callback(
        self, parameter_name: str, node_name: str, callback: ParameterCallback
    ) -> ParameterCallbackHandle:
        """Call a function with every new value of one parameter.

        Args:
            parameter_name: Full name of the parameter.
            node_name: Its node, absolute or relative to this one's namespace; empty for this node.
            callback: Called with rcl_interfaces/msg/Parameter.

        Returns:
            ParameterCallbackHandle: for `remove_parameter_callback`.
        """
        handle = ParameterCallbackHandle(parameter_name, self._resolve_path(node_name), callback)
        with self._lock:
            self._parameter_callbacks.insert(0, handle)
        return handle

    def remove_parameter_callback(self, handle: ParameterCallbackHandle) -> None:
        """Undo `add_parameter_callback`.

        Args:
            handle: What that returned.
        """
        with self._lock:
            if handle not in self._parameter_callbacks:
                raise RuntimeError("Callback doesn't exist")
            self._parameter_callbacks.remove(handle)

    def add_parameter_event_callback(self, callback: EventCallback) -> ParameterEventCallbackHandle:
        """Call a function with every event.

        Args:
            callback: Called with rcl_interfaces/msg/ParameterEvent.

        Returns:
            ParameterEventCallbackHandle: for `remove_parameter_event_callback`.
        """
        handle = ParameterEventCallbackHandle(callback)
        with self._lock:
            self._event_callbacks.insert(0, handle)
        return handle

    def remove_parameter_event_callback(self, handle: ParameterEventCallbackHandle) -> None:
        """Undo `add_parameter_event_callback`.

        Args:
            handle: What that returned.
        """
        with self._lock:
            if handle not in self._event_callbacks:
                raise RuntimeError("Callback doesn't exist")
            self._event_callbacks.remove(handle)

    def _resolve_path(self, node_path: str | None = None) -> str:
        if not node_path:
            return self.node.get_fully_qualified_name()
        if node_path.startswith("/"):
            return node_path
        return f"{self.node.get_namespace().rstrip('/')}/{node_path}"
