# SPDX-License-Identifier: Apache-2.0
"""The transport within one process: topics, services, waiting, graph, quality of service."""

import json
import threading
import time
from dataclasses import dataclass, replace
from pathlib import Path

import cyclonedds.builtin as builtin
import pytest
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from tests.domains import own_domain_id

from pneu_runtime import interfaces
from pneu_runtime.transport import (
    EndpointQos,
    EnvironmentVariableError,
    EventKind,
    ForeignServiceError,
    Session,
    TransportError,
    UnknownNodeError,
    Waiter,
    domain,
)
from pneu_runtime.transport.dds import INFINITY_NS
from pneu_runtime.transport.idl import topic_type

pytestmark = pytest.mark.kernel_free

DOMAIN = own_domain_id()
LOCAL = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
STRING = "std_msgs/msg/String"
TRIGGER = "std_srvs/srv/Trigger"
RELIABLE = EndpointQos()


def text(value):
    return interfaces.serialize(interfaces.message_class(STRING)(data=value))


def words(source):
    """All messages that wait at a subscription."""
    found = []
    while (sample := source.take()) is not None:
        cls = interfaces.message_class(STRING)
        found.append(interfaces.deserialize(sample.data, cls).data)
    return found


def until(condition, timeout_s=10.0):
    """Waits for a condition to become true."""
    end = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end, "timed out"
        time.sleep(0.005)


@pytest.fixture
def session():
    with_domain = Session(DOMAIN, environment=LOCAL)
    yield with_domain
    with_domain.close()


@pytest.fixture
def node(session):
    return session.add_node("/rig", "probe")


@pytest.fixture
def waiter():
    one = Waiter()
    yield one
    one.close()


# Topics.


def test_messages_arrive_in_order_with_their_origin(session, node, waiter):
    publication = session.create_publication(node, "/words", STRING, RELIABLE)
    subscription = session.create_subscription(node, "/words", STRING, RELIABLE)
    waiter.attach(subscription)
    before = time.time_ns()
    for word in ("a", "b", "c"):
        publication.publish(text(word))
    assert waiter.wait(5) == [subscription]
    sample = subscription.take()
    assert sample.publisher_gid == publication.gid
    assert before <= sample.source_timestamp_ns <= sample.received_timestamp_ns
    assert words(subscription) == ["b", "c"]
    assert waiter.wait(0) == []
    assert (publication.matched_count(), subscription.matched_count()) == (1, 1)
    assert publication.wait_for_all_acked(1)


def test_depth_keeps_the_newest(session, node):
    publication = session.create_publication(node, "/words", STRING, RELIABLE)
    subscription = session.create_subscription(node, "/words", STRING, EndpointQos(depth=2))
    for word in "abcd":
        publication.publish(text(word))
    assert words(subscription) == ["c", "d"]


def test_late_joiners_get_what_is_kept(session, node):
    kept = EndpointQos(depth=1, durability=1)
    publication = session.create_publication(node, "/words", STRING, kept)
    publication.publish(text("a"))
    publication.publish(text("b"))
    late = session.create_subscription(node, "/words", STRING, kept)
    volatile = session.create_subscription(node, "/words", STRING, RELIABLE)
    time.sleep(0.1)
    assert words(late) == ["b"]
    assert words(volatile) == []


def test_own_messages_can_be_left_out(session, node):
    publication = session.create_publication(node, "/words", STRING, RELIABLE)
    ignoring = session.create_subscription(
        node, "/words", STRING, RELIABLE, ignore_local_publications=True
    )
    publication.publish(text("a"))
    time.sleep(0.1)
    assert words(ignoring) == []


def test_two_sessions_of_a_process_meet(session, node):
    other = Session(DOMAIN, environment=LOCAL)
    try:
        publication = session.create_publication(node, "/words", STRING, RELIABLE)
        subscription = other.create_subscription(
            other.add_node("/", "other"), "/words", STRING, RELIABLE
        )
        until(lambda: publication.matched_count() and subscription.matched_count())
        publication.publish(text("a"))
        until(lambda: words(subscription) == ["a"])
        until(lambda: len(session.node_names()) == 2)
    finally:
        other.close()
    until(lambda: len(session.node_names()) == 1)


