# SPDX-License-Identifier: Apache-2.0
"""The end that commands the valve bridge and listens to it: `... bridge_probe CONTROL_PORT`.

When a voltage reached the valves, and from when on a register held a reading, the emulated lab
tells on its control port; its steady clock is this process's own.
"""

import itertools
import random
import sys
import threading
import time
from typing import Any

from benchmarks.graph.processes import orders, reply
from pneu_hw_bridge.lab.asking import ask
from pneu_runtime import hook

hook.install()

import rclpy  # noqa: E402
from pneu_msgs.msg import ValveCommand  # noqa: E402
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor  # noqa: E402
from rclpy.node import Node  # noqa: E402
from rclpy.qos import qos_profile_sensor_data  # noqa: E402
from sensor_msgs.msg import FluidPressure  # noqa: E402

from pneu_graph.nodes.common import COMMAND_QOS  # noqa: E402

PERIOD_S = 1.0 / 500.0
LONGEST_S = 30.0
HELD_V = 5.0
REMEMBERED = 400
"""Commands between two questions: the lab remembers the last 500 changes of voltage."""


class Probe:
    """A controller at 500 Hz and a listener."""

    def __init__(self, node: Node, control_port: int) -> None:
        self._port = control_port
        self._publisher = node.create_publisher(ValveCommand, "valve/command", COMMAND_QOS)
        self._first_s: dict[float, float] = {}
        self._readings = 0
        node.create_subscription(
            FluidPressure, "taps/end/pressure", self._on_pressure, qos_profile_sensor_data
        )

    def _on_pressure(self, message: FluidPressure) -> None:
        self._first_s.setdefault(message.fluid_pressure, time.monotonic())
        self._readings += 1

    def _send(self, volts: float) -> float:
        now_s = time.monotonic()
        self._publisher.publish(ValveCommand(name=["voltage"], voltage_v=[volts]))
        return now_s

    def follow(self) -> None:
        """Commands until the valves follow."""
        end = time.monotonic() + LONGEST_S
        while ask(self._port, {"do": "status"})["volts"]["voltage"] != HELD_V:
            if time.monotonic() > end:
                raise TimeoutError("the valves do not follow")
            for _ in range(50):
                self._send(HELD_V)
                time.sleep(PERIOD_S)

    def commands(self, count: int) -> dict[str, Any]:
        """From publishing a voltage until the device's register has it; each is a new voltage."""
        self.follow()
        sent: dict[float, float] = {}
        reached: dict[float, float] = {}
        readings, spent_s = 0, 0.0
        for first in range(0, count, REMEMBERED):
            begin_s = due_s = time.monotonic()
            before = self._readings
            for number in range(first, min(first + REMEMBERED, count)):
                # 0.5 V/s: below every limit, and exact as a float32
                volts = 4.0 + number % 2048 / 1024 + number // 2048 / 8192
                sent[volts] = self._send(volts)
                due_s += PERIOD_S
                time.sleep(max(due_s - time.monotonic(), 0.0))
            spent_s += time.monotonic() - begin_s
            readings += self._readings - before
            time.sleep(0.02)
            for change in ask(self._port, {"do": "history"})["history"]:
                reached.setdefault(change["volts"]["voltage"], change["steady_s"])
        late = [reached[volts] - at for volts, at in sent.items() if volts in reached]
        return {
            "latency_s": late,
            "arrived": len(late) / len(sent),
            "rate_hz": len(sent) / spent_s,
            "readings_hz": readings / spent_s,
        }

    def readings(self, count: int) -> dict[str, Any]:
        """From when the register holds a new reading until the callback has it."""
        self.follow()
        ended = threading.Event()

        def hold() -> None:
            while not ended.wait(PERIOD_S):
                self._send(HELD_V)

        holder = threading.Thread(target=hold)
        holder.start()
        draw = random.Random(1)
        latencies = []
        try:
            for value in itertools.islice(itertools.cycle(range(200_000, 600_000, 64)), count):
                fault = {"do": "fault", "name": "out_of_range", "channel": "end", "value": value}
                self._first_s.pop(float(value), None)
                since_s = ask(self._port, fault)["steady_s"]
                end_s = since_s + 5.0
                while float(value) not in self._first_s:
                    if time.monotonic() > end_s:
                        raise TimeoutError("a reading does not arrive")
                    time.sleep(PERIOD_S)
                latencies.append(self._first_s[float(value)] - since_s)
                time.sleep(draw.uniform(0.005, 0.02))  # so that it meets any phase of the bus
        finally:
            ended.set()
            holder.join()
            ask(self._port, {"do": "clear"})
        return {"latency_s": latencies}


def main(control_port: int) -> None:
    """Takes orders."""
    rclpy.init(args=[])
    node = Node("probe")
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    probe = Probe(node, control_port)
    spinning = threading.Thread(target=executor.spin, daemon=True)
    spinning.start()
    try:
        for order in orders():
            measured = getattr(probe, order["measure"])
            reply(**measured(int(order["count"])))
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        executor.shutdown()
        spinning.join(2.0)
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main(int(sys.argv[1]))
