# SPDX-License-Identifier: Apache-2.0
"""Nodes: names, entities, destruction."""

import pytest
import rclpy
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.exceptions import InvalidHandle
from rclpy.node import Node
from std_msgs.msg import String
from std_srvs.srv import Trigger

pytestmark = pytest.mark.kernel_free


def test_names(make_node):
    node = make_node("name", namespace="space/inner")
    assert node.get_name() == "name"
    assert node.get_namespace() == "/space/inner"
    assert node.get_fully_qualified_name() == "/space/inner/name"
    assert node.get_logger().name == "space.inner.name"


def test_the_root_namespace(node):
    assert node.get_namespace() == "/"
    assert node.get_fully_qualified_name() == "/conformance"
    assert node.get_logger().name == "conformance"


def test_entities_are_listed_and_destroyed(make_node):
    node = make_node(start_parameter_services=False)
    before = len(list(node.publishers))
    publisher = node.create_publisher(String, "topic", 1)
    subscription = node.create_subscription(String, "topic", lambda message: None, 1)
    client = node.create_client(Trigger, "service")
    service = node.create_service(Trigger, "service", lambda request, response: response)
    timer = node.create_timer(1.0, lambda: None)
    guard = node.create_guard_condition(lambda: None)
    assert len(list(node.publishers)) == before + 1
    for entities, entity, destroy in (
        (lambda: node.publishers, publisher, node.destroy_publisher),
        (lambda: node.subscriptions, subscription, node.destroy_subscription),
        (lambda: node.clients, client, node.destroy_client),
        (lambda: node.services, service, node.destroy_service),
        (lambda: node.timers, timer, node.destroy_timer),
        (lambda: node.guards, guard, node.destroy_guard_condition),
    ):
        assert entity in list(entities())
        assert destroy(entity) is True
        assert entity not in list(entities())
        assert destroy(entity) is False


def test_a_destroyed_publisher_cannot_be_used(node):
    publisher = node.create_publisher(String, "topic", 1)
    node.destroy_publisher(publisher)
    with pytest.raises(InvalidHandle):
        publisher.publish(String())


def test_entities_go_with_their_node(context):
    node = rclpy.create_node("short_lived", context=context)
    publisher = node.create_publisher(String, "topic", 1)
    node.destroy_node()
    with pytest.raises(InvalidHandle):
        publisher.publish(String())
    with pytest.raises(InvalidHandle):
        node.get_name()


def test_a_node_can_be_destroyed_twice(context):
    node = rclpy.create_node("twice", context=context)
    node.destroy_node()
    node.destroy_node()


def test_a_node_is_in_one_executor(context, node, executor):
    assert node.executor is None
    assert executor.add_node(node) is True
    assert executor.add_node(node) is False
    assert node.executor is executor
    other = rclpy.executors.SingleThreadedExecutor(context=context)
    other.add_node(node)
    assert node.executor is other
    assert node not in executor.get_nodes()
    other.shutdown()


def test_the_default_callback_group_is_mutually_exclusive(node):
    assert isinstance(node.default_callback_group, MutuallyExclusiveCallbackGroup)
    timer = node.create_timer(1.0, lambda: None)
    assert timer.callback_group is node.default_callback_group
    assert node.default_callback_group.has_entity(timer)


def test_what_is_no_message_is_refused(node):
    with pytest.raises(AttributeError):
        node.create_publisher(int, "topic", 1)
    with pytest.raises(AttributeError):
        node.create_client(str, "service")


@pytest.mark.parametrize(("depth", "error"), [(-1, ValueError), ("ten", TypeError)])
def test_bad_depths_are_refused(node, depth, error):
    with pytest.raises(error):
        node.create_publisher(String, "topic", depth)


def test_subclasses_pass_their_arguments_on(context):
    class Talker(Node):
        def __init__(self):
            super().__init__("talker", context=context, namespace="/deep")
            self.publisher = self.create_publisher(String, "~/chat", 1)

    talker = Talker()
    assert talker.publisher.topic_name == "/deep/talker/chat"
    talker.destroy_node()


def test_handle_is_not_to_be_set(node):
    with pytest.raises(AttributeError):
        node.handle = None