def test_bytes_of_another_type_are_not_sent(session, node):
    publication = session.create_publication(node, "/words", STRING, RELIABLE)
    with pytest.raises(TransportError, match="String"):
        publication.publish(b"\x00\x01\x00\x00\xff\xff\xff\xff")
    with pytest.raises(TransportError):
        publication.publish(b"")


def test_what_is_closed_says_so(session, node):
    publication = session.create_publication(node, "/words", STRING, RELIABLE)
    subscription = session.create_subscription(node, "/words", STRING, RELIABLE)
    for one in (publication, subscription):
        one.close()
        one.close()
    assert subscription.take() is None
    with pytest.raises(TransportError, match="closed"):
        publication.publish(text("a"))
    session.close()
    with pytest.raises(TransportError, match="closed"):
        session.create_publication(node, "/words", STRING, RELIABLE)


# Services.


def call(client, server, waiter):
    cls = interfaces.service_class(TRIGGER)
    number = client.send(interfaces.serialize(cls.Request()))
    assert server in waiter.wait(5)
    request_id, data, info = server.take()
    assert interfaces.deserialize(data, cls.Request) == cls.Request()
    assert info.source_timestamp_ns > 0
    answer = cls.Response(success=True, message=str(number))
    assert server.respond(request_id, interfaces.serialize(answer))
    until(lambda: client in waiter.wait(5))
    got, data, _ = client.take()
    assert got == number
    assert interfaces.deserialize(data, cls.Response) == answer


def test_services_are_called_and_only_the_caller_hears(session, node, waiter):
    server = session.create_server(node, "/vent", TRIGGER, RELIABLE)
    clients = [session.create_client(node, "/vent", TRIGGER, RELIABLE) for _ in range(2)]
    for source in (server, *clients):
        waiter.attach(source)
    assert all(client.server_is_ready() for client in clients)
    call(clients[0], server, waiter)
    assert clients[1].take() is None
    call(clients[1], server, waiter)
    server.close()
    until(lambda: not clients[0].server_is_ready())


def test_the_answer_to_a_client_that_went_is_dropped(session, node, waiter):
    server = session.create_server(node, "/vent", TRIGGER, RELIABLE)
    client = session.create_client(node, "/vent", TRIGGER, RELIABLE)
    waiter.attach(server)
    cls = interfaces.service_class(TRIGGER)
    client.send(interfaces.serialize(cls.Request()))
    waiter.wait(5)
    request_id, _, _ = server.take()
    client.close()
    assert not server.respond(request_id, interfaces.serialize(cls.Response()))


def test_other_vendors_are_refused(session, node, waiter):
    """Endpoints with the right topic and type but without the key of rmw_cyclonedds."""
    from pneu_runtime.transport.endpoints import Reader, Writer

    common = (session, None)
    foreign = (f"{TRIGGER}_Request", RELIABLE, b"", True)
    reader = Reader(*common, "rq/ventRequest", *foreign)
    client = session.create_client(node, "/vent", TRIGGER, RELIABLE)
    cls = interfaces.service_class(TRIGGER)
    data = interfaces.serialize(cls.Request())
    with pytest.raises(ForeignServiceError, match="rmw_cyclonedds"):
        client.send(data)
    assert not client.server_is_ready()
    reader.close()
    server = session.create_server(node, "/vent", TRIGGER, RELIABLE)
    writer = Writer(*common, "rq/ventRequest", *foreign)
    writer.publish(data[:4] + bytes(16) + data[4:])
    time.sleep(0.1)
    assert server.take() is None
    client.send(data)
    until(lambda: server.take() is not None)


# Waiting.


def test_wake_ends_one_wait(waiter):
    threading.Timer(0.05, waiter.wake).start()
    started = time.monotonic()
    assert waiter.wait(5) == []
    assert time.monotonic() - started < 1
    waiter.wake()
    assert waiter.wait(5) == []
    started = time.monotonic()
    assert waiter.wait(0.05) == []
    assert 0.04 < time.monotonic() - started < 0.5


