# SPDX-License-Identifier: Apache-2.0
"""An emulated arm whose device, sensor, loop or node goes away: how soon its motors have no torque.

The processes are those that run in a laboratory. What happens when is told by the emulated
amplifier, which knows when its motors lost their torque; what the machine itself was late by is
measured beside it, and where that is too much nothing is proven.
"""

import json
import math
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.measured import PATIENCE_S, MachineStalledError, Stalls

from pneu_common.errors import InputError
from pneu_hw_bridge.child import packed
from pneu_hw_bridge.hand_lab.process import PlantProcess
from pneu_hw_bridge.phantom.governor import STATES, State
from pneu_hw_bridge.phantom.net_ft import read_calibration
from pneu_hw_bridge.phantom.process import ServoProcess
from pneu_hw_bridge.phantom.servo import device_of
from pneu_sim.hand.drive import JointCommand
from pneu_sim.hand.settings import read_hand

pytestmark = pytest.mark.realtime

ROOT = Path(__file__).parents[3]
HAND = ROOT / "scenes/phantom/hand.yaml"
ARM = read_hand(HAND).arms["phantom"]

WITHIN_S = 0.010
"""So soon after it can be known torques must be zero."""
STALLED_S = 0.004
"""A machine that keeps a thread waiting for longer has no say in it."""


def free_ports() -> tuple[int, int]:
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp,
        socket.socket(socket.AF_INET, socket.SOCK_STREAM) as tcp,
    ):
        udp.bind(("127.0.0.1", 0))
        tcp.bind(("127.0.0.1", 0))
        return udp.getsockname()[1], tcp.getsockname()[1]


class Bench:
    """An emulated hand and the loop of its arm, as processes."""

    def __init__(self, folder: Path, device: str = "", library: str = "") -> None:
        self.port, self.web = free_ports()
        self.folder = folder
        self.plant = self._plant()
        self.joints: list[Any] = []
        self.wrenches: list[Any] = []
        self._told = self.settings(device or f"emulated:{folder}/phantom.sock", library)
        self.servo: ServoProcess
        self.open()
        self.effort = 0.1
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._command, daemon=True)
        self._thread.start()

    def _plant(self) -> PlantProcess:
        """The hand, its arm where the scene has it."""
        told: dict[str, Any] = {
            "hand": str(HAND),
            "truth": "",
            "devices": str(self.folder),
            "ports": {"phantom": (self.port, self.web)},
            "seed": 0,
            "touch": False,
            "rate": 1.0,
            "operator": None,
        }
        names = {"imu": ["object"], "pose": ["object"], "touch": ["phantom"]}
        return PlantProcess(told, names, lambda *_: None, lambda: None)

    def put_back(self) -> None:
        """Arm and loop as they begin: one that lost its torque in motion may lie at its stops."""
        self.servo.end()
        self.plant.end()
        self.plant = self._plant()
        self.open()

    def open(self) -> None:
        """Starts the loop, anew where there was one."""
        if hasattr(self, "servo"):
            self.servo.end()
        self.servo = ServoProcess(
            self._told,
            lambda j, w: (self.joints.extend(j), self.wrenches.extend(w)),
            lambda: None,
        )
        self.servo.tell(publishers=[1, ""])
        self.servo.tell(enable=True)

    def settings(self, device: str, library: str) -> dict[str, Any]:
        calibration = read_calibration("127.0.0.1", self.web)
        return {
            "joints": {name: joint.model_dump() for name, joint in ARM.joints.items()},
            "watchdog_s": 0.05,
            "device_timeout_s": 0.005,
            "sensor_timeout_s": 0.008,
            "dwell_s": 0.1,
            "device": device,
            "library": library,
            "sensor": {
                "host": "127.0.0.1",
                "port": self.port,
                "calibration": asdict(calibration),
            },
            "rate_hz": 2000.0,
            "every": 2,
        }

    def _command(self) -> None:
        """Torques that hold the arm at rest but never are zero, 250 times a second."""
        flip = 1.0
        while not self._end.wait(0.004):
            flip = -flip
            at = [JointCommand(0.0, 0.0, flip * self.effort)] * 3
            self.servo.command(at, time.monotonic())

    def wait(self, condition: Callable[[], object], loop: bool = True) -> None:
        """Waits until something is true; fails at once where what brings it about has ended.

        Args:
            condition: What is waited for.
            loop: Whether the loop of the arm has to run for it.
        """
        end_s = time.monotonic() + PATIENCE_S
        while not condition():
            assert not self.plant.ended, f"the emulated hand: {self.plant.ended}"
            assert not (loop and self.servo.ended), f"the loop: {self.servo.ended}"
            assert time.monotonic() < end_s, f"not in time: {self.servo.report}"
            time.sleep(0.01)

    def follow(self) -> None:
        """Waits until torques are given."""
        self.wait(lambda: self.torques() and self.state() is State.FOLLOWING)

    def out_of_range(self) -> bool:
        """Whether the arm lies where its loop lets nobody move it."""
        del self.joints[:]
        self.wait(lambda: self.joints)
        at = self.joints[-1].position_rad
        return not all(
            one.lower_rad <= q <= one.upper_rad
            for q, one in zip(at, ARM.joints.values(), strict=True)
        )

    def state(self) -> State | None:
        report = self.servo.report
        if not report or time.monotonic() - report["at_s"] > 1.0:
            return None  # of a loop that is no more
        return STATES[report["state"]]

    def torques(self) -> bool:
        """Whether the motors have torque."""
        answer = self.plant.ask()
        return bool(answer) and any(answer["torques"]["phantom"])

    def zero_since(self, event_s: float, patience_s: float = 1.0) -> float:
        """How long after an event the motors lost their torque, s."""
        end_s = event_s + patience_s
        while time.monotonic() < end_s:
            answer = self.plant.ask()
            zero_s = answer["zero_s"]["phantom"] if answer else None
            if zero_s is not None and zero_s > event_s - 0.001:
                return float(zero_s) - event_s
            time.sleep(0.002)
        return math.inf

    def close(self) -> None:
        self._end.set()
        self._thread.join()
        self.servo.end()
        self.plant.end()


