# SPDX-License-Identifier: Apache-2.0
"""Faults of the whole graph on hardware: launch file, emulated lab, recorder, one after the other.

After each the valves have their safe voltage in the device's register within 150 ms, /diagnostics
says what is wrong, no other process ends, and all goes on by itself when the fault is over; what
was killed is started again. The last test reads the recording of it all.

=====================================  =============================================================
fault                                  where it is tested
=====================================  =============================================================
kill -9 of bridge, controller, target  here; the bridge alone: pneu_hw_bridge/test_valve_bridge.py
kill -9 of the recorder                here; pneu_graph/test_recorder.py, test_bag.py
kill -9 of the lab                     here
kill -9 of the simulator               test_faults_simulated.py
a process that hangs, and wakes up     here; pneu_hw_bridge/test_lateness.py
bus cut for 5 s and restored           here; bus and supervisor alone: pneu_hw_bridge/test_faults.py
drop slow silent exception word_order  here; bus and supervisor alone: pneu_hw_bridge/test_faults.py
frozen out_of_range supply malformed   (likewise)
over-pressure, emergency stop          pneu_hw_bridge/test_faults.py, test_valve_bridge.py
SIGINT and SIGTERM, deactivation       pneu_hw_bridge/test_valve_bridge.py
two publishers of commands             here; test_valve_bridge.py, pneu_sim/test_simulator_node.py
NaN, inf, out-of-range commands        here; pneu_hw_bridge/test_valve_bridge.py, test_supervisor.py
NaN readings, stale readings, targets  pneu_policy/test_policy_nodes.py
clock jumping back                     test_faults_simulated.py; pneu_policy/test_policy_nodes.py
subscriber slower than publisher       test_faults_simulated.py; one that hangs: here
disk full while recording              here; pneu_graph/test_bag.py
malformed DDS packets and payloads     here; the codec alone: pneu_runtime/test_interfaces.py
10 000 random Modbus replies           pneu_hw_bridge/test_bus.py
=====================================  =============================================================

The controller's safe voltage (5 V) closes the valve, the bridge's (0 V) vents. Where only the
target is lost the controller closes the valve, and the bridge has no reason to vent.
"""

import contextlib
import itertools
import math
import random
import resource
import signal
import subprocess
import sys
import threading
import time

import pytest

from tests.forged import CDR_LE, HEADER, data, send  # isort: skip
from tests.live_graph import own_domain, running_graph, wait_for  # isort: skip

from pneu_msgs.msg import PressureTarget, ValveCommand
from rclpy.serialization import serialize_message
from rosbags.highlevel import AnyReader
from sensor_msgs.msg import FluidPressure
from tests.live_rig import HardwareRig
from tests.measured import in_good_time

from pneu_graph.bag.metadata import LOST_KEY
from pneu_graph.bag.reader import BagReader
from pneu_graph.bag.recover import recover_bag
from pneu_graph.nodes import common
from pneu_hw_bridge.lab.faults import KINDS
from pneu_runtime.transport import EndpointQos, Session

pytestmark = [pytest.mark.realtime, pytest.mark.takes(75)]

CLOSED_V = 5.0
COMMANDS = "/lab/valve/command"


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    with own_domain() as domain, running_graph() as graph:
        rig = HardwareRig(tmp_path_factory.mktemp("rig"), graph, domain)
        try:
            rig.start()
            yield rig
        finally:
            rig.nodes.close()


@pytest.fixture(autouse=True)
def in_good_order(rig, request):
    """Before each fault all works; none makes a process fail."""
    if "no_controller" not in request.fixturenames:
        rig.follows()
    yield
    assert not rig.nodes.complaints()


@pytest.mark.long
def test_kill_9_of_the_recorder(rig):
    """First, while the recording is short: the next one has all that comes after."""
    recorded = rig.recorded(rig.bag)
    pids = rig.nodes.pids()
    rig.nodes.kill("recorder")
    killed_ns = time.time_ns()
    del pids["recorder"]
    in_good_time(lambda: rig.stays_undisturbed(0.5))
    found = BagReader(rig.bag)
    assert found.metadata.message_count >= recorded
    assert killed_ns - found.metadata.end_ns < 2e9
    recover_bag(rig.bag)
    with AnyReader([rig.bag]) as bag:
        assert sum(1 for _ in bag.messages()) == found.metadata.message_count
    rig.bag = rig.folder / "again"
    rig.relaunch("recorder", record=rig.bag)
    rig.records()
    assert pids.items() <= rig.nodes.pids().items()


