# SPDX-License-Identifier: Apache-2.0
"""Managed nodes: their states, callbacks, entities and services."""

import pytest
from lifecycle_msgs.msg import State, Transition, TransitionEvent
from lifecycle_msgs.srv import ChangeState, GetAvailableStates, GetAvailableTransitions, GetState
from rclpy.lifecycle import (
    LifecycleNode,
    LifecycleState,
    ManagedEntity,
    TransitionCallbackReturn,
)
from rclpy.parameter_client import AsyncParameterClient
from std_msgs.msg import String

pytestmark = pytest.mark.kernel_free

SUCCESS = TransitionCallbackReturn.SUCCESS
FAILURE = TransitionCallbackReturn.FAILURE
ERROR = TransitionCallbackReturn.ERROR


class Recorder(LifecycleNode):
    """Notes its callbacks and answers as told."""

    def __init__(self, name, **kwargs):
        self.calls = []
        self.answers = {}
        super().__init__(name, **kwargs)

    def answer(self, callback, state):
        self.calls.append((callback, state.label))
        answer = self.answers.get(callback, SUCCESS)
        if isinstance(answer, Exception):
            raise answer
        return answer

    def on_configure(self, state):
        return self.answer("configure", state)

    def on_cleanup(self, state):
        return self.answer("cleanup", state)

    def on_shutdown(self, state):
        return self.answer("shutdown", state)

    def on_activate(self, state):
        return self.answer("activate", state)

    def on_deactivate(self, state):
        return self.answer("deactivate", state)

    def on_error(self, state):
        return self.answer("error", state)


class Managed:
    """A node and clients of its services."""

    def __init__(self, ros, make=None, name="managed"):
        self.ros = ros
        self.node = ros.node(name, cls=Recorder) if make is None else make()
        self.asking = ros.node("asking")
        services = [
            (ChangeState, "change_state"),
            (GetState, "get_state"),
            (GetAvailableStates, "get_available_states"),
            (GetAvailableTransitions, "get_available_transitions"),
            (GetAvailableTransitions, "get_transition_graph"),
        ]
        self.clients = {
            service: self.asking.create_client(type_, f"/{name}/{service}")
            for type_, service in services
        }
        assert ros.spin_until(
            lambda: all(client.service_is_ready() for client in self.clients.values())
        )

    def call(self, service, request):
        return self.ros.result(self.clients[service].call_async(request))

    def change(self, number=0, label=""):
        request = ChangeState.Request(transition=Transition(id=number, label=label))
        return self.call("change_state", request).success

    @property
    def state(self):
        state = self.call("get_state", GetState.Request()).current_state
        return state.label, state.id

    def transitions(self, service="get_available_transitions"):
        found = self.call(service, GetAvailableTransitions.Request()).available_transitions
        return [
            (one.transition.label, one.transition.id, one.start_state.label, one.goal_state.label)
            for one in found
        ]


@pytest.fixture
def managed(ros):
    return Managed(ros)


def test_through_all_states_by_service(managed):
    assert managed.state == ("unconfigured", State.PRIMARY_STATE_UNCONFIGURED)
    for number, state in [
        (Transition.TRANSITION_CONFIGURE, ("inactive", State.PRIMARY_STATE_INACTIVE)),
        (Transition.TRANSITION_ACTIVATE, ("active", State.PRIMARY_STATE_ACTIVE)),
        (Transition.TRANSITION_DEACTIVATE, ("inactive", State.PRIMARY_STATE_INACTIVE)),
        (Transition.TRANSITION_CLEANUP, ("unconfigured", State.PRIMARY_STATE_UNCONFIGURED)),
        (Transition.TRANSITION_UNCONFIGURED_SHUTDOWN, ("finalized", State.PRIMARY_STATE_FINALIZED)),
    ]:
        assert managed.change(number)
        assert managed.state == state
    assert managed.node.calls == [
        ("configure", "unconfigured"),
        ("activate", "inactive"),
        ("deactivate", "active"),
        ("cleanup", "inactive"),
        ("shutdown", "unconfigured"),
    ]


