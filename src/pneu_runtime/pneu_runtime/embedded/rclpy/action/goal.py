# SPDX-License-Identifier: Apache-2.0
"""Goals at the server: their states, and the handle a user gets."""

import threading
from collections.abc import Callable
from enum import IntEnum
from typing import TYPE_CHECKING, Any

from action_msgs.msg import GoalInfo, GoalStatus

from rclpy._rclpy_pybind11 import RCLError

if TYPE_CHECKING:
    from rclpy.action.server import ActionServer


class GoalEvent(IntEnum):
    """What makes a goal change its state."""

    EXECUTE = 0
    CANCEL_GOAL = 1
    SUCCEED = 2
    ABORT = 3
    CANCELED = 4


# https://design.ros2.org/articles/actions.html, goal states
_TRANSITIONS = {
    (GoalStatus.STATUS_ACCEPTED, GoalEvent.EXECUTE): GoalStatus.STATUS_EXECUTING,
    (GoalStatus.STATUS_ACCEPTED, GoalEvent.CANCEL_GOAL): GoalStatus.STATUS_CANCELING,
    (GoalStatus.STATUS_EXECUTING, GoalEvent.CANCEL_GOAL): GoalStatus.STATUS_CANCELING,
    (GoalStatus.STATUS_EXECUTING, GoalEvent.SUCCEED): GoalStatus.STATUS_SUCCEEDED,
    (GoalStatus.STATUS_EXECUTING, GoalEvent.ABORT): GoalStatus.STATUS_ABORTED,
    (GoalStatus.STATUS_CANCELING, GoalEvent.SUCCEED): GoalStatus.STATUS_SUCCEEDED,
    (GoalStatus.STATUS_CANCELING, GoalEvent.ABORT): GoalStatus.STATUS_ABORTED,
    (GoalStatus.STATUS_CANCELING, GoalEvent.CANCELED): GoalStatus.STATUS_CANCELED,
}
_ACTIVE = (GoalStatus.STATUS_ACCEPTED, GoalStatus.STATUS_EXECUTING, GoalStatus.STATUS_CANCELING)
_CANCELABLE = (GoalStatus.STATUS_ACCEPTED, GoalStatus.STATUS_EXECUTING)


class ServerGoalHandle:
    """An accepted goal, through which the user reports on it."""

    def __init__(self, action_server: "ActionServer", goal_info: GoalInfo, goal: Any) -> None:
        """Accept a goal; only the server does that.

        Args:
            action_server: The server.
            goal_info: Identifier and time of acceptance.
            goal: The goal message.
        """
        self._action_server = action_server
        self._goal_info = goal_info
        self._goal_request = goal
        self._status = GoalStatus.STATUS_ACCEPTED
        self._destroyed = False
        self._lock = threading.RLock()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ServerGoalHandle) and bool(self.goal_id == other.goal_id)

    def __hash__(self) -> int:
        return hash(bytes(self.goal_id.uuid))

    @property
    def request(self) -> Any:
        """The goal message."""
        return self._goal_request

    @property
    def goal_id(self) -> Any:
        """Identifier of the goal, unique_identifier_msgs/msg/UUID."""
        return self._goal_info.goal_id

    @property
    def is_active(self) -> bool:
        """Whether the goal has no outcome yet."""
        with self._lock:
            return not self._destroyed and self._status in _ACTIVE

    @property
    def is_cancel_requested(self) -> bool:
        """Whether a request to cancel the goal was accepted."""
        return self.status == GoalStatus.STATUS_CANCELING

    @property
    def status(self) -> int:
        """State of the goal, a number of action_msgs/msg/GoalStatus."""
        with self._lock:
            return GoalStatus.STATUS_UNKNOWN if self._destroyed else self._status

    @property
    def _is_cancelable(self) -> bool:
        return self.status in _CANCELABLE

    def _update_state(self, event: GoalEvent) -> None:
        with self._lock:
            if self._destroyed:
                return
            status = _TRANSITIONS.get((self._status, event))
            if status is None:
                raise RCLError(
                    f"goal_handle attempted invalid transition from state {self._status} "
                    f"with event {event.name}"
                )
            self._status = status
            done = status not in _ACTIVE
        if done:
            self._action_server._goal_done(self)
        self._action_server._publish_status()

    def execute(self, execute_callback: "Callable[[ServerGoalHandle], Any] | None" = None) -> None:
        """Have the executor run the goal.

        Args:
            execute_callback: Runs it and returns the result; the server's own where it is None.
        """
        # A goal that is to be cancelled already stays in that state and is run all the same, so
        # that its callback can end it.
        if not self.is_cancel_requested:
            self._update_state(GoalEvent.EXECUTE)
        self._action_server.notify_execute(self, execute_callback)

    def publish_feedback(self, feedback: Any) -> None:
        """Tell the clients how far the goal is.

        Args:
            feedback: Message of the action's Feedback type.
        """
        if not isinstance(feedback, self._action_server.action_type.Feedback):
            raise TypeError(
                f"feedback has to be a {self._action_server.action_type.Feedback.__name__}, "
                f"not {type(feedback).__name__}"
            )
        with self._lock:
            if not self._destroyed:
                self._action_server._publish_feedback(self.goal_id, feedback)

    def succeed(self) -> None:
        """End the goal as reached."""
        self._update_state(GoalEvent.SUCCEED)

    def abort(self) -> None:
        """End the goal as not reachable."""
        self._update_state(GoalEvent.ABORT)

    def canceled(self) -> None:
        """End the goal as cancelled, which has to have been requested."""
        self._update_state(GoalEvent.CANCELED)

    def destroy(self) -> None:
        """Let go of the goal; its state is unknown from now on."""
        with self._lock:
            self._destroyed = True
