# SPDX-License-Identifier: Apache-2.0
"""An arm on the graph: simulated and emulated behind the same topics, stopped, reset, recorded."""

import contextlib
import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.live_graph import Graph, own_domain, running_graph, wait_for

from geometry_msgs.msg import PoseStamped, WrenchStamped  # isort: skip
from pneu_hw_bridge.nodes.hand_lab import HandLab  # isort: skip
from pneu_hw_bridge.nodes.phantom_bridge import PhantomBridge  # isort: skip
from pneu_sim.nodes.hand_simulator import HandSimulator  # isort: skip
from sensor_msgs.msg import Imu, JointState  # isort: skip
from std_srvs.srv import Trigger  # isort: skip

pytestmark = pytest.mark.realtime

ROOT = Path(__file__).parents[1]
HAND = ROOT / "scenes/phantom/hand.yaml"
NAMES = ["waist", "shoulder", "linkage"]


@pytest.fixture
def graph(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Graph]:
    monkeypatch.setenv("PNEU_STATE_DIR", str(tmp_path / "state"))
    with own_domain(), running_graph() as one:
        yield one


def listen(graph: Graph) -> dict[str, list]:
    return {
        "joints": graph.listen(JointState, "phantom/joint_states"),
        "wrench": graph.listen(WrenchStamped, "phantom/wrench"),
        "imu": graph.listen(Imu, "object/imu"),
        "pose": graph.listen(PoseStamped, "object/pose"),
    }


class Hold:
    """Commands a position, 200 times a second."""

    def __init__(self, graph: Graph, linkage_rad: float) -> None:
        self.at = [0.0, 0.0, linkage_rad]
        self._publisher = graph.probe.create_publisher(JointState, "phantom/command", 1)
        self._timer = graph.probe.create_timer(0.005, self._say)

    def _say(self) -> None:
        self._publisher.publish(JointState(name=NAMES, position=self.at))


def reaches(got: dict[str, list], linkage_rad: float) -> bool:
    joints = got["joints"]
    return bool(joints) and abs(joints[-1].position[2] - linkage_rad) < 0.02


def test_a_simulated_arm_goes_where_it_is_told(graph: Graph) -> None:
    got = listen(graph)
    graph.add(HandSimulator, hand=str(HAND))
    Hold(graph, -0.1)
    wait_for(lambda: reaches(got, -0.1))
    wait_for(lambda: all(len(v) > 20 for v in got.values()))
    assert list(got["joints"][-1].name) == NAMES
    assert got["imu"][-1].linear_acceleration.z == pytest.approx(9.81, abs=0.5)
    assert got["wrench"][-1].wrench.force.z == pytest.approx(0.022 * 9.81, abs=0.1)


def free_port(kind: int) -> int:
    with socket.socket(socket.AF_INET, kind) as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


def test_an_emulated_arm_behind_its_bridge_does_too_and_stops(graph: Graph, tmp_path: Path) -> None:
    udp, web = free_port(socket.SOCK_DGRAM), free_port(socket.SOCK_STREAM)
    got = listen(graph)
    graph.add(HandLab, hand=str(HAND), devices=str(tmp_path), net_ft_port=udp, net_ft_web_port=web)
    bridge = graph.add(
        PhantomBridge,
        hand=str(HAND),
        device=f"emulated:{tmp_path}/phantom.sock",
        net_ft_host="127.0.0.1",
        net_ft_port=udp,
        net_ft_web_port=web,
        watchdog_s=0.5,
        device_timeout_s=0.1,
        sensor_timeout_s=0.1,
    )
    bridge.trigger_configure()
    hold = Hold(graph, -0.1)
    time.sleep(0.5)
    assert not got["joints"] or abs(got["joints"][-1].position[2]) < 0.05  # it is not active
    bridge.trigger_activate()
    wait_for(lambda: reaches(got, -0.1))
    wait_for(lambda: all(len(v) > 20 for v in got.values()))
    stamps = [m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec for m in got["joints"]]
    assert stamps == sorted(stamps)

    answer = graph.call(Trigger, "phantom_bridge/e_stop", Trigger.Request())
    assert answer.success
    assert answer.message == "torques are zero"
    hold.at = [0.0, 0.0, 0.1]
    time.sleep(0.3)
    assert not any(got["joints"][-1].effort)
    assert "called for by service" in graph.status("phantom_bridge: safety").message
    assert graph.call(Trigger, "phantom_bridge/reset_e_stop", Trigger.Request()).success
    wait_for(lambda: reaches(got, 0.1))
    bridge.end()


def test_a_bridge_without_a_device_says_so(graph: Graph, tmp_path: Path) -> None:
    bridge = graph.add(
        PhantomBridge,
        hand=str(HAND),
        device=f"emulated:{tmp_path}/none.sock",
        net_ft_host="127.0.0.1",
        net_ft_web_port=free_port(1),
        wait_s=0.0,
    )
    assert bridge.trigger_configure().name == "FAILURE"
    bridge.end()


@pytest.mark.long
def test_a_launch_file_records_an_exercise_that_the_scene_reads(tmp_path: Path) -> None:
    from pneu_sysid.contacts.read import read_tracks
    from pneu_sysid.contacts.scene import load_scene

    environment = os.environ | {
        "PNEU_STATE_DIR": str(tmp_path / "state"),
        "ROS_DOMAIN_ID": "78",
    }
    for backend in ("sim", "emulated"):
        bag = tmp_path / backend
        words = [
            sys.executable, "-m", "pneu_common.cli", "launch", "pneu_bringup",
            "hand.launch.yaml", f"backend:={backend}", f"hand:={HAND}", f"record:={bag}",
            "seconds:=2.0", "patience:=10.0", f"devices:={tmp_path}/dev",
        ]  # fmt: skip
        with contextlib.suppress(subprocess.TimeoutExpired):
            subprocess.run(words, env=environment, timeout=60, check=False)
        loaded = load_scene(ROOT / "scenes/phantom/hanging.yaml")
        (track,) = read_tracks([bag], loaded)
        assert track.span_s[1] - track.span_s[0] > 2.0
        force = track.sensors["phantom_force"].values
        assert abs(float(force[:, 2].mean()) - 0.022 * 9.81) < 0.1
