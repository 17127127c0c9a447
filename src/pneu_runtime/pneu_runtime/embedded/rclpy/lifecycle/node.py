# SPDX-License-Identifier: Apache-2.0
"""Nodes with a life cycle: callbacks for its transitions, and the services to drive it."""

import time
import traceback
from typing import TYPE_CHECKING, Any

from lifecycle_msgs.msg import State as StateMsg
from lifecycle_msgs.msg import Transition as TransitionMsg
from lifecycle_msgs.msg import TransitionDescription, TransitionEvent
from lifecycle_msgs.srv import ChangeState, GetAvailableStates, GetAvailableTransitions, GetState

from rclpy._rclpy_pybind11 import RCLError
from rclpy.callback_groups import CallbackGroup
from rclpy.lifecycle.managed_entity import ManagedEntity
from rclpy.lifecycle.publisher import LifecyclePublisher
from rclpy.lifecycle.state_machine import (
    STATES,
    TRANSITIONS,
    LifecycleState,
    StateMachine,
    Transition,
    TransitionCallbackReturn,
)
from rclpy.node import Node

# Callback of each passing state.
_CALLBACKS = {
    "configuring": "on_configure",
    "cleaningup": "on_cleanup",
    "shuttingdown": "on_shutdown",
    "activating": "on_activate",
    "deactivating": "on_deactivate",
    "errorprocessing": "on_error",
}