def test_close_ends_all_waits():
    one = Waiter()
    threads = [threading.Thread(target=one.wait) for _ in range(3)]
    for thread in threads:
        thread.start()
    time.sleep(0.05)
    one.close()
    for thread in threads:
        thread.join(5)
        assert not thread.is_alive()
    assert one.wait() == []


def test_sources_come_and_go_while_others_wait(session, node, waiter):
    """Publishing, closing and waiting from four threads."""
    publication = session.create_publication(node, "/words", STRING, RELIABLE)
    stop, faults = threading.Event(), []

    def guarded(work):
        try:
            while not stop.is_set():
                work()
        except Exception as error:
            faults.append(error)

    def churn():
        subscription = session.create_subscription(node, "/words", STRING, RELIABLE)
        waiter.attach(subscription)
        subscription.close()
        waiter.detach(subscription)

    def take():
        for source in waiter.wait(0.01):
            source.take()

    def send():
        publication.publish(text("x"))

    works = (churn, take, take, send)
    threads = [threading.Thread(target=guarded, args=(work,)) for work in works]
    for thread in threads:
        thread.start()
    time.sleep(1.0)
    stop.set()
    for thread in threads:
        thread.join(5)
        assert not thread.is_alive()
    assert faults == []


# The graph.


def test_the_graph_is_told(session, node):
    session.create_publication(node, "/words", STRING, EndpointQos(depth=3))
    session.create_subscription(node, "/words", STRING, EndpointQos(reliability=2))
    session.create_server(node, "/vent", TRIGGER, RELIABLE)
    session.create_client(node, "/home", TRIGGER, RELIABLE)
    assert session.node_names() == [("probe", "/rig", "/")]
    assert session.topic_names_and_types() == [("/words", [STRING])]
    assert dict(session.topic_names_and_types(no_demangle=True))["rt/words"] == [
        "std_msgs::msg::dds_::String_"
    ]
    assert session.service_names_and_types() == [("/home", [TRIGGER]), ("/vent", [TRIGGER])]
    assert session.publisher_names_and_types_by_node("probe", "/rig") == [("/words", [STRING])]
    assert session.subscriber_names_and_types_by_node("probe", "/rig") == [("/words", [STRING])]
    assert session.service_names_and_types_by_node("probe", "/rig") == [("/vent", [TRIGGER])]
    assert session.client_names_and_types_by_node("probe", "/rig") == [("/home", [TRIGGER])]
    (info,) = session.publishers_info("/words")
    assert (info.node_name, info.node_namespace, info.topic_type) == ("probe", "/rig", STRING)
    assert info.topic_type_hash == interfaces.type_hash(STRING)
    assert (info.qos.depth, info.qos.reliability) == (3, 1)
    (info,) = session.subscriptions_info("/words")
    assert info.qos.reliability == 2
    counts = session.count_publishers("/words"), session.count_subscribers("/words")
    assert counts == (1, 1)
    assert (session.count_services("/vent"), session.count_clients("/home")) == (1, 1)
    with pytest.raises(UnknownNodeError, match="nobody"):
        session.publisher_names_and_types_by_node("nobody", "/")


def test_changes_of_the_graph_wake(session, node, waiter):
    waiter.attach(session.graph_source)
    session.graph_source.take()
    version = session.graph_version()
    publication = session.create_publication(node, "/words", STRING, RELIABLE)
    assert waiter.wait(5) == [session.graph_source]
    assert session.graph_version() > version
    publication.close()
    assert session.topic_names_and_types() == []
    session.remove_node(node)
    assert session.node_names() == []


# Quality of service.

CAPTURE = json.loads(
    (Path(__file__).parent / "data/jazzy_wire/cyclonedds.json").read_text(encoding="utf-8")
)


def captured_qos(kind, topic):
    endpoints = CAPTURE["endpoints"]
    (first, *_) = [e for e in endpoints if (e["kind"], e["topic"]) == (kind, topic)]
    return sorted(first["qos"])


