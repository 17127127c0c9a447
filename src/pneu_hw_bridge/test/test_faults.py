# SPDX-License-Identifier: Apache-2.0
"""Every fault of the lab against bus and supervisor together: safe in time, and back by itself."""

import os
import threading
import time

import pytest
from tests.measured import Watch

from pneu_hw_bridge.lab.faults import KINDS
from pneu_hw_bridge.link import Link
from pneu_hw_bridge.modbus.bus import ModbusBus
from pneu_hw_bridge.registers.load import load_register_map
from pneu_hw_bridge.safety.limits import limits_of
from pneu_hw_bridge.safety.supervisor import State, Supervisor


def watch(lab):
    """Judges times from now on; the bus runs in this process."""
    return Watch(lab, [lab.process.pid, os.getpid()])


class Rig:
    """Bus and supervisor with a controller that sends 500 commands a second."""

    def __init__(self, port, profile="generic_plc", period_s=0.002):
        registers = load_register_map(profile, {"port": port})
        self.link = Link(Supervisor(limits_of(registers)), lambda: None)
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
            if not self.link.command({"voltage": self.volts}):
                self.bus.poke()

    @property
    def state(self):
        return self.link.report().state

    def follows(self):
        return self.state is State.FOLLOWING


def safe_since(lab):
    """When the valves got the safe voltage that they have kept from then on, and by whom."""
    changes = lab.ask("history")["history"]
    assert changes[-1]["volts"]["voltage"] == 0.0, changes[-3:]
    last = max(i for i, change in enumerate(changes) if change["volts"]["voltage"] != 0.0)
    return changes[last + 1]["steady_s"], changes[last + 1]["cause"]


@pytest.mark.parametrize("name", list(KINDS))
def test_fault(name, healthy_lab, wait_until):
    check_fault(name, healthy_lab, "generic_plc", wait_until)


# Registers that hold a whole reading each have no order that could be wrong.
@pytest.mark.parametrize("name", [name for name in KINDS if name != "word_order"])
def test_fault_of_a_device_with_a_clock(name, logging_lab, wait_until):
    check_fault(name, logging_lab, "logging_plc", wait_until)


def check_fault(name, lab, profile, wait_until):
    channel = "end" if name in ("frozen", "out_of_range") else ""
    with Rig(lab.port, profile) as rig:
        wait_until(rig.follows, 5.0)
        wait_until(lambda: lab.volts() == 5.5)
        time.sleep(0.1)
        judge = watch(lab).judge
        begun_s = lab.ask("fault", name=name, channel=channel, seconds=1.0)["steady_s"]
        time.sleep(0.6)
        judge(safe_since(lab)[0], begun_s)
        report = rig.link.report()
        assert report.reason
        # Which number comes out is chance, or the end of what the registers hold: it may trip.
        if name in ("word_order", "out_of_range") and report.state is State.TRIPPED:
            wait_until(lambda: rig.link.reset() == "", 2.0)
        else:
            assert report.state is State.HOLDING
        wait_until(rig.follows, 4.0)
        wait_until(lambda: lab.volts() == 5.5)


def test_bus_cut_for_five_seconds(healthy_lab, wait_until):
    lab = healthy_lab
    with Rig(lab.port) as rig:
        wait_until(rig.follows, 5.0)
        judge = watch(lab).judge
        begun_s = lab.ask("fault", name="drop", seconds=5.0)["steady_s"]
        time.sleep(4.8)
        judge(safe_since(lab)[0], begun_s)
        assert wait_until(rig.follows, 3.0) < 1.7
        assert rig.bus.statistics.connect_failures < 15


def test_commands_that_end_vent_through_the_bus(healthy_lab, wait_until):
    lab = healthy_lab
    with Rig(lab.port) as rig:
        wait_until(rig.follows, 5.0)
        rig._silent.set()
        judge, begun_s = watch(lab).judge, time.monotonic()
        time.sleep(0.3)
        at_s, cause = safe_since(lab)
    judge(at_s, begun_s)
    assert cause == "write", "the bridge itself vents, before the device's watchdog has to"


def test_e_stop_and_over_pressure_through_the_bus(healthy_lab, wait_until):
    lab = healthy_lab
    with Rig(lab.port) as rig:
        wait_until(rig.follows, 5.0)
        judge, begun_s = watch(lab).judge, time.monotonic()
        rig.link.e_stop("test")
        vented = rig.bus.vent()
        assert vented.verified
        judge(safe_since(lab)[0], begun_s, within_s=0.05)
        assert rig.link.reset() == ""
        wait_until(rig.follows)
        judge = watch(lab).judge
        begun_s = lab.ask("fault", name="out_of_range", channel="end", value=9.5e5)["steady_s"]
        wait_until(lambda: rig.state is State.TRIPPED)
        wait_until(lambda: lab.volts() == 0.0)
        judge(safe_since(lab)[0], begun_s)
        assert "still at" in rig.link.reset()
        lab.ask("clear")
        time.sleep(0.1)
        assert rig.state is State.TRIPPED
        assert rig.link.reset() == ""
        wait_until(rig.follows)
