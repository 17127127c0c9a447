# SPDX-License-Identifier: Apache-2.0
"""How soon valves are safe is known, told, and kept however slow a device is, or none is moved."""

import math
import time
from collections import deque

import pytest
import rclpy
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.parameter import Parameter
from tests.bridges import Rig, safe_since, watch
from tests.domains import own_domain_id
from tests.modbus_devices import Owner

from pneu_common.errors import InputError
from pneu_hw_bridge.link import Link
from pneu_hw_bridge.modbus.bus import ModbusBus
from pneu_hw_bridge.modbus.statistics import Durations
from pneu_hw_bridge.nodes.valve_bridge import ValveBridge
from pneu_hw_bridge.registers.load import load_register_map
from pneu_hw_bridge.safety.bound import bound, check
from pneu_hw_bridge.safety.limits import limits_of
from pneu_hw_bridge.safety.supervisor import State, Supervisor

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


# Each term of each time. No two of them are alike, nor are any sums or differences of two.

TERMS = {
    "period": 0.0625,
    "write": 0.015625,
    "watchdog": 0.09375,
    "sensor": 0.078125,
    "device": 0.25,
}
PARTS = {
    # The controller is silent: its last command is followed for the watchdog's time.
    "silent_s": {"watchdog", "write"},
    # A pressure rises just after a reading: it is seen a period later.
    "told_s": {"period", "write"},
    # The last reading counts until it is stale.
    "stale_s": {"sensor", "write"},
    # Nothing can be written any more: the device acts by itself.
    "dead_s": {"device"},
}


def bound_of(period, write, watchdog, sensor, device):
    registers = MAP.model_copy(
        update={"device": MAP.device.model_copy(update={"watchdog_s": device})}
    )
    # Its watchdog is the one now: shorter than the setting where the device is slow.
    limits = limits_of(registers, watchdog_s=0.1, sensor_timeout_s=sensor)
    return bound(registers, limits, period, write, watchdog)


@pytest.mark.parametrize("name", list(PARTS))
def test_each_time_is_the_sum_of_its_terms_and_of_no_others(name):
    found = getattr(bound_of(**TERMS), name)
    assert found == sum(TERMS[term] for term in PARTS[name])
    for term in TERMS:
        longer = {**TERMS, term: TERMS[term] + 0.03125}
        grown = getattr(bound_of(**longer), name) - found
        assert grown == (0.03125 if term in PARTS[name] else 0.0), term


def test_each_time_is_told_with_what_it_is_for():
    found = bound_of(**TERMS)
    assert found.by_event() == {
        "a silent controller": 0.109375,
        "a bad reading or a stop": 0.078125,
        "the last reading": 0.09375,
        "a dead line or bridge": 0.25,
    }
    assert str(found) == (
        "valves are safe 0.109 s after the last command, 0.078 s after a reading or a stop that"
        " calls for it, 0.094 s after the last reading, and after the line is cut or the bridge"
        " killed: 0.250 s"
    )


TICK_S = 2.0**-10
STEPS = 512


@pytest.mark.parametrize(
    ("event", "name"), [("command", "silent_s"), ("over", "told_s"), ("reading", "stale_s")]
)
def test_no_moment_of_an_event_is_worse_than_its_time(event, name):
    """The state machine step by step, with an event at each moment between two readings.

    What is written is there ``write`` later. The longest time found is the promised one, short of
    a step.
    """
    worst_s = 0.0
    period, write = round(TERMS["period"] / TICK_S), TERMS["write"]
    for at in range(128, 128 + period):
        limits = limits_of(MAP, watchdog_s=TERMS["watchdog"], sensor_timeout_s=TERMS["sensor"])
        one = Supervisor(limits)
        one.bus("")
        one.publishers(1)
        one.enable()
        last = at // period * period  # of the readings before
        for k in range(STEPS):
            now_s = 64.0 + TICK_S * k
            if k % period == 0 and not (event == "reading" and k > last):
                for place, tap in enumerate(limits.sensors):
                    over = event == "over" and k > at and tap == "end"
                    one.reading(tap, (1.4e6 if over else 3e5) + 10.0 * place + k, now_s)
            if not (event == "command" and k > at):
                one.command({"voltage": 7.0}, now_s)
            open_ = one.output(now_s) != one.safe()
            if k > at and not open_:
                break
            assert open_ or k < 8
        since_s = 64.0 + TICK_S * (last if event == "reading" else at)
        worst_s = max(worst_s, now_s + write - since_s)
    promised_s = getattr(bound_of(**TERMS), name)
    assert promised_s - TICK_S <= worst_s <= promised_s + TICK_S


class Fixed(Durations):
    """Durations that stay as they are, whatever is measured."""

    def add(self, duration_s):
        pass


def milliseconds(*durations):
    return Fixed(deque(1e-3 * one for one in durations))


