# SPDX-License-Identifier: Apache-2.0
"""A hand file as live arms and what they touch, in real time: the topics of bridge and laboratory.

Takes ``<arm>/command``; gives ``<arm>/joint_states``, ``<arm>/wrench``, ``<name>/imu`` and
``<name>/pose``. It is a plain node: there is no hardware to make safe. The plant moves in a thread
of its own, which leaves readings for the executor.
"""

import math
import threading
import time
from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, WrenchStamped
from numpy.typing import NDArray
from rclpy.node import Node
from sensor_msgs.msg import Imu, JointState

from pneu_common.errors import InputError
from pneu_graph.nodes import common
from pneu_graph.nodes.executor_callback import ExecutorCallback
from pneu_graph.nodes.parameters import Parameters, parameter
from pneu_sim.hand.drive import JointCommand, Motors
from pneu_sim.hand.loading import Hand
from pneu_sim.hand.pace import Pace
from pneu_sim.hand.settings import ArmSettings
from pneu_sim.hand.world import World
from pneu_sim.nodes.hand_messages import command_of, imu_message, pose_message, wrench_message

Floats = NDArray[np.float64]

WAITING = 8192
"""Readings that may wait for the executor."""


@dataclass
class HandSimulatorParameters(Parameters):
    """What the simulator of hands is told."""

    hand: str = parameter("", "Path of the hand file.", read_only=True)
    publish_rate_hz: float = parameter(
        1000.0, "How often joint_states are published, Hz.", within=(1.0, 4000.0), read_only=True
    )
    command_timeout_s: float = parameter(
        0.05, "Age at which a command gives way to no torque, s; 0: never.", within=(0.0, 10.0)
    )
    rate: float = parameter(
        1.0, "Seconds of the plant in one of the machine's.", within=(0.02, 1.0), read_only=True
    )
    seed: int = parameter(0, "Seed of the sensor noise.", within=(0, 2**31 - 1), read_only=True)


class _Arm:
    """An arm's motors and what they follow."""

    def __init__(self, settings: ArmSettings) -> None:
        self.names = list(settings.joints)
        self.motors = Motors(list(settings.joints.values()))
        self.command: list[JointCommand] | None = None
        self.command_s = -math.inf

    def drive(self, counts: list[int], time_s: float, timeout_s: float) -> list[float]:
        fresh = timeout_s == 0.0 or time.monotonic() - self.command_s < timeout_s
        return self.motors.drive(counts, time_s, self.command if fresh else None)


class HandSimulator(Node):
    """The node."""

    def __init__(self, **options: Any) -> None:
        """Reads the hand and lets it move.

        Args:
            **options: For the node.

        Raises:
            InputError: A parameter or a file is wrong.
        """
        super().__init__("hand_simulator", **options)
        self._thread: threading.Thread | None = None
        self._end = threading.Event()
        try:
            self._set_up()
        except InputError:
            self.destroy_node()
            raise

    def _set_up(self) -> None:
        params = self._params = HandSimulatorParameters.declare(self)
        if not params.hand:
            raise InputError("parameter hand: found nothing, it must be the path of a hand file")
        hand = Hand(params.hand)
        settings = hand.settings
        self._world = World(hand, seed=params.seed)
        self._every = max(1, round(1.0 / (self._world.step_s * params.publish_rate_hz)))
        self._stood_s = 0.0
        self._failure = ""
        self._waiting: deque[tuple[Any, Any]] = deque(maxlen=WAITING)
        self._arrived = ExecutorCallback(self, self._on_readings)
        self._arms = {name: _Arm(its) for name, its in settings.arms.items()}
        self._to: dict[tuple[str, str], Any] = {}
        for name, its in settings.arms.items():
            self._make("joints", name, JointState, f"{name}/joint_states")
            if its.wrench is not None:
                self._make("wrench", name, WrenchStamped, f"{name}/wrench")
            self.create_subscription(
                JointState,
                f"{name}/command",
                lambda message, arm=self._arms[name]: self._on_command(arm, message),
                common.COMMAND_QOS,
            )
        for name in settings.imus:
            self._make("imu", name, Imu, f"{name}/imu")
        for name in settings.poses:
            self._make("pose", name, PoseStamped, f"{name}/pose")
        self._diagnostics = common.Diagnostics(self, self._report)
        self._thread = threading.Thread(target=self._run, name="plant", daemon=True)
        self._thread.start()

    def destroy_node(self) -> None:
        """Ends the plant, then the node."""
        self._end.set()
        if self._thread is not None:
            self._thread.join()
            self._arrived.destroy()
        super().destroy_node()

    def _make(self, kind: str, name: str, message: Any, topic: str) -> None:
        self._to[kind, name] = self.create_publisher(message, topic, common.FAST_QOS)

    def _on_command(self, arm: _Arm, message: JointState) -> None:
        command = command_of(message, arm.names)
        if command is None:
            self.get_logger().warning(
                f"a command for joints other than {', '.join(arm.names)}, or not one number for"
                " each, is passed over",
                throttle_duration_sec=1.0,
            )
            return
        arm.command, arm.command_s = command, time.monotonic()

    def _on_readings(self) -> None:
        while self._waiting:
            key, message = self._waiting.popleft()
            self._to[key].publish(message)

    def _run(self) -> None:
        try:
            self._move()
        except Exception as error:  # told where people look
            self._failure = f"the plant failed: {error}"
            self.get_logger().error(self._failure)

    def _move(self) -> None:
        world = self._world
        origin_ns = self.get_clock().now().nanoseconds
        pace = Pace(world.time_s, self._params.rate)
        steps = 0
        while not self._end.is_set():
            pace.wait(world.time_s)
            self._stood_s = pace.stood_s
            now_s = world.time_s
            torques = {
                name: arm.drive(world.counts(name), now_s, self._params.command_timeout_s)
                for name, arm in self._arms.items()
            }
            readings = world.advance(torques)
            stamp = common.to_stamp(origin_ns + round(1e9 * now_s))
            if steps % self._every == 0:
                for name, arm in self._arms.items():
                    message = JointState(
                        name=arm.names,
                        position=arm.motors.position_rad,
                        velocity=arm.motors.velocity.velocity_rad_s,
                        effort=arm.motors.torque_n_m,
                    )
                    message.header.stamp = stamp
                    self._waiting.append((("joints", name), message))
            for reading in readings:
                told: Any
                if reading.kind == "wrench":
                    told = wrench_message(f"{reading.name}_wrench", reading.values, stamp)
                elif reading.kind == "imu":
                    told = imu_message(reading.name, reading.values, stamp)
                else:
                    told = pose_message(reading.name, reading.values, stamp)
                self._waiting.append(((reading.kind, reading.name), told))
            steps += 1
            if self._waiting:
                self._arrived.trigger()

    def _report(self) -> list[DiagnosticStatus]:
        values: dict[str, object] = {
            "stood still [s]": self._stood_s,
            "plant time [s]": self._world.time_s,
        }
        level = DiagnosticStatus.ERROR if self._failure else DiagnosticStatus.OK
        text = self._failure or "works"
        return [common.status(level, f"{self.get_name()}: plant", text, values, "simulated")]


def main(args: list[str] | None = None) -> None:
    """Runs the node.

    Args:
        args: Command line; None is the process's own.
    """
    common.run_node(HandSimulator, args)


if __name__ == "__main__":
    main()
