# SPDX-License-Identifier: Apache-2.0
"""What the tests of the bridge share: a lab in a process of its own, and patience."""

import json
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import pytest

from pneu_hw_bridge.lab.asking import ask
from pneu_runtime import hook

hook.install()  # before any test imports rclpy

ROOT = Path(__file__).parents[3]
RIG = ROOT / "rigs" / "lab.yaml"


def wait_until(condition, timeout_s=5.0, pause_s=0.002):
    """Waits until something is true; returns how long that took."""
    begun = time.monotonic()
    while not condition():
        if time.monotonic() - begun > timeout_s:
            raise TimeoutError(f"not within {timeout_s} s")
        time.sleep(pause_s)
    return time.monotonic() - begun


@pytest.fixture(name="wait_until")
def patience():
    """Waits until something is true; returns how long that took."""
    return wait_until


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
    command = [sys.executable, "-m", "pneu_sim.cli", "lab", "--rig", str(RIG)]
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


@pytest.fixture
def start_lab():
    """Runs a lab of one's own."""
    return running_lab


@pytest.fixture
def rig_file():
    """The rig of the labs."""
    return RIG


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """A lab that the tests of a module share."""
    with running_lab(tmp_path_factory.mktemp("lab"), "--seed", "7") as one:
        yield one


@pytest.fixture(scope="module")
def logging_lab(tmp_path_factory):
    """The same behind a device with a clock of its own."""
    options = ("--seed", "7", "--registers", "logging_plc")
    with running_lab(tmp_path_factory.mktemp("lab"), *options) as one:
        yield one


@pytest.fixture
def healthy_lab(lab):
    """The shared lab, without faults before and after."""
    lab.ask("clear")
    yield lab
    lab.ask("clear")