SAYS = {
    "drop": ("bus", ""),
    "slow": ("bus", "no answer within"),
    "silent": ("bus", "no answer within"),
    "exception": ("bus", "exception reply 4"),
    "malformed": ("bus", ""),
    # Which number comes out is chance: one that cannot be, or an over-pressure that trips.
    "word_order": ("safety", ("is out of its range", "over-pressure")),
    "out_of_range": ("safety", "sensor end: 1e+07 Pa is out of its range"),
    "frozen": ("safety", "frozen at"),
    "supply": ("safety", "Pa is below 250000 Pa"),
    "dead_valve": ("bus", "exception reply 11"),
}


# An encoder's faults are in test_robot_graph.py: this rig has none.
# Each is tried on the bridge alone in src/pneu_hw_bridge/test/test_faults.py.
@pytest.mark.parametrize(
    "name",
    [
        name if name == "drop" else pytest.param(name, marks=pytest.mark.long)
        for name, kind in KINDS.items()
        if kind.at != "encoder"
    ],
)
def test_faults_of_the_device(rig, name):
    part, text = SAYS[name]
    pids = rig.nodes.pids()

    def attempt():
        rig.follows()
        watch, since = rig.watch(), rig.graph.mark()
        channel = {"channel": "end"} if name in ("frozen", "out_of_range") else {}
        begun_s = rig.lab.ask("fault", name=name, **channel)["steady_s"]
        try:
            watch.safe(begun_s)
            level = b"\2" if part == "bus" else None
            status = rig.graph.wait_until_told(f"bridge: {part}", text, since, level=level)
            assert status.message != "works"
            rig.graph.wait_until_told("bridge: safety", ("holding", "tripped"), since)
            assert rig.lab.resting_since() is not None  # and it stays
        finally:
            rig.lab.ask("clear")
            if name == "word_order":
                time.sleep(0.05)
                rig.recovers()

    in_good_time(attempt)
    since = rig.graph.mark()
    rig.follows()
    rig.graph.wait_until_told("bridge: safety", "following", since)
    rig.graph.wait_until_told("bridge: bus", "works", since)
    assert rig.nodes.pids() == pids


@pytest.mark.long
def test_bus_cut_for_five_seconds(rig):

    def failures():
        status = rig.graph.wait_until_told("bridge: bus", "works", rig.graph.mark())
        return int(next(v.value for v in status.values if v.key == "connect_failures"))

    pids, before = rig.nodes.pids(), failures()
    watch, since = rig.watch(), rig.graph.mark()
    begun_s = rig.lab.ask("fault", name="drop", seconds=5.0)["steady_s"]
    in_good_time(lambda: watch.safe(begun_s))
    wait_for(lambda: rig.lab.ask("status")["faults"] == [], 8.0)
    begin, _ = rig.lab.resting_since()
    assert time.monotonic() - begin > 4.5  # it stayed so all the time
    rig.follows(3.0)
    rig.graph.wait_until_told("bridge: bus", "no connection to", since)
    after = failures()
    assert 3 <= after - before < 20  # it does not hammer
    assert rig.nodes.pids() == pids


def kill(rig, name, by, number=signal.SIGKILL):
    """Kills a node under load, after which it must be the bridge or the device that vents."""
    watch = rig.watch()
    if number == signal.SIGKILL:
        begun_s, known_s = rig.nodes.kill(name)
    else:
        begun_s, known_s = rig.nodes.signal(name, number)
    watch.safe(begun_s, known_s, by)


def test_kill_9_of_the_bridge(rig):
    def attempt():
        since = rig.graph.mark()
        try:
            kill(rig, "valve_bridge", "watchdog")
            rig.graph.wait_until_told("pid: control", "no pressure reading: safe voltage", since)
        finally:
            since = rig.graph.mark()
            rig.relaunch("valve_bridge")
            rig.graph.wait_until_told("bridge: safety", "the bridge before was killed", since, 20.0)
            assert rig.lab.resting_since() is not None, "until somebody has looked"
            rig.reset()
            rig.follows(20.0)

    others = {k: v for k, v in rig.nodes.pids().items() if k != "valve_bridge"}
    in_good_time(attempt)
    assert others.items() <= rig.nodes.pids().items()


@pytest.mark.long
def test_kill_9_of_the_controller(rig):
    """A dead publisher counts until DDS gives it up after 3 s; only then the next is followed."""

    def attempt():
        since = rig.graph.mark()
        try:
            kill(rig, "pid", "write")
            rig.graph.wait_until_told("bridge: safety", "command voltage: none", since)
        finally:
            rig.relaunch("pid")
            rig.follows(20.0)

    in_good_time(attempt)


