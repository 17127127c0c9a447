# SPDX-License-Identifier: Apache-2.0
"""An arm on the graph: simulated and emulated behind the same topics, stopped, reset, recorded."""

import contextlib
import math
import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from tests.live_graph import Graph, own_domain, running_graph, wait_for

from geometry_msgs.msg import PoseStamped, WrenchStamped  # isort: skip
from pneu_common.errors import InputError  # isort: skip
from pneu_hw_bridge.nodes.phantom_bridge import PhantomBridge  # isort: skip
from pneu_policy.nodes.push import PushNode  # isort: skip
from pneu_policy.nodes.teleoperate import TeleoperateNode  # isort: skip
from pneu_sim.nodes.hand_simulator import HandSimulator  # isort: skip
from sensor_msgs.msg import Imu, JointState  # isort: skip
from std_srvs.srv import Trigger  # isort: skip

pytestmark = [pytest.mark.realtime, pytest.mark.takes(20)]

ROOT = Path(__file__).parents[1]
HAND = ROOT / "scenes/phantom/hand.yaml"
PUSHING = ROOT / "scenes/phantom/pushing.yaml"
TELEOPERATION = ROOT / "scenes/phantom/teleoperation.yaml"
POLICY = ROOT / "policies/push_ensemble_0.npz"
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


@contextlib.contextmanager
def emulated(devices: Path, udp: int, web: int) -> Iterator[None]:
    """An arm and its force sensor in a process of their own: at 2 kHz they need all its turns."""
    parameters = {"hand": HAND, "devices": devices, "net_ft_port": udp, "net_ft_web_port": web}
    words = [sys.executable, "-m", "pneu_graph.tools.run", "pneu_hw_bridge", "hand_lab"]
    words += ["--ros-args", *(w for k, v in parameters.items() for w in ("-p", f"{k}:={v}"))]
    process = subprocess.Popen(words)
    try:
        wait_for(lambda: process.poll() is not None or (devices / "phantom.sock").exists())
        yield
    finally:
        process.terminate()
        process.wait(20.0)


def test_an_emulated_arm_behind_its_bridge_does_too_and_stops(graph: Graph, tmp_path: Path) -> None:
    udp, web = free_port(socket.SOCK_DGRAM), free_port(socket.SOCK_STREAM)
    with emulated(tmp_path, udp, web):
        arm_behind_its_bridge(graph, tmp_path, udp, web)


def arm_behind_its_bridge(graph: Graph, devices: Path, udp: int, web: int) -> None:
    got = listen(graph)
    bridge = graph.add(
        PhantomBridge,
        hand=str(HAND),
        device=f"emulated:{devices}/phantom.sock",
        net_ft_host="127.0.0.1",
        net_ft_port=udp,
        net_ft_web_port=web,
        watchdog_s=0.5,
        device_timeout_s=0.1,
        sensor_timeout_s=0.1,
    )
    graph.run_in_executor(bridge.trigger_configure)
    hold = Hold(graph, -0.1)
    time.sleep(0.5)
    assert not got["joints"] or abs(got["joints"][-1].position[2]) < 0.05  # it is not active
    graph.run_in_executor(bridge.trigger_activate)
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
    time.sleep(0.3)
    assert not any(got["joints"][-1].effort), "a reset alone moves nothing"
    graph.run_in_executor(bridge.trigger_deactivate)
    graph.run_in_executor(bridge.trigger_activate)
    wait_for(lambda: reaches(got, 0.1))
    graph.run_in_executor(bridge.end)


def test_a_bridge_without_a_device_says_so(graph: Graph, tmp_path: Path) -> None:
    bridge = graph.add(
        PhantomBridge,
        hand=str(HAND),
        device=f"emulated:{tmp_path}/none.sock",
        net_ft_host="127.0.0.1",
        net_ft_web_port=free_port(1),
        wait_s=0.0,
    )
    assert graph.run_in_executor(bridge.trigger_configure).name == "FAILURE"
    graph.run_in_executor(bridge.end)


def test_a_policy_pushes_what_is_simulated_along_its_path(graph: Graph) -> None:
    """As off its path as in simulated time, though other work takes the processor."""
    poses = graph.listen(PoseStamped, "object/pose")
    targets = graph.listen(PoseStamped, "object/target")
    node = graph.add(PushNode, hand=str(PUSHING), policy=str(POLICY), seconds=2.5, seed=1)
    graph.add(HandSimulator, hand=str(PUSHING), rate=0.5, command_timeout_s=1.0)
    wait_for(node.done.done, 30.0)

    def table(messages: list[PoseStamped]) -> np.ndarray:
        stamps = [m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec for m in messages]
        places = [(m.pose.position.x, m.pose.position.y) for m in messages]
        return np.column_stack([stamps, places])

    where, wanted = table(poses), table(targets)
    assert len(wanted) > 100 and np.ptp(wanted[:, 1:], axis=0).min() > 0.02
    there = np.column_stack([np.interp(wanted[:, 0], where[:, 0], where[:, k]) for k in (1, 2)])
    assert np.sqrt(np.mean(np.sum((there - wanted[:, 1:]) ** 2, axis=1))) < 0.006