def prove(stalls: Stalls, took_s: float, within_s: float) -> None:
    """Checks what took how long, or says that the machine was in no state to tell."""
    stalls.close()
    if took_s > within_s and stalls.longest_s > STALLED_S and took_s < math.inf:
        raise MachineStalledError(
            f"torques ended after {1e3 * took_s:.1f} ms, of which the machine stalled for"
            f" {1e3 * stalls.longest_s:.1f} ms"
        )
    assert took_s <= within_s


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    bench = Bench(tmp_path_factory.mktemp("devices"))
    try:
        yield bench
    finally:
        bench.close()


@pytest.fixture
def bench(shared: Bench) -> Bench:
    """The bench, as if it had just begun: without faults, its loop alive, following."""
    shared.plant.tell(arm_fault="none", sensor_fault="none")
    shared.effort = 0.1
    time.sleep(0.1)  # an encoder that jumped has jumped back
    if shared.servo.ended or shared.servo.ask(reset=True).get("refused", "no answer"):
        shared.open()
    else:
        shared.servo.tell(enable=True)  # a reset alone moves nothing
    if shared.out_of_range():
        shared.put_back()
    shared.follow()
    return shared


def test_it_follows_and_tells_what_it_reads(bench: Bench) -> None:
    del bench.joints[:], bench.wrenches[:]
    bench.wait(lambda: min(len(bench.joints), len(bench.wrenches)) >= 300)
    numbers = [w.sample for w in bench.wrenches]
    assert numbers == sorted(set(numbers))
    assert numbers[-1] - numbers[0] < 1.2 * len(numbers)
    weight = 0.022 * 9.81  # the tip hangs on the sensor, while the arm shakes a little
    assert np.mean([w.values[2] for w in bench.wrenches]) == pytest.approx(weight, rel=0.2)


@pytest.mark.parametrize(
    ("fault", "knows_s"),
    [("gone", 0.0), ("frozen", 0.005), ("amplifier", 0.0), ("jump", 0.0)],
)
def test_a_device_that_fails_has_no_torque(bench: Bench, fault: str, knows_s: float) -> None:
    stalls = Stalls()
    event_s = time.monotonic()
    bench.plant.tell(arm_fault=fault)
    prove(stalls, bench.zero_since(event_s), knows_s + WITHIN_S)


@pytest.mark.parametrize("fault", ["silent", "short", "status"])
def test_a_force_sensor_that_fails_ends_torques(bench: Bench, fault: str) -> None:
    knows_s = 0.0 if fault == "status" else 0.008
    stalls = Stalls()
    event_s = time.monotonic()
    bench.plant.tell(sensor_fault=fault)
    prove(stalls, bench.zero_since(event_s), knows_s + WITHIN_S)
    assert bench.state() is State.HOLDING
    assert "force sensor" in bench.servo.report["why"]
    bench.plant.tell(sensor_fault="none")
    bench.follow()  # it comes back by itself


@pytest.mark.parametrize(("fault", "counted"), [("lost", "lost"), ("repeated", "repeated")])
def test_records_lost_or_repeated_are_counted_and_do_no_harm(
    bench: Bench, fault: str, counted: str
) -> None:
    del bench.wrenches[:]
    bench.plant.tell(sensor_fault=fault)
    time.sleep(1.2)
    assert bench.servo.report["sensor"][counted] > 100
    numbers = [w.sample for w in bench.wrenches]
    assert numbers == sorted(set(numbers))
    bench.follow()


def test_a_torque_beyond_its_limit_ends_all(bench: Bench) -> None:
    stalls = Stalls()
    event_s = time.monotonic()
    bench.effort = 0.7
    prove(stalls, bench.zero_since(event_s), 0.004 + WITHIN_S)
    assert "allowed are 0.6 either way" in bench.servo.report["why"]


def test_a_loop_that_is_killed_leaves_no_torque(bench: Bench) -> None:
    stalls = Stalls()
    event_s = time.monotonic()
    os.kill(bench.servo.pid, signal.SIGKILL)
    prove(stalls, bench.zero_since(event_s), WITHIN_S)
    assert bench.servo.ended == "its process has ended"


