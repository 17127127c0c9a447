# SPDX-License-Identifier: Apache-2.0
"""The loop of an arm at 2 kHz, and the estimate of state and contact force as readings come in."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.report import Table

ROOT = Path(__file__).resolve().parents[1]
HAND = ROOT / "scenes/phantom/hand.yaml"
SCENE = ROOT / "scenes/phantom/hanging.yaml"
SECONDS = 60.0
RATE_HZ = 2000.0

BARE = """
import json, sys, time
from pneu_hw_bridge.priority import precedence, punctual
seconds, rate = float(sys.argv[1]), float(sys.argv[2])
ticks, missed = [], 0
with precedence():
    punctual()
    next_s = end_s = time.monotonic()
    end_s += seconds
    while next_s < end_s:
        ticks.append(time.monotonic())
        next_s += 1.0 / rate
        left = next_s - time.monotonic()
        if left > 0.0:
            time.sleep(left)
        elif left < -1.0 / rate:
            skipped = int(-left * rate)
            missed += skipped
            next_s += skipped / rate
print(json.dumps({"ticks": ticks, "missed": missed, "cpu": time.process_time()}))
"""

LOOP = """
import json, socket, sys, time
from pathlib import Path
from pneu_hw_bridge.child import packed
from pneu_hw_bridge.phantom.emulated import EmulatedDevice
from pneu_hw_bridge.phantom.governor import Limits
from pneu_hw_bridge.phantom.net_ft import NetFt, read_calibration
from pneu_hw_bridge.phantom.servo import Servo
from pneu_hw_bridge.phantom.wire import packed_command
from pneu_hw_bridge.priority import precedence
from pneu_sim.hand.drive import JointCommand
from pneu_sim.hand.settings import read_hand
seconds, rate, hand, folder, port, web = sys.argv[1:]
arm = read_hand(hand).arms["phantom"]
ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
theirs.setblocking(False)
device = EmulatedDevice(Path(folder) / "phantom.sock")
device.open()
limits = Limits(tuple(arm.joints), tuple(arm.joints.values()), 0.5, 0.1, 0.1, True, 0.1)
servo = Servo(theirs, device, limits, 2, NetFt("127.0.0.1", int(port)),
              read_calibration("127.0.0.1", int(web)))
servo.governor.publishers(1)
servo.governor.enable(True)
ours.setblocking(False)
ticks, end_s, step = [], time.monotonic() + float(seconds), 0
def tick(frame):
    global step
    ticks.append(time.monotonic())
    if ticks[-1] > end_s:
        return None
    step += 1
    if step % 4 == 0:  # a controller at 500 Hz, and a node that takes samples
        ours.send(packed_command([JointCommand(0.1)] * 3, ticks[-1]))
        try:
            while ours.recv(65536):
                pass
        except BlockingIOError:
            pass
    return servo.tick(frame)
with precedence():
    device.run(tick, float(rate))
print(json.dumps({"ticks": ticks, "missed": device.missed, "cpu": time.process_time(),
                  "lost": servo.sensor.received.lost}))
"""


def _row(name: str, told: dict[str, Any]) -> dict[str, Any]:
    ticks = np.array(told["ticks"], dtype=float)
    off = np.abs(np.diff(ticks) - 1.0 / RATE_HZ) * 1e6
    return {
        "loop": name,
        "ticks": len(ticks),
        "missed": told["missed"],
        "p50": float(np.quantile(off, 0.5)),
        "p99": float(np.quantile(off, 0.99)),
        "worst": float(off.max()),
        "cpu": 100.0 * float(told["cpu"]) / float(ticks[-1] - ticks[0]),
    }


def loop() -> Table:
    """The loop beside a process that only sleeps until each tick, at the same time."""
    from pneu_hw_bridge.hand_lab.process import PlantProcess
    from pneu_sim.hand.settings import read_hand

    settings = read_hand(HAND)
    names = {"imu": list(settings.imus), "pose": list(settings.poses), "touch": ["phantom"]}
    table = Table(
        "Arms: a loop at 2 kHz for 60 s",
        "The loop of an arm as a process: the newest frame of an emulated device, commands at 500"
        " Hz, records of a force sensor at 1 kHz, torques, samples for a node at 1 kHz. `Off` is"
        " how far a period is from its nominal length. A process that only sleeps until each tick"
        " runs at the same time, and a third moves the plant: what both miss the machine has"
        " taken.",
        {
            "loop": "loop",
            "ticks": "ticks",
            "missed": "missed",
            "p50": "off p50, us",
            "p99": "off p99, us",
            "worst": "off at worst, us",
            "cpu": "CPU of a core, %",
        },
    )
    with tempfile.TemporaryDirectory() as folder:
        ports = (49252, 8149)
        told = {
            "hand": str(HAND), "truth": "", "devices": folder, "ports": {"phantom": ports},
            "seed": 0, "touch": False, "rate": 1.0, "operator": None,
        }  # fmt: skip
        plant = PlantProcess(told, names, lambda *_: None, lambda: None)
        try:
            words = [str(SECONDS), str(RATE_HZ)]
            running = [
                subprocess.Popen(
                    [sys.executable, "-c", LOOP, *words, str(HAND), folder, *map(str, ports)],
                    stdout=subprocess.PIPE,
                ),
                subprocess.Popen([sys.executable, "-c", BARE, *words], stdout=subprocess.PIPE),
            ]
            outs = [json.loads(one.communicate()[0]) for one in running]
        finally:
            plant.end()
    for name, out in zip(("arm", "sleeps only"), outs, strict=True):
        table.rows.append(_row(name, out))
    return table


def estimate() -> Table:
    """A cycle of the fixed-lag estimate, by the knots of its window."""
    from studies.hand_force import followed, moved

    from pneu_sim.hand.exercise import exercise
    from pneu_sim.hand.loading import Hand
    from pneu_sim.hand.paths import Kinematics
    from pneu_sim.hand.truth import Truth
    from pneu_sysid.contacts.scene import load_scene

    hand, loaded = Hand(HAND), load_scene(SCENE)
    path = exercise(hand, Kinematics(hand, "phantom", "phantom_tip"), "phantom_tip", "object", 5, 1)
    table = Table(
        "Arms: state and contact force as readings come in",
        "11 directions of motion, nine sensors of 240 Hz to 1.8 kHz, an estimate every 10 ms of the"
        " plant's time, one thread.",
        {
            "knots": "knots",
            "window": "window, ms",
            "lag": "lag, ms",
            "p50": "cycle p50, ms",
            "p99": "cycle p99, ms",
        },
    )
    for knots in (12, 16, 24):
        run = moved(hand, Truth(), loaded, 5.0, 1, followed(path), "estimate", knots)
        took = 1e3 * np.array([told[3] for told in run.told][5:])
        lag = 1e3 * float(np.median([told[2] - told[0] for told in run.told]))
        table.rows.append(
            {
                "knots": knots,
                "window": 2.5 * knots,
                "lag": lag,
                "p50": float(np.quantile(took, 0.5)),
                "p99": float(np.quantile(took, 0.99)),
            }
        )
    return table


def measure() -> list[Table]:
    """Measures all of it."""
    return [loop(), estimate()]
