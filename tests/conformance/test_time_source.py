# SPDX-License-Identifier: Apache-2.0
"""ROS time: from the system, or from /clock where use_sim_time is set."""

import time

import pytest
from action_msgs.msg import GoalStatusArray
from builtin_interfaces.msg import Time as TimeMsg
from pneu_msgs.action import Identify
from rcl_interfaces.msg import ParameterEvent
from rclpy.action import ActionClient, ActionServer
from rclpy.clock import ClockChange, ClockType, JumpThreshold
from rclpy.duration import Duration
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, qos_profile_action_status_default
from rclpy.time import Time
from rosgraph_msgs.msg import Clock as ClockMsg

pytestmark = pytest.mark.kernel_free


class Simulated:
    """A node on simulated time, and the publisher of that time."""

    def __init__(self, ros):
        self.ros = ros
        self.node = ros.node(
            "simulated", parameter_overrides=[Parameter("use_sim_time", value=True)]
        )
        self.source = ros.node("source")
        self.publisher = self.source.create_publisher(ClockMsg, "/clock", QoSProfile(depth=10))
        assert ros.spin_until(lambda: self.publisher.get_subscription_count() == 1)

    @property
    def now(self):
        return self.node.get_clock().now()

    def publish(self, seconds):
        whole = int(seconds)
        stamp = TimeMsg(sec=whole, nanosec=round((seconds - whole) * 1e9))
        self.publisher.publish(ClockMsg(clock=stamp))

    def set(self, seconds):
        """Publish until the node has it: /clock is best effort."""
        expected = round(seconds * 1e9)

        def there():
            self.publish(seconds)
            self.ros.spin_until(lambda: self.now.nanoseconds == expected, timeout_sec=0.1)
            return self.now.nanoseconds == expected

        assert self.ros.spin_until(there)


@pytest.fixture
def simulated(ros):
    return Simulated(ros)


def test_time_is_the_system_s_by_default(ros):
    node = ros.node("real")
    clock = node.get_clock()
    assert clock.clock_type == ClockType.ROS_TIME
    assert not clock.ros_time_is_active
    assert abs(clock.now().nanoseconds - time.time_ns()) < 1e9


def test_simulated_time_is_zero_before_the_first_message(simulated):
    assert simulated.node.get_clock().ros_time_is_active
    assert simulated.now.nanoseconds == 0


def test_simulated_time_stands_between_messages(simulated):
    simulated.set(12.5)
    time.sleep(0.05)
    simulated.ros.spin_until(lambda: False, timeout_sec=0.1)
    assert simulated.now == Time(seconds=12, nanoseconds=500_000_000, clock_type=ClockType.ROS_TIME)
    simulated.set(13.0)


def test_simulated_time_jumps_back(simulated):
    simulated.set(100.0)
    jumps = []
    threshold = JumpThreshold(
        min_forward=None, min_backward=Duration(seconds=-1), on_clock_change=True
    )
    handle = simulated.node.get_clock().create_jump_callback(
        threshold, post_callback=lambda jump: jumps.append(jump)
    )
    simulated.set(99.5)  # less than the threshold
    assert jumps == []
    simulated.set(10.0)
    assert len(jumps) == 1
    assert jumps[0].clock_change == ClockChange.ROS_TIME_NO_CHANGE
    assert jumps[0].delta == Duration(seconds=-89, nanoseconds=-500_000_000)
    handle.unregister()
    simulated.set(1.0)
    assert len(jumps) == 1


def test_simulated_time_is_switched_on_and_off(ros):
    node = ros.node("switching")
    changes = []
    threshold = JumpThreshold(min_forward=None, min_backward=None, on_clock_change=True)
    handle = node.get_clock().create_jump_callback(
        threshold, post_callback=lambda jump: changes.append(jump.clock_change)
    )
    assert node.set_parameters([Parameter("use_sim_time", value=True)])[0].successful
    assert node.get_clock().ros_time_is_active
    assert node.set_parameters([Parameter("use_sim_time", value=False)])[0].successful
    assert not node.get_clock().ros_time_is_active
    assert abs(node.get_clock().now().nanoseconds - time.time_ns()) < 1e9
    assert changes == [ClockChange.ROS_TIME_ACTIVATED, ClockChange.ROS_TIME_DEACTIVATED]
    handle.unregister()


def test_use_sim_time_has_to_be_a_bool(ros):
    node = ros.node("strict")
    assert not node.set_parameters([Parameter("use_sim_time", value=1)])[0].successful


def test_timers_follow_simulated_time(simulated):
    calls = []
    simulated.set(1.0)
    simulated.node.create_timer(1.0, lambda: calls.append(simulated.now.nanoseconds))
    simulated.ros.spin_until(lambda: calls, timeout_sec=1.2)
    assert calls == []  # a second has passed, but not on this clock
    simulated.set(2.5)
    assert simulated.ros.spin_until(lambda: calls)
    assert calls == [2_500_000_000]


def test_changes_of_parameters_are_stamped_in_simulated_time(simulated):
    events = []
    simulated.source.create_subscription(ParameterEvent, "/parameter_events", events.append, 100)
    topic = "/parameter_events"
    assert simulated.ros.spin_until(lambda: simulated.source.count_publishers(topic) == 2)
    simulated.set(12.25)
    simulated.node.declare_parameter("gain", 0)

    def told():
        gain = simulated.node.get_parameter("gain").value
        simulated.node.set_parameters([Parameter("gain", value=gain + 1)])
        simulated.ros.spin_until(lambda: False, timeout_sec=0.02)
        return any(event.changed_parameters for event in events if event.node == "/simulated")

    assert simulated.ros.spin_until(told)
    changes = [e for e in events if e.node == "/simulated" and e.changed_parameters]
    assert {(change.stamp.sec, change.stamp.nanosec) for change in changes} == {(12, 250_000_000)}


def test_goals_are_stamped_in_simulated_time(simulated):
    simulated.set(12.25)

    def execute(handle):
        handle.succeed()
        return Identify.Result()

    server = ActionServer(simulated.node, Identify, "count", execute)
    client = ActionClient(simulated.source, Identify, "count")
    assert simulated.ros.spin_until(client.server_is_ready)
    handle = simulated.ros.result(client.send_goal_async(Identify.Goal()))
    assert handle.stamp == TimeMsg(sec=12, nanosec=250_000_000)
    simulated.ros.result(handle.get_result_async())
    statuses = []
    simulated.source.create_subscription(
        GoalStatusArray, "count/_action/status", statuses.append, qos_profile_action_status_default
    )
    assert simulated.ros.spin_until(lambda: statuses)
    (status,) = statuses[-1].status_list
    assert status.goal_info.stamp == handle.stamp
    server.destroy()
    client.destroy()


def test_timers_live_on_after_a_jump_back(simulated):
    simulated.set(100.0)
    calls = []
    simulated.node.create_timer(1.0, lambda: calls.append(simulated.now.nanoseconds))
    simulated.set(101.5)
    assert simulated.ros.spin_until(lambda: calls)
    simulated.set(5.0)
    calls.clear()
    simulated.set(5.5)
    simulated.set(6.5)
    assert simulated.ros.spin_until(lambda: calls)
    assert calls[0] <= 6_500_000_000
