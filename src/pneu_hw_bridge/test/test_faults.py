# SPDX-License-Identifier: Apache-2.0
"""Every fault of the lab against bus and supervisor together: safe in time, and back by itself."""

import time

import pytest
from tests.bridges import Rig, quickly, safe_since, watch

from pneu_hw_bridge.lab.faults import KINDS
from pneu_hw_bridge.safety.supervisor import State

pytestmark = [pytest.mark.realtime, pytest.mark.takes(45)]

WITHOUT_ENCODERS = [name for name, kind in KINDS.items() if kind.at != "encoder"]
CLOCKED = {"drop", "frozen", "silent"}
"""Faults that are tried quickly on the device with a clock; the others on the one without."""
PLACES = {"frozen": "end", "out_of_range": "end", "dead_valve": "voltage"}


# Of the product of faults and devices one each is enough where time is short.
@pytest.mark.parametrize("name", quickly(WITHOUT_ENCODERS, set(WITHOUT_ENCODERS) - CLOCKED))
def test_fault(name, healthy_lab, wait_until):
    check_fault(name, healthy_lab, "generic_plc", wait_until)


# Registers that hold a whole reading each have no order that could be wrong.
@pytest.mark.parametrize(
    "name", quickly([name for name in WITHOUT_ENCODERS if name != "word_order"], CLOCKED)
)
def test_fault_of_a_device_with_a_clock(name, logging_lab, wait_until):
    check_fault(name, logging_lab, "logging_plc", wait_until)


def check_fault(name, lab, profile, wait_until):
    channel = PLACES.get(name, "")
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
        # Which number comes out is chance, or the end of what the registers hold: it may trip,
        # and so it may later, as long as the fault lasts.
        may_trip = name in ("word_order", "out_of_range")
        assert report.state is State.HOLDING or (may_trip and report.state is State.TRIPPED)

        def follows():
            if may_trip and rig.link.report().state is State.TRIPPED:
                rig.reset()
            return rig.follows()

        wait_until(follows, 4.0)
        wait_until(lambda: lab.volts() == 5.5)


@pytest.mark.long
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
        rig.fall_silent()
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
        assert rig.reset() == ""
        wait_until(rig.follows)
        judge = watch(lab).judge
        begun_s = lab.ask("fault", name="out_of_range", channel="end", value=9.5e5)["steady_s"]
        wait_until(lambda: rig.state is State.TRIPPED)
        wait_until(lambda: lab.volts() == 0.0)
        judge(safe_since(lab)[0], begun_s)
        assert "still at" in rig.reset()
        lab.ask("clear")
        time.sleep(0.1)
        assert rig.state is State.TRIPPED
        assert rig.reset() == ""
        wait_until(rig.follows)