@pytest.mark.parametrize("name", ["valve_bridge", "pid"])
def test_a_process_that_hangs(rig, name):
    pids = rig.nodes.pids()

    def attempt():
        rig.follows()
        try:
            kill(rig, name, "watchdog" if name == "valve_bridge" else "write", signal.SIGSTOP)
        finally:
            rig.nodes.signal(name, signal.SIGCONT)

    in_good_time(attempt)
    rig.follows()
    assert rig.nodes.pids() == pids


def test_a_bridge_that_wakes_up_follows_no_command_from_before(rig):
    """The controller hangs as well, and its last command still waits in the bridge's queue."""
    for _ in range(3):
        rig.nodes.signal("valve_bridge", signal.SIGSTOP)
        try:
            time.sleep(0.05)
            rig.nodes.signal("pid", signal.SIGSTOP)
            wait_for(lambda: rig.lab.resting_since() is not None)
            begun_s, _ = rig.lab.resting_since()
            time.sleep(0.25)
            rig.nodes.signal("valve_bridge", signal.SIGCONT)
            time.sleep(0.4)
            end_s = time.monotonic()
            rests = [r for r in rig.lab.ask("status")["safe"] if r["begun_s"] >= begun_s]
            rested_s = sum((r["ended_s"] or end_s) - r["begun_s"] for r in rests)
            # A request that was just being sent when the bridge stopped still goes out.
            assert end_s - begun_s - rested_s < 0.05, rests
        finally:
            rig.nodes.signal("valve_bridge", signal.SIGCONT)
            rig.nodes.signal("pid", signal.SIGCONT)
        rig.follows()


def test_kill_9_of_the_target(rig):
    def attempt():
        watch, since = rig.watch("pid"), rig.graph.mark()
        try:
            begun_s, known_s = rig.nodes.kill("target")
            wait_for(lambda: rig.lab.volts() == CLOSED_V)
            history = rig.lab.ask("history")["history"]
            assert history[-1]["volts"]["voltage"] == CLOSED_V
            at_s = history[-1]["steady_s"]
            watch.judge(at_s, begun_s, known_s)
            rig.graph.wait_until_told("pid: control", "no target: safe voltage", since)
            assert rig.lab.resting_since() is None
        finally:
            rig.relaunch("target")
            wait_for(lambda: rig.lab.volts() != CLOSED_V, 20.0)

    in_good_time(attempt)


def test_kill_9_of_the_lab(rig):
    """Nothing holds the valves any more; what is left waits, and goes on with the next device."""
    pids, since = rig.nodes.pids(), rig.graph.mark()
    rig.nodes.kill("lab")
    del pids["lab"]
    rig.graph.wait_until_told("bridge: bus", "", since)
    rig.graph.wait_until_told("bridge: safety", "holding: bus", since)
    rig.graph.wait_until_told("pid: control", "no pressure reading: safe voltage", since)
    since = rig.graph.mark()
    rig.lab.start()
    assert rig.lab.ask("history")["history"][0]["volts"]["voltage"] == 0.0
    rig.follows()
    rig.graph.wait_until_told("bridge: safety", "following", since)
    rig.graph.wait_until_told("pid: control", "tracking", since)
    assert pids.items() <= rig.nodes.pids().items()


@pytest.mark.long
def test_two_publishers_of_commands(rig):
    def attempt():
        rig.follows()
        watch, since = rig.watch(), rig.graph.mark()
        begun_s = time.monotonic()
        other = rig.graph.probe.create_publisher(ValveCommand, COMMANDS, common.COMMAND_QOS)
        known_s = time.monotonic()
        try:
            watch.safe(begun_s, known_s)
            rig.graph.wait_until_told("bridge: safety", "2 publishers", since)
        finally:
            rig.graph.probe.destroy_publisher(other)

    in_good_time(attempt)
    rig.follows()


@pytest.fixture(scope="class")
def no_controller(rig):
    assert rig.nodes.end("pid") == 0
    yield
    rig.relaunch("pid")
    rig.follows(20.0)


