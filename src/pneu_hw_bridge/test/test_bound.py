# SPDX-License-Identifier: Apache-2.0
"""How soon valves are safe is known, told, and kept however slow a device is, or none is moved."""

import math
import time

import pytest
from tests.bridges import Rig, safe_since, watch

from pneu_common.errors import InputError
from pneu_hw_bridge.registers.load import load_register_map
from pneu_hw_bridge.safety.bound import bound, check
from pneu_hw_bridge.safety.limits import limits_of
from pneu_hw_bridge.safety.supervisor import State

pytestmark = pytest.mark.realtime

MAP = load_register_map("generic_plc")


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("timeout_s", {"timeout_s": 0.2}),
        ("sensor_timeout_s", {"sensor_timeout_s": 0.5}),
        ("rate_hz", {"period_s": 1.0}),
        ("sensor_timeout_s", {"period_s": 0.1}),
        ("device.watchdog_s", {"watchdog_s": 1.0}),
    ],
)
def test_settings_that_are_too_slow_are_refused(name, changes):
    device = MAP.device.model_copy(update={"watchdog_s": changes.pop("watchdog_s", 0.1)})
    registers = MAP.model_copy(update={"device": device})
    limits = {"sensor_timeout_s": changes.pop("sensor_timeout_s", 0.1)}
    settings = {"period_s": 0.002, "timeout_s": 0.1, **changes}
    with pytest.raises(InputError, match=f"^{name}: found"):
        check(registers, limits_of(registers, **limits), **settings)
    limits["safe_within_s"] = 2.0
    if settings["period_s"] != 0.1:  # raised knowingly
        limits["sensor_timeout_s"] = max(limits["sensor_timeout_s"], 1.5 * settings["period_s"])
        check(registers, limits_of(registers, **limits), **settings)


def test_a_killed_bridge_of_a_device_without_watchdog_is_said_to_leave_valves_open():
    registers = load_register_map("labjack_t")
    found = bound(registers, limits_of(registers), 0.002, 0.01, 0.1)
    assert math.isinf(found.dead_s)
    assert "NEVER" in str(found)
    assert bound(MAP, limits_of(MAP), 0.002, 0.01, 0.1).dead_s == 0.1


@pytest.mark.parametrize("reply_s", [0.02, 0.05])
def test_slow_replies(reply_s, healthy_lab, wait_until):
    """Of a silent controller, an over-pressure and a stop the valves are safe in time."""
    lab = healthy_lab
    with Rig(lab.port) as rig:
        wait_until(rig.follows, 5.0)
        assert rig.bus.lines == 2
        lab.ask("fault", name="slow", value=reply_s)
        time.sleep(2.0)
        wait_until(rig.follows, 10.0)
        wait_until(lambda: lab.volts() == 5.5)
        assert 2 * reply_s < rig.bus.takes_s(0.5) < 2 * reply_s + 0.03
        judge, begun_s = watch(lab).judge, time.monotonic()
        rig.link.e_stop("test")
        assert rig.bus.vent().verified
        judge(safe_since(lab)[0], begun_s)
        assert rig.link.reset() == ""
        wait_until(lambda: lab.volts() == 5.5)
        judge = watch(lab).judge
        begun_s = lab.ask("fault", name="out_of_range", channel="end", value=9.5e5)["steady_s"]
        wait_until(lambda: rig.state is State.TRIPPED)
        wait_until(lambda: lab.volts() == 0.0)
        judge(safe_since(lab)[0], begun_s)
        lab.ask("clear", name="out_of_range")
        wait_until(lambda: rig.link.reset() == "")
        wait_until(lambda: lab.volts() == 5.5)
        judge, begun_s = watch(lab).judge, time.monotonic()
        rig.fall_silent()
        time.sleep(0.4)
        judge(safe_since(lab)[0], begun_s)


def test_replies_with_which_no_bound_can_be_kept(healthy_lab, wait_until):
    with Rig(healthy_lab.port) as rig:
        wait_until(rig.follows, 5.0)
        healthy_lab.ask("fault", name="slow", value=0.09)
        wait_until(lambda: "the device is too slow" in rig.link.report().reason, 10.0)
        assert healthy_lab.volts() == 0.0