def announced_qos(kind, topic):
    """The policies of an endpoint as Cyclone's own Python layer reads them."""
    participant = DomainParticipant(DOMAIN)
    topics = {
        "writer": builtin.BuiltinTopicDcpsPublication,
        "reader": builtin.BuiltinTopicDcpsSubscription,
    }
    reader = builtin.BuiltinDataReader(participant, topics[kind])
    found = []
    until(lambda: found.extend(e for e in reader.take(100) if e.topic_name == topic) or found)
    return found[0].qos


def seen_qos(kind, topic):
    """The same as text, without what identifies the endpoint."""
    policies = map(str, announced_qos(kind, topic))
    return sorted(policy for policy in policies if not policy.startswith("Policy.Userdata"))


# One policy by another, each unlike its default and unlike all other values here.
POLICIES = {
    "history": (EndpointQos(history=2, depth=0), Policy.History.KeepAll),
    "depth": (EndpointQos(depth=7), Policy.History.KeepLast(7)),
    "reliability": (EndpointQos(reliability=2), Policy.Reliability.BestEffort),
    "durability": (EndpointQos(durability=1), Policy.Durability.TransientLocal),
    "lifespan": (EndpointQos(lifespan_ns=3_250_000_000), Policy.Lifespan(3_250_000_000)),
    "deadline": (EndpointQos(deadline_ns=1_500_000_000), Policy.Deadline(1_500_000_000)),
    "liveliness": (
        EndpointQos(liveliness=3, liveliness_lease_duration_ns=2_750_000_000),
        Policy.Liveliness.ManualByTopic(2_750_000_000),
    ),
    "lease": (
        EndpointQos(liveliness_lease_duration_ns=4_125_000_000),
        Policy.Liveliness.Automatic(4_125_000_000),
    ),
}
# What other programs may announce and ROS has no word for (rmw_cyclonedds, `dds_qos_to_rmw_qos`).
WORDLESS = {
    "transient": (EndpointQos(durability=3), Policy.Durability.Transient),
    "persistent": (EndpointQos(durability=3), Policy.Durability.Persistent),
    "by_participant": (
        EndpointQos(liveliness=4, liveliness_lease_duration_ns=2_250_000_000),
        Policy.Liveliness.ManualByParticipant(2_250_000_000),
    ),
}
DEFAULT_POLICIES = Qos(
    Policy.History.KeepLast(10),
    Policy.Reliability.Reliable(INFINITY_NS),
    Policy.Durability.Volatile,
    Policy.Lifespan(INFINITY_NS),
    Policy.Deadline(INFINITY_NS),
    Policy.Liveliness.Automatic(INFINITY_NS),
)


@dataclass
class PlainString(IdlStruct, typename="std_msgs.msg.dds_.String_"):
    """The type as a program of plain DDS has it."""

    data: str


def with_policy(policy, *, writer):
    """The default policies with one replaced; readers have no lifespan."""
    scope = policy.__scope__
    chosen = [one for one in DEFAULT_POLICIES if one.__scope__ != scope] + [policy]
    return Qos(*(one for one in chosen if writer or one.__scope__ != "Lifespan"))


@pytest.mark.parametrize("name", POLICIES)
def test_each_policy_is_announced(session, node, name):
    """By an independent reader of what an endpoint announces."""
    qos, policy = POLICIES[name]
    session.create_publication(node, "/offered", STRING, qos)
    session.create_subscription(node, "/requested", STRING, qos)
    for kind, topic in (("writer", "rt/offered"), ("reader", "rt/requested")):
        announced = announced_qos(kind, topic)
        for expected in with_policy(policy, writer=kind == "writer"):
            assert announced[expected] == expected


