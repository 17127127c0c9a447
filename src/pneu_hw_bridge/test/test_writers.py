# SPDX-License-Identifier: Apache-2.0
"""Whose commands are followed while the graph does not list all who publish them.

The publishers are real. That the graph lists one late, as with rmw_fastrtps, is made certain by a
node that leaves it out; needs nothing of ROS but rclpy and its messages.
"""

import contextlib
import importlib.util
import os
import threading
import time
from types import SimpleNamespace

import pytest
from tests.domains import own_domain_id
from tests.measured import PATIENCE_S

if importlib.util.find_spec("rclpy") is None or "PNEU_RCLPY" in os.environ:
    from pneu_runtime import hook

    hook.install()

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.topic_endpoint_info import TopicEndpointInfo
from std_msgs.msg import Float64

from pneu_graph.nodes.common import COMMAND_QOS
from pneu_hw_bridge.nodes.writers import NO_NODES, UNLISTED, Writers, competing, wrong_writer

pytestmark = pytest.mark.kernel_free

TOPICS = ("first", "second")


def wait_for(condition):
    end_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.01)


class LateNode(Node):
    """A node to which the graph does not list the publishers of some nodes."""

    hidden: frozenset[str] = frozenset()

    def get_publishers_info_by_topic(self, *args, **options):
        found = super().get_publishers_info_by_topic(*args, **options)
        return [one for one in found if one.node_name not in self.hidden]


class Bench:
    """A bridge's subscriptions, and those who publish to them."""

    def __init__(self, topics):
        self.context = rclpy.Context()
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        rclpy.init(args=[], context=self.context, domain_id=own_domain_id())
        self.node = LateNode("bridge", context=self.context)
        self.heard = []
        self.subscriptions = {
            topic: self.node.create_subscription(
                Float64,
                topic,
                lambda message, info, topic=topic: self.heard.append((topic, message, info)),
                COMMAND_QOS,
            )
            for topic in topics
        }
        self.nodes = [self.node]
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.over = threading.Event()
        self.thread = threading.Thread(target=self._spin)
        self.thread.start()

    def _spin(self):
        while not self.over.is_set():
            self.executor.spin_once(timeout_sec=0.05)

    def writers(self, commander=""):
        return Writers(self.node, self.subscriptions, commander)

    def publisher(self, name, topic=TOPICS[0], qos=COMMAND_QOS):
        found = [one for one in self.nodes if one.get_name() == name]
        node = found[0] if found else rclpy.create_node(name, context=self.context)
        self.nodes += [] if found else [node]
        return node.create_publisher(Float64, topic, qos)

    def wait_for_heard(self, *counts):
        """Waits until the subscriptions receive from so many publishers each."""
        wait_for(
            lambda: (
                [one.get_publisher_count() for one in self.subscriptions.values()] == list(counts)
            )
        )

    def info(self, publisher):
        """What the middleware tells of a message of a publisher."""
        begin = len(self.heard)
        publisher.publish(Float64(data=1.0))
        wait_for(lambda: len(self.heard) > begin)
        return self.heard[-1][2]

    def close(self):
        self.over.set()
        self.thread.join()
        self.executor.shutdown()
        for node in self.nodes:
            node.destroy_node()
        self.context.try_shutdown()


@pytest.fixture
def bench():
    with contextlib.closing(Bench(TOPICS[:1])) as one:
        yield one


@pytest.fixture
def wide_bench():
    with contextlib.closing(Bench(TOPICS)) as one:
        yield one


def test_one_publisher_is_followed(bench):
    policy = bench.publisher("policy")
    writers = bench.writers()
    wait_for(lambda: writers.look() == (1, ""))
    info = bench.info(policy)
    assert writers.is_known(TOPICS[0], info)
    assert writers.look(info) == (1, "")


def test_a_publisher_that_the_graph_does_not_list_yet_is_not_followed(bench):
    policy = bench.publisher("policy")
    bench.node.hidden = frozenset({"policy"})
    bench.wait_for_heard(1)
    writers = bench.writers()
    wait_for(lambda: writers.look() == (1, UNLISTED))
    info = bench.info(policy)
    assert not writers.is_known(TOPICS[0], info)
    assert writers.look(info) == (1, UNLISTED)
    bench.node.hidden = frozenset()
    wait_for(lambda: writers.look() == (1, ""))


def test_nobody_is_followed_beside_a_publisher_that_the_graph_does_not_list_yet(bench):
    policy = bench.publisher("policy")
    bench.node.hidden = frozenset({"rival"})
    writers = bench.writers()
    wait_for(lambda: writers.look() == (1, ""))
    rival = bench.publisher("rival")
    bench.wait_for_heard(2)
    for publisher in (policy, rival):
        info = bench.info(publisher)
        assert not writers.is_known(TOPICS[0], info)
        assert writers.look(info)[0] == 2
    rival.destroy()
    bench.wait_for_heard(1)
    assert writers.look() == (1, "")
    assert writers.is_known(TOPICS[0], bench.info(policy))


def test_on_another_topic_neither(wide_bench):
    """A node may have a publisher on each topic; one that is not listed may be another's."""
    bench = wide_bench
    bench.publisher("policy", TOPICS[0])
    bench.node.hidden = frozenset({"rival"})
    writers = bench.writers()
    wait_for(lambda: writers.look() == (1, ""))
    bench.publisher("policy", TOPICS[1])
    bench.wait_for_heard(1, 1)
    wait_for(lambda: writers.look() == (1, ""))
    bench.publisher("rival", TOPICS[1])
    bench.wait_for_heard(1, 2)
    wait_for(lambda: writers.look() == (2, UNLISTED))


