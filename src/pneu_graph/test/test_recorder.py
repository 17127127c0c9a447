# SPDX-License-Identifier: Apache-2.0
"""Recorder and player on a graph of several processes."""

import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from tests.domains import own_domain_id

from pneu_graph.bag.reader import BagReader
from pneu_graph.bag.recover import recover_bag

pytestmark = pytest.mark.realtime

GENUINE = Path(__file__).parent / "data" / "rosbag2_zstd"
PRESSURE = "/rig/taps/end/pressure"

TALKER = """
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import FluidPressure
from std_msgs.msg import String

rclpy.init()
try:
    node = rclpy.create_node("talker", namespace="/rig")
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    state = node.create_publisher(String, "state", latched)
    state.publish(String(data="latched"))
    fast = node.create_publisher(FluidPressure, "taps/end/pressure", qos_profile_sensor_data)
    count = 0
    def tick():
        global count
        message = FluidPressure(fluid_pressure=float(count))
        message.header.stamp = node.get_clock().now().to_msg()
        fast.publish(message)
        count += 1
    node.create_timer(0.002, tick)
    rclpy.spin(node)
except (KeyboardInterrupt, ExternalShutdownException):
    pass
finally:
    rclpy.try_shutdown()
"""


@pytest.fixture
def environment(tmp_path):
    return {
        **os.environ,
        "ROS_DOMAIN_ID": str(own_domain_id()),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_LOG_DIR": str(tmp_path / "log"),
    }


