# SPDX-License-Identifier: Apache-2.0
"""The commands on the graph, against a node in another process."""

import os
import signal
import subprocess
import sys
import time

import pytest
from ruamel.yaml import YAML
from tests.domains import own_domain_id

from pneu_common.errors import InputError
from pneu_graph.tools.message_text import fill, parse_values, plain, yaml_text
from pneu_graph.tools.rates import Bandwidth, Rate

pytestmark = pytest.mark.kernel_free

TALKER = """
import rclpy
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.executors import ExternalShutdownException
from sensor_msgs.msg import FluidPressure
from std_srvs.srv import SetBool

def answer(request, response):
    response.success, response.message = request.data, "done"
    return response

rclpy.init()
try:
    node = rclpy.create_node("talker", namespace="/rig")
    limits = [FloatingPointRange(from_value=0.0, to_value=9.0)]
    node.declare_parameter(
        "gain.p", 1.5, ParameterDescriptor(description="A gain.", floating_point_range=limits)
    )
    node.declare_parameter("names", ["a", "b"])
    publisher = node.create_publisher(FluidPressure, "taps/end/pressure", 10)
    node.create_timer(0.02, lambda: publisher.publish(
        FluidPressure(header={header}, fluid_pressure=101325.0)))
    node.create_service(SetBool, "~/enable", answer)
    rclpy.spin(node)
except (KeyboardInterrupt, ExternalShutdownException):
    pass
finally:
    rclpy.try_shutdown()
""".replace("{header}", "__import__('std_msgs.msg', fromlist=['x']).Header(frame_id='end')")

TOPIC = "/rig/taps/end/pressure"


@pytest.fixture(scope="module")
def environment(tmp_path_factory):
    return {
        **os.environ,
        "ROS_DOMAIN_ID": str(own_domain_id()),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_LOG_DIR": str(tmp_path_factory.mktemp("log")),
    }


@pytest.fixture(scope="module")
def pneu(environment):
    def run(*words, status=0, timeout_s=60):
        done = subprocess.run(
            [sys.executable, "-m", "pneu_graph.tools", *words],
            env=environment,
            capture_output=True,
            text=True,
            timeout=timeout_s,
        )
        assert done.returncode == status, (words, done.stdout, done.stderr)
        return done.stdout if status == 0 else done.stderr

    return run


@pytest.fixture(scope="module")
def talker(environment, pneu, tmp_path_factory):
    script = tmp_path_factory.mktemp("script") / "talker.py"
    script.write_text(TALKER)
    command = [sys.executable, "-m", "pneu_graph.tools", "run", str(script)]
    process = subprocess.Popen(command, env=environment)
    deadline = time.monotonic() + 60
    while pneu("node", "list") != "/rig/talker\n":
        assert process.poll() is None and time.monotonic() < deadline
    yield process
    process.send_signal(signal.SIGINT)
    assert process.wait(20) == 0


