# SPDX-License-Identifier: Apache-2.0
"""The commands on the graph, against a node in another process."""

import math
import os
import signal
import subprocess
import sys
import time

import numpy as np
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
        "unprintable": [
            "\x1f",
            "\x7f",
            "\x80",
            "\x9f",
            "\u2028",
            "\u2029",
            "\ufeff",
            "\n\x85\U0001f600",
        ],
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


@pytest.mark.parametrize(
    ("options", "shown"),
    [
        ({}, [["ab", "abc", "abcd"], [1.0, 2.0, 3.0, 4.0], [5.0, 6.0, 7.0], "abcd"]),
        (
            {"truncate_length": 3},
            [["ab", "abc", "abc..."], [1.0, 2.0, 3.0, "..."], [5.0, 6.0, 7.0], "abc..."],
        ),
        ({"truncate_length": 0}, [["..."], ["..."], ["..."], "..."]),
        (
            {"no_arr": True},
            [
                "<array type: sequence<string>, length: 3>",
                "<array type: sequence<double>, length: 4>",
                "<array type: sequence<double>, length: 3>",
                "abcd",
            ],
        ),
        (
            {"no_str": True},
            [
                ["ab", "abc", "abcd"],
                [1.0, 2.0, 3.0, 4.0],
                [5.0, 6.0, 7.0],
                "<string length: 4>",
            ],
        ),
    ],
)
def test_long_arrays_and_strings_are_cut_or_named(options, shown):
    from pneu_runtime import hook

    hook.install()
    from sensor_msgs.msg import JointState

    message = JointState(name=["ab", "abc", "abcd"], position=[1.0, 2.0, 3.0, 4.0])
    message.velocity = [5.0, 6.0, 7.0]
    message.header.frame_id = "abcd"
    found = plain(message, **options)
    assert found["header"]["stamp"] == {"sec": 0, "nanosec": 0}
    assert [*(found[k] for k in ("name", "position", "velocity"))] == shown[:3]
    assert found["header"]["frame_id"] == shown[3]


def test_options_hold_for_the_messages_in_an_array():
    from pneu_runtime import hook

    hook.install()
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

    message = DiagnosticArray()
    values = [KeyValue(key=word, value="") for word in ("a", "b", "longer")]
    message.status = [DiagnosticStatus(level=b"\x02", name="longer", values=values)]
    (cut,) = plain(message, 2)["status"]
    assert cut["values"] == [{"key": "a", "value": ""}, {"key": "b", "value": ""}, "..."]
    assert (cut["level"], cut["name"]) == (2, "lo...")
    (named,) = plain(message, no_str=True)["status"]
    assert named["values"][2] == {"key": "<string length: 6>", "value": "<string length: 0>"}
    assert plain(message, no_arr=True)["status"].endswith("DiagnosticStatus>, length: 1>")
    (listed,) = [plain(one, no_arr=True) for one in message.status]
    assert listed["values"] == "<array type: sequence<diagnostic_msgs/KeyValue>, length: 3>"


def test_plain_values():
    assert [plain(b"\x07"), plain(b"\x07\x01"), plain(b"")] == [7, [7, 1], []]
    found = plain([np.float32(0.5), np.int16(-3), np.bool_(True)])
    assert found == [0.5, -3, True] and [type(one) for one in found] == [float, int, bool]
    fixed = plain(np.array([[1.5, 2.5], [3.5, 4.5]]))
    assert fixed == [[1.5, 2.5], [3.5, 4.5]] and type(fixed[1][0]) is float
    assert plain("ab", 2) == "ab" and plain("abc", 2) == "ab..." and plain("abc") == "abc"
    assert plain("x" * 200) == "x" * 200 and plain([3] * 200) == [3] * 200


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "null"),
        (True, "true"),
        (False, "false"),
        (7, "7"),
        (-0.5, "-0.5"),
        (1e-30, "1.0e-30"),
        (1.5e-7, "1.5e-07"),
        (math.nan, ".nan"),
        (math.inf, ".inf"),
        (-math.inf, "-.inf"),
        ("", "''"),
        ("...", "'...'"),
        ("a b/c.d-e+(f)", "a b/c.d-e+(f)"),
        ("_x", "_x"),
        ("a, b", "'a, b'"),
        ("x ", "'x '"),
        (" x", "' x'"),
        ("7", "'7'"),
        ("it's", "'it''s'"),
        ("two\nlines", '"two\\nlines"'),
        ("\x1f", '"\\u001f"'),
        ("\x7fé", '"\\u007fé"'),
        ("\u2028é", '"\\u2028é"'),
        (" ", "' '"),
        *((word, f"'{word}'") for word in ("true", "False", "YES", "no", "on", "Off", "null")),
        *((word, f"'{word}'") for word in ("y", "N", ".nan", ".inf")),
        ([], "[]"),
        ({}, "{}"),
        ([1, [2, "a"], {"b": [], "no": {}}], "- 1\n- - 2\n  - a\n- b: []\n  'no': {}"),
        ({"a": {"b": [1, {"c": 2, "d": 3}]}, "e": [4]},
         "a:\n  b:\n  - 1\n  - c: 2\n    d: 3\ne:\n- 4"),
    ],
)  # fmt: skip
def test_yaml_of_values(value, text):
    assert yaml_text(value) == text + "\n"


