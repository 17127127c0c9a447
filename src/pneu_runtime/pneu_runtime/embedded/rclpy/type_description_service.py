# SPDX-License-Identifier: Apache-2.0
"""The service get_type_description of a node: the definitions behind the types it uses."""

import re
import weakref
from typing import TYPE_CHECKING, Any

from rcl_interfaces.msg import ParameterDescriptor
from type_description_interfaces.msg import TypeDescription, TypeSource
from type_description_interfaces.srv import GetTypeDescription

from pneu_runtime import interfaces
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_services_default

if TYPE_CHECKING:
    from rclpy.node import Node

START_TYPE_DESCRIPTION_SERVICE_PARAM = "start_type_description_service"

_HASH = re.compile(r"RIHS01_[0-9a-f]{64}")


class TypeDescriptionService:
    """Answers what the types look like that the entities of one node have."""

    def __init__(self, node: "Node") -> None:
        """Create the service unless the parameter start_type_description_service is false.

        Args:
            node: Node it belongs to; kept weakly, because the node keeps this object.
        """
        self._node_weak_ref = weakref.ref(node)
        self.service_name = f"{node.get_name()}/get_type_description"
        if not node.has_parameter(START_TYPE_DESCRIPTION_SERVICE_PARAM):
            node.declare_parameter(
                START_TYPE_DESCRIPTION_SERVICE_PARAM,
                True,
                ParameterDescriptor(
                    description="If enabled, start the ~/get_type_description service.",
                    read_only=True,
                ),
            )
        parameter = node.get_parameter(START_TYPE_DESCRIPTION_SERVICE_PARAM)
        self.enabled = parameter.type_ == Parameter.Type.BOOL and parameter.value
        if parameter.type_ != Parameter.Type.BOOL:
            node.get_logger().error(
                f"Invalid type for parameter '{START_TYPE_DESCRIPTION_SERVICE_PARAM}' "
                f"{parameter.type_!r} should be bool"
            )
        if self.enabled:
            node.create_service(
                GetTypeDescription,
                self.service_name,
                self._service_callback,
                qos_profile=qos_profile_services_default,
            )

    def _types_in_use(self) -> set[str]:
        """Full names of the types of the node's entities."""
        node = self._node_weak_ref()
        if node is None:
            raise ReferenceError("Expected valid node weak reference")
        classes: list[Any] = [publisher.msg_type for publisher in node.publishers]
        classes += [subscription.msg_type for subscription in node.subscriptions]
        classes += [service.srv_type for service in node.services]
        classes += [client.srv_type for client in node.clients]
        for waitable in node.waitables:
            action = getattr(waitable, "action_type", None)
            if action is not None:
                classes += [
                    action.Impl.SendGoalService,
                    action.Impl.GetResultService,
                    action.Impl.CancelGoalService,
                    action.Impl.FeedbackMessage,
                    action.Impl.GoalStatusMessage,
                ]
        return {interfaces.type_name(cls) for cls in classes}

    def _service_callback(
        self, request: GetTypeDescription.Request, response: GetTypeDescription.Response
    ) -> GetTypeDescription.Response:
        response.successful = False
        if not _HASH.fullmatch(request.type_hash):
            response.failure_reason = "Failed to parse type hash"
            return response
        for name in sorted(self._types_in_use()):
            if interfaces.type_hash(name) == request.type_hash:
                break
        else:
            response.failure_reason = "Type not currently in use by this node"
            return response
        response.type_description = interfaces.from_dict(
            TypeDescription, interfaces.type_description(name)
        )
        if request.include_type_sources:
            response.type_sources = [
                TypeSource(type_name=type_name, encoding=encoding, raw_file_contents=text)
                for type_name, encoding, text in interfaces.type_sources(name)
            ]
        response.successful = True
        return response