@pytest.mark.usefixtures("no_controller")
class TestWithoutTheController:
    """The test itself commands the valves."""

    @pytest.fixture
    def commands(self, rig):
        """A message that is published at 250 Hz, as it is at the time, and its publisher."""
        publisher = rig.graph.probe.create_publisher(ValveCommand, COMMANDS, common.COMMAND_QOS)
        message = ValveCommand(name=["voltage"], voltage_v=[6.0])
        sending, over = threading.Lock(), []

        def send():  # in the thread that spins, which must not meet a closed publisher
            with sending:
                if not over:
                    publisher.publish(message)

        timer = rig.graph.probe.create_timer(0.004, send)
        try:
            rig.follows()
            yield message, publisher
        finally:
            with sending:
                over.append(True)
            rig.graph.probe.destroy_timer(timer)
            rig.graph.probe.destroy_publisher(publisher)

    @pytest.mark.long
    @pytest.mark.parametrize("volts", [math.nan, math.inf, -math.inf, 1e9, -50.0])
    def test_commands_that_make_no_sense(self, rig, commands, volts):
        message, _ = commands

        def attempt():
            message.voltage_v = [6.0]
            rig.follows()
            watch, since = rig.watch(), rig.graph.mark()
            begun_s = time.monotonic()
            message.voltage_v = [volts]
            watch.safe(begun_s)
            rig.graph.wait_until_told("bridge: safety", "command voltage: none", since)

        in_good_time(attempt)
        message.voltage_v = [10.5]  # a little too much is clamped
        wait_for(lambda: rig.lab.volts() == 10.0)

    @pytest.mark.long
    def test_commands_faster_than_the_bridge_are_not_worked_off_later(self, rig, commands):
        """They come as fast as they can be sent; when they end the valves are safe in time."""
        message, publisher = commands

        def attempt():
            message.voltage_v = [6.0]
            rig.follows()
            watch = rig.watch()
            end_s = time.monotonic() + 1.0
            sent = 0
            while (last_s := time.monotonic()) < end_s:
                message.voltage_v = [5.5 + sent % 100 * 0.01]
                publisher.publish(message)
                sent += 1
            message.voltage_v = [math.nan]
            watch.safe(last_s)
            return sent

        assert in_good_time(attempt) > 500

    def test_what_is_forged_arrives(self, rig):
        """Or else the test of malformed payloads would show nothing."""
        good = serialize_message(ValveCommand(name=["voltage"], voltage_v=[7.25]))
        numbers = itertools.count(1)

        def arrives():
            send(rig.nodes.pids()["valve_bridge"], data(gid, next(numbers), good))
            return rig.lab.reached(7.25, 0.0) is not None

        with forger(rig, COMMANDS, ValveCommand) as gid:
            wait_for(arrives)


@contextlib.contextmanager
def forger(rig, topic, kind):
    """The identity of a writer that others know and that never writes anything."""
    session = Session(rig.domain, environment={"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"})
    try:
        node = session.add_node("/", "forger")
        package, part, *_ = kind.__module__.split(".")
        name = f"{package}/{part}/{kind.__name__}"
        writer = session.create_publication(node, topic, name, EndpointQos())
        wait_for(lambda: writer.matched_count() > 0)
        time.sleep(0.2)  # for the other side to know it as well
        yield writer.gid
    finally:
        session.close()


def payloads(rng):
    """Contents of messages that are none, or not of the type."""
    yield b""
    yield CDR_LE
    yield CDR_LE + b"\xff" * 64
    yield b"\x00\x03" + b"\0\0" + b"\1" * 40  # another encoding
    yield CDR_LE + b"\0" * 8 + (2**31).to_bytes(4, "little") + b"x" * 16
    for _ in range(40):
        yield CDR_LE + rng.randbytes(rng.randrange(1, 200))


FORGED = {
    "valve_bridge": (COMMANDS, ValveCommand(name=["voltage"], voltage_v=[7.0])),
    "pid": ("/lab/target", PressureTarget(tap="end", step_s=0.02, pressure_pa=[3e5])),
    "recorder": ("/lab/taps/end/pressure", FluidPressure(fluid_pressure=2e5)),
}


@pytest.mark.long
def test_malformed_payloads_and_packets(rig):
    """Forged in the name of a writer that the nodes know, and thrown at every socket they have."""
    rng = random.Random(5)
    pids, since = rig.nodes.pids(), rig.graph.mark()
    for name, (topic, sample) in FORGED.items():
        with forger(rig, topic, type(sample)) as gid:
            number = 1
            for payload in payloads(rng):
                send(pids[name], data(gid, number, payload))
                number += 1
            for _ in range(100):
                send(
                    pids[name],
                    rng.randbytes(rng.randrange(1, 300)),
                    HEADER + rng.randbytes(rng.randrange(12, 300)),
                    mutated(rng, data(gid, number, serialize_message(sample))),
                )
    rig.graph.wait_until_told("bridge: safety", "2 publishers", since)
    since = rig.graph.mark()
    rig.follows()
    rig.graph.wait_until_told("pid: control", "tracking", since)
    rig.graph.wait_until_told("recorder: bag", "recording", since)
    assert rig.nodes.pids() == pids


