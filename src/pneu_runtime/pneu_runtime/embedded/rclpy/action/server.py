# SPDX-License-Identifier: Apache-2.0
"""The server of an action: accepts goals, runs them, keeps their results for a while."""

import functools
import threading
import traceback
from collections.abc import Callable
from enum import Enum
from typing import TYPE_CHECKING, Any

from action_msgs.msg import GoalInfo, GoalStatus
from action_msgs.srv import CancelGoal

from pneu_runtime import interfaces
from rclpy._rclpy_pybind11 import RCLError
from rclpy.action._ends import check_action_type, create_end, decode, service_of
from rclpy.action.goal import GoalEvent, ServerGoalHandle
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

_NO_ID = bytes(16)


class GoalResponse(Enum):
    """Answer to a new goal."""

    REJECT = 1
    ACCEPT = 2


class CancelResponse(Enum):
    """Answer to a request to cancel."""

    REJECT = 1
    ACCEPT = 2


def default_handle_accepted_callback(goal_handle: ServerGoalHandle) -> None:
    """Run the goal at once.

    Args:
        goal_handle: The goal.
    """
    goal_handle.execute()


def default_goal_callback(goal_request: Any) -> GoalResponse:
    """Accept all goals.

    Args:
        goal_request: The goal message.
    """
    return GoalResponse.ACCEPT


def default_cancel_callback(cancel_request: Any) -> CancelResponse:
    """Cancel nothing.

    Args:
        cancel_request: The goal.
    """
    return CancelResponse.REJECT