@pytest.mark.usefixtures("talker")
class TestOnAGraph:
    @pytest.mark.long
    def test_node_info(self, pneu):
        lines = pneu("node", "info", "/rig/talker").splitlines()
        assert lines[:3] == ["/rig/talker", "  Subscribers:", "  Publishers:"]
        assert f"    {TOPIC}: sensor_msgs/msg/FluidPressure" in lines
        assert "    /rig/talker/enable: std_srvs/srv/SetBool" in lines
        assert [line for line in lines if line.startswith("  ") and line[2] != " "][2:] == [
            "  Service Servers:", "  Service Clients:", "  Action Servers:", "  Action Clients:",
        ]  # fmt: skip
        assert "Unable to find node 'nobody'" in pneu("node", "info", "nobody", status=1)

    @pytest.mark.long
    def test_topics(self, pneu):
        assert f"{TOPIC} [sensor_msgs/msg/FluidPressure]" in pneu("topic", "list", "-t")
        shown = pneu("topic", "info", "-v", TOPIC)
        assert shown.startswith("Type: sensor_msgs/msg/FluidPressure\n\nPublisher count: 1\n\n")
        for line in ("Node name: talker", "Node namespace: /rig", "  Reliability: RELIABLE",
                     "Endpoint type: PUBLISHER", "  Lifespan: Infinite"):  # fmt: skip
            assert line in shown.splitlines()
        assert "Topic type hash: RIHS01_22dfb2b145a0bd5a31a1ac38" in shown
        assert "Unknown topic '/none'" in pneu("topic", "info", "/none", status=1)

    @pytest.mark.long
    def test_echo_prints_yaml_documents(self, pneu):
        shown = pneu("topic", "echo", "--once", TOPIC)
        assert shown.endswith("\n---\n")
        message = YAML(typ="safe").load(shown.removesuffix("---\n"))
        assert message == {
            "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": "end"},
            "fluid_pressure": 101325.0,
            "variance": 0.0,
        }
        assert pneu("topic", "echo", "--once", "--field", "header.frame_id", TOPIC) == "end\n---\n"
        assert "is not known" in pneu("topic", "echo", "/none", status=2)

    @pytest.mark.long
    def test_hz(self, pneu):
        shown = pneu("topic", "hz", "--seconds", "2", TOPIC)
        rate = float(shown.splitlines()[-2].removeprefix("average rate: "))
        assert rate == pytest.approx(50.0, rel=0.3)

    @pytest.mark.long
    def test_parameters(self, pneu):
        assert pneu("param", "get", "/rig/talker", "gain.p") == "Double value is: 1.5\n"
        assert pneu("param", "get", "/rig/talker", "names") == "String values are: ['a', 'b']\n"
        assert pneu("param", "set", "/rig/talker", "gain.p", "2.5") == "Set parameter successful\n"
        assert "Setting parameter failed" in pneu(
            "param", "set", "/rig/talker", "gain.p", "99.0", status=1
        )
        dumped = YAML(typ="safe").load(pneu("param", "dump", "/rig/talker"))
        assert dumped["/rig/talker"]["ros__parameters"]["gain"] == {"p": 2.5}
        assert "    Max value: 9.0" in pneu("param", "describe", "/rig/talker", "gain.p")
        assert "Parameter not set" in pneu("param", "get", "/rig/talker", "none", status=1)

    @pytest.mark.long
    def test_parameters_from_a_file(self, pneu, tmp_path):
        path = tmp_path / "p.yaml"
        path.write_text("/**: {ros__parameters: {gain: {p: 3.5}}}\n")
        assert pneu("param", "load", "/rig/talker", str(path)) == (
            "Set parameter gain.p successful\n"
        )
        assert pneu("param", "get", "--hide-type", "/rig/talker", "gain.p") == "3.5\n"

    @pytest.mark.long
    def test_service_call(self, pneu):
        shown = pneu("service", "call", "/rig/talker/enable", "std_srvs/srv/SetBool",
                     "{data: true}")  # fmt: skip
        assert "requester: making request: std_srvs.srv.SetBool_Request(data=True)" in shown
        assert "response:\nstd_srvs.srv.SetBool_Response(success=True, message='done')" in shown
        assert pneu("service", "type", "/rig/talker/enable") == "std_srvs/srv/SetBool\n"
        assert "data: is boolean" in pneu(
            "service", "call", "/x", "std_srvs/srv/SetBool", "{data: 7}", status=2
        )


@pytest.mark.long
def test_pub_reaches_echo(pneu, environment):
    command = [sys.executable, "-m", "pneu_graph.tools", "topic", "echo", "--once", "/c",
               "std_msgs/msg/String"]  # fmt: skip
    process = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)
    shown = pneu("topic", "pub", "--once", "/c", "std_msgs/msg/String", "{data: hello}")
    assert "publishing #1: std_msgs.msg.String(data='hello')" in shown
    assert process.communicate(timeout=30)[0] == "data: hello\n---\n"


@pytest.mark.long
def test_interfaces_are_shown(pneu):
    assert "\t\tint32 sec\n" in pneu("interface", "show", "sensor_msgs/msg/FluidPressure")
    assert "    std_srvs/srv/Trigger\n" in pneu("interface", "list", "-s")


def test_yaml_is_read_back_as_it_was():
    value = {
        "a": [1, 2.5, {"b": [], "c": {}}, [True, None]],
        "text": ["", "yes", "1.0", "a: b", "it's", "two\nlines", "#", " x ", "é", "1e5", "-"],
        "numbers": [1e-30, 1e300, float("inf"), -0.5],
    }
    for version in ((1, 1), (1, 2)):
        yaml = YAML(typ="safe", pure=True)
        yaml.version = version
        assert yaml.load(yaml_text(value)) == value
        assert yaml.load(yaml_text(value, flow=True)) == value


def test_messages_are_filled_by_field(monkeypatch):
    from diagnostic_msgs.msg import DiagnosticArray

    message = DiagnosticArray()
    fill(message, parse_values("{status: [{name: a, values: [{key: k, value: v}]}]}"))
    assert plain(message)["status"][0]["values"] == [{"key": "k", "value": "v"}]
    with pytest.raises(InputError, match=r"status\[0\]\.nam: no such field; DiagnosticStatus has"):
        fill(message, {"status": [{"nam": "a"}]})
    with pytest.raises(InputError, match="status: is sequence"):
        fill(message, {"status": 1})


def test_rates():
    rate, bandwidth = Rate(10), Bandwidth(10)
    assert rate.text() == bandwidth.text() == ""
    for i in range(5):
        rate.add(0.1 * i, 100)
        bandwidth.add(0.1 * i, 100)
    assert rate.text().startswith("average rate: 10.000\n\tmin: 0.100s max: 0.100s")
    assert bandwidth.text().startswith("1.00 KB/s from 5 messages")