def mutated(rng, packet):
    """A packet with some bytes changed."""
    changed = bytearray(packet)
    for _ in range(rng.randrange(1, 8)):
        changed[rng.randrange(20, len(changed))] = rng.randrange(256)
    return bytes(changed)


def test_a_subscriber_that_hangs_holds_nobody_up(rig):
    """The recorder, which listens to everything, and reliably so."""
    rig.nodes.signal("recorder", signal.SIGSTOP)
    try:
        in_good_time(lambda: rig.stays_undisturbed(2.0))
        since = rig.graph.mark()
        rig.graph.wait_until_told("bridge: safety", "following", since)
    finally:
        since = rig.graph.mark()
        rig.nodes.signal("recorder", signal.SIGCONT)
    rig.graph.wait_until_told("recorder: bag", "recording", since)


@pytest.fixture
def small_disk(tmp_path):
    """A folder that fills up: fill(pid) and free(pid), and what the system says then."""
    small = tmp_path / "small"
    small.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=4m", "none", str(small)]
    if subprocess.run(mount, capture_output=True, check=False).returncode == 0:
        ballast = small / "ballast"
        ballast.write_bytes(bytes((4 << 20) - (1 << 17)))
        yield small, lambda pid: None, lambda pid: ballast.unlink(), "No space left on device"
        subprocess.run(["umount", str(small)], check=True)
    else:  # no right to mount: files that may not grow

        def limit(pid, size):
            resource.prlimit(pid, resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))

        yield (
            small,
            lambda pid: limit(pid, 1 << 17),
            lambda pid: limit(pid, resource.RLIM_INFINITY),
            "File too large",
        )


@pytest.mark.long
def test_disk_full_while_recording(rig, small_disk):
    folder, fill, free, text = small_disk
    pids, since = rig.nodes.pids(), rig.graph.mark()
    words = ["-m", "pneu_common.cli", "run", "pneu_graph", "recorder", "--ros-args"]
    words += ["-r", "__node:=other", "-p", f"uri:={folder / 'bag'}"]
    rig.nodes.start("other", [sys.executable, *words])
    try:
        wait_for((folder / "bag").exists, 20.0)
        fill(rig.nodes.pids()["other"])
        status = rig.graph.wait_until_told("other: bag", f"cannot write: {text}", since, 30.0)
        assert status.level == b"\2"
        found = BagReader(folder / "bag")
        assert found.metadata.message_count > 100 and not found.files[0].damage
        in_good_time(lambda: rig.stays_undisturbed(0.5))
        since = rig.graph.mark()
        free(rig.nodes.pids()["other"])
        rig.graph.wait_until_told("other: bag", "recording", since)
        time.sleep(1.0)
    finally:
        log = rig.nodes.log("other").read_text
        assert rig.nodes.end("other") == 1, log()  # it says that it is not whole
        assert "messages were lost" in log()
    whole = BagReader(folder / "bag")
    assert whole.files[0].indexed
    assert whole.metadata.message_count > found.metadata.message_count + 100
    with AnyReader([folder / "bag"]) as bag:
        assert sum(1 for _ in bag.messages()) == whole.metadata.message_count
    assert pids.items() <= rig.nodes.pids().items()


def test_the_recording_is_intact(rig):
    """Everything that the recorder saw since it was started, with what was told meanwhile.

    It stood still for two seconds and heard floods: if it lost anything of that, it says how much.
    """
    status, log = rig.nodes.end("recorder"), rig.nodes.log("recorder").read_text()
    found = BagReader(rig.bag)
    lost = found.metadata.custom_data.get(LOST_KEY, "")
    assert status == (1 if lost else 0), log
    for topic, count in (one.split() for one in lost.split(", ") if one):
        assert f"{topic}: {count} messages never came" in log
        assert int(count) > 0
    assert all(file.indexed for file in found.files)
    with AnyReader([rig.bag]) as bag:
        by_topic = {c.topic: c for c in bag.connections}
        readings = [by_topic["/lab/taps/end/pressure"]]
        stamps = [
            common.from_stamp(bag.deserialize(raw, c.msgtype).header.stamp)
            for c, _, raw in bag.messages(readings)
        ]
        told = [
            status.message
            for c, _, raw in bag.messages([by_topic["/diagnostics"]])
            for status in bag.deserialize(raw, c.msgtype).status
        ]
    assert len(stamps) > 100
    assert len(set(stamps)) == len(stamps)
    assert "following" in told
