# SPDX-License-Identifier: Apache-2.0
"""The valve bridge as a process, between a graph and the emulated lab: topics, safety, its end."""

import math
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import contextmanager
from itertools import pairwise

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from pneu_msgs.msg import TapPressures, ValveCommand
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSProfile,
    ReliabilityPolicy,
    qos_profile_sensor_data,
)
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import FluidPressure
from std_msgs.msg import Bool
from std_srvs.srv import Trigger
from tests.domains import own_domain_id
from tests.measured import PATIENCE_S, Watch

pytestmark = pytest.mark.realtime

DOMAIN = own_domain_id()
ENVIRONMENT = {
    **os.environ,
    "ROS_DOMAIN_ID": str(DOMAIN),
    "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
}
START = (
    "import sys; from pneu_runtime import hook; hook.install();"
    "from pneu_hw_bridge.nodes.valve_bridge import main; main(sys.argv[1:])"
)
LATE_START = """
import sys
from pneu_runtime import hook; hook.install()
from pneu_hw_bridge.nodes.bridge import run_bridge
from pneu_hw_bridge.nodes.valve_bridge import ValveBridge

class LateBridge(ValveBridge):
    def get_publishers_info_by_topic(self, *args, **options):
        found = super().get_publishers_info_by_topic(*args, **options)
        return [one for one in found if one.node_name != "rival"]

run_bridge(LateBridge, sys.argv[1:])
"""
"""A bridge to which the graph never lists the publishers of the node `rival`."""
COMMAND_QOS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
)
LATCHED_QOS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)


class Graph:
    """The rest of the graph: a controller, a listener, an operator."""

    def __init__(self):
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=DOMAIN)
        self.node = rclpy.create_node("tester", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.singles, self.sets, self.stops, self.health = [], [], [], []
        listen = self.node.create_subscription
        listen(FluidPressure, "taps/end/pressure", self.singles.append, qos_profile_sensor_data)
        listen(TapPressures, "taps/pressures", self.sets.append, qos_profile_sensor_data)
        listen(Bool, "e_stop", self.stops.append, LATCHED_QOS)
        listen(DiagnosticArray, "/diagnostics", self.health.append, 10)
        self.publisher = self.node.create_publisher(ValveCommand, "valve/command", COMMAND_QOS)
        self.volts = None
        self._end = threading.Event()
        self._threads = [
            threading.Thread(target=self.executor.spin, daemon=True),
            threading.Thread(target=self._control, daemon=True),
        ]
        for thread in self._threads:
            thread.start()

    def _control(self):
        while not self._end.wait(0.002):
            if self.volts is not None:
                self.publisher.publish(ValveCommand(name=["voltage"], voltage_v=[self.volts]))

    def call(self, kind, name, request=None):
        client = self.node.create_client(kind, name)
        try:
            assert client.wait_for_service(PATIENCE_S), name
            future = client.call_async(request or kind.Request())
            end = time.monotonic() + PATIENCE_S
            while not future.done():
                assert time.monotonic() < end, f"{name} did not answer"
                time.sleep(0.002)
            return future.result()
        finally:
            self.node.destroy_client(client)

    def change(self, transition):
        request = ChangeState.Request(transition=Transition(id=transition))
        return self.call(ChangeState, "valve_bridge/change_state", request).success

    def state(self):
        return self.call(GetState, "valve_bridge/get_state").current_state.id

    def status(self, part="safety"):
        """The newest diagnostics of a part of the bridge: level and message."""
        for message in reversed(self.health):
            for one in message.status:
                if one.name == f"valve_bridge: {part}":
                    return one
        return None

    def close(self):
        self._end.set()
        self._threads[1].join(2.0)
        self.executor.shutdown()
        self._threads[0].join(2.0)
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


@pytest.fixture
def graph():
    one = Graph()
    yield one
    one.close()


@contextmanager
def running_bridge(port, *parameters, state=None, remap=(), namespace="", program=START):
    """The node as a process, which remembers nothing unless it is told where."""
    command = [sys.executable, "-c", program, "--ros-args", "-p", f"port:={port}"]
    for parameter in parameters:
        command += ["-p", parameter]
    for rule in (*remap, *([f"__ns:={namespace}"] if namespace else [])):
        command += ["-r", rule]
    with tempfile.TemporaryDirectory() as fresh:
        environment = {**ENVIRONMENT, "PNEU_STATE_DIR": str(state or fresh)}
        process = subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True)
        try:
            yield process
        finally:
            if process.poll() is None:
                process.kill()
            process.communicate(timeout=10)