@pytest.fixture
def start(environment):
    started = []

    def begin(*words):
        command = [sys.executable, "-m", "pneu_graph.tools", *map(str, words)]
        process = subprocess.Popen(
            command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        started.append(process)
        return process

    yield begin
    for process in started:
        process.kill()
        process.wait()
        process.stdout.close()


def wait_for(condition, timeout_s=40.0):
    deadline = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def count_in(folder):
    try:
        return BagReader(folder).metadata.message_count
    except Exception:  # not there yet, or its first bytes are just being written
        return 0


@pytest.fixture
def talker(start, tmp_path):
    script = tmp_path / "talker.py"
    script.write_text(TALKER)
    return start("run", script)


def stop(process, number=signal.SIGINT):
    process.send_signal(number)
    out, _ = process.communicate(timeout=30)
    return out


@pytest.mark.long
@pytest.mark.usefixtures("talker")
def test_a_recording_is_complete(start, tmp_path):
    rig = tmp_path / "rig.yaml"
    rig.write_text("pneu_rig: 1\n")
    recorder = start("bag", "record", "--all", "-o", tmp_path / "bag", "--attach", rig)
    wait_for(lambda: count_in(tmp_path / "bag") > 1500)
    out = stop(recorder)
    assert (recorder.returncode == 0) == ("never came" not in out), out
    with AnyReader([tmp_path / "bag"]) as bag:
        by_topic = {c.topic: c for c in bag.connections}
        assert {PRESSURE, "/rig/state", "/rosout", "/diagnostics"} <= set(by_topic)
        values = [
            bag.deserialize(data, connection.msgtype).fluid_pressure
            for connection, _, data in bag.messages([by_topic[PRESSURE]])
        ]
        ((_, _, latched),) = bag.messages([by_topic["/rig/state"]])
        assert bag.deserialize(latched, "std_msgs/msg/String").data == "latched"
    missing = values[-1] - values[0] + 1 - len(values)
    assert missing <= 0.01 * len(values)  # best effort, on a machine that is busy with tests
    with next((tmp_path / "bag").glob("*.mcap")).open("rb") as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        attachments = {a.name: a.data.decode() for a in reader.iter_attachments()}
        records = {m.name: m.metadata for m in reader.iter_metadata()}
        late_ns = [m.log_time - m.publish_time for *_, m in reader.iter_messages(PRESSURE)]
    assert 0 < sorted(late_ns)[len(late_ns) // 2] < 50e6
    assert attachments["rig.yaml"] == "pneu_rig: 1\n"
    assert "use_sim_time: false" in attachments["parameters/rig/talker.yaml"]
    assert records["pneu"]["command"]
    channels = {c.topic: c for c in summary.channels.values()}
    assert all(summary.schemas[c.schema_id].data for c in channels.values())
    assert all(c.metadata["topic_type_hash"].startswith("RIHS01_") for c in channels.values())
    assert "reliability: best_effort" in channels[PRESSURE].metadata["offered_qos_profiles"]
    assert "durability: transient_local" in channels["/rig/state"].metadata["offered_qos_profiles"]


@pytest.mark.long
@pytest.mark.usefixtures("talker")
def test_a_killed_recorder_leaves_a_readable_bag(start, tmp_path):
    folder = tmp_path / "bag"
    recorder = start("bag", "record", PRESSURE, "-o", folder)
    wait_for(lambda: count_in(folder) > 1000)
    lost_s = []
    for _ in range(20):  # what is not on the disk yet when a kill comes, at any moment
        time.sleep(0.0317)
        lost_s.append(1e-9 * (time.time_ns() - BagReader(folder).metadata.end_ns))
    assert sorted(lost_s)[len(lost_s) // 2] < 0.1
    killed_ns = time.time_ns()
    stop(recorder, signal.SIGKILL)
    found = BagReader(folder)
    assert not found.files[0].indexed
    assert killed_ns - found.metadata.end_ns < 1.5e9, "on a machine that is busy with tests"
    recover_bag(folder)
    with AnyReader([folder]) as bag:
        assert sum(1 for _ in bag.messages()) == found.metadata.message_count


FLOOD = """
import sys, time
import rclpy
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import String

rate_hz, count, size, stays_s = map(int, sys.argv[1:])
rclpy.init()
node = rclpy.create_node("flood")
quality = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
topics = [node.create_publisher(String, f"flood{k}", quality) for k in range(6)]
while any(topic.get_subscription_count() < 1 for topic in topics):
    time.sleep(0.05)
time.sleep(2.0)  # until what was sent is told for the first time
text = "x" * size
begun = time.monotonic()
for k in range(count):
    if k == count - 1:  # by its number a listener knows how many came before it
        time.sleep(stays_s)
    elif rate_hz:
        time.sleep(max(begun + k / rate_hz - time.monotonic(), 0.0))
    for topic in topics:
        topic.publish(String(data=text))
    if k == 0:
        time.sleep(1.5)
        begun += 1.5
time.sleep(1.0)
node.destroy_node()
rclpy.shutdown()
"""


def recorded(folder):
    return {topic.name: topic.message_count for topic in BagReader(folder).metadata.topics}


@pytest.mark.long
def test_six_thousand_messages_a_second_are_recorded(start, tmp_path):
    script = tmp_path / "flood.py"
    script.write_text(FLOOD)
    recorder = start("bag", "record", "--regex", "/flood.", "-o", tmp_path / "bag")
    assert start("run", script, 1000, 4000, 100, 1).wait(60.0) == 0
    out = stop(recorder)
    assert recorder.returncode == 0, out
    assert recorded(tmp_path / "bag") == {f"/flood{k}": 4000 for k in range(6)}


@pytest.mark.long
def test_what_never_came_is_counted_and_told(start, tmp_path):
    """The recorder stands still for longer than the kernel keeps what comes."""
    script = tmp_path / "flood.py"
    script.write_text(FLOOD)
    folder, count = tmp_path / "bag", 6000
    recorder = start("bag", "record", "--regex", "/flood.", "-o", folder)
    flood = start("run", script, 0, count, 2000, 9)
    wait_for(lambda: count_in(folder) >= 6)
    time.sleep(0.5)
    recorder.send_signal(signal.SIGSTOP)
    time.sleep(5.0)
    recorder.send_signal(signal.SIGCONT)
    assert flood.wait(60.0) == 0
    time.sleep(1.0)
    out = stop(recorder)
    assert recorder.returncode == 1, out
    lost = {topic: count - found for topic, found in recorded(folder).items()}
    assert min(lost.values()) > 10
    told = dict(line.split()[1::1][:2] for line in out.splitlines() if "never came" in line)
    assert {topic.rstrip(":"): int(number) for topic, number in told.items()} == lost
    info = start("bag", "info", folder).communicate(timeout=40)[0]
    assert all(f"{topic} {number}" in info for topic, number in lost.items())


@pytest.mark.long
@pytest.mark.usefixtures("talker")
def test_split_and_snapshot_services(start, tmp_path):
    recorder = start("bag", "record", PRESSURE, "-o", tmp_path / "bag")
    wait_for(lambda: count_in(tmp_path / "bag") > 100)
    asked = start("service", "call", "/recorder/split", "std_srvs/srv/Trigger")
    assert "success=True" in asked.communicate(timeout=40)[0]
    wait_for(lambda: len(BagReader(tmp_path / "bag").files) == 2)
    refused = start("service", "call", "/recorder/snapshot", "std_srvs/srv/Trigger")
    assert "does not run in snapshot mode" in refused.communicate(timeout=40)[0]
    stop(recorder)
    assert recorder.returncode == 0


@pytest.mark.long
@pytest.mark.parametrize("cut", [False, True])
def test_a_genuine_bag_is_replayed(start, tmp_path, cut):
    """Every message arrives byte by byte at a recorder; also from a bag that was cut short."""
    source = tmp_path / "source"
    shutil.copytree(GENUINE, source)
    if cut:
        (source / "metadata.yaml").unlink()
        os.truncate(source / "realbag_zstd_0.mcap", 9000)
    recorder = start("bag", "record", "/again/p", "/rig/joint_states", "-o", tmp_path / "bag")
    wait_for((tmp_path / "bag").exists)
    player = start("bag", "play", source, "--rate", "10", "--delay", "2",
                   "--remap", f"{PRESSURE}:=/again/p")  # fmt: skip
    out, _ = player.communicate(timeout=60)
    assert player.returncode == 0, out
    time.sleep(0.5)
    stop(recorder)
    names = {PRESSURE: "/again/p", "/rig/joint_states": "/rig/joint_states"}
    sent = [(names[m.topic], m.data) for m in BagReader(GENUINE).messages()]
    got = [(m.topic, m.data) for m in BagReader(tmp_path / "bag").messages()]
    assert sorted(got) == sorted(sent)
    topics = {t.name: t for t in BagReader(tmp_path / "bag").metadata.topics}
    assert topics["/again/p"].profiles[0].reliability == "reliable"
    assert topics["/again/p"].type_hash.startswith("RIHS01_22dfb2b145a0bd5a31a1ac38")


@pytest.mark.long
def test_there_is_one_clock(start, tmp_path):
    first = start("bag", "play", GENUINE, "--clock", "50", "--loop")
    shown = start("topic", "echo", "--once", "/clock", "rosgraph_msgs/msg/Clock")
    assert "sec: 17952247" in shown.communicate(timeout=40)[0]
    second = start("bag", "play", GENUINE, "--clock", "50")
    out, _ = second.communicate(timeout=40)
    assert second.returncode == 2
    assert "/clock is published by /player already" in out
    third = start("topic", "pub", "/clock", "rosgraph_msgs/msg/Clock", "--rate", "50")
    giving_up = threading.Timer(60.0, first.kill)
    giving_up.start()
    assert any("/clock has another publisher" in line for line in first.stdout)
    giving_up.cancel()
    stop(third)
    stop(first)
    assert first.returncode == 130
