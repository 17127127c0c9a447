# SPDX-License-Identifier: Apache-2.0
"""A client of the parameter services of another node."""

import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from rcl_interfaces.msg import Parameter as ParameterMsg
from rcl_interfaces.msg import ParameterEvent
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    GetParameterTypes,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)

from rclpy.callback_groups import CallbackGroup
from rclpy.client import Client
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.parameter import Parameter, parameter_dict_from_yaml_file
from rclpy.qos import QoSProfile, qos_profile_parameter_events, qos_profile_services_default
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription
from rclpy.task import Future

if TYPE_CHECKING:
    from rclpy.node import Node

DoneCallback = Callable[[Future], Any]

_POLL_S = 0.02


class AsyncParameterClient:
    """Reads and sets parameters of another node; every call returns a Future of the response."""

    def __init__(
        self,
        node: "Node",
        remote_node_name: str,
        qos_profile: QoSProfile = qos_profile_services_default,
        callback_group: CallbackGroup | None = None,
    ) -> None:
        """Create clients of all six services.

        Args:
            node: Node that asks.
            remote_node_name: Node that is asked, absolute or relative to this one's namespace.
            qos_profile: QoS of the services.
            callback_group: Group of the clients; the node's default one where it is None.
        """
        self.remote_node_name = remote_node_name
        self.node = node

        def client(service: type, name: str) -> Client:
            return node.create_client(
                service,
                f"{remote_node_name}/{name}",
                qos_profile=qos_profile,
                callback_group=callback_group,
            )

        self._get_parameter_client = client(GetParameters, "get_parameters")
        self._list_parameter_client = client(ListParameters, "list_parameters")
        self._set_parameter_client = client(SetParameters, "set_parameters")
        self._get_parameter_types_client = client(GetParameterTypes, "get_parameter_types")
        self._describe_parameters_client = client(DescribeParameters, "describe_parameters")
        self._set_parameters_atomically_client = client(
            SetParametersAtomically, "set_parameters_atomically"
        )

    def services_are_ready(self) -> bool:
        """Return whether all six services are there."""
        return all(
            client.service_is_ready()
            for client in (
                self._list_parameter_client,
                self._set_parameter_client,
                self._get_parameter_client,
                self._get_parameter_types_client,
                self._describe_parameters_client,
                self._set_parameters_atomically_client,
            )
        )

    def wait_for_services(self, timeout_sec: float | None = None) -> bool:
        """Wait until all six services are there.

        Args:
            timeout_sec: Longest wait [s]; None waits for ever.

        Returns:
            bool: whether they are.
        """
        end = None if timeout_sec is None else time.monotonic() + timeout_sec
        while not self.services_are_ready():
            if end is not None and time.monotonic() >= end:
                return False
            time.sleep(_POLL_S)
        return True

    def list_parameters(
        self,
        prefixes: list[str] | None = None,
        depth: int | None = None,
        callback: DoneCallback | None = None,
    ) -> Future:
        """Ask for the names of parameters.

        Args:
            prefixes: Groups to list; all where it is None.
            depth: Levels of names to list; all where it is None.
            callback: Called with the future when the answer is there.
        """
        request = ListParameters.Request()
        if prefixes:
            request.prefixes = prefixes
        if depth:
            request.depth = depth
        return _call(self._list_parameter_client, request, callback)

    def get_parameters(self, names: list[str], callback: DoneCallback | None = None) -> Future:
        """Ask for values.

        Args:
            names: Full names.
            callback: Called with the future when the answer is there.
        """
        return _call(self._get_parameter_client, GetParameters.Request(names=names), callback)

    def set_parameters(
        self,
        parameters: Sequence[Parameter | ParameterMsg],
        callback: DoneCallback | None = None,
    ) -> Future:
        """Set parameters one after the other.

        Args:
            parameters: Parameters with their new values.
            callback: Called with the future when the answer is there.
        """
        request = SetParameters.Request(parameters=_messages(parameters))
        return _call(self._set_parameter_client, request, callback)

    def describe_parameters(self, names: list[str], callback: DoneCallback | None = None) -> Future:
        """Ask for descriptors.

        Args:
            names: Full names.
            callback: Called with the future when the answer is there.
        """
        request = DescribeParameters.Request(names=names)
        return _call(self._describe_parameters_client, request, callback)

    def get_parameter_types(self, names: list[str], callback: DoneCallback | None = None) -> Future:
        """Ask for types.

        Args:
            names: Full names.
            callback: Called with the future when the answer is there.
        """
        request = GetParameterTypes.Request(names=names)
        return _call(self._get_parameter_types_client, request, callback)

    def set_parameters_atomically(
        self,
        parameters: Sequence[Parameter | ParameterMsg],
        callback: DoneCallback | None = None,
    ) -> Future:
        """Set all parameters or none.

        Args:
            parameters: Parameters with their new values.
            callback: Called with the future when the answer is there.
        """
        request = SetParametersAtomically.Request(parameters=_messages(parameters))
        return _call(self._set_parameters_atomically_client, request, callback)

    def delete_parameters(self, names: list[str], callback: DoneCallback | None = None) -> Future:
        """Undeclare parameters, which only those of dynamic type allow.

        Args:
            names: Full names.
            callback: Called with the future when the answer is there.
        """
        return self.set_parameters([Parameter(name) for name in names], callback)

    def load_parameter_file(
        self,
        parameter_file: str,
        use_wildcard: bool = False,
        callback: DoneCallback | None = None,
    ) -> Future:
        """Set the parameters of a file one after the other.

        Args:
            parameter_file: Path of the file, in the format of `ros2 param dump`.
            use_wildcard: Whether the entries of `/**` count.
            callback: Called with the future when the answer is there.
        """
        parameters = parameter_dict_from_yaml_file(parameter_file, use_wildcard)
        return self.set_parameters(list(parameters.values()), callback)

    def load_parameter_file_atomically(
        self,
        parameter_file: str,
        use_wildcard: bool = False,
        callback: DoneCallback | None = None,
    ) -> Future:
        """Set all parameters of a file or none.

        Args:
            parameter_file: Path of the file, in the format of `ros2 param dump`.
            use_wildcard: Whether the entries of `/**` count.
            callback: Called with the future when the answer is there.
        """
        parameters = parameter_dict_from_yaml_file(parameter_file, use_wildcard)
        return self.set_parameters_atomically(list(parameters.values()), callback)

    def on_parameter_event(
        self,
        callback: Callable[[ParameterEvent], Any],
        qos_profile: QoSProfile = qos_profile_parameter_events,
        *,
        callback_group: CallbackGroup | None = None,
        event_callbacks: SubscriptionEventCallbacks | None = None,
        qos_overriding_options: QoSOverridingOptions | None = None,
        raw: bool = False,
    ) -> Subscription:
        """Subscribe to /parameter_events, which holds the changes of all nodes.

        Args:
            callback: Called with each event.
            qos_profile: QoS of the subscription.
            callback_group: Group of the subscription; the node's default one where it is None.
            event_callbacks: Callbacks for middleware events.
            qos_overriding_options: Which policies parameters may override.
            raw: Whether the callback gets bytes.
        """
        return self.node.create_subscription(
            ParameterEvent,
            "/parameter_events",
            callback,
            qos_profile,
            callback_group=callback_group,
            event_callbacks=event_callbacks,
            qos_overriding_options=qos_overriding_options,
            raw=raw,
        )


def _messages(parameters: Sequence[Parameter | ParameterMsg]) -> list[ParameterMsg]:
    return [one.to_parameter_msg() if isinstance(one, Parameter) else one for one in parameters]


def _call(client: Client, request: Any, callback: DoneCallback | None) -> Future:
    future = client.call_async(request)
    if callback:
        future.add_done_callback(callback)
    return future
