# SPDX-License-Identifier: Apache-2.0
"""Events of publishers and subscriptions, and QoS overridden by parameters."""

import pytest
from rcl_interfaces.msg import SetParametersResult
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.parameter import Parameter
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSPolicyKind,
    QoSProfile,
    ReliabilityPolicy,
)
from rclpy.qos_overriding_options import InvalidQosOverridesError, QoSOverridingOptions
from std_msgs.msg import String

pytestmark = pytest.mark.kernel_free

RELIABLE = QoSProfile(depth=10)
BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)


class Ends:
    """Makes publishers and subscriptions of /chat, which note their events."""

    def __init__(self, ros):
        self.ros = ros
        self.talking = ros.node("talking")
        self.listening = ros.node("listening")
        self.events = {}

    def publisher(self, qos, *kinds):
        callbacks = PublisherEventCallbacks(**self.notes("publisher", kinds))
        return self.talking.create_publisher(String, "chat", qos, event_callbacks=callbacks)

    def subscription(self, qos, *kinds):
        callbacks = SubscriptionEventCallbacks(**self.notes("subscription", kinds))
        return self.listening.create_subscription(
            String, "chat", lambda msg: None, qos, event_callbacks=callbacks
        )

    def notes(self, side, kinds):
        for kind in kinds:
            self.events[side, kind] = []
        return {kind: self.events[side, kind].append for kind in kinds}

    def wait(self, side, kind, timeout_sec=10.0):
        assert self.ros.spin_until(lambda: self.events[side, kind], timeout_sec), (side, kind)
        return self.events[side, kind][-1]


@pytest.fixture
def ends(ros):
    return Ends(ros)


def test_matches(ends):
    publisher = ends.publisher(RELIABLE, "matched")
    subscription = ends.subscription(RELIABLE, "matched")
    for side in ("publisher", "subscription"):
        event = ends.wait(side, "matched")
        assert (event.current_count, event.current_count_change) == (1, 1)
        assert (event.total_count, event.total_count_change) == (1, 1)
        ends.events[side, "matched"].clear()
    ends.listening.destroy_subscription(subscription)
    event = ends.wait("publisher", "matched")
    assert (event.current_count, event.current_count_change) == (0, -1)
    assert (event.total_count, event.total_count_change) == (1, 0)
    ends.talking.destroy_publisher(publisher)


@pytest.mark.parametrize(
    ("offered", "requested", "policy"),
    [
        (BEST_EFFORT, RELIABLE, QoSPolicyKind.RELIABILITY),
        (
            RELIABLE,
            QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL),
            QoSPolicyKind.DURABILITY,
        ),
        (
            RELIABLE,
            QoSProfile(depth=10, deadline=Duration(seconds=1)),
            QoSPolicyKind.DEADLINE,
        ),
        (
            RELIABLE,
            QoSProfile(depth=10, liveliness=LivelinessPolicy.MANUAL_BY_TOPIC),
            QoSPolicyKind.LIVELINESS,
        ),
    ],
    ids=lambda value: value.name if isinstance(value, QoSPolicyKind) else "",
)
def test_incompatible_qos(ends, offered, requested, policy):
    publisher = ends.publisher(offered, "incompatible_qos")
    ends.subscription(requested, "incompatible_qos")
    for side in ("publisher", "subscription"):
        event = ends.wait(side, "incompatible_qos")
        assert event.total_count == 1
        assert event.last_policy_kind == policy
    assert publisher.get_subscription_count() == 0


def test_deadlines(ends):
    qos = QoSProfile(depth=10, deadline=Duration(nanoseconds=100_000_000))
    publisher = ends.publisher(qos, "deadline", "matched")
    ends.subscription(qos, "deadline")
    ends.wait("publisher", "matched")
    publisher.publish(String())
    for side in ("publisher", "subscription"):
        event = ends.wait(side, "deadline")
        assert event.total_count >= event.total_count_change >= 1