def pneu_stop(*words):
    """Runs `pneu stop` as a user does, who has pressed the key just before."""
    program = "import sys; from pneu_common.entry import main; main()"
    return subprocess.run(
        [sys.executable, "-c", program, "stop", *words],
        env=ENVIRONMENT,
        capture_output=True,
        text=True,
        timeout=60,
    )


@pytest.fixture
def healthy_lab(healthy_lab, wait_until):
    """With its valves closed: a killed bridge leaves them to the watchdog of the device."""
    wait_until(lambda: healthy_lab.volts() == 0.0)
    return healthy_lab


@pytest.fixture
def bridge(healthy_lab):
    """An active bridge."""
    with running_bridge(healthy_lab.port, "autostart:=true") as process:
        yield process


def follow(lab, graph, wait_until, volts=5.5):
    """Sends commands until the valves have them."""
    graph.volts = volts
    wait_until(lambda: lab.volts() == volts, 20.0, 0.02)
    time.sleep(0.1)


def watch(lab, bridge):
    """Judges times from now on; the rest of the graph runs in this process."""
    return Watch(lab, [lab.process.pid, bridge.pid, os.getpid()])


def safe_since(lab):
    """When the valves got the safe voltage that they have kept from then on, and by whom."""
    changes = lab.ask("history")["history"]
    assert changes[-1]["volts"]["voltage"] == 0.0, changes[-3:]
    last = max(i for i, change in enumerate(changes) if change["volts"]["voltage"] != 0.0)
    return changes[last + 1]["steady_s"], changes[last + 1]["cause"]


def test_readings_and_commands(bridge, lab, graph, wait_until):
    follow(lab, graph, wait_until, 6.0)
    follow(lab, graph, wait_until, 5.0)
    time.sleep(0.5)
    one, whole = graph.singles[-1], graph.sets[-1]
    assert list(whole.name) == ["supply", "valve_out", "middle", "end", "exhaust"]
    assert one.header.frame_id == "end"
    assert 1.5e5 < one.fluid_pressure < 7e5
    assert whole.pressure_pa[3] == pytest.approx(one.fluid_pressure, abs=5e3)
    age_s = time.time() - (one.header.stamp.sec + 1e-9 * one.header.stamp.nanosec)
    assert -0.01 < age_s < 0.5
    stamps = [s.header.stamp.sec * 10**9 + s.header.stamp.nanosec for s in graph.sets[-200:]]
    assert all(b > a for a, b in pairwise(stamps))
    graph.volts = None
    judge, begun_s = watch(lab, bridge).judge, time.monotonic()
    time.sleep(0.3)
    at_s, cause = safe_since(lab)
    judge(at_s, begun_s)
    assert cause == "write"