@pytest.mark.parametrize("name", [*POLICIES, *WORDLESS])
def test_each_policy_of_a_peer_is_read(session, name):
    """From a program of plain DDS, as writer and as reader."""
    qos, policy = {**POLICIES, **WORDLESS}[name]
    participant = DomainParticipant(DOMAIN)
    ends = (
        DataWriter(
            participant,
            Topic(participant, "rt/offered", PlainString),
            with_policy(policy, writer=True),
        ),
        DataReader(
            participant,
            Topic(participant, "rt/requested", PlainString),
            with_policy(policy, writer=False),
        ),
    )
    until(lambda: session.publishers_info("/offered") and session.subscriptions_info("/requested"))
    (offered,) = session.publishers_info("/offered")
    (requested,) = session.subscriptions_info("/requested")
    assert offered.qos == qos
    assert requested.qos == replace(qos, lifespan_ns=INFINITY_NS)
    assert (offered.writer, requested.writer) == (True, False)
    assert (offered.topic_type, requested.topic_type) == (STRING, STRING)
    del ends


def test_a_topic_may_go_without_the_prefix_of_ros(session, node):
    bare = EndpointQos(avoid_ros_namespace_conventions=True)
    session.create_publication(node, "/bare/offered", STRING, bare)
    session.create_subscription(node, "/bare/requested", STRING, bare)
    names = dict(session.topic_names_and_types(no_demangle=True))
    assert {"bare/offered", "bare/requested"} <= set(names)
    assert session.topic_names_and_types() == []
    (info,) = session.publishers_info("bare/offered", no_mangle=True)
    assert info.node_name == "probe"


@pytest.mark.parametrize("reliability", [1, 2])
@pytest.mark.parametrize("durability", [1, 2])
def test_best_available_is_what_the_peers_offer(session, node, reliability, durability):
    offer = EndpointQos(reliability=reliability, durability=durability)
    session.create_publication(node, "/words", STRING, offer)
    best = session.create_subscription(
        node, "/words", STRING, EndpointQos(reliability=4, durability=4)
    )
    assert (best.qos.reliability, best.qos.durability) == (reliability, durability)
    assert best.matched_count() == 1
    writer = session.create_publication(
        node, "/others", STRING, EndpointQos(reliability=4, durability=4)
    )
    assert (writer.qos.reliability, writer.qos.durability) == (1, 1)


def test_policies_are_those_of_a_real_ros(session, node):
    ten_seconds = 10_000_000_000
    rosout = EndpointQos(depth=1000, durability=1, lifespan_ns=ten_seconds)
    session.create_publication(node, "/rosout", "rcl_interfaces/msg/Log", rosout)
    session.create_server(node, "/rig/vent", TRIGGER, RELIABLE)
    for kind, topic in (
        ("writer", "ros_discovery_info"),
        ("writer", "rt/rosout"),
        ("writer", "rr/rig/ventReply"),
        ("reader", "rq/rig/ventRequest"),
    ):
        assert seen_qos(kind, topic) == captured_qos(kind, topic)


def test_events_are_noticed(session, node, waiter):
    publication = session.create_publication(node, "/words", STRING, EndpointQos(reliability=2))
    matched = publication.event_source(EventKind.MATCHED)
    refused = publication.event_source(EventKind.INCOMPATIBLE_QOS)
    waiter.attach(matched)
    waiter.attach(refused)
    assert waiter.wait(0) == []
    session.create_subscription(node, "/words", STRING, RELIABLE)
    assert waiter.wait(5) == [refused]
    assert refused.take() == {
        "total_count": 1,
        "total_count_change": 1,
        "last_policy_kind": 1 << 4,  # RMW_QOS_POLICY_RELIABILITY
    }
    subscription = session.create_subscription(node, "/words", STRING, EndpointQos(reliability=2))
    assert waiter.wait(5) == [matched]
    assert matched.take()["current_count"] == 1
    subscription.close()
    assert waiter.wait(5) == [matched]
    assert matched.take()["current_count_change"] == -1
    assert waiter.wait(0) == []


def test_a_missed_deadline_is_noticed(session, node, waiter):
    qos = EndpointQos(deadline_ns=50_000_000)
    publication = session.create_publication(node, "/words", STRING, qos)
    subscription = session.create_subscription(node, "/words", STRING, qos)
    missed = subscription.event_source(EventKind.DEADLINE_MISSED)
    waiter.attach(missed)
    publication.publish(text("a"))
    assert waiter.wait(5) == [missed]
    assert missed.take()["total_count"] >= 1