def test_a_message_of_somebody_else_than_the_one_that_is_listed_is_not_followed(bench):
    bench.publisher("policy")
    bench.wait_for_heard(1)
    writers = bench.writers()
    wait_for(lambda: writers.look() == (1, ""))
    other = {"publisher_gid": {"data": bytes(range(1, 17))}}
    assert not writers.is_known(TOPICS[0], other)
    assert writers.look(other) == (1, UNLISTED)
    handle = {"publisher_gid": {"data": bytes(range(1, 9)) + bytes(8)}}  # of rmw_cyclonedds
    assert writers.is_known(TOPICS[0], handle) and writers.look(handle) == (1, "")
    assert writers.is_known(TOPICS[0], {})  # of rclpy in Jazzy


def test_a_command_counts_from_when_it_was_sent(bench, monkeypatch):
    """By its stamp, of a clock of its own; the first one tells how far that clock is away."""
    clock = SimpleNamespace(monotonic=lambda: 64.0 + passed_s)
    monkeypatch.setattr("pneu_hw_bridge.nodes.writers.time", clock)
    writers = bench.writers()
    for passed_s, sent_s, late_s in ((0.0, 900.0, 0.0), (0.5, 900.25, 0.25), (1.0, 901.0, 0.0)):
        info = {"source_timestamp": round(1e9 * sent_s)}
        assert writers.sent_s(info) == pytest.approx(64.0 + passed_s - late_s, abs=2e-3)
    passed_s = 2.0
    assert writers.sent_s({}) == writers.sent_s({"source_timestamp": 0}) == 66.0


def test_the_only_one_listed_is_not_heard(bench):
    """Best effort does not reach a reliable subscription, so what is heard is somebody else's."""
    bench.publisher("policy", qos=qos_profile_sensor_data)
    writers = bench.writers()
    wait_for(lambda: "commands of /policy are not heard" in writers.look()[1])


def test_only_the_node_that_is_named_is_followed(bench):
    bench.publisher("rival")
    writers = bench.writers("/policy")
    wait_for(
        lambda: writers.look() == (1, "/rival publishes commands, only /policy may (commander)")
    )


def listed(name, namespace="/", qos=COMMAND_QOS):
    """A publisher as the graph lists it."""
    return TopicEndpointInfo(node_name=name, node_namespace=namespace, qos_profile=qos)


ONE, OTHER, LAB = listed("one"), listed("other"), listed("one", "/lab")
DEAF = listed("one", qos=qos_profile_sensor_data)
NOT_HEARD = "commands of /one are not heard: "


@pytest.mark.parametrize(
    ("topics", "commander", "count", "why"),
    [
        ([([], 0)], "", 0, ""),
        ([([ONE], 1)], "", 1, ""),
        ([([ONE], 0)], "", 1, ""),
        ([([], 1)], "", 1, UNLISTED),
        ([([ONE], 2)], "", 2, UNLISTED),
        ([([ONE, OTHER], 2)], "", 2, ""),
        ([([ONE, ONE], 2)], "", 2, ""),
        ([([ONE, ONE], 3)], "", 3, UNLISTED),
        ([([ONE, ONE], 0)], "", 2, ""),
        ([([DEAF, DEAF], 2)], "", 2, ""),
        ([([ONE], 1), ([ONE], 1)], "", 1, ""),
        ([([ONE], 1), ([OTHER], 1)], "", 2, ""),
        ([([ONE], 1), ([LAB], 1)], "", 2, ""),
        ([([ONE], 1), ([], 1)], "", 1, UNLISTED),
        ([([ONE], 2), ([ONE, OTHER], 1)], "", 2, UNLISTED),
        ([([ONE], 1), ([], 0)], "/one", 1, ""),
        ([([LAB], 1)], "one", 1, "/lab/one publishes commands, only one may (commander)"),
        ([([LAB], 1)], "lab/one", 1, ""),
        ([([ONE, OTHER], 2)], "/none", 2, ""),
        ([([DEAF], 0)], "", 1, NOT_HEARD),
    ],
)
def test_who_competes(topics, commander, count, why):
    found, wrong = competing(topics, commander)
    assert found == count and (wrong == why or (why and wrong.startswith(why) and why[-1] == " "))


@pytest.mark.parametrize(
    ("writers", "commander", "why"),
    [
        ([], "/one", ""),
        ([OTHER, ONE], "/one", ""),
        ([ONE], "", ""),
        ([ONE], "/one", ""),
        ([LAB], "/lab/one", ""),
        ([listed("one", "/lab/")], "/lab/one", ""),
        ([OTHER], "/one", "/other publishes commands, only /one may (commander)"),
        *(
            ([listed(name)], commander, "the publisher on the command topic belongs to no node")
            for name in NO_NODES
            for commander in ("", f"/{name}")
        ),
    ],
)
def test_why_the_one_writer_is_not_followed(writers, commander, why):
    assert wrong_writer(writers, commander) == why


def test_words_about_a_writer_that_is_not_heard_say_why():
    found = wrong_writer([DEAF], "")
    assert found.startswith(NOT_HEARD) and "reliab" in found.lower()