class ActionServer(Waitable):
    """Serves one action. User callbacks run in the executor of the node."""

    def __init__(
        self,
        node: "Node",
        action_type: Any,
        action_name: str,
        execute_callback: Callable[[ServerGoalHandle], Any] | None,
        *,
        callback_group: CallbackGroup | None = None,
        goal_callback: Callable[[Any], Any] = default_goal_callback,
        handle_accepted_callback: Callable[
            [ServerGoalHandle], Any
        ] = default_handle_accepted_callback,
        cancel_callback: Callable[[Any], Any] = default_cancel_callback,
        goal_service_qos_profile: QoSProfile = qos_profile_services_default,
        result_service_qos_profile: QoSProfile = qos_profile_services_default,
        cancel_service_qos_profile: QoSProfile = qos_profile_services_default,
        feedback_pub_qos_profile: QoSProfile | None = None,
        status_pub_qos_profile: QoSProfile = qos_profile_action_status_default,
        result_timeout: float = 10,
    ) -> None:
        """Start to serve.

        Args:
            node: Node it belongs to.
            action_type: Class of the action.
            action_name: Its name, relative to the node's namespace or absolute.
            execute_callback: Runs an accepted goal and returns the result message.
            callback_group: Group of the server; the node's default one where it is None.
            goal_callback: Decides on a goal message; returns a GoalResponse.
            handle_accepted_callback: Gets each accepted goal; by default it is run at once.
            cancel_callback: Decides on a request to cancel; returns a CancelResponse.
            goal_service_qos_profile: QoS of the service send_goal.
            result_service_qos_profile: QoS of the service get_result.
            cancel_service_qos_profile: QoS of the service cancel_goal.
            feedback_pub_qos_profile: QoS of the topic feedback; depth 10 by default.
            status_pub_qos_profile: QoS of the topic status.
            result_timeout: How long a result is kept [s], on the node's clock; negative for ever.
        """
        check_action_type(action_type)
        group = node.default_callback_group if callback_group is None else callback_group
        super().__init__(group)
        self._lock = threading.RLock()
        self._node = node
        self._action_type = action_type
        self._logger = node.get_logger().get_child("action_server")
        self._result_timeout_ns = int(result_timeout * 1e9)
        self._goal_handles: dict[bytes, ServerGoalHandle] = {}
        self._result_futures: dict[bytes, Future] = {}
        self._done_since_ns: dict[bytes, int] = {}
        self._destroyed = False
        self.register_handle_accepted_callback(handle_accepted_callback)
        self.register_goal_callback(goal_callback)
        self.register_cancel_callback(cancel_callback)
        self.register_execute_callback(execute_callback)

        def end(kind: str, name: str, qos: QoSProfile) -> Any:
            return create_end(node, kind, action_type, action_name, name, qos)

        self._servers = {
            "send_goal": end("server", "send_goal", goal_service_qos_profile),
            "cancel_goal": end("server", "cancel_goal", cancel_service_qos_profile),
            "get_result": end("server", "get_result", result_service_qos_profile),
        }
        feedback_qos = feedback_pub_qos_profile or QoSProfile(depth=10)
        self._feedback = end("publication", "feedback", feedback_qos)
        self._status = end("publication", "status", status_pub_qos_profile)
        self._sources = tuple(self._servers.values())
        node.add_waitable(self)

    @property
    def action_type(self) -> Any:
        """Class of the action."""
        return self._action_type

    # Registering callbacks

    def register_handle_accepted_callback(
        self, handle_accepted_callback: Callable[[ServerGoalHandle], Any] | None
    ) -> None:
        """Replace the function that gets each accepted goal.

        Args:
            handle_accepted_callback: The function; None for the default one, which runs the goal.
        """
        self._handle_accepted_callback = (
            handle_accepted_callback or default_handle_accepted_callback
        )

    def register_goal_callback(self, goal_callback: Callable[[Any], Any] | None) -> None:
        """Replace the function that decides on goals.

        Args:
            goal_callback: The function; None for the default one, which accepts all.
        """
        self._goal_callback = goal_callback or default_goal_callback

    def register_cancel_callback(self, cancel_callback: Callable[[Any], Any] | None) -> None:
        """Replace the function that decides on requests to cancel.

        Args:
            cancel_callback: The function; None for the default one, which refuses all.
        """
        self._cancel_callback = cancel_callback or default_cancel_callback

    def register_execute_callback(
        self, execute_callback: Callable[[ServerGoalHandle], Any] | None
    ) -> None:
        """Replace the function that runs goals.

        Args:
            execute_callback: The function.
        """
        if execute_callback is not None and not callable(execute_callback):
            raise TypeError("Failed to register goal execution callback: not callable")
        self._execute_callback = execute_callback

    # Waitable

    def is_ready(self, wait_set: Any) -> bool:
        """Return whether a request has come in; taking tells, so this is always worth a try.

        Args:
            wait_set: Not used.
        """
        return not self._destroyed

    def take_data(self) -> dict[str, tuple[Any, Any]]:
        """Take one request of each service."""
        taken: dict[str, tuple[Any, Any]] = {}
        with self._lock:
            if self._destroyed:
                return taken
            for name, server in self._servers.items():
                sample = server.take()
                if sample is None:
                    continue
                service, _ = service_of(self._action_type, name)
                request = decode(sample[1], service.Request, self._logger)
                if request is not None:
                    taken[name] = (sample[0], request)
        return taken

    async def execute(self, taken_data: Any) -> None:
        """Handle the requests that were taken.

        Args:
            taken_data: What `take_data` returned.
        """
        self._expire_results()
        if not taken_data:
            return
        if "send_goal" in taken_data:
            await self._execute_goal_request(*taken_data["send_goal"])
        if "cancel_goal" in taken_data:
            await self._execute_cancel_request(*taken_data["cancel_goal"])
        if "get_result" in taken_data:
            self._execute_get_result_request(*taken_data["get_result"])

    def get_num_entities(self) -> NumberOfEntities:
        """Return how many endpoints there are to wait for."""
        return NumberOfEntities(num_services=len(self._servers))

    def add_to_wait_set(self, wait_set: Any) -> None:
        """Add the services to a wait set.

        Args:
            wait_set: The wait set.
        """
        for server in self._servers.values():
            wait_set.add_source(server)

    # Requests

    def _respond(self, name: str, request_id: Any, response: Any) -> None:
        with self._lock:
            if not self._destroyed:
                self._servers[name].respond(request_id, interfaces.serialize(response))

    async def _execute_goal_request(self, request_id: Any, request: Any) -> None:
        uuid = bytes(request.goal_id.uuid)
        response = self._action_type.Impl.SendGoalService.Response()
        handle = None
        if uuid not in self._goal_handles:
            decision = await await_or_execute(self._goal_callback, request.goal)
            if decision == GoalResponse.ACCEPT:
                info = GoalInfo(
                    goal_id=request.goal_id, stamp=self._node.get_clock().now().to_msg()
                )
                handle = ServerGoalHandle(self, info, request.goal)
                response.accepted = True
                response.stamp = info.stamp
                future = Future()
                with self._lock:
                    self._goal_handles[uuid] = handle
                    self._result_futures[uuid] = future
                self.add_future(future)
            elif not isinstance(decision, GoalResponse):
                self._logger.warning(
                    "Goal request callback did not return a GoalResponse type. Rejecting goal."
                )
        self._respond("send_goal", request_id, response)
        if handle is None:
            self._logger.debug(f"New goal rejected: {request.goal_id.uuid}")
            return
        self._logger.debug(f"New goal accepted: {request.goal_id.uuid}")
        await await_or_execute(self._handle_accepted_callback, handle)

    def _goals_to_cancel(self, info: GoalInfo) -> tuple[int, list[ServerGoalHandle]]:
        """Return code and goals of a request, by the rules in action_msgs/srv/CancelGoal."""
        uuid = bytes(info.goal_id.uuid)
        stamp = (info.stamp.sec, info.stamp.nanosec)
        code = CancelGoal.Response.ERROR_NONE
        with self._lock:
            handles = list(self._goal_handles.values())
            named = self._goal_handles.get(uuid)
        wanted = [named] if named is not None else []
        if uuid == _NO_ID or stamp != (0, 0):
            for handle in handles:
                accepted = handle._goal_info.stamp
                early = stamp == (0, 0) or (accepted.sec, accepted.nanosec) <= stamp
                if early and handle is not named:
                    wanted.append(handle)
        elif named is None:
            code = CancelGoal.Response.ERROR_UNKNOWN_GOAL_ID
        elif not named._is_cancelable:
            code = CancelGoal.Response.ERROR_GOAL_TERMINATED
        return code, [handle for handle in wanted if handle._is_cancelable]

    async def _execute_cancel_request(self, request_id: Any, request: Any) -> None:
        code, handles = self._goals_to_cancel(request.goal_info)
        canceling = []
        for handle in handles:
            decision = await await_or_execute(self._cancel_callback, handle)
            if decision != CancelResponse.ACCEPT:
                continue
            try:
                handle._update_state(GoalEvent.CANCEL_GOAL)
            except RCLError as error:  # it has ended while the callback decided
                self._logger.debug(f"Failed to cancel goal in cancel callback: {error}")
                continue
            canceling.append(handle._goal_info)
        if handles and not canceling:
            code = CancelGoal.Response.ERROR_REJECTED
        response = CancelGoal.Response(return_code=code, goals_canceling=canceling)
        self._respond("cancel_goal", request_id, response)

    def _execute_get_result_request(self, request_id: Any, request: Any) -> None:
        with self._lock:
            future = self._result_futures.get(bytes(request.goal_id.uuid))
        if future is None:
            self._logger.debug(
                f"Sending result response for unknown goal ID: {request.goal_id.uuid}"
            )
            response = self._action_type.Impl.GetResultService.Response()
            response.status = GoalStatus.STATUS_UNKNOWN
            self._respond("get_result", request_id, response)
            return
        future.add_done_callback(functools.partial(self._send_result, request_id))

    def _send_result(self, request_id: Any, future: Future) -> None:
        self._respond("get_result", request_id, future.result())

    # Running goals

    def notify_execute(
        self,
        goal_handle: ServerGoalHandle,
        execute_callback: Callable[[ServerGoalHandle], Any] | None,
    ) -> None:
        """Have the executor run a goal.

        Args:
            goal_handle: The goal.
            execute_callback: Runs it; the registered function where it is None.
        """
        callback = execute_callback or self._execute_callback
        if callback is None:
            return
        executor = self._node.executor
        if executor is None:
            raise RuntimeError("a goal can only be run while the node is in an executor")
        executor.create_task(self._execute_goal, callback, goal_handle)

    async def _execute_goal(
        self, execute_callback: Callable[[ServerGoalHandle], Any], goal_handle: ServerGoalHandle
    ) -> None:
        result = None
        try:
            result = await await_or_execute(execute_callback, goal_handle)
        except Exception as error:
            # Whatever it was, the client has to get an answer.
            self._logger.error(f"Error raised in execute callback: {error}")
            traceback.print_exc()
        if goal_handle.is_active:
            self._logger.warning(
                f"Goal state not set, assuming aborted. Goal ID: {goal_handle.goal_id.uuid}"
            )
            goal_handle.abort()
        response = self._action_type.Impl.GetResultService.Response()
        response.status = goal_handle.status
        if result is not None:
            response.result = result
        with self._lock:
            future = self._result_futures.get(bytes(goal_handle.goal_id.uuid))
        if future is not None:
            future.set_result(response)

    def _publish_feedback(self, goal_id: Any, feedback: Any) -> None:
        message = self._action_type.Impl.FeedbackMessage(goal_id=goal_id, feedback=feedback)
        with self._lock:
            if not self._destroyed:
                self._feedback.publish(interfaces.serialize(message))

    def _publish_status(self) -> None:
        with self._lock:
            if self._destroyed:
                return
            message = self._action_type.Impl.GoalStatusMessage(
                status_list=[
                    GoalStatus(goal_info=handle._goal_info, status=handle.status)
                    for handle in self._goal_handles.values()
                ]
            )
            self._status.publish(interfaces.serialize(message))

    # Results are kept for a while, for clients that ask late

    def _goal_done(self, goal_handle: ServerGoalHandle) -> None:
        with self._lock:
            now_ns = self._node.get_clock().now().nanoseconds
            self._done_since_ns[bytes(goal_handle.goal_id.uuid)] = now_ns
        self._expire_results()

    def _expire_results(self) -> None:
        """Forget goals whose time is over; called whenever somebody could notice them."""
        if self._result_timeout_ns < 0:
            return
        with self._lock:
            now_ns = self._node.get_clock().now().nanoseconds
            for uuid, since_ns in list(self._done_since_ns.items()):
                future = self._result_futures[uuid]
                if now_ns - since_ns < self._result_timeout_ns or not future.done():
                    continue
                del self._done_since_ns[uuid]
                self._goal_handles.pop(uuid).destroy()
                self.remove_future(self._result_futures.pop(uuid))

    def destroy(self) -> None:
        """Stop serving."""
        with self._lock:
            if self._destroyed:
                return
            self._destroyed = True
            for handle in self._goal_handles.values():
                handle.destroy()
        self._node.remove_waitable(self)
        for endpoint in (*self._servers.values(), self._feedback, self._status):
            endpoint.close()
