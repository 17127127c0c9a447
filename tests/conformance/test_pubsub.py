# SPDX-License-Identifier: Apache-2.0
"""Messages from publishers to subscriptions within one process."""

import time

import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message
from rclpy.wait_for_message import wait_for_message
from sensor_msgs.msg import FluidPressure, JointState
from std_msgs.msg import String

pytestmark = pytest.mark.kernel_free


@pytest.fixture
def connected(node, executor, spin_until):
    """A publisher and a subscription that have found each other; what is received."""
    executor.add_node(node)
    received = []
    publisher = node.create_publisher(String, "chatter", 10)
    subscription = node.create_subscription(String, "chatter", received.append, 10)
    assert spin_until(lambda: publisher.get_subscription_count() == 1)
    assert spin_until(lambda: subscription.get_publisher_count() == 1)
    return publisher, subscription, received


def test_messages_arrive_in_order(connected, spin_until):
    publisher, _, received = connected
    for number in range(5):
        publisher.publish(String(data=str(number)))
    assert spin_until(lambda: len(received) == 5)
    assert [message.data for message in received] == ["0", "1", "2", "3", "4"]


def test_a_message_goes_to_every_subscription(connected, node, make_node, executor, spin_until):
    publisher, _, received = connected
    other = make_node("other")
    executor.add_node(other)
    elsewhere = []
    other.create_subscription(String, "chatter", elsewhere.append, 10)
    assert spin_until(lambda: publisher.get_subscription_count() == 2)
    publisher.publish(String(data="to all"))
    assert spin_until(lambda: received and elsewhere)
    assert received == elsewhere == [String(data="to all")]


def test_only_messages_of_the_type_are_published(connected):
    publisher, _, _ = connected
    with pytest.raises(TypeError):
        publisher.publish(FluidPressure())
    with pytest.raises(TypeError):
        publisher.publish("text")


def test_bytes_are_published_and_received_as_they_are(node, executor, spin_until):
    executor.add_node(node)
    received = []
    publisher = node.create_publisher(String, "raw", 10)
    subscription = node.create_subscription(String, "raw", received.append, 10, raw=True)
    assert subscription.raw
    assert spin_until(lambda: publisher.get_subscription_count() == 1)
    data = serialize_message(String(data="hi"))
    publisher.publish(data)
    assert spin_until(lambda: received)
    # the middleware may fill up to a multiple of four bytes
    assert received[0].startswith(data) and len(received[0]) < len(data) + 4
    assert deserialize_message(received[0], String) == String(data="hi")


def test_a_callback_with_two_arguments_gets_times(node, executor, spin_until):
    executor.add_node(node)
    received = []
    publisher = node.create_publisher(String, "timed", 10)
    node.create_subscription(
        String, "timed", lambda message, info: received.append((message, info)), 10
    )
    assert spin_until(lambda: publisher.get_subscription_count() == 1)
    before_ns = time.time_ns()
    publisher.publish(String(data="when"))
    assert spin_until(lambda: received)
    message, info = received[0]
    assert message.data == "when"
    # the middleware's clock may be coarser than Python's
    assert before_ns - 10_000_000 <= info["source_timestamp"] <= time.time_ns()
    assert info["source_timestamp"] <= info["received_timestamp"]


def test_a_callback_must_take_one_or_two_arguments(node):
    with pytest.raises(RuntimeError):
        node.create_subscription(String, "chatter", lambda: None, 10)


def test_the_callback_can_be_replaced(connected, spin_until):
    publisher, subscription, received = connected
    replaced = []
    subscription.callback = replaced.append
    publisher.publish(String(data="new"))
    assert spin_until(lambda: replaced)
    assert not received


def test_a_destroyed_subscription_receives_no_more(connected, node, spin_until):
    publisher, subscription, received = connected
    node.destroy_subscription(subscription)
    assert spin_until(lambda: publisher.get_subscription_count() == 0)
    publisher.publish(String(data="nobody"))
    assert not spin_until(lambda: received, timeout_s=0.2)


def test_standard_messages_survive_the_way(node, executor, spin_until):
    executor.add_node(node)
    received = []
    publisher = node.create_publisher(JointState, "joints", 10)
    node.create_subscription(JointState, "joints", received.append, 10)
    assert spin_until(lambda: publisher.get_subscription_count() == 1)
    sent = JointState(name=["a", "b"], position=[0.25, -1.5], velocity=[1e-300, 1e300])
    sent.header.frame_id = "base"
    sent.header.stamp.sec = 5
    publisher.publish(sent)
    assert spin_until(lambda: received)
    assert received[0] == sent
    assert list(received[0].position) == [0.25, -1.5]


def test_a_late_subscription_gets_what_transient_local_keeps(node, executor, spin_until):
    executor.add_node(node)
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    publisher = node.create_publisher(String, "latched", latched)
    publisher.publish(String(data="old"))
    publisher.publish(String(data="kept"))
    received = []
    node.create_subscription(String, "latched", received.append, latched)
    assert spin_until(lambda: received)
    assert received == [String(data="kept")]


def test_a_late_volatile_subscription_gets_nothing_old(node, executor, spin_until):
    executor.add_node(node)
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    publisher = node.create_publisher(String, "latched", latched)
    publisher.publish(String(data="old"))
    received = []
    node.create_subscription(String, "latched", received.append, 1)
    assert spin_until(lambda: publisher.get_subscription_count() == 1)
    assert not spin_until(lambda: received, timeout_s=0.2)


def test_keep_last_keeps_the_newest(node, executor, spin_until):
    received = []
    publisher = node.create_publisher(String, "newest", 10)
    node.create_subscription(String, "newest", received.append, 2)
    deadline_s = time.monotonic() + 10.0
    while publisher.get_subscription_count() == 0 and time.monotonic() < deadline_s:
        time.sleep(0.01)
    for number in range(6):
        publisher.publish(String(data=str(number)))
    time.sleep(0.2)
    executor.add_node(node)
    assert spin_until(lambda: len(received) == 2)
    assert [message.data for message in received] == ["4", "5"]


def test_incompatible_profiles_do_not_connect(node, executor, spin_until):
    executor.add_node(node)
    received = []
    best_effort = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
    publisher = node.create_publisher(String, "apart", best_effort)
    node.create_subscription(String, "apart", received.append, 10)
    assert not spin_until(lambda: publisher.get_subscription_count() > 0, timeout_s=0.3)


def test_reliable_messages_are_acknowledged(connected, spin_until):
    from rclpy.duration import Duration

    publisher, _, _received = connected
    publisher.publish(String(data="sure"))
    assert publisher.wait_for_all_acked(Duration(seconds=5))


def test_wait_for_message(node, make_node):
    sender = make_node("sender")
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    publisher = sender.create_publisher(String, "awaited", latched)
    publisher.publish(String(data="here"))
    found, message = wait_for_message(String, node, "awaited", qos_profile=latched, time_to_wait=5)
    assert found and message == String(data="here")
    found, message = wait_for_message(String, node, "silence", time_to_wait=0.1)
    assert not found and message is None
