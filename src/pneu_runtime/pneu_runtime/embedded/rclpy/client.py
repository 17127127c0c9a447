# SPDX-License-Identifier: Apache-2.0
"""Clients: calls of services."""

import threading
import time
from typing import Any

from pneu_runtime import interfaces, transport
from rclpy._endpoint import Endpoint
from rclpy.callback_groups import CallbackGroup
from rclpy.clock import Clock
from rclpy.context import Context
from rclpy.qos import QoSProfile
from rclpy.service_introspection import ServiceIntrospectionState
from rclpy.task import Future

# The graph is told of a server a moment before the endpoints are matched, and nothing tells of the
# matching; so it is looked for again after this time.
_MATCHING_S = 0.05


class Client(Endpoint):
    """Calls a service. Made by `Node.create_client`.

    Args:
        context: The context it belongs to.
        client_impl: The endpoint of the transport.
        srv_type: The class of the service.
        srv_name: The service's name as it was given.
        qos_profile: The quality of service.
        callback_group: The callback group in which responses are handled.
    """

    def __init__(
        self,
        context: Context,
        client_impl: Any,
        srv_type: Any,
        srv_name: str,
        qos_profile: QoSProfile,
        callback_group: CallbackGroup,
    ) -> None:
        self._start(client_impl)
        self.context = context
        self.srv_type = srv_type
        self.srv_name = srv_name
        self.qos_profile = qos_profile
        self.callback_group = callback_group
        self._executor_event = False
        self._pending_requests: dict[int, Future] = {}
        self._session: Any = None
        self._graph_source: Any = None
        self._pending_lock = threading.Lock()

    @property
    def service_name(self) -> str:
        """The service's full name."""
        self._check()
        return self._full_name

    def call(self, request: Any, timeout_sec: float | None = None) -> Any:
        """Call the service and wait for the response.

        An executor must run in another thread. In a callback, await `call_async` instead.

        Args:
            request: The request.
            timeout_sec: How long to wait [s]; None for as long as it takes.

        Returns:
            object: The response. TimeoutError where it does not come in time.
        """
        future = self.call_async(request)
        if not future._wait_in_thread(timeout_sec):
            self.remove_pending_request(future)
            raise TimeoutError(f"no response from '{self._full_name}' within {timeout_sec} s")
        return future.result()

    def call_async(self, request: Any) -> Future:
        """Call the service.

        Args:
            request: The request.

        Returns:
            Future: Its result will be the response.
        """
        if not isinstance(request, self.srv_type.Request):
            raise TypeError(f"Expected {self.srv_type.Request}, got {type(request)}")
        self._check()
        data = interfaces.serialize(request)
        future = Future()
        # the response must not be looked for before the future is entered
        with self._pending_lock:
            sequence = self._end.send(data)
            if sequence in self._pending_requests:
                raise RuntimeError(f"Sequence ({sequence}) conflicts with pending request")
            self._pending_requests[sequence] = future
        future.add_done_callback(self.remove_pending_request)
        return future

    def get_pending_request(self, sequence_number: int) -> Future:
        """Return the future of a request that was not answered yet.

        Args:
            sequence_number: The number of the request.

        Returns:
            Future: The future; KeyError where there is none.
        """
        with self._pending_lock:
            return self._pending_requests[sequence_number]

    def remove_pending_request(self, future: Future) -> None:
        """Stop waiting for a response; one that comes is thrown away.

        Args:
            future: What `call_async` returned.
        """
        with self._pending_lock:
            for sequence, pending in self._pending_requests.items():
                if pending is future:
                    del self._pending_requests[sequence]
                    break

    def service_is_ready(self) -> bool:
        """Say whether the service is there.

        Returns:
            bool: Whether it is.
        """
        self._check()
        return self._end.server_is_ready()

    def wait_for_service(self, timeout_sec: float | None = None) -> bool:
        """Wait until the service is there.

        Args:
            timeout_sec: How long to wait [s]; None or negative for as long as it takes.

        Returns:
            bool: Whether it is there.
        """
        self._check()
        if self._end.server_is_ready():
            return True
        deadline_s = None
        if timeout_sec is not None and timeout_sec >= 0:
            deadline_s = time.monotonic() + timeout_sec
        if self._graph_source is None:
            self._graph_source = self._session.create_graph_source()
        waiter = transport.Waiter()
        self.context._add_waker(waiter.wake)
        try:
            waiter.attach(self._graph_source)
            while self.context.ok() and not self._destroyed:
                self._graph_source.take()
                if self._end.server_is_ready():
                    return True
                remaining_s = _MATCHING_S
                if deadline_s is not None:
                    remaining_s = min(remaining_s, deadline_s - time.monotonic())
                    if remaining_s <= 0:
                        return False
                waiter.wait(remaining_s)
            return False
        finally:
            self.context._remove_waker(waiter.wake)
            waiter.close()

    def destroy(self) -> None:
        """Leave the graph. Users call `Node.destroy_client`."""
        super().destroy()
        if self._graph_source is not None:
            self._graph_source.close()

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
                "the embedded runtime has no Client.configure_introspection but OFF"
            )

    def _receive(self) -> Any:
        """Take a response, or None."""
        with self._lock:
            return None if self._destroyed else self._end.take()

    def _call(self, received: Any, executor: Any) -> None:
        """Give a response to whoever waits for it."""
        sequence, data, _info = received
        with self._pending_lock:
            future = self._pending_requests.pop(sequence, None)
        if future is None:  # nobody waits any more
            return
        future._set_executor(executor)
        try:
            response = interfaces.deserialize(data, self.srv_type.Response)
        except interfaces.DecodeError as error:
            future.set_exception(error)
            return
        future.set_result(response)
