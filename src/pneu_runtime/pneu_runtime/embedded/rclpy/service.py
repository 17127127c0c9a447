# SPDX-License-Identifier: Apache-2.0
"""Services: functions that other nodes call."""

import inspect
from collections.abc import Callable
from typing import Any

from pneu_runtime import interfaces
from rclpy import logging
from rclpy._endpoint import Endpoint
from rclpy.callback_groups import CallbackGroup
from rclpy.clock import Clock
from rclpy.qos import QoSProfile
from rclpy.service_introspection import ServiceIntrospectionState

_COMPLAINT_PERIOD_S = 5.0


class Service(Endpoint):
    """Answers requests with a function. Made by `Node.create_service`.

    Args:
        service_impl: The endpoint of the transport.
        srv_type: The class of the service.
        srv_name: The service's name as it was given.
        callback: Called with the request and an empty response; returns the response. May be a
            coroutine function.
        callback_group: The callback group it runs in.
        qos_profile: The quality of service.
    """

    def __init__(
        self,
        service_impl: Any,
        srv_type: Any,
        srv_name: str,
        callback: Callable[[Any, Any], Any],
        callback_group: CallbackGroup,
        qos_profile: QoSProfile,
    ) -> None:
        self._start(service_impl)
        self.srv_type = srv_type
        self.srv_name = srv_name
        self.callback = callback
        self.callback_group = callback_group
        self._executor_event = False
        self.qos_profile = qos_profile

    @property
    def service_name(self) -> str:
        """The service's full name."""
        self._check()
        return self._full_name

    def send_response(self, response: Any, header: Any) -> None:
        """Answer a request.

        Args:
            response: The response.
            header: What identifies the request.
        """
        self._check()
        if not isinstance(response, self.srv_type.Response):
            raise TypeError(f"Expected {self.srv_type.Response}, got {type(response)}")
        self._end.respond(header, interfaces.serialize(response))

    def configure_introspection(
        self,
        clock: Clock,
        service_event_qos_profile: QoSProfile,
        introspection_state: ServiceIntrospectionState,
    ) -> None:
        """Switch the publishing of requests and responses off, the only state there is.

        Args:
            clock: Gives the times of the events.
            service_event_qos_profile: Their quality of service.
            introspection_state: What is published.
        """
        if introspection_state != ServiceIntrospectionState.OFF:
            raise NotImplementedError(
                "the embedded runtime has no Service.configure_introspection but OFF"
            )

    def _receive(self) -> Any:
        """Take a request, or None."""
        with self._lock:
            return None if self._destroyed else self._end.take()

    def _call(self, received: Any, executor: Any) -> Any:
        """Answer a request, or return a coroutine that will."""
        request_id, data, _info = received
        try:
            request = interfaces.deserialize(data, self.srv_type.Request)
        except interfaces.DecodeError as error:
            logging.get_logger(self._logger_name).error(
                f"dropped a malformed request to '{self._full_name}': {error}",
                throttle_duration_sec=_COMPLAINT_PERIOD_S,
            )
            return None
        answer = self.callback(request, self.srv_type.Response())
        if inspect.iscoroutine(answer):
            return self._send_later(answer, request_id)
        self._send(answer, request_id)
        return None

    async def _send_later(self, answer: Any, request_id: Any) -> None:
        self._send(await answer, request_id)

    def _send(self, response: Any, request_id: Any) -> None:
        if self._destroyed:  # by the callback itself; nobody is left to answer
            return
        self.send_response(response, request_id)