@pytest.mark.long
def test_a_device_with_a_clock(start_lab, tmp_path, graph, wait_until):
    """Stamps step as the device samples, commands and /clock are in its time, nothing is lost."""
    applied, clock, sets = [], [], []
    listen = graph.node.create_subscription
    # reliable, and deep enough for a test that gets no processor for a while
    listen(TapPressures, "taps/pressures", sets.append, 2000)
    listen(ValveCommand, "valve/applied", applied.append, 50)
    listen(Clock, "/clock", clock.append, 50)
    with (
        start_lab(tmp_path, "--registers", "logging_plc", "--paced", "1") as lab,
        running_bridge(
            lab.port, "autostart:=true", "register_map:=logging_plc", "publish_clock:=true"
        ),
    ):
        follow(lab, graph, wait_until, 6.0)
        first = len(sets)
        follow(lab, graph, wait_until, 5.0)
        time.sleep(0.5)
        told = [ns(one.header.stamp) for one in sets[first:]]
        wait_until(lambda: graph.status("device clock").message == "works")
        assert graph.status("device clock").level == b"\0"
        taken = list(applied)
        lab.ask("restart")

        def restarted():
            values = {one.key: one.value for one in graph.status("device clock").values}
            return values["compared anew"] == "1"

        wait_until(restarted)
    assert len(told) > 200
    assert {b - a for a, b in pairwise(told)} == {2_000_000}
    assert {ns(one.clock) for one in clock} & set(told)
    since = [(ns(one.header.stamp) - told[0]) % 1_000_000 for one in taken]
    assert max(since) < 10 and 6.0 in {one.voltage_v[0] for one in taken}


def ns(stamp):
    return stamp.sec * 10**9 + stamp.nanosec


@pytest.mark.long
def test_diagnostics(bridge, lab, graph, wait_until):
    follow(lab, graph, wait_until)
    wait_until(lambda: graph.status() is not None and graph.status().message == "following")
    assert graph.status().level == b"\0"
    assert graph.status("bus").message == "works"
    graph.volts = None
    wait_until(lambda: graph.status().message.startswith("holding: command voltage: none for"))
    count = len(graph.health)
    time.sleep(3.2)
    assert 3 <= len(graph.health) - count <= 5, "1 Hz while nothing changes"
    follow(lab, graph, wait_until)
    lab.ask("fault", name="frozen", channel="end")
    wait_until(lambda: "frozen" in graph.status().message)
    assert graph.status().level == b"\x01"
    lab.ask("fault", name="silent")
    wait_until(lambda: graph.status("bus").level == b"\x02")


def resume(graph):
    """Activates the bridge anew, as it needs after a reset."""
    assert graph.change(Transition.TRANSITION_DEACTIVATE)
    assert graph.change(Transition.TRANSITION_ACTIVATE)


def test_emergency_stop(bridge, lab, graph, wait_until):
    follow(lab, graph, wait_until)
    wait_until(lambda: graph.stops and not graph.stops[-1].data)
    judge, begun_s = watch(lab, bridge).judge, time.monotonic()
    answer = graph.call(Trigger, "valve_bridge/e_stop")
    assert answer.success and "read back voltage 0 V" in answer.message
    time.sleep(0.3)  # commands go on
    judge(safe_since(lab)[0], begun_s)
    wait_until(lambda: graph.stops[-1].data)
    wait_until(lambda: "e_stop" in graph.status().message)
    late = Graph()
    try:
        wait_until(lambda: late.stops, 10.0)
        assert late.stops[-1].data, "who comes late learns of the stop"
    finally:
        late.close()
    assert graph.change(Transition.TRANSITION_DEACTIVATE)
    assert graph.change(Transition.TRANSITION_ACTIVATE)
    time.sleep(0.2)
    assert lab.volts() == 0.0, "activating anew does not release it"
    assert graph.call(Trigger, "valve_bridge/reset_e_stop").success
    wait_until(lambda: not graph.stops[-1].data)
    time.sleep(0.3)
    assert lab.volts() == 0.0, "a reset alone moves nothing"
    resume(graph)
    wait_until(lambda: lab.volts() == 5.5)


