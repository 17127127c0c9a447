# SPDX-License-Identifier: Apache-2.0
"""Commands on the graph, run in this process against nodes with one interface of each kind."""

import time
from importlib.metadata import EntryPoint

import pytest

from tests.graph_fixtures import domain, spinning  # isort: skip

import rclpy
from pneu_msgs.action import Identify
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.action import ActionServer, GoalResponse
from rclpy.executors import MultiThreadedExecutor
from rclpy.lifecycle import LifecycleNode
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Header, String
from std_srvs.srv import SetBool
from typer.testing import CliRunner

from pneu_common.cli import COMMANDS_GROUP, build_app

pytestmark = pytest.mark.kernel_free

__all__ = ["domain"]  # a fixture

RECEIVED = []
"""When messages on /rig/input came, and their text."""


def receive(message):
    RECEIVED.append((time.monotonic(), message.data))


def answer(request, response):
    response.success, response.message = request.data, "done"
    return response


def execute(goal_handle):
    goal_handle.succeed()
    return Identify.Result(success=True, verdict="as asked")


def accept(goal):
    return GoalResponse.REJECT if goal.task == "no" else GoalResponse.ACCEPT


@pytest.fixture(scope="module")
def talker(domain):
    """A node with topics, parameters, a service and an action, beside a lifecycle node."""
    with spinning(MultiThreadedExecutor) as (context, executor):
        node = rclpy.create_node("talker", namespace="/rig", context=context)
        gain = ParameterDescriptor(
            description="A gain.",
            floating_point_range=[FloatingPointRange(from_value=0.0, to_value=9.0)],
        )
        node.declare_parameter("gain.p", 1.5, gain)
        node.declare_parameter("names", ["a", "b"], ParameterDescriptor(read_only=True))
        latched = QoSProfile(depth=3, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        node.create_publisher(Header, "latched", latched).publish(Header(frame_id="end"))
        periodic = node.create_publisher(String, "periodic", 10)
        node.create_timer(0.02, lambda: periodic.publish(String(data="abc")))
        node.create_subscription(String, "input", receive, 10)
        node.create_service(SetBool, "~/enable", answer)
        action = ActionServer(node, Identify, "identify", execute, goal_callback=accept)
        device = LifecycleNode("device", namespace="/rig", context=context)
        executor.add_node(node)
        executor.add_node(device)
        yield node
        for one in (device, node):
            executor.remove_node(one)
        action.destroy()
        device.destroy_node()
        node.destroy_node()


@pytest.fixture
def pneu(talker):
    """Run a command; return its standard output, or its standard error where it fails."""
    app = build_app([EntryPoint("graph", "pneu_graph.commands:register", COMMANDS_GROUP)])

    def run(*words, status=0):
        done = CliRunner().invoke(app, words)
        assert done.exit_code == status, (words, done.output, done.exception)
        return done.stderr if status else done.stdout

    return run


TOPICS = ["/rig/input", "/rig/latched", "/rig/periodic"]


def test_topics(pneu):
    shown = pneu("topic", "list").splitlines()
    assert [name for name in shown if name in TOPICS] == TOPICS
    assert not any("_action" in name for name in shown)
    assert any("_action" in n for n in pneu("topic", "list", "--include-hidden-topics").split())
    assert pneu("topic", "list", "-c") == f"{len(shown)}\n"
    assert "/rig/latched [std_msgs/msg/Header]" in pneu("topic", "list", "-t").splitlines()
    published, subscribed = pneu("topic", "list", "-v").split("Subscribed topics:")
    assert " * /rig/latched [std_msgs/msg/Header] 1 publisher\n" in published
    assert "/rig/latched" not in subscribed and "/rig/input" not in published
    assert " * /rig/input [std_msgs/msg/String] 1 subscriber\n" in subscribed
    assert pneu("topic", "type", "rig/latched") == "std_msgs/msg/Header\n"
    pneu("topic", "type", "/rig/none", status=1)


def test_alone_it_says_that_nobody_was_found(domain, monkeypatch):
    monkeypatch.setattr("pneu_graph.nodes.discovery.patience_s", lambda least_s=0.0: 0.2)
    app = build_app([EntryPoint("graph", "pneu_graph.commands:register", COMMANDS_GROUP)])
    monkeypatch.setenv("ROS_DOMAIN_ID", "231")
    done = CliRunner().invoke(app, ["topic", "list"])
    assert done.exit_code == 0 and "no other node was found in domain 231" in done.stderr


def test_with_others_there_it_says_nothing_of_that(talker):
    app = build_app([EntryPoint("graph", "pneu_graph.commands:register", COMMANDS_GROUP)])
    assert CliRunner().invoke(app, ["topic", "list"]).stderr == ""


def test_endpoints_of_a_topic(pneu):
    shown = pneu("topic", "info", "/rig/latched")
    assert shown == "Type: std_msgs/msg/Header\nPublisher count: 1\nSubscription count: 0\n"
    shown = pneu("topic", "info", "-v", "/rig/latched").splitlines()
    for line in ("Node name: talker", "Node namespace: /rig", "  Durability: TRANSIENT_LOCAL"):
        assert line in shown
    assert "Unknown topic '/none'" in pneu("topic", "info", "/none", status=1)


def test_messages_are_shown(pneu):
    latched = ("--once", "--timeout", "20", "/rig/latched")
    assert pneu("topic", "echo", "--field", "frame_id", *latched) == "end\n---\n"
    assert pneu("topic", "echo", "--csv", *latched) == "0,0,end\n"
    assert pneu("topic", "echo", *latched).endswith("frame_id: end\n---\n")
    assert "has no field 'where'" in pneu("topic", "echo", "--field", "where", *latched, status=2)
    silent = ("--once", "--timeout", "0.1", "/rig/input")
    assert "no message on /rig/input within 0.1 s" in pneu("topic", "echo", *silent, status=1)


@pytest.mark.parametrize(("options", "count"), [(("--once",), 1), (("-t", "3", "-r", "5"), 3)])
def test_messages_are_published(pneu, options, count):
    RECEIVED.clear()
    shown = pneu("topic", "pub", *options, "/rig/input", "std_msgs/msg/String", "{data: hello}")
    assert shown.count("publishing #") == count
    assert shown.startswith("Waiting for at least 1 matching subscription(s)...\n")
    until_s = time.monotonic() + 10.0
    while len(RECEIVED) < count and time.monotonic() < until_s:
        time.sleep(0.01)
    assert [text for _, text in RECEIVED] == ["hello"] * count
    assert RECEIVED[-1][0] - RECEIVED[0][0] >= 0.8 * (count - 1) / 5.0  # five a second
    words = ("-r", "-1", "/rig/input", "std_msgs/msg/String")
    assert "--rate: is more than 0, found -1" in pneu("topic", "pub", *words, status=2)


@pytest.mark.parametrize(
    ("name", "found"),
    [
        ("a//b", "/a//b"),
        ("/1", "/1"),
        ("{ns}/x", "///x"),
        ("a b", "/a b"),
        ("a/", "/a/"),
        ("", "/"),
    ],
)
def test_names_that_cannot_be_are_refused(pneu, name, found):
    kind = "std_msgs/msg/String"
    said = pneu("topic", "pub", "--once", name, kind, status=2)
    assert said.startswith("pneu: Invalid topic name: ") and said.count("\n") == 1
    assert f"found '{found}'" in said
    assert "Invalid" in pneu("service", "call", name, "std_srvs/srv/SetBool", status=2)


@pytest.mark.parametrize(
    "words",
    [
        ("hz", "-w", "0", "/rig/periodic"),
        ("hz", "--seconds", "-1", "/rig/periodic"),
        ("hz", "--seconds", "nan", "/rig/periodic"),
        ("bw", "--seconds", "inf", "/rig/periodic"),
        ("echo", "--timeout", "-1", "/rig/periodic"),
        ("echo", "--timeout", "nan", "/rig/periodic"),
        ("echo", "-l", "-3", "/rig/periodic"),
        ("echo", "--qos-depth", "-1", "/rig/periodic"),
        ("pub", "-r", "nan", "/rig/input", "std_msgs/msg/String"),
        ("pub", "-r", "inf", "/rig/input", "std_msgs/msg/String"),
        ("pub", "-t", "-3", "/rig/input", "std_msgs/msg/String"),
        ("pub", "-w", "-5", "/rig/input", "std_msgs/msg/String"),
        ("pub", "-p", "-1", "/rig/input", "std_msgs/msg/String"),
        ("pub", "--keep-alive", "-1", "/rig/input", "std_msgs/msg/String"),
    ],
)
def test_numbers_that_cannot_be_are_refused(pneu, words):
    assert "Invalid value" in pneu("topic", *words, status=2)


def test_rates_are_measured(pneu):
    shown = pneu("topic", "hz", "--seconds", "1.2", "/rig/periodic")
    # A busy machine drops messages and adds none; test_tools.py shows the mean to be right.
    assert 5.0 < float(shown.split("average rate: ")[1].split()[0]) < 75.0
    shown = pneu("topic", "bw", "--seconds", "1.2", "/rig/periodic")
    assert shown.startswith("Subscribed to [/rig/periodic]\n")


def test_nodes(pneu):
    assert pneu("node", "list") == "/rig/device\n/rig/talker\n"
    assert pneu("node", "list", "-c") == "2\n"
    assert "/_ros2cli_" in pneu("node", "list", "-a")
    shown = pneu("node", "info", "rig/talker").splitlines()
    assert shown[0] == "/rig/talker"
    subscribed, published = shown.index("  Subscribers:"), shown.index("  Publishers:")
    served = shown.index("  Service Servers:")
    assert subscribed < shown.index("    /rig/input: std_msgs/msg/String") < published
    assert published < shown.index("    /rig/latched: std_msgs/msg/Header") < served
    assert served < shown.index("    /rig/talker/enable: std_srvs/srv/SetBool")
    acts = shown.index("  Action Servers:")
    assert acts < shown.index("    /rig/identify: pneu_msgs/action/Identify")
    assert "Unable to find node 'nobody'" in pneu("node", "info", "nobody", status=1)


def test_parameters_are_shown(pneu):
    assert pneu("param", "get", "/rig/talker", "names") == "String values are: ['a', 'b']\n"
    assert pneu("param", "get", "--hide-type", "/rig/talker", "names") == "['a', 'b']\n"
    assert "Parameter not set" in pneu("param", "get", "/rig/talker", "none", status=1)
    assert "Node not found" in pneu("param", "get", "/rig/nobody", "names", status=1)
    listed = pneu("param", "list")
    assert listed.startswith("/rig/device:\n")
    assert "/rig/talker:\n  gain.p\n  names\n" in listed
    of_one = pneu("param", "list", "rig/talker", "--param-type")
    assert of_one.startswith("  gain.p (type: double)\n  names (type: string array)\n")
    about = pneu("param", "describe", "/rig/talker", "gain.p", "names")
    of_gain, of_names = about.split("Parameter name: names")
    assert "  Type: double\n  Description: A gain.\n" in of_gain and "Read only" not in of_gain
    assert "    Min value: 0.0\n    Max value: 9.0\n" in of_gain and "Step" not in of_gain
    assert "    Read only: true" in of_names and "Max value" not in of_names


def test_parameters_are_set(pneu, tmp_path):
    assert pneu("param", "set", "/rig/talker", "gain.p", "2.5") == "Set parameter successful\n"
    assert "gain:\n      p: 2.5\n" in pneu("param", "dump", "/rig/talker")
    refused = pneu("param", "set", "/rig/talker", "gain.p", "99.0", status=1)
    assert refused.startswith("Setting parameter failed: ")
    path = tmp_path / "p.yaml"
    path.write_text("/**: {ros__parameters: {gain: {p: 3.5}}}\n/rig/other: {}\n")
    loaded = pneu("param", "load", "/rig/talker", str(path))
    assert loaded == "Set parameter gain.p successful\n"
    assert pneu("param", "get", "/rig/talker", "gain.p") == "Double value is: 3.5\n"
    path.write_text("/rig/talker: {ros__parameters: {gain.p: -1.0}}\n")
    refused = pneu("param", "load", "/rig/talker", str(path), status=1)
    assert refused.startswith("Set parameter gain.p failed: ")
    path.write_text("/rig/other: {ros__parameters: {a: 1}}\n")
    none = pneu("param", "load", "/rig/talker", str(path), status=2)
    assert "has no parameters of /rig/talker, and none of '/**'" in none


def test_services(pneu):
    shown = pneu("service", "list", "-t").splitlines()
    assert "/rig/talker/enable [std_srvs/srv/SetBool]" in shown
    assert pneu("service", "list", "-c") == f"{len(shown)}\n"
    assert not any("_action" in name for name in shown)
    assert pneu("service", "type", "rig/talker/enable") == "std_srvs/srv/SetBool\n"
    pneu("service", "type", "/none", status=1)
    shown = pneu("service", "call", "/rig/talker/enable", "std_srvs/srv/SetBool", "{data: true}")
    assert "requester: making request: std_srvs.srv.SetBool_Request(data=True)" in shown
    assert "response:\nstd_srvs.srv.SetBool_Response(success=True, message='done')" in shown
    words = ("--timeout", "0.1", "/none", "std_srvs/srv/SetBool")
    assert "service /none is not there" in pneu("service", "call", *words, status=2)


def test_actions(pneu):
    assert pneu("action", "list") == "/rig/identify\n"
    assert pneu("action", "list", "-t") == "/rig/identify [pneu_msgs/action/Identify]\n"
    assert pneu("action", "list", "-c") == "1\n"
    assert pneu("action", "type", "rig/identify") == "pneu_msgs/action/Identify\n"
    pneu("action", "type", "/none", status=1)
    shown = pneu("action", "info", "-t", "/rig/identify")
    assert shown == (
        "Action: /rig/identify\nAction clients: 0\nAction servers: 1\n"
        "    /rig/talker [pneu_msgs/action/Identify]\n"
    )
    words = ("/rig/identify", "pneu_msgs/action/Identify")
    shown = pneu("action", "send_goal", *words, "{task: fit}")
    assert "    task: fit\n" in shown and "    verdict: as asked\n" in shown
    assert shown.endswith("Goal finished with status: SUCCEEDED\n")
    assert "Goal was rejected." in pneu("action", "send_goal", *words, "{task: no}", status=1)


def test_states(pneu):
    assert pneu("lifecycle", "nodes") == "/rig/device\n"
    assert pneu("lifecycle", "get", "rig/device") == "unconfigured [1]\n"
    assert pneu("lifecycle", "get") == "/rig/device: unconfigured [1]\n"
    assert "Node not found" in pneu("lifecycle", "get", "/rig/talker", status=1)
    assert pneu("lifecycle", "set", "/rig/device", "configure") == "Transitioning successful\n"
    assert pneu("lifecycle", "get", "/rig/device") == "inactive [2]\n"
    assert pneu("lifecycle", "set", "/rig/device", "3") == "Transitioning successful\n"
    assert pneu("lifecycle", "get", "/rig/device") == "active [3]\n"
    refused = pneu("lifecycle", "set", "/rig/device", "configure", status=2)
    assert "transition 'configure' is not possible now; possible are deactivate [4]" in refused
    shown = pneu("lifecycle", "list", "/rig/device")
    assert "- deactivate [4]" in shown and "- configure [1]" not in shown