def test_transitions_go_by_label_too(managed):
    assert managed.change(label="configure")
    assert managed.change(label="activate")
    assert managed.state[0] == "active"
    assert not managed.change(label="activate")
    assert managed.change(label="shutdown")
    assert managed.state[0] == "finalized"


def test_a_node_drives_itself(ros):
    node = ros.node("driving", cls=Recorder, enable_communication_interface=False)
    assert node.trigger_configure() == SUCCESS
    assert node.trigger_activate() == SUCCESS
    with pytest.raises(RuntimeError):
        node.trigger_configure()
    assert node.trigger_deactivate() == SUCCESS
    assert node.trigger_cleanup() == SUCCESS
    assert node.trigger_shutdown() == SUCCESS
    with pytest.raises(RuntimeError):
        node.trigger_configure()


def test_failure_leads_back(managed):
    managed.node.answers = {"configure": FAILURE}
    assert not managed.change(Transition.TRANSITION_CONFIGURE)
    assert managed.state[0] == "unconfigured"
    managed.node.answers = {"activate": FAILURE}
    assert managed.change(Transition.TRANSITION_CONFIGURE)
    assert not managed.change(Transition.TRANSITION_ACTIVATE)
    assert managed.state[0] == "inactive"
    managed.node.answers = {"deactivate": FAILURE}
    assert managed.change(Transition.TRANSITION_ACTIVATE)
    assert not managed.change(Transition.TRANSITION_DEACTIVATE)
    assert managed.state[0] == "active"


@pytest.mark.parametrize("error", [ERROR, RuntimeError("on purpose")], ids=["returned", "raised"])
@pytest.mark.parametrize(
    ("answer", "state"), [(SUCCESS, "unconfigured"), (FAILURE, "finalized"), (ERROR, "finalized")]
)
def test_errors_are_processed(managed, error, answer, state):
    managed.node.answers = {"configure": error, "error": answer}
    assert not managed.change(Transition.TRANSITION_CONFIGURE)
    assert managed.state[0] == state
    assert [call[0] for call in managed.node.calls] == ["configure", "error"]


def test_available_states(managed):
    found = managed.call("get_available_states", GetAvailableStates.Request()).available_states
    assert {(state.label, state.id) for state in found} == {
        ("unknown", State.PRIMARY_STATE_UNKNOWN),
        ("unconfigured", State.PRIMARY_STATE_UNCONFIGURED),
        ("inactive", State.PRIMARY_STATE_INACTIVE),
        ("active", State.PRIMARY_STATE_ACTIVE),
        ("finalized", State.PRIMARY_STATE_FINALIZED),
        ("configuring", State.TRANSITION_STATE_CONFIGURING),
        ("cleaningup", State.TRANSITION_STATE_CLEANINGUP),
        ("shuttingdown", State.TRANSITION_STATE_SHUTTINGDOWN),
        ("activating", State.TRANSITION_STATE_ACTIVATING),
        ("deactivating", State.TRANSITION_STATE_DEACTIVATING),
        ("errorprocessing", State.TRANSITION_STATE_ERRORPROCESSING),
    }


def test_available_transitions(managed):
    assert managed.transitions() == [
        ("configure", Transition.TRANSITION_CONFIGURE, "unconfigured", "configuring"),
        ("shutdown", Transition.TRANSITION_UNCONFIGURED_SHUTDOWN, "unconfigured", "shuttingdown"),
    ]
    managed.change(Transition.TRANSITION_CONFIGURE)
    assert managed.transitions() == [
        ("cleanup", Transition.TRANSITION_CLEANUP, "inactive", "cleaningup"),
        ("activate", Transition.TRANSITION_ACTIVATE, "inactive", "activating"),
        ("shutdown", Transition.TRANSITION_INACTIVE_SHUTDOWN, "inactive", "shuttingdown"),
    ]


def test_transition_graph(managed):
    graph = managed.transitions("get_transition_graph")
    assert len(graph) == 25
    assert {(start, goal) for label, _, start, goal in graph if label == "transition_error"} == {
        ("configuring", "errorprocessing"),
        ("cleaningup", "errorprocessing"),
        ("shuttingdown", "errorprocessing"),
        ("activating", "errorprocessing"),
        ("deactivating", "errorprocessing"),
        ("errorprocessing", "finalized"),
    }
    starts = [start for label, _, start, _ in graph if label == "shutdown"]
    assert starts == ["unconfigured", "inactive", "active"]