class LifecycleNodeMixin(ManagedEntity):
    """What makes a `Node` a managed one; inherit it together with `Node` and initialise it last."""

    if TYPE_CHECKING:
        # Provided by Node.
        create_service: Any
        create_publisher: Any
        get_logger: Any
        default_callback_group: CallbackGroup

    def __init__(
        self,
        *,
        enable_communication_interface: bool = True,
        callback_group: CallbackGroup | None = None,
    ) -> None:
        """Start in the state unconfigured.

        Args:
            enable_communication_interface: Whether the services and transition_event are made.
            callback_group: Group of the services; the node's default one where it is None.
        """
        # In the order in which they were added, which is the order they are called in.
        self._managed_entities: dict[ManagedEntity, None] = {}
        self._state_machine = StateMachine(self.__publish_transition)
        self._pub_transition_event = None
        if not enable_communication_interface:
            return
        group = self.default_callback_group if callback_group is None else callback_group
        self._pub_transition_event = self.create_publisher(
            TransitionEvent, "~/transition_event", 10
        )
        services: list[tuple[type, str, Any]] = [
            (ChangeState, "change_state", self.__on_change_state),
            (GetState, "get_state", self.__on_get_state),
            (GetAvailableStates, "get_available_states", self.__on_get_available_states),
            (
                GetAvailableTransitions,
                "get_available_transitions",
                self.__on_get_available_transitions,
            ),
            (GetAvailableTransitions, "get_transition_graph", self.__on_get_transition_graph),
        ]
        for service, name, callback in services:
            self.create_service(service, f"~/{name}", callback, callback_group=group)

    # Transitions made by the node itself

    def trigger_configure(self) -> TransitionCallbackReturn:
        """Go from unconfigured to inactive; RCLError where that is not the state."""
        return self.__change_state(TransitionMsg.TRANSITION_CONFIGURE)

    def trigger_cleanup(self) -> TransitionCallbackReturn:
        """Go from inactive to unconfigured; RCLError where that is not the state."""
        return self.__change_state(TransitionMsg.TRANSITION_CLEANUP)

    def trigger_shutdown(self) -> TransitionCallbackReturn:
        """Go to finalized; RCLError where the state allows no shutdown."""
        return self.__change_state("shutdown")

    def trigger_activate(self) -> TransitionCallbackReturn:
        """Go from inactive to active; RCLError where that is not the state."""
        return self.__change_state(TransitionMsg.TRANSITION_ACTIVATE)

    def trigger_deactivate(self) -> TransitionCallbackReturn:
        """Go from active to inactive; RCLError where that is not the state."""
        return self.__change_state(TransitionMsg.TRANSITION_DEACTIVATE)

    # Managed entities

    def add_managed_entity(self, entity: ManagedEntity) -> None:
        """Take an entity along through the transitions.

        Args:
            entity: The entity.
        """
        if not isinstance(entity, ManagedEntity):
            raise TypeError("Expected a rclpy.lifecycle.ManagedEntity instance.")
        self._managed_entities[entity] = None

    def create_lifecycle_publisher(self, *args: Any, **kwargs: Any) -> LifecyclePublisher:
        """Create a publisher that is silent unless the node is active.

        Args:
            *args: As for `Node.create_publisher`.
            **kwargs: As for `Node.create_publisher`.
        """
        if "publisher_class" in kwargs:
            raise TypeError(
                "create_publisher() got an unexpected keyword argument 'publisher_class'"
            )
        publisher = self.create_publisher(*args, **kwargs, publisher_class=LifecyclePublisher)
        assert isinstance(publisher, LifecyclePublisher)
        self._managed_entities[publisher] = None
        return publisher

    def destroy_lifecycle_publisher(self, publisher: LifecyclePublisher) -> bool:
        """Destroy a publisher made by `create_lifecycle_publisher`.

        Args:
            publisher: The publisher.

        Returns:
            bool: whether it was one of this node.
        """
        self._managed_entities.pop(publisher, None)
        return Node.destroy_publisher(self, publisher)  # type: ignore[arg-type]

    # Callbacks; a node that overrides one calls super() to take its managed entities along

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Configure the managed entities, up to the first that does not succeed.

        Args:
            state: State the node comes from.
        """
        return self.__call_entities("on_configure", state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Clean up the managed entities, up to the first that does not succeed.

        Args:
            state: State the node comes from.
        """
        return self.__call_entities("on_cleanup", state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Shut down the managed entities, up to the first that does not succeed.

        Args:
            state: State the node comes from.
        """
        return self.__call_entities("on_shutdown", state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Activate the managed entities, up to the first that does not succeed.

        Args:
            state: State the node comes from.
        """
        return self.__call_entities("on_activate", state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Deactivate the managed entities, up to the first that does not succeed.

        Args:
            state: State the node comes from.
        """
        return self.__call_entities("on_deactivate", state)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Let the managed entities recover; success leads to unconfigured, else to finalized.

        Args:
            state: State the node comes from.
        """
        return self.__call_entities("on_error", state)

    def __call_entities(self, callback: str, state: LifecycleState) -> TransitionCallbackReturn:
        for entity in list(self._managed_entities):
            outcome = getattr(entity, callback)(state)
            if not isinstance(outcome, TransitionCallbackReturn):
                raise TypeError(
                    f"{callback}() return value of class {type(entity)} should be"
                    f" `TransitionCallbackReturn`.\n"
                    f"Instance of the class that caused the failure: {entity}"
                )
            if outcome != TransitionCallbackReturn.SUCCESS:
                return outcome
        return TransitionCallbackReturn.SUCCESS

    def __run_callback(self, previous: LifecycleState) -> TransitionCallbackReturn:
        """Run the callback of the present state; whatever goes wrong in it is an error."""
        name = _CALLBACKS[self._state_machine.current.label]
        try:
            outcome = getattr(self, name)(previous)
        except Exception as error:
            self.get_logger().error(f"{name} raised {error!r}\n{traceback.format_exc()}")
            return TransitionCallbackReturn.ERROR
        if not isinstance(outcome, TransitionCallbackReturn):
            self.get_logger().error(
                f"{name} has to return a TransitionCallbackReturn, not {outcome!r}"
            )
            return TransitionCallbackReturn.ERROR
        return outcome

    def __change_state(self, wanted: int | str) -> TransitionCallbackReturn:
        machine = self._state_machine
        previous = machine.current
        machine.trigger(wanted)
        outcome = self.__run_callback(previous)
        machine.trigger(outcome.to_label())
        if outcome == TransitionCallbackReturn.ERROR:
            machine.trigger(self.__run_callback(previous).to_label())
        return outcome

    def __publish_transition(self, transition: Transition) -> None:
        if self._pub_transition_event is not None:
            description = _description(transition)
            self._pub_transition_event.publish(
                TransitionEvent(
                    timestamp=time.time_ns(),
                    transition=description.transition,
                    start_state=description.start_state,
                    goal_state=description.goal_state,
                )
            )

    # Services

    def __on_change_state(
        self, request: ChangeState.Request, response: ChangeState.Response
    ) -> ChangeState.Response:
        wanted = request.transition.label or request.transition.id
        try:
            self._state_machine.find(wanted)
        except RCLError as error:
            # The mistake of whoever asked; the node goes on as it is.
            self.get_logger().warning(f"change_state refused: {error}")
            response.success = False
            return response
        response.success = self.__change_state(wanted) == TransitionCallbackReturn.SUCCESS
        return response

    def __on_get_state(
        self, request: GetState.Request, response: GetState.Response
    ) -> GetState.Response:
        response.current_state = _state_message(self._state_machine.current)
        return response

    def __on_get_available_states(
        self, request: GetAvailableStates.Request, response: GetAvailableStates.Response
    ) -> GetAvailableStates.Response:
        response.available_states = [_state_message(state) for state in STATES.values()]
        return response

    def __on_get_available_transitions(
        self, request: GetAvailableTransitions.Request, response: GetAvailableTransitions.Response
    ) -> GetAvailableTransitions.Response:
        transitions = self._state_machine.available_transitions
        response.available_transitions = [_description(one) for one in transitions]
        return response

    def __on_get_transition_graph(
        self, request: GetAvailableTransitions.Request, response: GetAvailableTransitions.Response
    ) -> GetAvailableTransitions.Response:
        response.available_transitions = [_description(one) for one in TRANSITIONS]
        return response


def _state_message(state: LifecycleState) -> StateMsg:
    return StateMsg(id=state.state_id, label=state.label)


def _description(transition: Transition) -> TransitionDescription:
    return TransitionDescription(
        transition=TransitionMsg(id=transition.transition_id, label=transition.label),
        start_state=_state_message(transition.start),
        goal_state=_state_message(transition.goal),
    )


class LifecycleNode(LifecycleNodeMixin, Node):
    """A managed node."""

    def __init__(
        self, node_name: str, *, enable_communication_interface: bool = True, **kwargs: Any
    ) -> None:
        """Make the node, unconfigured.

        Args:
            node_name: Its name.
            enable_communication_interface: Whether the services and transition_event are made.
            **kwargs: As for `Node`.
        """
        Node.__init__(self, node_name, **kwargs)
        LifecycleNodeMixin.__init__(
            self, enable_communication_interface=enable_communication_interface
        )
