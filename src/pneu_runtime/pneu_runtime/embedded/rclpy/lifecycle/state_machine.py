# SPDX-License-Identifier: Apache-2.0
"""The states of a managed node and the transitions between them.

Follows https://design.ros2.org/articles/node_lifecycle.html with the numbers of lifecycle_msgs.
"""

from collections.abc import Callable
from enum import IntEnum
from typing import NamedTuple

from lifecycle_msgs.msg import State as StateMsg
from lifecycle_msgs.msg import Transition as TransitionMsg

from rclpy._rclpy_pybind11 import RCLError


class TransitionCallbackReturn(IntEnum):
    """What a transition callback reports."""

    SUCCESS = TransitionMsg.TRANSITION_CALLBACK_SUCCESS
    FAILURE = TransitionMsg.TRANSITION_CALLBACK_FAILURE
    ERROR = TransitionMsg.TRANSITION_CALLBACK_ERROR

    def to_label(self) -> str:
        """Return the label of the transition that follows."""
        return f"transition_{self.name.lower()}"


class LifecycleState(NamedTuple):
    """A state by its name and number."""

    label: str
    state_id: int


class Transition(NamedTuple):
    """A way from one state to another."""

    transition_id: int
    label: str
    start: LifecycleState
    goal: LifecycleState


def _states() -> dict[str, LifecycleState]:
    primary = ("UNKNOWN", "UNCONFIGURED", "INACTIVE", "ACTIVE", "FINALIZED")
    passing = (
        "CONFIGURING",
        "CLEANINGUP",
        "SHUTTINGDOWN",
        "ACTIVATING",
        "DEACTIVATING",
        "ERRORPROCESSING",
    )
    numbers = {name: getattr(StateMsg, f"PRIMARY_STATE_{name}") for name in primary}
    numbers |= {name: getattr(StateMsg, f"TRANSITION_STATE_{name}") for name in passing}
    return {name.lower(): LifecycleState(name.lower(), number) for name, number in numbers.items()}


STATES = _states()

# Command, its starts, the passing state, and where success, failure and error lead from there.
_COMMANDS: tuple[tuple[str, dict[str, str], str, str, str, str], ...] = (
    ("configure", {"unconfigured": "CONFIGURE"}, "configuring", "CONFIGURE", "inactive",
     "unconfigured"),
    ("cleanup", {"inactive": "CLEANUP"}, "cleaningup", "CLEANUP", "unconfigured", "inactive"),
    ("activate", {"inactive": "ACTIVATE"}, "activating", "ACTIVATE", "active", "inactive"),
    ("deactivate", {"active": "DEACTIVATE"}, "deactivating", "DEACTIVATE", "inactive", "active"),
    (
        "shutdown",
        {
            "unconfigured": "UNCONFIGURED_SHUTDOWN",
            "inactive": "INACTIVE_SHUTDOWN",
            "active": "ACTIVE_SHUTDOWN",
        },
        "shuttingdown", "SHUTDOWN", "finalized", "finalized",
    ),
)  # fmt: skip


def _transitions() -> tuple[Transition, ...]:
    found = []

    def add(constant: str, label: str, start: str, goal: str) -> None:
        number = getattr(TransitionMsg, f"TRANSITION_{constant}")
        found.append(Transition(number, label, STATES[start], STATES[goal]))

    for label, starts, passing, outcome, on_success, on_failure in _COMMANDS:
        for start, constant in starts.items():
            add(constant, label, start, passing)
        add(f"ON_{outcome}_SUCCESS", "transition_success", passing, on_success)
        add(f"ON_{outcome}_FAILURE", "transition_failure", passing, on_failure)
        add(f"ON_{outcome}_ERROR", "transition_error", passing, "errorprocessing")
    add("ON_ERROR_SUCCESS", "transition_success", "errorprocessing", "unconfigured")
    add("ON_ERROR_FAILURE", "transition_failure", "errorprocessing", "finalized")
    add("ON_ERROR_ERROR", "transition_error", "errorprocessing", "finalized")
    return tuple(found)


TRANSITIONS = _transitions()


class StateMachine:
    """The present state; every change is reported."""

    def __init__(self, report: Callable[[Transition], None]) -> None:
        """Start unconfigured.

        Args:
            report: Called with each transition once it has been made.
        """
        self.current = STATES["unconfigured"]
        self._report = report

    @property
    def available_transitions(self) -> list[Transition]:
        """Transitions that start from the present state."""
        return [one for one in TRANSITIONS if one.start == self.current]

    def find(self, wanted: int | str) -> Transition:
        """Return the transition of a number or label from the present state.

        Args:
            wanted: Number or label; RCLError where no such transition starts here.
        """
        for one in self.available_transitions:
            if wanted in (one.transition_id, one.label):
                return one
        known = ", ".join(
            f"{one.label} [{one.transition_id}]" for one in self.available_transitions
        )
        raise RCLError(
            f"No transition matching {wanted} found for current state {self.current.label}; "
            f"there are: {known or 'none'}"
        )

    def trigger(self, wanted: int | str) -> None:
        """Make a transition.

        Args:
            wanted: Number or label; RCLError where no such transition starts here.
        """
        transition = self.find(wanted)
        self.current = transition.goal
        self._report(transition)
