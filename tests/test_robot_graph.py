# SPDX-License-Identifier: Apache-2.0
"""The graph with a Kokoro behind Modbus: faults from the lab's encoder to both of its valves."""

import math
import os
import signal
import time

import pytest
from tests.bridges import wait_until
from tests.live_graph import own_domain, running_graph, wait_for
from tests.live_rig import ALMOST_S, LaunchedNodes, activate_anew
from tests.measured import MachineStalledError, Watch
from tests.robots import KOKORO, SEEN_S, STOP, kokoro_lab

from sensor_msgs.msg import JointState  # isort: skip
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage

from pneu_graph.nodes import common

pytestmark = [pytest.mark.realtime, pytest.mark.takes(40)]

OVERRIDES = """
/**/excite:
  ros__parameters:
    swing: true
    low_v: 1.5
    high_v: 8.5
    shortest_s: 0.9
    longest_s: 0.9
"""
RESET = "/lab/valve_bridge/reset_e_stop"


class Robot:
    """Lab, bridge, controller and view of a Kokoro."""

    def __init__(self, folder, lab, graph):
        self.lab, self.graph = lab, graph
        self.nodes = LaunchedNodes(
            folder,
            OVERRIDES,
            rig=KOKORO,
            registers="kokoro_plc",
            controller="excite",
            view="true",
            backend="modbus",
            port=lab.port,
        )

    def swings(self):
        """Waits until the arm is driven from stop to stop.

        An arm of an emulated lab that does not get to run stands still, and the bridge rightly
        trips; it is reset then, for the next try.
        """
        watch, begun_s = self.watch(), time.monotonic()
        wait_for(lambda: any(self.lab.ask("status")["volts"].values()) or self.tripped(), 40.0)
        for sign in (-1.0, 1.0):
            wait_until(lambda s=sign: s * self.elbow() > STOP or self.tripped(), 10.0, 0.001)
        if told := self.tripped():
            stalled_s = watch.stalled_s(begun_s, time.monotonic())
            self.mend()
            text = f"without any fault {told}; the machine stalled for {stalled_s:.3f} s"
            assert stalled_s > ALMOST_S, text
            raise MachineStalledError(text)

    def tripped(self):
        """What the bridge says where it has tripped; empty where it has not."""
        if self.resting_since() is None:
            return ""
        told = self.graph.status("bridge: safety").message
        return told if told.startswith("tripped") else ""

    def elbow(self):
        return self.lab.ask("status")["encoders"]["elbow"]

    def watch(self):
        return Watch(self.lab, [self.lab.process.pid, *self.nodes.pids().values(), os.getpid()])

    def resting_since(self):
        rest = self.lab.ask("status")["safe"][-1]
        return None if rest["ended_s"] is not None else rest["begun_s"]

    def mend(self):
        """Has everything work again."""
        self.lab.ask("clear")
        wait_for(lambda: abs(self.elbow()) < 0.93, 5.0)
        wait_for(lambda: self.graph.call(Trigger, RESET, Trigger.Request()).success, 10.0)
        activate_anew(self.graph, "/lab/valve_bridge")


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    folder = tmp_path_factory.mktemp("robot")
    with own_domain(), running_graph() as graph, kokoro_lab(folder) as lab:
        one = Robot(folder, lab, graph)
        one.nodes.launch()
        try:
            yield one
            assert not one.nodes.complaints()
        finally:
            one.nodes.close()


def killed(robot):
    before_s, _ = robot.nodes.kill("excite")
    return before_s


def frozen(robot):
    wait_until(lambda: robot.elbow() < -STOP, 10.0, 0.001)
    time.sleep(0.2)
    wait_until(lambda: robot.elbow() > -0.7, 10.0, 0.0005)
    begun_s = robot.lab.ask("fault", name="frozen", channel="elbow")["steady_s"]
    if robot.elbow() > 0.5:
        raise MachineStalledError("the arm was past the middle before the encoder froze")
    return begun_s


def jumps(robot):
    wait_until(lambda: robot.elbow() < -STOP, 10.0, 0.001)
    before_s = time.monotonic()
    begun_s = robot.lab.ask("fault", name="jump", channel="elbow", value=1.3)["steady_s"]
    if begun_s - before_s > SEEN_S:
        raise MachineStalledError(f"the lab was asked for {begun_s - before_s:.3f} s")
    return begun_s


def beyond(robot):
    return robot.lab.ask("fault", name="out_of_range", channel="elbow", value=1.1)["steady_s"]


def dead(robot):
    return robot.lab.ask("fault", name="dead_valve", channel="rod")["steady_s"]


# What an encoder may report is tried on the bridge alone too, in test_robot_faults.py.
@pytest.mark.parametrize(
    "begin",
    [dead, *(pytest.param(one, marks=pytest.mark.long) for one in (frozen, killed, jumps, beyond))],
)
def test_both_valves_are_safe_in_time(robot, begin):
    robot.swings()
    watch = robot.watch()
    try:
        begun_s = begin(robot)
        wait_for(lambda: robot.resting_since() is not None, 3.0)
        time.sleep(0.2)
        assert robot.resting_since() is not None
        watch.judge(robot.resting_since(), begun_s)
        if begin not in (dead, killed):
            told = robot.graph.status("bridge: safety")
            assert told.message.startswith("tripped: encoder: elbow"), told.message
            robot.lab.ask("clear")
            time.sleep(1.2)
            assert robot.resting_since() is not None, "until somebody resets it"
    finally:
        robot.mend()
        if begin is killed:
            robot.nodes.launch("excite")


@pytest.mark.long
def test_the_bridge_says_where_the_arm_is_and_the_view_how_its_link_stands(robot):
    robot.swings()
    told = robot.graph.listen(JointState, "/joint_states", common.READINGS_QOS)
    frames = robot.graph.listen(TFMessage, "/tf", 100)
    wait_for(lambda: len(told) > 200 and len(frames) > 20)
    assert all(list(m.name) == ["elbow"] and not len(m.velocity) for m in told)
    places = [m.position[0] for m in told]
    assert min(places) > -1.0 and max(places) < 1.0
    stamps = [common.from_stamp(m.header.stamp) for m in told]
    assert stamps == sorted(stamps) and abs(stamps[-1] - time.time_ns()) < 5e9
    by_stamp = dict(zip(stamps, places, strict=True))
    shown = [m.transforms[0] for m in list(frames)]
    same = [
        (by_stamp[at], 2.0 * math.atan2(t.transform.rotation.y, t.transform.rotation.w))
        for t in shown
        if (at := common.from_stamp(t.header.stamp)) in by_stamp
    ]
    assert len(same) > 5
    assert all(a == pytest.approx(b, abs=1e-9) for a, b in same)
    assert {t.child_frame_id for t in shown} == {"arm_link"}


def test_a_bridge_that_is_killed_leaves_both_valves_to_the_device(robot):
    robot.swings()
    watch = robot.watch()
    before_s, _ = robot.nodes.signal("valve_bridge", signal.SIGKILL)
    wait_for(lambda: robot.resting_since() is not None, 3.0)
    watch.judge(robot.resting_since(), before_s)