def test_a_program_of_plain_dds_is_heard(session, node):
    """One that announces its type, which then has to be the same structure."""
    from cyclonedds.idl import types

    @dataclass
    class Time(IdlStruct, typename="builtin_interfaces.msg.dds_.Time_"):
        sec: types.int32
        nanosec: types.uint32

    @dataclass
    class Header(IdlStruct, typename="std_msgs.msg.dds_.Header_"):
        stamp: Time
        frame_id: str

    @dataclass
    class FluidPressure(IdlStruct, typename="sensor_msgs.msg.dds_.FluidPressure_"):
        header: Header
        fluid_pressure: types.float64
        variance: types.float64

    name = "sensor_msgs/msg/FluidPressure"
    assert topic_type(name).__idl__ is not None
    subscription = session.create_subscription(node, "/taps/end/pressure", name, RELIABLE)
    participant = DomainParticipant(DOMAIN)
    topic = Topic(participant, "rt/taps/end/pressure", FluidPressure)
    writer = DataWriter(participant, topic, Qos(Policy.Reliability.Reliable(0)))
    until(lambda: subscription.matched_count())
    writer.write(FluidPressure(Header(Time(1, 2), "end"), 1.5e5, 0.25))
    taken = []
    until(lambda: taken.append(subscription.take()) or taken[-1])
    got = interfaces.deserialize(taken[-1].data, interfaces.message_class(name))
    assert (got.fluid_pressure, got.header.frame_id, got.header.stamp.nanosec) == (1.5e5, "end", 2)


# Settings.


@pytest.mark.parametrize("text", ["-1", "233", "a", "1.5", "²"])
def test_wrong_domains_are_refused(text):
    with pytest.raises(EnvironmentVariableError, match="ROS_DOMAIN_ID"):
        domain.domain_id_from({"ROS_DOMAIN_ID": text})


def test_settings_follow_the_variables(tmp_path):
    assert domain.domain_id_from({}) == 0
    assert domain.domain_id_from({"ROS_DOMAIN_ID": "42"}) == 42
    local = domain.configuration({})
    assert "<AllowMulticast>false</AllowMulticast>" in local
    assert '<Peer address="localhost"/>' in local
    peers = domain.configuration({"ROS_STATIC_PEERS": "10.0.0.2; a&b"})
    assert '<Peer address="10.0.0.2"/><Peer address="a&amp;b"/>' in peers
    subnet = domain.configuration({"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"})
    assert "AllowMulticast" not in subnet
    assert "Tag" in domain.configuration({"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"})
    own = "<CycloneDDS><Domain/></CycloneDDS>"
    assert domain.configuration({"CYCLONEDDS_URI": own}).endswith("," + own)
    # a file that chooses interfaces, such as the usual loopback profile: ours would collide
    profile = tmp_path / "loopback.xml"
    profile.write_text(
        '<CycloneDDS><Domain><General><Interfaces><NetworkInterface name="lo"/></Interfaces>'
        "</General></Domain></CycloneDDS>"
    )
    asked = domain.configuration({"CYCLONEDDS_URI": f"file://{profile}"})
    assert "<Interfaces>" in local or not domain._has_network_interface()
    assert "<Interfaces>" not in asked and asked.endswith(f",file://{profile}")
    with pytest.raises(EnvironmentVariableError, match="ROS_AUTOMATIC_DISCOVERY_RANGE"):
        domain.configuration({"ROS_AUTOMATIC_DISCOVERY_RANGE": "EVERYWHERE"})


def test_nothing_is_left_behind(session, node, waiter):
    """Memory after many creations and closings, and no thread or entity that stays."""
    import resource

    def churn(count):
        for _ in range(count):
            subscription = session.create_subscription(node, "/words", STRING, RELIABLE)
            waiter.attach(subscription)
            waiter.detach(subscription)
            subscription.close()

    churn(300)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    churn(1500)
    grown_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    assert grown_kib < 1500 * 2
    assert session.count_subscribers("/words") == 0
    assert node.readers == []
