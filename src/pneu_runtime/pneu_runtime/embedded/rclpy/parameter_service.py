# SPDX-License-Identifier: Apache-2.0
"""The six services through which others see and change the parameters of a node."""

import weakref
from typing import TYPE_CHECKING, Any

from rcl_interfaces.msg import ListParametersResult, SetParametersResult
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    GetParameterTypes,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)

from rclpy.exceptions import ParameterNotDeclaredException, ParameterUninitializedException
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_parameters

if TYPE_CHECKING:
    from rclpy.node import Node


class ParameterService:
    """Serves the parameters of one node."""

    def __init__(self, node: "Node") -> None:
        """Create the services.

        Args:
            node: Node they belong to; kept weakly, because the node keeps this object.
        """
        self._node_weak_ref = weakref.ref(node)
        services: list[tuple[type, str, Any]] = [
            (DescribeParameters, "describe_parameters", self._describe_parameters_callback),
            (GetParameters, "get_parameters", self._get_parameters_callback),
            (GetParameterTypes, "get_parameter_types", self._get_parameter_types_callback),
            (ListParameters, "list_parameters", self._list_parameters_callback),
            (SetParameters, "set_parameters", self._set_parameters_callback),
            (
                SetParametersAtomically,
                "set_parameters_atomically",
                self._set_parameters_atomically_callback,
            ),
        ]
        for service, name, callback in services:
            node.create_service(
                service, f"{node.get_name()}/{name}", callback, qos_profile=qos_profile_parameters
            )

    # An answer about several parameters is empty as soon as one of them is unknown.

    def _describe_parameters_callback(
        self, request: DescribeParameters.Request, response: DescribeParameters.Response
    ) -> DescribeParameters.Response:
        try:
            response.descriptors = self._get_node().describe_parameters(request.names)
        except ParameterNotDeclaredException:
            response.descriptors = []
        return response

    def _get_parameters_callback(
        self, request: GetParameters.Request, response: GetParameters.Response
    ) -> GetParameters.Response:
        try:
            parameters = self._get_node().get_parameters(request.names)
        except (ParameterNotDeclaredException, ParameterUninitializedException):
            parameters = []
        response.values = [parameter.get_parameter_value() for parameter in parameters]
        return response

    def _get_parameter_types_callback(
        self, request: GetParameterTypes.Request, response: GetParameterTypes.Response
    ) -> GetParameterTypes.Response:
        try:
            types = self._get_node().get_parameter_types(request.names)
        except ParameterNotDeclaredException:
            types = []
        response.types = [getattr(type_, "value", type_) for type_ in types]
        return response

    def _list_parameters_callback(
        self, request: ListParameters.Request, response: ListParameters.Response
    ) -> ListParameters.Response:
        try:
            response.result = self._get_node().list_parameters(
                list(request.prefixes), request.depth
            )
        except (TypeError, ValueError):
            response.result = ListParametersResult()
        return response

    def _set_parameters_callback(
        self, request: SetParameters.Request, response: SetParameters.Response
    ) -> SetParameters.Response:
        response.results = [self._set([parameter]) for parameter in request.parameters]
        return response

    def _set_parameters_atomically_callback(
        self, request: SetParametersAtomically.Request, response: SetParametersAtomically.Response
    ) -> SetParametersAtomically.Response:
        response.result = self._set(request.parameters)
        return response

    def _set(self, messages: list[Any]) -> SetParametersResult:
        try:
            parameters = [Parameter.from_parameter_msg(message) for message in messages]
            return self._get_node().set_parameters_atomically(parameters)
        except (ParameterNotDeclaredException, ValueError) as error:
            # ValueError: a type number that does not exist; the caller's fault, not the node's.
            return SetParametersResult(successful=False, reason=str(error))

    def _get_node(self) -> "Node":
        node = self._node_weak_ref()
        if node is None:
            raise ReferenceError("Expected valid node weak reference")
        return node