def test_arms_are_not_commanded_where_nobody_sees_what_is_pushed(graph: Graph) -> None:
    told = graph.listen(JointState, "two/command")
    graph.add(PushNode, hand=str(PUSHING), policy=str(POLICY))
    arms = {
        name: graph.probe.create_publisher(JointState, f"{name}/joint_states", 1)
        for name in ("one", "two", "three")
    }
    sight = graph.probe.create_publisher(PoseStamped, "object/pose", 1)
    at_ns, seen, where_m = [0], [False], [0.0]

    def say() -> None:
        at_ns[0] += 5_000_000
        for publisher in arms.values():
            message = JointState(name=NAMES, position=[0.0] * 3, velocity=[0.0] * 3)
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(at_ns[0], 10**9)
            publisher.publish(message)
        if seen[0]:
            pose = PoseStamped()
            pose.pose.position.x = where_m[0]
            pose.header.stamp.sec, pose.header.stamp.nanosec = divmod(at_ns[0], 10**9)
            sight.publish(pose)

    graph.probe.create_timer(0.005, say)
    time.sleep(1.0)
    assert not told
    seen[0] = True
    wait_for(lambda: any(len(m.effort) for m in told), 20.0)  # it has begun to push
    assert any(len(m.position) for m in told)

    def commanded() -> bool:
        time.sleep(0.5)
        count = len(told)
        time.sleep(0.5)
        return len(told) > count

    assert commanded()
    where_m[0] = math.nan
    assert not commanded()
    where_m[0] = 0.0
    assert commanded()
    seen[0] = False
    assert not commanded()


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"policy": ""}, "parameter policy: found nothing"),
        ({"policy": "none.npz"}, "none.npz: no such policy file"),
        ({"policy": str(ROOT / "policies/short_pde_0.npz")}, "pneu_push_policy"),
        ({"hand": str(HAND)}, "trained with arms one, two, three, .* has phantom"),
        ({"thing": "cup"}, "parameter thing: found 'cup'"),
    ],
)
def test_a_node_that_cannot_push_says_why(graph: Graph, change: dict[str, str], says: str) -> None:
    with pytest.raises(InputError, match=says):
        graph.add(PushNode, **({"hand": str(PUSHING), "policy": str(POLICY)} | change))


def test_the_follower_goes_where_the_leader_is_and_is_felt(graph: Graph) -> None:
    follow = graph.listen(JointState, "phantom/command")
    feel = graph.listen(JointState, "leader/command")
    graph.add(TeleoperateNode, hand=str(TELEOPERATION), feedback=0.5)
    at = {"leader": [0.1, 0.0, -0.1], "phantom": [0.05, 0.0, -0.1]}
    told = {
        name: graph.probe.create_publisher(JointState, f"{name}/joint_states", 1) for name in at
    }
    at_ns = [0]

    def say() -> None:
        at_ns[0] += 5_000_000
        for name, publisher in list(told.items()):
            message = JointState(name=NAMES, position=at[name], velocity=[0.0] * 3)
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(at_ns[0], 10**9)
            publisher.publish(message)

    graph.probe.create_timer(0.005, say)
    wait_for(lambda: follow and abs(follow[-1].position[0] - 0.1) < 1e-5)
    assert follow[0].position[0] == pytest.approx(0.05, abs=1e-3)  # it engages from where it is
    assert list(follow[-1].position) == pytest.approx([0.1, 0.0, -0.1], abs=1e-5)
    wait_for(lambda: feel[-1].effort[0] < -0.0999)
    assert list(feel[-1].effort) == pytest.approx([-0.5 * 4.0 * 0.05, 0.0, 0.0], abs=1e-3)
    del told["phantom"]  # its bridge has ended
    time.sleep(0.5)
    count = len(follow)
    time.sleep(0.5)
    assert len(follow) == count


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"leader": "mine"}, "parameter leader: found 'mine'"),
        ({"leader": "phantom"}, "two arms alike are needed"),
        ({"hand": ""}, "parameter hand: found nothing"),
    ],
)
def test_a_node_that_cannot_couple_says_why(
    graph: Graph, change: dict[str, str], says: str
) -> None:
    with pytest.raises(InputError, match=says):
        graph.add(TeleoperateNode, **({"hand": str(TELEOPERATION)} | change))


@pytest.mark.long
def test_a_recording_by_teleoperation_is_read_by_the_scene(tmp_path: Path) -> None:
    from pneu_sysid.contacts.read import read_tracks
    from pneu_sysid.contacts.scene import load_scene

    bag = tmp_path / "bag"
    words = [
        sys.executable, "-m", "pneu_common.cli", "launch", "pneu_bringup",
        "teleoperate.launch.yaml", f"hand:={TELEOPERATION}", f"record:={bag}", "seconds:=3.0",
        "rate:=0.25", "patience:=10.0", f"devices:={tmp_path}/dev",
    ]  # fmt: skip
    environment = os.environ | {"PNEU_STATE_DIR": str(tmp_path / "state"), "ROS_DOMAIN_ID": "76"}
    with contextlib.suppress(subprocess.TimeoutExpired):
        subprocess.run(words, env=environment, timeout=120, check=False)
    (track,) = read_tracks([bag], load_scene(ROOT / "scenes/phantom/hanging.yaml"))
    assert track.span_s[1] - track.span_s[0] > 3.0
    force = track.sensors["phantom_force"].values
    assert np.ptp(np.linalg.norm(force, axis=1)) > 0.2  # it has touched


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