@pytest.mark.long
def test_a_stop_from_the_shell(bridge, lab, graph, wait_until):
    """All bridges of the machine, without waiting for the graph."""
    follow(lab, graph, wait_until)
    watched, begun_s = watch(lab, bridge), time.monotonic()
    told = pneu_stop("--local")
    took_s = time.monotonic() - begun_s
    assert told.returncode == 0, told.stderr
    assert told.stdout == "/valve_bridge: safe, read back voltage 0 V\n"
    watched.judge(safe_since(lab)[0], begun_s, begun_s + took_s - 0.05, within_s=0.3)
    wait_until(lambda: graph.stops[-1].data)
    assert "pneu stop" in graph.status().message or wait_until(
        lambda: "pneu stop" in graph.status().message
    )
    assert graph.call(Trigger, "valve_bridge/reset_e_stop").success
    resume(graph)
    wait_until(lambda: lab.volts() == 5.5)


@pytest.mark.long
def test_a_stop_from_the_shell_finds_bridges_of_other_machines(
    healthy_lab, graph, wait_until, tmp_path, monkeypatch
):
    """This one's sockets cannot be seen: its service is called."""
    with running_bridge(healthy_lab.port, "autostart:=true", namespace="/far"):
        graph.publisher = graph.node.create_publisher(
            ValveCommand, "/far/valve/command", COMMAND_QOS
        )
        follow(healthy_lab, graph, wait_until)
        monkeypatch.setitem(ENVIRONMENT, "PNEU_RUN_DIR", str(tmp_path))
        told = pneu_stop()
        assert told.returncode == 0, told.stderr
        assert told.stdout == "/far/valve_bridge: safe, read back voltage 0 V\n"
        assert healthy_lab.volts() == 0.0
        told = pneu_stop("--local")
        assert (told.returncode, told.stdout) == (1, "no bridge found on this machine\n")


@pytest.mark.long
def test_bridges_that_share_a_device_obey_one_stop(healthy_lab, graph, wait_until):
    other = running_bridge(
        healthy_lab.port, "autostart:=true", remap=["__node:=other_bridge"], namespace="/other"
    )
    with running_bridge(healthy_lab.port, "autostart:=true"), other:
        stops = []
        graph.node.create_subscription(Bool, "/other/e_stop", stops.append, LATCHED_QOS)
        wait_until(lambda: stops and graph.stops, 20.0)
        assert not stops[-1].data
        assert graph.call(Trigger, "valve_bridge/e_stop").message
        wait_until(lambda: stops[-1].data, 3.0)


@pytest.mark.long
def test_a_bridge_obeys_the_stop_of_another_one_in_its_namespace(
    healthy_lab, graph, wait_until, tmp_path, monkeypatch
):
    """Over the graph, as between two machines."""
    monkeypatch.setitem(ENVIRONMENT, "PNEU_RUN_DIR", str(tmp_path / "one"))
    with running_bridge(healthy_lab.port, "autostart:=true"):
        follow(healthy_lab, graph, wait_until)
        monkeypatch.setitem(ENVIRONMENT, "PNEU_RUN_DIR", str(tmp_path / "two"))
        with running_bridge(1, "autostart:=true", remap=["__node:=other_bridge"]):
            assert "no connection" in graph.call(Trigger, "other_bridge/e_stop").message
            wait_until(lambda: healthy_lab.volts() == 0.0, 3.0)
            wait_until(lambda: "another bridge of this namespace" in graph.status().message)


@pytest.mark.long
@pytest.mark.parametrize("how", ["stopped", "tripped", "killed", "interrupted"])
def test_a_restart_forgets_no_stop(how, healthy_lab, graph, wait_until, tmp_path):
    lab, state = healthy_lab, tmp_path / "state"
    with running_bridge(lab.port, "autostart:=true", state=state) as bridge:
        follow(lab, graph, wait_until)
        if how == "stopped":
            assert graph.call(Trigger, "valve_bridge/e_stop").success
        elif how == "tripped":
            lab.ask("fault", name="out_of_range", channel="end", value=9.5e5)
            wait_until(lambda: graph.status() and "tripped" in graph.status().message)
            lab.ask("clear")
            time.sleep(0.2)
        bridge.send_signal(signal.SIGKILL if how == "killed" else signal.SIGTERM)
        bridge.wait(10.0)
    graph.health.clear()
    with running_bridge(lab.port, "autostart:=true", state=state):
        if how == "interrupted":  # it vented and said so
            follow(lab, graph, wait_until)
            return
        said = {"stopped": "by service", "tripped": "over-pressure", "killed": "was killed"}[how]
        wait_until(lambda: graph.status() and said in graph.status().message, 20.0)
        time.sleep(0.5)
        assert lab.volts() == 0.0
        assert graph.call(Trigger, "valve_bridge/reset_e_stop").success
        resume(graph)
        wait_until(lambda: lab.volts() == 5.5, 20.0)