def test_yaml_on_one_line():
    value = {"a": [1, {"no": True}, []], "b": {}, "c": {"d": "e"}}
    assert yaml_text(value, flow=True) == "{a: [1, {'no': true}, []], b: {}, c: {d: e}}\n"


@pytest.mark.parametrize("text", ["", "''", "null", "{}", "~"])
def test_no_values(text):
    assert parse_values(text) == {}


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[1]", "values '[1]': are a mapping such as \"{data: 1.0}\", found list"),
        ("7", "values '7': are a mapping such as \"{data: 1.0}\", found int"),
        ("0", "values '0': are a mapping such as \"{data: 1.0}\", found int"),
        ("false", "values 'false': are a mapping such as \"{data: 1.0}\", found bool"),
    ],
)
def test_values_that_are_no_mapping(text, says):
    with pytest.raises(InputError) as caught:
        parse_values(text)
    assert str(caught.value) == says


def test_fields_of_each_kind_are_filled():
    from pneu_runtime import hook

    hook.install()
    from builtin_interfaces.msg import Time
    from diagnostic_msgs.msg import DiagnosticStatus
    from rosgraph_msgs.msg import Clock
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64, Header

    now = Time(sec=3, nanosec=5)
    joints = JointState()
    fill(joints, {"header": "auto", "position": [1, "2.5"], "name": ["a"]}, now=now)
    assert (joints.header.stamp, list(joints.position)) == (now, [1.0, 2.5])
    assert joints.name == ["a"]
    clock = Clock()
    fill(clock, {"clock": "now"}, now=now)
    assert clock.clock == now
    fill(clock, {"clock": {"sec": 7}})
    assert clock.clock == Time(sec=7, nanosec=5)
    header = Header()
    fill(header, {"stamp": "now", "frame_id": "now"}, now=now)
    assert (header.stamp, header.frame_id) == (now, "now")
    status = DiagnosticStatus()
    fill(status, {"level": 2, "name": "auto"}, now=now)
    assert (status.level, status.name) == (b"\x02", "auto")
    number = Float64()
    fill(number, {"data": "1e3"})
    assert number.data == 1000.0 and type(number.data) is float

    for message, values, says in (
        (Float64(), {"data": True}, "data: is double, found True"),
        (Float64(), {"data": "x"}, "data: is double, found 'x'"),
        (Float64(), {"date": 1}, "date: no such field; Float64 has data"),
        (Header(), {"stamp": "auto"}, "stamp: is builtin_interfaces/Time, a mapping; found 'auto'"),
        (JointState(), {"header": "now"}, "header: is std_msgs/Header, a mapping; found 'now'"),
        (JointState(), {"header": {"frame": "x"}},
         "header.frame: no such field; Header has stamp, frame_id"),
        (JointState(), {"position": 1.0}, "position: is sequence<double>, a list; found 1.0"),
        (JointState(), {"name": [1]}, "name: is sequence<string>, found [1]"),
        (DiagnosticStatus(), {"level": 256}, "level: is octet, found 256"),
        (DiagnosticStatus(), {"values": [{"key": "a"}, {"key": 3}]},
         "values[1].key: is string, found 3"),
    ):  # fmt: skip
        with pytest.raises(InputError) as caught:
            fill(message, values, now=now)
        assert str(caught.value) == says
    for message, values in ((Clock(), {"clock": "now"}), (JointState(), {"header": "auto"})):
        with pytest.raises(InputError, match="a mapping; found"):
            fill(message, values)


def test_rates():
    rate, bandwidth = Rate(10), Bandwidth(10)
    assert rate.text() == bandwidth.text() == ""
    for i in range(5):
        rate.add(0.1 * i, 100)
        bandwidth.add(0.1 * i, 100)
    assert rate.text().startswith("average rate: 10.000\n\tmin: 0.100s max: 0.100s")
    assert bandwidth.text().startswith("1.00 KB/s from 5 messages")