def test_a_loop_that_hangs_leaves_no_torque(bench: Bench) -> None:
    stalls = Stalls()
    event_s = time.monotonic()
    os.kill(bench.servo.pid, signal.SIGSTOP)
    try:
        prove(stalls, bench.zero_since(event_s), WITHIN_S)
    finally:
        os.kill(bench.servo.pid, signal.SIGCONT)


NODE = """
import json, sys, time
from pneu_hw_bridge.phantom.process import ServoProcess
from pneu_hw_bridge.phantom.servo import device_of
from pneu_sim.hand.drive import JointCommand
servo = ServoProcess(json.loads(sys.argv[1]), lambda j, w: None, lambda: None)
servo.tell(publishers=[1, ""])
servo.tell(enable=True)
flip = 0.1
while True:
    flip = -flip
    servo.command([JointCommand(0.0, 0.0, flip)] * 3, time.monotonic())
    time.sleep(0.004)
"""


def test_a_node_that_is_killed_leaves_no_torque(bench: Bench) -> None:
    bench.servo.end()
    settings = bench.settings(f"emulated:{bench.folder}/phantom.sock", "")
    settings["watchdog_s"] = 1.0  # not what ends them
    node = subprocess.Popen([sys.executable, "-c", NODE, json.dumps(settings)])
    try:
        bench.wait(lambda: node.poll() is not None or bench.torques(), loop=False)
        assert node.poll() is None
        stalls = Stalls()
        event_s = time.monotonic()
        node.kill()
        prove(stalls, bench.zero_since(event_s), WITHIN_S)
    finally:
        node.kill()
        node.wait()


def test_a_stop_answers_once_torques_are_zero(bench: Bench) -> None:
    assert bench.servo.ask(e_stop="a test")["zero"]
    bench.wait(lambda: not bench.torques())
    time.sleep(0.3)
    assert not bench.torques()
    assert bench.servo.ask(reset=True)["refused"] == ""
    time.sleep(0.3)
    assert not bench.torques()
    bench.servo.tell(enable=True)
    bench.follow()


def test_a_device_that_is_not_there_is_one_sentence(tmp_path: Path) -> None:
    for device, says in (
        (f"emulated:{tmp_path}/none.sock", "no emulated device there"),
        ("openhaptics:Left", "'/nowhere/libHD.so': OpenHaptics cannot be used"),
        ("something", "allowed are emulated:SOCKET and openhaptics:NAME"),
    ):
        with pytest.raises(InputError, match=says):
            device_of(device, "/nowhere/libHD.so").open()


@pytest.fixture(scope="session")
def libhd(tmp_path_factory: pytest.TempPathFactory) -> Path:
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("needs a C compiler (cc)")
    library = tmp_path_factory.mktemp("hd") / "libHD.so"
    source = Path(__file__).with_name("hd_emulated.c")
    command = [compiler, "-shared", "-fPIC", "-O1", "-Wall", "-Wextra", "-Werror", "-pthread"]
    subprocess.run([*command, "-o", str(library), str(source)], check=True)
    return library


def test_openhaptics_drives_a_device_with_its_c_interface(libhd: Path, tmp_path: Path) -> None:
    bench = Bench(tmp_path, f"openhaptics:{tmp_path}/phantom.sock", str(libhd))
    try:
        bench.follow()
        del bench.joints[:]
        bench.effort = 0.0
        # It goes on telling; how fast is the machine's affair.
        bench.wait(lambda: len(bench.joints) > 300)
        assert all(j.device_ns < 0 for j in bench.joints)  # HDAPI has no stamps
        bench.effort = 0.1
        bench.follow()
        event_s = time.monotonic()
        bench.plant.tell(arm_fault="gone")
        assert bench.zero_since(event_s) < 0.1
        bench.wait(lambda: bench.servo.ended, loop=False)
        assert "communication error" in bench.servo.ended
    finally:
        bench.close()


def test_openhaptics_says_what_it_has_not(libhd: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="OpenHaptics has no such device"):
        device_of(f"openhaptics:{tmp_path}/none.sock", str(libhd)).open()
    with pytest.raises(InputError, match="OpenHaptics has no such device"):
        device_of("openhaptics:", str(libhd)).open()  # there is no default one


def test_a_loop_whose_device_is_not_there_says_so(tmp_path: Path) -> None:
    settings: dict[str, Any] = {
        "joints": {name: joint.model_dump() for name, joint in ARM.joints.items()},
        "watchdog_s": 0.05, "device_timeout_s": 0.005, "sensor_timeout_s": 0.008, "dwell_s": 0.1,
        "library": "", "sensor": None, "rate_hz": 2000.0, "every": 2,
        "device": f"emulated:{tmp_path}/none.sock",
    }  # fmt: skip
    with pytest.raises(InputError, match="no emulated device there"):
        ServoProcess(settings, lambda j, w: None, lambda: None)


def test_a_message_of_plain_values_is_json() -> None:
    assert packed({"end": True}) == b'J{"end": true}'
