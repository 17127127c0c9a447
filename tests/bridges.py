# SPDX-License-Identifier: Apache-2.0
"""Bus and supervisor in front of a lab, with a controller, and when the valves were safe."""

import json
import os
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import pytest
from tests.measured import PATIENCE_S, Watch

from pneu_hw_bridge.lab.asking import ask
from pneu_hw_bridge.link import Link
from pneu_hw_bridge.modbus.bus import ModbusBus
from pneu_hw_bridge.registers.load import load_register_map
from pneu_hw_bridge.safety.limits import limits_of
from pneu_hw_bridge.safety.supervisor import State, Supervisor

ROOT = Path(__file__).parents[1]
RIG = ROOT / "rigs" / "lab.yaml"


def quickly(names, quick):
    """Return parameters of a test, of which some run where time is short and the others long.

    Args:
        names: All of them.
        quick: Those that run always.
    """
    return [one if one in quick else pytest.param(one, marks=pytest.mark.long) for one in names]


def wait_until(condition, timeout_s=5.0, pause_s=0.002, alive=None):
    """Waits until something is true, with patience; returns how long that took.

    Args:
        condition: What is waited for.
        timeout_s: Longest wait, s, if it is longer than `PATIENCE_S`.
        pause_s: Interval at which the condition is evaluated, s.
        alive: Whether what is to bring it about still runs; the wait fails at once if not.
    """
    begun, patience_s = time.monotonic(), max(timeout_s, PATIENCE_S)
    while not condition():
        assert alive is None or alive(), "what is waited for has ended"
        if time.monotonic() - begun > patience_s:
            raise TimeoutError(f"not within {patience_s} s")
        time.sleep(pause_s)
    return time.monotonic() - begun


class RunningLab:
    """A lab process and its ports."""

    def __init__(self, process, ports):
        self.process = process
        self.port = ports["modbus_port"]
        self.control_port = ports["control_port"]

    def ask(self, what, **details):
        return ask(self.control_port, {"do": what, **details})

    def volts(self):
        return self.ask("status")["volts"]["voltage"]


@contextmanager
def running_lab(folder, *options):
    """Runs `pneu lab` as a user does."""
    ready = folder / f"ready{time.monotonic_ns()}.json"
    command = [sys.executable, "-m", "pneu_common.cli", "lab", "--rig", str(RIG)]
    command += ["--port", "0", "--control-port", "0", "--dx", "0.1", "--ready-file", str(ready)]
    process = subprocess.Popen(
        [*command, *options], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        wait_until(lambda: ready.exists() or process.poll() is not None, 120.0, 0.05)
        assert process.poll() is None, process.stderr.read()
        yield RunningLab(process, json.loads(ready.read_text()))
    finally:
        process.terminate()
        process.communicate(timeout=10)


def watch(lab):
    """Judges times from now on; the bus runs in this process."""
    return Watch(lab, [lab.process.pid, os.getpid()])


class Rig:
    """Bus and supervisor with a controller that sends 500 commands a second."""

    def __init__(self, port, profile="generic_plc", period_s=0.002):
        self.set_up(load_register_map(profile, {"port": port}), period_s)

    def set_up(self, registers, period_s, **limits):
        limits = limits_of(registers, **limits)
        self.link = Link(Supervisor(limits), lambda: None, device_time=registers.clock is not None)
        self.bus = ModbusBus(registers, self.link, period_s)
        self.volts = 5.5
        self._silent = threading.Event()
        self._thread = threading.Thread(target=self._control, daemon=True)

    def __enter__(self):
        self.bus.start()
        self.link.publishers(1)
        self.link.enable(True)
        self._thread.start()
        return self

    def __exit__(self, *error):
        self._silent.set()
        self._thread.join(1.0)
        self.link.enable(False)
        self.bus.vent()
        self.bus.stop()

    def _control(self):
        while not self._silent.wait(0.002):
            if not self.link.command(self.commands()):
                self.bus.poke()

    def commands(self):
        """What the controller commands."""
        return {"voltage": self.volts}

    def reset(self):
        """Releases stop and trip, and activates anew; returns why not."""
        refused = self.link.reset()
        if not refused:
            self.link.enable(True)
        return refused

    def fall_silent(self):
        """Has the controller send no more commands."""
        self._silent.set()

    @property
    def state(self):
        """State of the supervisor, while the thread of the bus runs."""
        assert self.bus._thread.is_alive(), "the thread of the bus has ended"
        return self.link.report().state

    def follows(self):
        return self.state is State.FOLLOWING


def safe_since(lab):
    """When all valves had the safe voltage that they have kept from then on, and by whom."""
    changes = lab.ask("history")["history"]
    assert not any(changes[-1]["volts"].values()), changes[-3:]
    last = max(i for i, change in enumerate(changes) if any(change["volts"].values()))
    return changes[last + 1]["steady_s"], changes[last + 1]["cause"]
