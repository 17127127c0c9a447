# SPDX-License-Identifier: Apache-2.0
"""The client of an action: sends goals, follows them, asks for their results, cancels them."""

import threading
import time
import uuid
import weakref
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from action_msgs.msg import GoalStatus
from action_msgs.srv import CancelGoal
from unique_identifier_msgs.msg import UUID

from pneu_runtime import interfaces
from rclpy.action._ends import check_action_type, create_end, decode, service_of, topic_of
from rclpy.callback_groups import CallbackGroup
from rclpy.executors import await_or_execute
from rclpy.qos import (
    QoSProfile,
    qos_profile_action_status_default,
    qos_profile_services_default,
)
from rclpy.task import Future
from rclpy.waitable import NumberOfEntities, Waitable

if TYPE_CHECKING:
    from rclpy.node import Node

_POLL_S = 0.02
_TERMINAL = (
    GoalStatus.STATUS_SUCCEEDED,
    GoalStatus.STATUS_CANCELED,
    GoalStatus.STATUS_ABORTED,
)


class ClientGoalHandle:
    """A goal that was sent, with the server's answer."""

    def __init__(self, action_client: "ActionClient", goal_id: Any, goal_response: Any) -> None:
        """Remember the answer; only the client does that.

        Args:
            action_client: The client.
            goal_id: Identifier of the goal.
            goal_response: Response of the service send_goal.
        """
        self._action_client = action_client
        self._goal_id = goal_id
        self._goal_response = goal_response
        self._status = GoalStatus.STATUS_UNKNOWN

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ClientGoalHandle) and bool(self._goal_id == other._goal_id)

    def __hash__(self) -> int:
        return hash(bytes(self._goal_id.uuid))

    def __repr__(self) -> str:
        return (
            f"ClientGoalHandle <id={self.goal_id.uuid}, accepted={self.accepted}, "
            f"status={self.status}>"
        )

    @property
    def goal_id(self) -> Any:
        """Identifier of the goal, unique_identifier_msgs/msg/UUID."""
        return self._goal_id

    @property
    def stamp(self) -> Any:
        """When the server accepted it, builtin_interfaces/msg/Time."""
        return self._goal_response.stamp

    @property
    def accepted(self) -> bool:
        """Whether the server accepted it."""
        return bool(self._goal_response.accepted)

    @property
    def status(self) -> int:
        """Last known state, a number of action_msgs/msg/GoalStatus."""
        return self._status

    def cancel_goal(self) -> Any:
        """Request to cancel and wait for the response; not from within a callback."""
        return _wait(self.cancel_goal_async())

    def cancel_goal_async(self) -> Future:
        """Request to cancel; the future gets the response of action_msgs/srv/CancelGoal."""
        return self._action_client._cancel_goal_async(self)

    def get_result(self) -> Any:
        """Wait for the result response; not from within a callback."""
        return _wait(self.get_result_async())

    def get_result_async(self) -> Future:
        """Ask for the result; the future gets a response with `status` and `result`."""
        return self._action_client._get_result_async(self)


def _wait(future: Future) -> Any:
    """Block until an executor in another thread has completed a future."""
    event = threading.Event()
    future.add_done_callback(lambda _: event.set())
    event.wait()
    exception = future.exception()
    if exception is not None:
        raise exception
    return future.result()


