# SPDX-License-Identifier: Apache-2.0
"""What may become of frames between bridge and device: safe in time, and back by itself.

All kinds, several times and beside busy processes: `make faults`.
"""

import time

import pytest
from tests.bridges import Rig, quickly, safe_since, watch
from tests.proxy import LIES, Proxy

from pneu_hw_bridge.modbus.bus import TRIES_OF_TWO
from pneu_hw_bridge.safety.supervisor import State

pytestmark = [pytest.mark.realtime, pytest.mark.takes(20)]


@pytest.fixture
def proxy(healthy_lab):
    one = Proxy(healthy_lab.port)
    yield one
    one.close()


CHANGES = {name: {"lie": lie} for name, lie in LIES.items() if name != "every reply twice"}
CHANGES["replies that are lost"] = {"swallow": True}
AS_OF_THE_DEVICE = {"a garbled reply", "exception replies", "replies that are lost"}


# What a device may do itself is tried quickly in test_faults.py.
@pytest.mark.parametrize("name", quickly(CHANGES, set(CHANGES) - AS_OF_THE_DEVICE))
def test_nothing_that_becomes_of_replies_keeps_valves_open(name, proxy, healthy_lab, wait_until):
    lab = healthy_lab
    with Rig(proxy.port) as rig:
        wait_until(lambda: lab.volts() == 5.5)
        judge, begun_s = watch(lab).judge, time.monotonic()
        for key, value in CHANGES[name].items():
            setattr(proxy, key, value)
        time.sleep(0.5)
        judge(safe_since(lab)[0], begun_s)
        proxy.heal()
        # Random bytes may happen to be a pressure above its limit.
        wait_until(lambda: rig.state is State.TRIPPED or lab.volts() == 5.5, 6.0)


def test_replies_that_come_twice_do_no_harm(proxy, healthy_lab, wait_until):
    with Rig(proxy.port) as rig:
        wait_until(rig.follows)
        proxy.lie = LIES["every reply twice"]
        time.sleep(0.5)
        rig.volts = 4.5
        wait_until(lambda: healthy_lab.volts() in (4.5, 0.0))
        proxy.heal()
        wait_until(lambda: healthy_lab.volts() == 4.5, 6.0)


def test_what_waited_on_the_way_is_not_applied(proxy, healthy_lab, wait_until):
    """Requests are held up; meanwhile the controller falls silent."""
    lab = healthy_lab
    with Rig(proxy.port) as rig:
        wait_until(lambda: lab.volts() == 5.5)
        judge, begun_s = watch(lab).judge, time.monotonic()
        proxy.hold = True
        time.sleep(0.5)
        rig.fall_silent()
        time.sleep(0.3)
        proxy.hold = False
        time.sleep(0.7)
        judge(safe_since(lab)[0], begun_s)


def test_a_device_that_keeps_only_the_latest_connection(proxy, healthy_lab, wait_until):
    """Several connections end early before one is enough, and this one lasts."""
    proxy.ousts = True
    with Rig(proxy.port) as rig:
        wait_until(lambda: rig.bus.statistics.connects > TRIES_OF_TWO, 10.0)
        wait_until(lambda: healthy_lab.volts() == 5.5, 10.0)
        connects = rig.bus.statistics.connects
        time.sleep(0.5)
        assert (rig.bus.lines, rig.bus.statistics.connects) == (1, connects)


def test_a_device_that_serves_one_connection(proxy, healthy_lab, wait_until):
    proxy.most = 1
    with Rig(proxy.port) as rig:
        wait_until(lambda: healthy_lab.volts() == 5.5, 10.0)
        assert rig.bus.lines == 1
        judge, begun_s = watch(healthy_lab).judge, time.monotonic()
        rig.fall_silent()
        time.sleep(0.3)
        judge(safe_since(healthy_lab)[0], begun_s)