def test_transitions_are_published(managed):
    events = []
    managed.asking.create_subscription(
        TransitionEvent, "/managed/transition_event", events.append, 10
    )
    topic = "/managed/transition_event"
    assert managed.ros.spin_until(lambda: managed.node.count_subscribers(topic) == 1)
    managed.ros.spin_until(lambda: False, timeout_sec=0.5)  # both ends have to have matched
    managed.change(Transition.TRANSITION_CONFIGURE)
    assert managed.ros.spin_until(lambda: len(events) == 2)
    assert [(event.start_state.label, event.goal_state.label) for event in events] == [
        ("unconfigured", "configuring"),
        ("configuring", "inactive"),
    ]


class Entity(ManagedEntity):
    def __init__(self, answer=SUCCESS):
        self.answer = answer
        self.calls = []

    def on_configure(self, state):
        self.calls.append(state)
        return self.answer


def test_entities_follow_their_node(ros):
    node = ros.node("with_entities", cls=LifecycleNode, enable_communication_interface=False)
    entity = Entity()
    node.add_managed_entity(entity)
    assert node.trigger_configure() == SUCCESS
    assert entity.calls == [LifecycleState("unconfigured", State.PRIMARY_STATE_UNCONFIGURED)]


def test_an_entity_that_fails_stops_the_transition(ros):
    node = ros.node("failing", cls=LifecycleNode, enable_communication_interface=False)
    node.add_managed_entity(Entity(FAILURE))
    assert node.trigger_configure() == FAILURE
    with pytest.raises(RuntimeError):
        node.trigger_activate()


def test_a_lifecycle_publisher_is_silent_unless_active(ros):
    node = ros.node("publishing", cls=LifecycleNode, enable_communication_interface=False)
    publisher = node.create_lifecycle_publisher(String, "talk", 10)
    received = []
    listener = ros.node("listening")
    listener.create_subscription(String, "talk", lambda msg: received.append(msg.data), 10)
    assert ros.spin_until(lambda: publisher.get_subscription_count() == 1)

    publisher.publish(String(data="unconfigured"))
    node.trigger_configure()
    publisher.publish(String(data="inactive"))
    assert not publisher.is_activated
    node.trigger_activate()
    assert publisher.is_activated
    assert ros.spin_until(lambda: publisher.publish(String(data="active")) or received)
    node.trigger_deactivate()
    publisher.publish(String(data="inactive"))
    ros.spin_until(lambda: False, timeout_sec=0.3)
    assert set(received) == {"active"}
    assert node.destroy_lifecycle_publisher(publisher)


MANAGED = """
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rclpy.parameter import Parameter

class Valve(LifecycleNode):
    def on_configure(self, state):
        self.set_parameters([Parameter("configured", value=True)])
        return super().on_configure(state)

    def on_activate(self, state):
        raise RuntimeError("on purpose")

rclpy.init()
node = Valve("managed")
node.declare_parameter("configured", False)
print("ready", flush=True)
try:
    rclpy.spin(node)
except (KeyboardInterrupt, ExternalShutdownException):
    pass
"""


@pytest.mark.long
def test_a_node_in_another_process(ros, start_peer):
    managed = Managed(ros, lambda: start_peer(MANAGED).wait_for_line("ready"))
    parameters = AsyncParameterClient(managed.asking, "managed")
    assert ros.spin_until(parameters.services_are_ready)
    assert managed.state[0] == "unconfigured"
    assert managed.change(Transition.TRANSITION_CONFIGURE)
    (value,) = ros.result(parameters.get_parameters(["configured"])).values
    assert value.bool_value
    # The default on_error succeeds, which leads back to the start.
    assert not managed.change(Transition.TRANSITION_ACTIVATE)
    assert managed.state[0] == "unconfigured"
    assert managed.change(Transition.TRANSITION_UNCONFIGURED_SHUTDOWN)
    assert managed.state[0] == "finalized"
