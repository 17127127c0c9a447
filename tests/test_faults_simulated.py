# SPDX-License-Identifier: Apache-2.0
"""Faults of the whole graph on simulated time: the clock jumps back, the simulator is killed.

The table of all faults, and where each is tested, is in ``test_faults.py``.
"""

import threading
import time

import pytest

from tests.live_graph import own_domain, running_graph, wait_for  # isort: skip

from pneu_msgs.msg import ValveCommand
from pneu_msgs.srv import ResetSimulator
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rosbags.highlevel import AnyReader
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import FluidPressure
from tests.live_rig import LaunchedNodes

from pneu_graph.bag.metadata import LOST_KEY
from pneu_graph.bag.reader import BagReader
from pneu_graph.nodes import common

pytestmark = [pytest.mark.realtime, pytest.mark.takes(15)]

CLOSED_V = 5.0
END = "/lab/taps/end/pressure"


class Rig:
    """Everything that runs, and what it says."""

    def __init__(self, folder, graph):
        self.graph, self.bag = graph, folder / "bag"
        self.nodes = LaunchedNodes(folder, "", backend="sim", use_sim_time="true")
        graph.mark()
        self.clock = graph.listen(Clock, "/clock", common.COMMAND_QOS)
        self.commands = graph.listen(ValveCommand, "/lab/valve/command", common.COMMAND_QOS)
        self.nodes.launch(record=self.bag)

    def now_s(self):
        return common.from_stamp(self.clock[-1].clock) * 1e-9

    def tracks(self, since, seconds=20.0):
        self.graph.wait_until_told("pid: control", "tracking", since, seconds)
        self.graph.wait_until_told("simulator: commands", "commands arrive", since, seconds)

    def recorded(self):
        """Messages that the recorder has written, as it says itself."""
        status = self.graph.wait_until_told("recorder: bag", "recording", self.graph.mark())
        return int(next(v.value for v in status.values if v.key == "written"))


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    with own_domain(), running_graph() as graph:
        rig = Rig(tmp_path_factory.mktemp("rig"), graph)
        try:
            rig.tracks(0, 40.0)
            wait_for(lambda: rig.recorded() > 100, 20.0)
            yield rig
        finally:
            rig.nodes.close()


@pytest.fixture(autouse=True)
def nothing_else_ends(rig):
    yield
    assert not rig.nodes.complaints()


def jumps(status):
    return int(next(v.value for v in status.values if v.key == "jumps of the clock"))


@pytest.mark.long
def test_clock_jumps_back(rig):
    pids, recorded, since = rig.nodes.pids(), rig.recorded(), rig.graph.mark()
    wait_for(lambda: rig.now_s() > 2.0, 20.0)
    before = jumps(rig.graph.wait_until_told("pid: control", "tracking", since))
    since, count = rig.graph.mark(), len(rig.commands)
    assert rig.graph.call(ResetSimulator, "/lab/simulator/reset", ResetSimulator.Request()).success
    wait_for(lambda: rig.now_s() < 2.0)
    rig.tracks(since)
    after = [m for m in rig.commands[count:] if common.from_stamp(m.header.stamp) < 2e9]
    # What belongs to the time before is forgotten: the valve stays closed until it is known anew.
    assert after[0].voltage_v[0] == CLOSED_V
    opened = next(m for m in after if m.voltage_v[0] != CLOSED_V)
    assert common.from_stamp(opened.header.stamp) < 1.5e9
    assert all(0.0 <= m.voltage_v[0] <= 10.0 for m in after)
    status = rig.graph.wait_until_told("pid: control", "tracking", rig.graph.mark())
    assert jumps(status) > before
    assert rig.recorded() > recorded
    assert rig.nodes.pids() == pids


@pytest.mark.long
def test_kill_9_of_the_simulator(rig):
    since = rig.graph.mark()
    pids = rig.nodes.pids()
    rig.nodes.kill("simulator")
    del pids["simulator"]
    rig.graph.wait_until_told("pid: control", "the clock stands still", since)
    count = len(rig.commands)
    time.sleep(0.3)
    assert len(rig.commands) == count  # no time, no commands
    recorded, since = rig.recorded(), rig.graph.mark()
    rig.nodes.launch("simulator")
    wait_for(lambda: rig.now_s() < 1.0, 20.0)
    rig.tracks(since)
    assert rig.recorded() > recorded
    assert pids.items() <= rig.nodes.pids().items()


@pytest.mark.long
def test_kill_9_of_the_controller(rig):
    since = rig.graph.mark()
    rig.nodes.kill("pid")
    text = "no new command for voltage: safe state"
    status = rig.graph.wait_until_told("simulator: commands", text, since)
    assert {v.key: v.value for v in status.values}["voltage (V)"] == f"{CLOSED_V:g}"
    assert common.from_stamp(rig.commands[-1].header.stamp) * 1e-9 < rig.now_s() - 0.1
    since = rig.graph.mark()
    rig.nodes.launch("pid")
    rig.tracks(since)


@pytest.mark.long  # test_faults.py has a subscriber that hangs
@pytest.mark.parametrize("reliability", [ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT])
def test_a_subscriber_slower_than_the_publisher(rig, reliability):
    """It gets what is new, and nobody else gets less for it."""
    slow = Node("slow")
    got, ages = [], []

    def work(message):
        time.sleep(0.25)  # 60 messages come meanwhile
        got.append(common.from_stamp(message.header.stamp))
        ages.append(rig.now_s() - got[-1] * 1e-9)

    qos = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=1, reliability=reliability)
    slow.create_subscription(FluidPressure, END, work, qos)
    executor = SingleThreadedExecutor()
    executor.add_node(slow)
    thread = threading.Thread(target=executor.spin, daemon=True)
    fast = rig.graph.listen(FluidPressure, END)
    wait_for(lambda: len(fast) > 10)
    thread.start()
    try:
        since, recorded = rig.graph.mark(), rig.recorded()
        wait_for(lambda: len(got) > 8, 20.0)
        stamps = [common.from_stamp(m.header.stamp) for m in list(fast)[-400:]]
        rig.tracks(since)
        assert rig.recorded() > recorded + 500
    finally:
        executor.shutdown()
        thread.join(5.0)
        slow.destroy_node()
    assert got == sorted(got)
    assert max(ages[1:]) < 0.6  # the newest message, not the oldest that waits
    expected = (stamps[-1] - stamps[0]) / 4e6 + 1
    assert len(stamps) > 0.9 * expected


@pytest.mark.long
def test_the_recording_is_intact(rig):
    """Readable, though its time was set back in the middle; what it lost it reports."""
    status, log = rig.nodes.end("recorder"), rig.nodes.log("recorder").read_text()
    found = BagReader(rig.bag)
    assert status == (1 if found.metadata.custom_data.get(LOST_KEY) else 0), log
    assert all(file.indexed for file in found.files)
    with AnyReader([rig.bag]) as bag:
        counts = {}
        for connection, _, _ in bag.messages():
            counts[connection.topic] = counts.get(connection.topic, 0) + 1
    assert sum(counts.values()) == found.metadata.message_count
    assert {END, "/clock", "/diagnostics", "/lab/valve/command", "/lab/target"} <= set(counts)
    assert counts[END] > 1000
