# SPDX-License-Identifier: Apache-2.0
"""Every fault of a Kokoro against bus and supervisor together: both valves safe in time."""

import time

import pytest
from tests.bridges import quickly, safe_since, watch
from tests.robots import FAULTS, UP, KokoroRig, kokoro_lab

from pneu_hw_bridge.safety.supervisor import State

pytestmark = [pytest.mark.realtime, pytest.mark.takes(15)]

SAYS = {
    "the encoder freezes": ("elbow is frozen at",),
    # Between two readings that a busy machine took late nothing is a jump, but too fast.
    "the encoder jumps": ("elbow jumped by", "elbow moves at"),
    "the encoder shows more than the joint may": ("below its limit -0.935",),
    "the joint swings beyond its limit": ("above its limit 0.3",),
}
"""What trips, and why; the other faults hold."""


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    with kokoro_lab(tmp_path_factory.mktemp("robot"), "--seed", "3") as lab:
        yield lab


@pytest.fixture
def healthy(robot):
    robot.ask("clear")
    yield robot
    robot.ask("clear")


# A dead bus is tried quickly on the whole graph, in test_robot_graph.py.
@pytest.mark.parametrize("name", quickly(FAULTS, set(FAULTS) - {"the bus to one valve is dead"}))
def test_both_valves_are_safe_in_time(name, healthy, wait_until):
    begin, encoder = FAULTS[name]
    with KokoroRig(healthy, **encoder) as rig:
        judge = watch(healthy).judge
        begun_s = begin(rig)
        wait_until(lambda: not any(healthy.ask("status")["volts"].values()), 2.0)
        time.sleep(0.2)
        judge(safe_since(healthy)[0], begun_s)
        report = rig.link.report()
        if name not in SAYS:
            assert report.state is State.HOLDING
            return
        assert report.state is State.TRIPPED, report.reason
        assert any(said in report.reason for said in SAYS[name]), report.reason
        healthy.ask("clear")
        time.sleep(1.5)
        assert rig.state is State.TRIPPED, "until it is reset"
        wait_until(lambda: not rig.reset(), 5.0)  # vented, the arm falls back
        rig.fall_silent()


def test_a_healthy_arm_swings_over_the_place_where_the_encoder_begins_anew(healthy, wait_until):
    with KokoroRig(healthy) as rig:
        for _ in range(2):
            rig.rest_below()
            rig.target = UP
            wait_until(lambda: rig.link.report().readings["elbow"] > 0.8, 5.0)
            assert rig.follows(), rig.link.report().reason


def test_an_arm_that_is_too_fast_trips(healthy, wait_until):
    with KokoroRig(healthy, speed_limit=1.0) as rig:
        rig.rest_below()
        rig.target = UP
        wait_until(lambda: rig.state is State.TRIPPED, 5.0)
        assert "above its limit 1" in rig.link.report().reason
        wait_until(lambda: not any(healthy.ask("status")["volts"].values()), 2.0)