class ActionClient(Waitable):
    """Client of one action."""

    def __init__(
        self,
        node: "Node",
        action_type: Any,
        action_name: str,
        *,
        callback_group: CallbackGroup | None = None,
        goal_service_qos_profile: QoSProfile = qos_profile_services_default,
        result_service_qos_profile: QoSProfile = qos_profile_services_default,
        cancel_service_qos_profile: QoSProfile = qos_profile_services_default,
        feedback_sub_qos_profile: QoSProfile | None = None,
        status_sub_qos_profile: QoSProfile = qos_profile_action_status_default,
    ) -> None:
        """Create the client.

        Args:
            node: Node it belongs to.
            action_type: Class of the action.
            action_name: Its name, relative to the node's namespace or absolute.
            callback_group: Group of the client; the node's default one where it is None.
            goal_service_qos_profile: QoS of the service send_goal.
            result_service_qos_profile: QoS of the service get_result.
            cancel_service_qos_profile: QoS of the service cancel_goal.
            feedback_sub_qos_profile: QoS of the topic feedback; depth 10 by default.
            status_sub_qos_profile: QoS of the topic status.
        """
        check_action_type(action_type)
        group = node.default_callback_group if callback_group is None else callback_group
        super().__init__(group)
        self._lock = threading.RLock()
        self._node = node
        self._action_type = action_type
        self._action_name = action_name
        self._logger = node.get_logger().get_child("action_client")
        self._destroyed = False
        # Handles are the user's: the client only updates those that are still in use.
        self._goal_handles: dict[bytes, weakref.ref[ClientGoalHandle]] = {}
        self._feedback_callbacks: dict[bytes, Callable[[Any], Any]] = {}
        self._last_statuses: list[Any] = []
        # By service and sequence number: the future, and the goal that was asked about.
        self._pending: dict[tuple[str, int], tuple[Future, Any]] = {}

        def end(kind: str, name: str, qos: QoSProfile) -> Any:
            return create_end(node, kind, action_type, action_name, name, qos)

        self._clients = {
            "send_goal": end("client", "send_goal", goal_service_qos_profile),
            "cancel_goal": end("client", "cancel_goal", cancel_service_qos_profile),
            "get_result": end("client", "get_result", result_service_qos_profile),
        }
        feedback_qos = feedback_sub_qos_profile or QoSProfile(depth=10)
        self._topics = {
            "feedback": end("subscription", "feedback", feedback_qos),
            "status": end("subscription", "status", status_sub_qos_profile),
        }
        self._sources = (*self._clients.values(), *self._topics.values())
        node.add_waitable(self)

    @property
    def action_type(self) -> Any:
        """Class of the action."""
        return self._action_type

    # Waitable

    def is_ready(self, wait_set: Any) -> bool:
        """Return whether something has come in; taking tells, so this is always worth a try.

        Args:
            wait_set: Not used.
        """
        return not self._destroyed

    def take_data(self) -> dict[str, Any]:
        """Take one response of each service and all messages of the topics."""
        taken: dict[str, Any] = {}
        with self._lock:
            if self._destroyed:
                return taken
            for name, client in self._clients.items():
                reply = client.take()
                if reply is not None:
                    service, _ = service_of(self._action_type, name)
                    response = decode(reply[1], service.Response, self._logger)
                    if response is not None:
                        taken[name] = (reply[0], response)
            for name, subscription in self._topics.items():
                cls, _ = topic_of(self._action_type, name)
                messages = []
                while (sample := subscription.take()) is not None:
                    message = decode(sample.data, cls, self._logger)
                    if message is not None:
                        messages.append(message)
                if messages:
                    taken[name] = messages
        return taken

    async def execute(self, taken_data: Any) -> None:
        """Complete futures and call user callbacks for what was taken.

        Args:
            taken_data: What `take_data` returned.
        """
        if not taken_data:
            return
        # What has happened on the way to a result is told before the result.
        if "send_goal" in taken_data:
            self._complete("send_goal", *taken_data["send_goal"])
        for message in taken_data.get("feedback", ()):
            callback = self._feedback_callbacks.get(bytes(message.goal_id.uuid))
            if callback is not None:
                await await_or_execute(callback, message)
        for message in taken_data.get("status", ()):
            self._update_status(message.status_list)
        for name in ("cancel_goal", "get_result"):
            if name in taken_data:
                self._complete(name, *taken_data[name])

    def _complete(self, name: str, sequence_number: int, response: Any) -> None:
        with self._lock:
            pending = self._pending.pop((name, sequence_number), None)
        if pending is None:
            self._logger.warning(
                f"Ignoring unexpected {name} response. There may be more than one action server "
                f"for the action '{self._action_name}'"
            )
            return
        future, goal_id = pending
        outcome = response
        if name == "send_goal":
            outcome = ClientGoalHandle(self, goal_id, response)
            if outcome.accepted:
                with self._lock:
                    self._goal_handles[bytes(goal_id.uuid)] = weakref.ref(outcome)
                    # The status may have come before the answer.
                    self._update_status(self._last_statuses)
            else:
                self._feedback_callbacks.pop(bytes(goal_id.uuid), None)
        elif name == "get_result":
            # No feedback follows a result.
            self._feedback_callbacks.pop(bytes(goal_id.uuid), None)
        future.set_result(outcome)
        self._forget(future)

    def _update_status(self, statuses: list[Any]) -> None:
        with self._lock:
            self._last_statuses = statuses
            for status in statuses:
                key = bytes(status.goal_info.goal_id.uuid)
                reference = self._goal_handles.get(key)
                if reference is None:
                    continue
                handle = reference()
                if handle is not None:
                    handle._status = status.status
                if handle is None or status.status in _TERMINAL:
                    del self._goal_handles[key]

    def get_num_entities(self) -> NumberOfEntities:
        """Return how many endpoints there are to wait for."""
        return NumberOfEntities(num_subs=len(self._topics), num_clients=len(self._clients))

    def add_to_wait_set(self, wait_set: Any) -> None:
        """Add all endpoints to a wait set.

        Args:
            wait_set: The wait set.
        """
        for source in (*self._clients.values(), *self._topics.values()):
            wait_set.add_source(source)

    # Requests

    def _request(self, name: str, request: Any, goal_id: Any) -> Future:
        future = Future()
        with self._lock:
            # The lock keeps the answer from being handled before its future is known.
            sequence_number = self._clients[name].send(interfaces.serialize(request))
            self._pending[(name, sequence_number)] = (future, goal_id)
        self.add_future(future)
        future.add_done_callback(self._forget)
        return future

    def _forget(self, future: Future) -> None:
        """Drop a future that was answered, or that the user has cancelled."""
        with self._lock:
            for key, (pending, _) in list(self._pending.items()):
                if pending is future:
                    del self._pending[key]
            if future in self._futures:
                self.remove_future(future)

    def send_goal(self, goal: Any, **kwargs: Any) -> Any:
        """Send a goal and wait for its result; not from within a callback.

        Args:
            goal: The goal message.
            **kwargs: As for `send_goal_async`.

        Returns:
            object: response with `status` and `result`.
        """
        return _wait(self._get_result_async(_wait(self.send_goal_async(goal, **kwargs))))

    def send_goal_async(
        self,
        goal: Any,
        feedback_callback: Callable[[Any], Any] | None = None,
        goal_uuid: Any = None,
    ) -> Future:
        """Send a goal.

        Args:
            goal: The goal message.
            feedback_callback: Called with each feedback message of this goal.
            goal_uuid: Identifier, unique_identifier_msgs/msg/UUID; a random one by default.

        Returns:
            Future: gets a ClientGoalHandle when the server has answered.
        """
        if not isinstance(goal, self._action_type.Goal):
            raise TypeError(
                f"goal has to be a {self._action_type.Goal.__name__}, not {type(goal).__name__}"
            )
        goal_id = UUID(uuid=list(uuid.uuid4().bytes)) if goal_uuid is None else goal_uuid
        request = self._action_type.Impl.SendGoalService.Request(goal_id=goal_id, goal=goal)
        if feedback_callback is not None:
            self._feedback_callbacks[bytes(goal_id.uuid)] = feedback_callback
        return self._request("send_goal", request, goal_id)

    def _cancel_goal_async(self, goal_handle: ClientGoalHandle) -> Future:
        _check_handle(goal_handle)
        request = CancelGoal.Request()
        request.goal_info.goal_id = goal_handle.goal_id
        return self._request("cancel_goal", request, goal_handle.goal_id)

    def _get_result_async(self, goal_handle: ClientGoalHandle) -> Future:
        _check_handle(goal_handle)
        service = self._action_type.Impl.GetResultService
        request = service.Request(goal_id=goal_handle.goal_id)
        return self._request("get_result", request, goal_handle.goal_id)

    def server_is_ready(self) -> bool:
        """Return whether a server with all its services and topics is there."""
        with self._lock:
            if self._destroyed:
                return False
            return all(client.server_is_ready() for client in self._clients.values()) and all(
                topic.matched_count() > 0 for topic in self._topics.values()
            )

    def wait_for_server(self, timeout_sec: float | None = None) -> bool:
        """Wait until a server is there.

        Args:
            timeout_sec: Longest wait [s]; None waits for ever.

        Returns:
            bool: whether it is.
        """
        end = None if timeout_sec is None else time.monotonic() + timeout_sec
        while not self.server_is_ready():
            if not self._node.context.ok() or (end is not None and time.monotonic() >= end):
                return False
            time.sleep(_POLL_S)
        return True

    def destroy(self) -> None:
        """Stop; futures that are pending stay without a result."""
        with self._lock:
            if self._destroyed:
                return
            self._destroyed = True
        self._node.remove_waitable(self)
        for endpoint in (*self._clients.values(), *self._topics.values()):
            endpoint.close()


def _check_handle(goal_handle: Any) -> None:
    if not isinstance(goal_handle, ClientGoalHandle):
        raise TypeError(f"Expected type ClientGoalHandle but received {type(goal_handle)}")