def test_liveliness(ends):
    qos = QoSProfile(
        depth=10,
        liveliness=LivelinessPolicy.MANUAL_BY_TOPIC,
        liveliness_lease_duration=Duration(nanoseconds=300_000_000),
    )
    publisher = ends.publisher(qos, "liveliness", "matched")
    ends.subscription(qos, "liveliness")
    ends.wait("publisher", "matched")
    seen = ends.events["subscription", "liveliness"]

    def alive():
        publisher.assert_liveliness()
        return any(event.alive_count == 1 for event in seen)

    assert ends.ros.spin_until(alive)
    seen.clear()
    event = ends.wait("subscription", "liveliness")
    assert (event.alive_count, event.not_alive_count) == (0, 1)
    assert ends.wait("publisher", "liveliness").total_count >= 1


# Overriding by parameters


def test_policies_are_overridden(ros):
    name = "qos_overrides./chat.publisher"
    node = ros.node(
        "overriding",
        parameter_overrides=[
            Parameter(f"{name}.depth", value=3),
            Parameter(f"{name}.reliability", value="best_effort"),
        ],
    )
    publisher = node.create_publisher(
        String, "chat", 10, qos_overriding_options=QoSOverridingOptions.with_default_policies()
    )
    assert publisher.qos_profile.depth == 3
    assert publisher.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
    assert publisher.qos_profile.history == HistoryPolicy.KEEP_LAST
    assert node.get_parameter(f"{name}.history").value == "keep_last"
    assert node.describe_parameter(f"{name}.depth").read_only


OVERRIDES = {
    QoSPolicyKind.HISTORY: ("keep_all", HistoryPolicy.KEEP_ALL),
    QoSPolicyKind.DEPTH: (3, 3),
    QoSPolicyKind.RELIABILITY: ("best_effort", ReliabilityPolicy.BEST_EFFORT),
    QoSPolicyKind.DURABILITY: ("transient_local", DurabilityPolicy.TRANSIENT_LOCAL),
    QoSPolicyKind.LIVELINESS: ("manual_by_topic", LivelinessPolicy.MANUAL_BY_TOPIC),
    QoSPolicyKind.DEADLINE: (1_500_000_000, Duration(nanoseconds=1_500_000_000)),
    QoSPolicyKind.LIFESPAN: (3_250_000_000, Duration(nanoseconds=3_250_000_000)),
    QoSPolicyKind.LIVELINESS_LEASE_DURATION: (
        2_750_000_000,
        Duration(nanoseconds=2_750_000_000),
    ),
}


@pytest.mark.parametrize("side", ["publisher", "subscription"])
def test_every_policy_can_be_overridden(ros, side):
    node = ros.node(
        "every",
        parameter_overrides=[
            Parameter(f"qos_overrides./chat.{side}.{kind.name.lower()}", value=value)
            for kind, (value, _) in OVERRIDES.items()
        ],
    )
    options = QoSOverridingOptions(tuple(OVERRIDES))
    if side == "publisher":
        made = node.create_publisher(String, "chat", 10, qos_overriding_options=options)
    else:
        made = node.create_subscription(
            String, "chat", lambda msg: None, 10, qos_overriding_options=options
        )
    for kind, (_, policy) in OVERRIDES.items():
        name = f"qos_overrides./chat.{side}.{kind.name.lower()}"
        if side == "subscription" and kind == QoSPolicyKind.LIFESPAN:  # it has none
            assert not node.has_parameter(name)
        else:
            assert getattr(made.qos_profile, kind.name.lower()) == policy, kind


def test_several_entities_of_a_topic_are_told_apart(ros):
    node = ros.node("apart", namespace="/rig")
    for entity in ("fast", "slow"):
        options = QoSOverridingOptions((QoSPolicyKind.DEADLINE,), entity_id=entity)
        node.create_subscription(
            String, "chat", lambda msg: None, 10, qos_overriding_options=options
        )
    for entity in ("fast", "slow"):
        assert node.has_parameter(f"qos_overrides./rig/chat.subscription_{entity}.deadline")


def test_overrides_can_be_refused(ros):
    options = QoSOverridingOptions.with_default_policies(
        callback=lambda qos: SetParametersResult(successful=qos.depth > 100, reason="too short")
    )
    with pytest.raises(InvalidQosOverridesError):
        ros.node("refused").create_publisher(String, "chat", 10, qos_overriding_options=options)
    accepted = [Parameter("qos_overrides./chat.publisher.depth", value=200)]
    node = ros.node("accepted", parameter_overrides=accepted)
    publisher = node.create_publisher(String, "chat", 10, qos_overriding_options=options)
    assert publisher.qos_profile.depth == 200