@pytest.mark.long
def test_life_cycle(healthy_lab, graph, wait_until):
    lab = healthy_lab
    with running_bridge(lab.port) as bridge:
        assert graph.state() == State.PRIMARY_STATE_UNCONFIGURED
        assert graph.change(Transition.TRANSITION_CONFIGURE)
        wait_until(lambda: graph.sets)  # readable, but no commands
        graph.volts = 7.0
        time.sleep(0.3)
        assert lab.volts() == 0.0
        assert graph.change(Transition.TRANSITION_ACTIVATE)
        wait_until(lambda: lab.volts() == 7.0)
        judge, begun_s = watch(lab, bridge).judge, time.monotonic()
        assert graph.change(Transition.TRANSITION_DEACTIVATE)
        time.sleep(0.2)
        at_s, cause = safe_since(lab)
        judge(at_s, begun_s)
        assert cause == "write"
        assert graph.change(Transition.TRANSITION_CLEANUP)
        count = len(graph.sets)
        time.sleep(0.2)
        assert len(graph.sets) <= count + 1
        assert graph.change(Transition.TRANSITION_CONFIGURE)
        assert graph.change(Transition.TRANSITION_ACTIVATE)
        wait_until(lambda: lab.volts() == 7.0)


@pytest.mark.long
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL])
def test_end_by_a_signal(number, healthy_lab, graph, wait_until):
    lab = healthy_lab
    with running_bridge(lab.port, "autostart:=true") as bridge:
        follow(lab, graph, wait_until)
        judge, begun_s = watch(lab, bridge).judge, time.monotonic()
        bridge.send_signal(number)
        known_s = time.monotonic()
        bridge.wait(10.0)
        time.sleep(0.2)
        at_s, cause = safe_since(lab)
    judge(at_s, begun_s, known_s)
    assert cause == ("watchdog" if number is signal.SIGKILL else "write")
    if number is not signal.SIGKILL:
        assert bridge.returncode == 0


@pytest.mark.long
def test_two_publishers(bridge, lab, graph, wait_until):
    follow(lab, graph, wait_until)
    judge = watch(lab, bridge).judge
    since = len(lab.ask("history")["history"])
    other = graph.node.create_publisher(ValveCommand, "valve/command", COMMAND_QOS)
    begun_s = time.monotonic()
    for _ in range(250):
        other.publish(ValveCommand(name=["voltage"], voltage_v=[9.5]))
        time.sleep(0.002)
    judge(safe_since(lab)[0], begun_s)
    written = [change["volts"]["voltage"] for change in lab.ask("history")["history"][since:]]
    assert 9.5 not in written, "nothing of a rival ever gets to the valve"
    wait_until(lambda: "2 publishers" in graph.status().message)
    graph.node.destroy_publisher(other)
    wait_until(lambda: lab.volts() == 5.5)


