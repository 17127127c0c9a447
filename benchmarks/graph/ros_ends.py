# SPDX-License-Identifier: Apache-2.0
"""Ends of the graph benchmarks on rclpy: `python -m benchmarks.graph.ros_ends STACK ROLE [TYPE]`.

The stack is `pneu`, our embedded runtime, or `rclpy`, the one of ROS; the code is the same.
"""

import sys
import threading
import time
from typing import Any

from benchmarks.graph.processes import OURS, orders, reply
from pneu_runtime import hook

if sys.argv[1] == OURS:
    hook.install()

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, qos_profile_sensor_data
from rclpy.task import Future
from sensor_msgs.msg import FluidPressure, JointState
from std_msgs.msg import Float64

from benchmarks.graph.loops import Ticks
from pneu_policy.control.pid import Gains, Pid

JOINTS = 7
LONGEST_S = 60.0
ALL = QoSProfile(history=HistoryPolicy.KEEP_ALL)


def example(kind: str) -> Any:
    """A message of a type."""
    if kind == "FluidPressure":
        message = FluidPressure(fluid_pressure=101325.0)
        message.header.frame_id = "end"
        return message
    values = [0.1 * joint for joint in range(JOINTS)]
    names = [f"joint_{joint}" for joint in range(JOINTS)]
    return JointState(name=names, position=values, velocity=values, effort=values)


def stamp(message: Any, now_ns: int) -> None:
    """Writes the machine's steady clock into a header."""
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(now_ns, 1_000_000_000)


def stamped(message: Any) -> int:
    """Reads the steady clock out of a header, ns."""
    return int(message.header.stamp.sec) * 1_000_000_000 + int(message.header.stamp.nanosec)


def end_with_input(context: Any) -> None:
    """For an end that is asked nothing: it ends with whoever started it."""

    def watch() -> None:
        sys.stdin.read()
        context.try_shutdown()

    threading.Thread(target=watch, daemon=True).start()


def found(node: Node, publishes: str, listens: str) -> None:
    """Waits for the other end."""
    end = time.monotonic() + LONGEST_S
    while not (node.count_subscribers(publishes) and node.count_publishers(listens)):
        if time.monotonic() > end:
            raise TimeoutError(f"nobody listens to {publishes} and publishes {listens}")
        time.sleep(0.01)
    time.sleep(0.3)  # the other end has to find this one too


def echo(node: Node, message: Any) -> None:
    """Sends back what comes, with the time at which the callback had it."""
    publisher = node.create_publisher(type(message), "pong", 10)

    def back(got: Any) -> None:
        stamp(got, time.monotonic_ns())
        publisher.publish(got)

    node.create_subscription(type(message), "ping", back, 10)
    end_with_input(node.context)
    rclpy.spin(node)


def ping(node: Node, message: Any) -> None:
    """Sends the next message when the last one is back; both ways are timed."""
    publisher = node.create_publisher(type(message), "ping", 10)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    trips: list[tuple[int, int]] = []
    sent_ns, left, done = 0, 0, Future()

    def send() -> None:
        nonlocal sent_ns
        sent_ns = time.monotonic_ns()
        stamp(message, sent_ns)
        publisher.publish(message)

    def got(answer: Any) -> None:
        nonlocal left
        now_ns = time.monotonic_ns()
        trips.append((stamped(answer) - sent_ns, now_ns - sent_ns))
        left -= 1
        if left:
            send()
        else:
            done.set_result(True)

    node.create_subscription(type(message), "pong", got, 10)
    found(node, "ping", "pong")
    for order in orders():
        trips.clear()
        left, done = int(order["count"]), Future()
        send()
        executor.spin_until_future_complete(done, LONGEST_S)
        if not done.done():
            raise TimeoutError(f"{left} of {order['count']} answers are missing")
        reply(forth_ns=[a for a, _ in trips], round_ns=[b for _, b in trips])


def source(node: Node, message: Any) -> None:
    """Publishes as fast as it can; reliable with all history, so nothing may be lost."""
    publisher = node.create_publisher(type(message), "stream", ALL)
    while publisher.get_subscription_count() == 0:
        time.sleep(0.01)
    time.sleep(0.3)
    for order in orders():
        begin_ns = time.monotonic_ns()
        for _ in range(int(order["count"])):
            publisher.publish(message)
        reply(begin_ns=begin_ns, publish_ns=time.monotonic_ns() - begin_ns)


def sink(node: Node, message: Any) -> None:
    """Counts what comes."""
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    left, done = 0, Future()

    def got(_: Any) -> None:
        nonlocal left
        left -= 1
        if left == 0:
            done.set_result(time.monotonic_ns())

    node.create_subscription(type(message), "stream", got, ALL)
    for order in orders():
        left, done = int(order["count"]), Future()
        executor.spin_until_future_complete(done, LONGEST_S)
        if not done.done():
            raise TimeoutError(f"{left} of {order['count']} messages are missing")
        reply(end_ns=done.result())


def plant(node: Node, _: Any) -> None:
    """Answers every voltage with a pressure that follows it."""
    publisher = node.create_publisher(FluidPressure, "pressure", 10)
    pressure = FluidPressure(fluid_pressure=300e3)

    def on_voltage(voltage: Float64) -> None:
        pressure.fluid_pressure += 200.0 * (voltage.data - 5.0)
        pressure.header.stamp = node.get_clock().now().to_msg()
        publisher.publish(pressure)

    node.create_subscription(Float64, "voltage", on_voltage, 1)
    end_with_input(node.context)
    rclpy.spin(node)


def controller(node: Node, _: Any) -> None:
    """A timer on the steady clock; each tick takes the newest pressure and sends a voltage."""
    publisher = node.create_publisher(Float64, "voltage", 1)
    readings = [300e3]

    def on_pressure(message: FluidPressure) -> None:
        readings[0] = message.fluid_pressure

    node.create_subscription(FluidPressure, "pressure", on_pressure, qos_profile_sensor_data)
    found(node, "voltage", "pressure")
    clock = Clock(clock_type=ClockType.STEADY_TIME)
    for order in orders():
        period_s = 1.0 / order["rate_hz"]
        pid = Pid(Gains(kp_v_per_pa=1e-5, ki_v_per_pa_s=2e-5))
        times: list[int] = []

        def tick(pid: Pid = pid, period_s: float = period_s, times: list[int] = times) -> None:
            times.append(time.monotonic_ns())
            target = 400e3 if (len(times) * period_s) % 2.0 < 1.0 else 200e3
            publisher.publish(Float64(data=pid.step(target, readings[0], period_s)))

        executor = SingleThreadedExecutor()
        executor.add_node(node)
        timer = node.create_timer(period_s, tick, clock=clock)
        cpu_s, end_s = time.process_time(), time.monotonic() + order["duration_s"]
        while time.monotonic() < end_s:
            executor.spin_once(timeout_sec=0.1)
        cpu_s = time.process_time() - cpu_s
        node.destroy_timer(timer)
        executor.remove_node(node)
        reply(**Ticks.of(times, period_s).__dict__, cpu_s=cpu_s, last_pa=readings[0])


ROLES = {
    "echo": echo,
    "ping": ping,
    "source": source,
    "sink": sink,
    "plant": plant,
    "controller": controller,
}


def main(role: str, kind: str) -> None:
    """Runs one end until its input ends."""
    rclpy.init(args=[])
    node = Node(role)
    try:
        ROLES[role](node, example(kind))
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main(sys.argv[2], sys.argv[3] if len(sys.argv) > 3 else "FluidPressure")