def test_quantiles_of_durations():
    assert math.isnan(Durations().quantile(0.5))
    durations = Durations()
    for k in (4, 1, 10, 7, 2, 9, 3, 8, 6, 5):
        durations.add(float(k))
    assert [durations.quantile(f) for f in (0.0, 0.1, 0.5, 0.85, 0.95, 1.0)] == [
        1.0,
        2.0,
        6.0,
        9.0,
        10.0,
        10.0,
    ]
    for _ in range(2000):
        durations.add(0.5)
    assert durations.quantile(1.0) == 0.5, "of the latest alone"


@pytest.mark.parametrize(
    ("lines", "readable", "reads"), [(1, True, 4), (1, False, 2), (2, True, 2), (2, False, 1)]
)
def test_how_long_a_write_and_the_next_reading_take_at_most(lines, readable, reads):
    """Of one request to read and one to write; replies take 1 to 20 ms."""
    bus = ModbusBus(MAP, Owner(), 0.0078125)
    assert math.isnan(bus.takes_s(0.5)) and bus.reads_s(0.95) == 0.0078125
    bus.statistics.reply = milliseconds(*range(1, 21))
    bus.lines, bus._reader.readable = lines, readable
    # Every 5 ms the owner is asked; one request may be on its way before the write.
    assert bus.takes_s(0.5) == pytest.approx(0.005 + 2 * 0.011)
    assert bus.takes_s(0.95) == pytest.approx(0.005 + 2 * 0.020)
    assert bus.reads_s(0.95) == pytest.approx(reads * 0.020)
    assert bus.reads_s(0.0) == 0.0078125, "replies of 1 ms take less than the period"
    bus.stop()


def test_the_bus_tells_its_owner_both_quantiles_in_their_order(server, wait_until):
    owner = Owner()
    bus = ModbusBus(load_register_map("generic_plc", {"port": server.port}), owner)
    bus.statistics.reply = milliseconds(*range(1, 21))
    bus.start()
    try:
        wait_until(lambda: hasattr(owner, "takes_s"))
    finally:
        bus.stop()
    mostly_s, usually_s = owner.takes_s
    assert (mostly_s, usually_s) == (pytest.approx(0.045), pytest.approx(0.027))


def test_the_owner_hands_both_quantiles_on_in_their_order():
    one = Supervisor(limits_of(MAP))
    link = Link(one, lambda: None)
    link.takes(0.1, 0.0625)
    assert link.watchdog_s == pytest.approx(0.05)
    assert not any("too slow" in reason for reason in one.reasons(64.0))
    link.takes(0.0625, 0.14)
    assert link.watchdog_s == pytest.approx(0.0875)
    assert any("safe after 0.16 s at best" in reason for reason in one.reasons(64.0))


def test_the_bridge_promises_its_times_by_replies_as_they_are(server, monkeypatch, tmp_path):
    """The node itself; of its replies 95 of 100 take 20 ms at most, and half of them 11 ms."""
    monkeypatch.setenv("PNEU_STATE_DIR", str(tmp_path))
    context = rclpy.Context()
    rclpy.init(args=[], context=context, domain_id=own_domain_id())
    values = {
        "port": server.port,
        "rate_hz": 125.0,
        "watchdog_s": 0.0625,
        "sensor_timeout_s": 0.09375,
    }
    node = ValveBridge(
        context=context,
        parameter_overrides=[Parameter(name, value=value) for name, value in values.items()],
    )
    try:
        monkeypatch.setattr(ModbusBus, "start", lambda bus: None)  # replies are what they are
        assert node.on_configure(None) == TransitionCallbackReturn.SUCCESS
        bus = node._bus
        bus.lines = 2
        bus.statistics.reply = milliseconds(*range(1, 21))
        bus.statistics.request = milliseconds(*range(1, 101))
        bus.statistics.command = milliseconds(*range(201, 301))
        (shown,) = [one for one in node._report() if one.name.endswith(": bus")]
    finally:
        node.on_cleanup(None)
        node.destroy_node()
        context.try_shutdown()
    found = {one.key: float(one.value) for one in shown.values if one.key.endswith(" [s]")}
    write_s = 0.005 + 2 * 0.020
    assert found == {
        "safe after a silent controller [s]": pytest.approx(0.0625 + write_s),
        "safe after a bad reading or a stop [s]": pytest.approx(2 * 0.020 + write_s),
        "safe after the last reading [s]": pytest.approx(0.09375 + write_s),
        "safe after a dead line or bridge [s]": pytest.approx(0.1),
        "request p50 [s]": pytest.approx(0.051),
        "request p99 [s]": pytest.approx(0.100),
        "command to confirmation p50 [s]": pytest.approx(0.251),
        "command to confirmation p99 [s]": pytest.approx(0.300),
    }


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
        assert rig.reset() == ""
        wait_until(lambda: lab.volts() == 5.5)
        judge = watch(lab).judge
        begun_s = lab.ask("fault", name="out_of_range", channel="end", value=9.5e5)["steady_s"]
        wait_until(lambda: rig.state is State.TRIPPED)
        wait_until(lambda: lab.volts() == 0.0)
        judge(safe_since(lab)[0], begun_s)
        lab.ask("clear", name="out_of_range")
        wait_until(lambda: rig.reset() == "")
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