@pytest.mark.long
def test_a_publisher_that_the_graph_does_not_list_is_not_followed(healthy_lab, graph, wait_until):
    """Nor is anybody else as long as it is there; alone it is not followed either."""
    with running_bridge(healthy_lab.port, "autostart:=true", program=LATE_START):
        follow(healthy_lab, graph, wait_until)
        since = len(healthy_lab.ask("history")["history"])
        rival = rclpy.create_node("rival", context=graph.context)
        other = rival.create_publisher(ValveCommand, "valve/command", COMMAND_QOS)

        def refused(reason):
            other.publish(ValveCommand(name=["voltage"], voltage_v=[9.5]))
            return reason in graph.status().message

        wait_until(lambda: refused("2 publishers"))
        assert healthy_lab.volts() == 0.0
        graph.volts = None
        time.sleep(0.1)  # for the thread that publishes
        graph.node.destroy_publisher(graph.publisher)
        wait_until(lambda: refused("is not known to the graph yet"))
        rival.destroy_node()
        changes = healthy_lab.ask("history")["history"][since:]
        assert 9.5 not in [change["volts"]["voltage"] for change in changes]


@pytest.mark.long
def test_only_the_node_that_is_named_may_command(healthy_lab, graph, wait_until):
    graph.volts = 5.5
    name = graph.node.get_fully_qualified_name()
    with running_bridge(healthy_lab.port, "autostart:=true", "commander:=/lab/policy"):
        wait_until(
            lambda: graph.status() and f"{name} publishes commands" in graph.status().message, 20.0
        )
        assert healthy_lab.volts() == 0.0
    with running_bridge(healthy_lab.port, "autostart:=true", f"commander:={name}"):
        follow(healthy_lab, graph, wait_until)


@pytest.mark.long
@pytest.mark.parametrize("value", [math.nan, math.inf, 1e9, -50.0])
def test_commands_that_make_no_sense(value, bridge, lab, graph, wait_until):
    follow(lab, graph, wait_until)
    graph.volts = value
    judge, begun_s = watch(lab, bridge).judge, time.monotonic()
    time.sleep(0.3)
    judge(safe_since(lab)[0], begun_s)
    follow(lab, graph, wait_until)


@pytest.mark.long
def test_malformed_commands(bridge, lab, graph, wait_until):
    follow(lab, graph, wait_until)
    graph.volts = None
    for names, volts in (
        (["voltage"], []),
        (["other"], [5.0]),
        ([], []),
        (["voltage"] * 2, [1, 2]),
    ):
        graph.publisher.publish(ValveCommand(name=names, voltage_v=[float(v) for v in volts]))
    wait_until(lambda: lab.volts() == 0.0)
    follow(lab, graph, wait_until)


@pytest.mark.long
def test_parameters(healthy_lab, graph, wait_until):
    def set_to(name, value):
        kind = ParameterType.PARAMETER_BOOL if value is True else ParameterType.PARAMETER_DOUBLE
        field = {"bool_value": value} if value is True else {"double_value": value}
        one = Parameter(name=name, value=ParameterValue(type=kind, **field))
        request = SetParameters.Request(parameters=[one])
        return graph.call(SetParameters, "valve_bridge/set_parameters", request).results[0]

    with running_bridge(healthy_lab.port):
        for name, value in (("watchdog_s", 0.0), ("watchdog_s", 0.2), ("timeout_s", 1.0)):
            assert not set_to(name, value).successful
        assert set_to("watchdog_s", 0.05).successful
        refused = set_to("use_sim_time", True)
        assert not refused.successful and "keep the machine's time" in refused.reason
        assert graph.change(Transition.TRANSITION_CONFIGURE)
        refused = set_to("watchdog_s", 0.06)
        assert not refused.successful and "before the node is configured" in refused.reason


@pytest.mark.long
@pytest.mark.parametrize(
    ("parameter", "says"),
    [
        ("use_sim_time:=true", "keep the machine's time"),
        ("register_map:=no_such_map.yaml", "could not be configured"),
        ("publish_clock:=true", "'generic_plc' names no clock of the device"),
    ],
)
def test_bad_start(parameter, says, healthy_lab):
    command = [sys.executable, "-c", START, "--ros-args", "-p", "autostart:=true", "-p", parameter]
    result = subprocess.run(command, env=ENVIRONMENT, capture_output=True, text=True, timeout=30)
    assert result.returncode == 2
    assert says in result.stderr
