# SPDX-License-Identifier: Apache-2.0
"""What a node can ask the graph."""

import pytest
from rclpy.duration import Duration, Infinite
from rclpy.node import NodeNameNonExistentError
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)
from rclpy.topic_endpoint_info import TopicEndpointTypeEnum
from std_msgs.msg import String
from std_srvs.srv import Trigger

pytestmark = pytest.mark.kernel_free


@pytest.fixture
def graph(make_node, executor, spin_until):
    """A node to ask, and another one with one entity of each kind."""
    asking = make_node("asking")
    asked = make_node("asked", namespace="/space")
    executor.add_node(asking)
    profile = QoSProfile(depth=3, reliability=ReliabilityPolicy.BEST_EFFORT)
    entities = {
        "publisher": asked.create_publisher(String, "out", profile),
        "subscription": asked.create_subscription(String, "in", lambda message: None, 10),
        "service": asked.create_service(Trigger, "offer", lambda request, response: response),
        "client": asked.create_client(Trigger, "need"),
    }
    assert spin_until(lambda: ("/space/need", ["std_srvs/srv/Trigger"]) in client_names(asking))
    return asking, asked, entities


def client_names(asking):
    try:
        return asking.get_client_names_and_types_by_node("asked", "/space")
    except NodeNameNonExistentError:
        return []


def test_node_names(graph):
    asking, _, _ = graph
    assert {"asking", "asked"} <= set(asking.get_node_names())
    assert ("asked", "/space") in asking.get_node_names_and_namespaces()
    assert "/space/asked" in asking.get_fully_qualified_node_names()
    assert ("asked", "/space", "/") in asking.get_node_names_and_namespaces_with_enclaves()


def test_names_and_types(graph):
    asking, _, _ = graph
    topics = dict(asking.get_topic_names_and_types())
    assert topics["/space/out"] == ["std_msgs/msg/String"]
    assert topics["/rosout"] == ["rcl_interfaces/msg/Log"]
    services = dict(asking.get_service_names_and_types())
    assert services["/space/offer"] == ["std_srvs/srv/Trigger"]


def test_names_and_types_by_node(graph):
    asking, _, _ = graph
    published = asking.get_publisher_names_and_types_by_node("asked", "/space")
    assert ("/space/out", ["std_msgs/msg/String"]) in published
    subscribed = asking.get_subscriber_names_and_types_by_node("asked", "/space")
    assert ("/space/in", ["std_msgs/msg/String"]) in subscribed
    offered = asking.get_service_names_and_types_by_node("asked", "/space")
    assert ("/space/offer", ["std_srvs/srv/Trigger"]) in offered
    assert ("/space/asked/get_parameters", ["rcl_interfaces/srv/GetParameters"]) in offered


def test_a_node_that_is_not_there(graph):
    asking, _, _ = graph
    with pytest.raises(NodeNameNonExistentError):
        asking.get_publisher_names_and_types_by_node("nobody", "/space")


def test_counts(graph):
    asking, _, _ = graph
    assert asking.count_publishers("/space/out") == 1
    assert asking.count_subscribers("/space/out") == 0
    assert asking.count_subscribers("/space/in") == 1
    assert asking.count_services("/space/offer") == 1
    assert asking.count_clients("/space/need") == 1


def test_endpoint_information(graph):
    asking, _, _ = graph
    (info,) = asking.get_publishers_info_by_topic("/space/out")
    assert (info.node_name, info.node_namespace) == ("asked", "/space")
    assert info.topic_type == "std_msgs/msg/String"
    assert info.endpoint_type == TopicEndpointTypeEnum.PUBLISHER
    assert info.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
    assert any(info.endpoint_gid)
    # the hash that every ROS 2 Jazzy has for this type
    assert str(info.topic_type_hash) == (
        "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
    )
    (info,) = asking.get_subscriptions_info_by_topic("/space/in")
    assert info.endpoint_type == TopicEndpointTypeEnum.SUBSCRIPTION


# Each policy unlike its default, and each duration unlike the others.
UNUSUAL = {
    "reliability": ReliabilityPolicy.BEST_EFFORT,
    "durability": DurabilityPolicy.TRANSIENT_LOCAL,
    "deadline": Duration(seconds=1, nanoseconds=500_000_000),
    "lifespan": Duration(seconds=3, nanoseconds=250_000_000),
    "liveliness": LivelinessPolicy.MANUAL_BY_TOPIC,
    "liveliness_lease_duration": Duration(seconds=2, nanoseconds=750_000_000),
}


@pytest.mark.parametrize("unusual", [True, False])
def test_each_policy_is_in_the_endpoint_information(make_node, executor, spin_until, unusual):
    asking, asked = make_node("asking"), make_node("asked")
    executor.add_node(asking)
    profile = QoSProfile(depth=7, **(UNUSUAL if unusual else {}))
    asked.create_publisher(String, "out", profile)
    asked.create_subscription(String, "in", lambda message: None, profile)
    expected = {
        "reliability": ReliabilityPolicy.RELIABLE,
        "durability": DurabilityPolicy.VOLATILE,
        "deadline": Infinite,
        "lifespan": Infinite,
        "liveliness": LivelinessPolicy.AUTOMATIC,
        "liveliness_lease_duration": Infinite,
    } | (UNUSUAL if unusual else {})
    look = asking.get_publishers_info_by_topic, asking.get_subscriptions_info_by_topic
    assert spin_until(lambda: look[0]("/out") and look[1]("/in"))
    (offered,), (requested,) = look[0]("/out"), look[1]("/in")
    if offered.qos_profile.history != HistoryPolicy.UNKNOWN:  # not every middleware announces it
        assert (offered.qos_profile.history, offered.qos_profile.depth) == (
            HistoryPolicy.KEEP_LAST,
            7,
        )
    for name, value in expected.items():
        assert getattr(offered.qos_profile, name) == value, name
        if name != "lifespan":  # which a subscription has not
            assert getattr(requested.qos_profile, name) == value, name


def test_what_is_destroyed_leaves_the_graph(graph, spin_until):
    asking, asked, entities = graph
    asked.destroy_publisher(entities["publisher"])
    assert spin_until(lambda: asking.count_publishers("/space/out") == 0)
    asked.destroy_node()
    assert spin_until(lambda: "asked" not in asking.get_node_names())
