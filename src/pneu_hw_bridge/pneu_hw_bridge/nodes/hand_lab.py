# SPDX-License-Identifier: Apache-2.0
"""Emulated devices of a hand, and what a laboratory's own drivers would publish beside them.

Arms are behind sockets in the folder ``devices``, force sensors behind UDP; inertial units and
motion capture are on their topics, ``<name>/imu`` and ``<name>/pose``, as their makers' nodes have
them. Faults are parameters, which may be set while it runs.
"""

import sys
import tempfile
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, WrenchStamped
from numpy.typing import NDArray
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import Imu

from pneu_common.errors import InputError
from pneu_graph.nodes.common import (
    EXIT_BAD_INPUT,
    FAST_QOS,
    Diagnostics,
    say_ready,
    status,
    to_stamp,
)
from pneu_graph.nodes.executor_callback import ExecutorCallback
from pneu_graph.nodes.lifetime import initialised
from pneu_graph.nodes.parameters import Parameters, parameter
from pneu_hw_bridge.hand_lab import amplifier, box
from pneu_hw_bridge.hand_lab.process import PlantProcess
from pneu_hw_bridge.phantom import rdt
from pneu_sim.hand.settings import read_hand
from pneu_sim.nodes.hand_messages import imu_message, pose_message, wrench_message

Floats = NDArray[np.float64]

MAKE = {
    "imu": imu_message,
    "pose": pose_message,
    "touch": lambda name, values, stamp: wrench_message("world", values, stamp),
}
WAITING = 8192
"""Readings that may wait for the executor."""


@dataclass
class HandLabParameters(Parameters):
    """What the laboratory is told."""

    hand: str = parameter("", "hand file (YAML)", read_only=True)
    truth: str = parameter(
        "", "file with what is hidden, sealed or plain; empty hides nothing", read_only=True
    )
    devices: str = parameter(
        "", "folder of the arms' sockets; empty: pneu-devices in the folder of temporary files",
        read_only=True,
    )  # fmt: skip
    net_ft_port: int = parameter(
        rdt.PORT, "UDP port of the first arm's force sensor; the others' follow",
        within=(1, 65535), read_only=True,
    )  # fmt: skip
    net_ft_web_port: int = parameter(
        8049, "port of its page of settings; the others' follow", within=(1, 65535), read_only=True
    )
    tell_touch: bool = parameter(
        False,
        "tell the true force of each arm's tip on what it touches, on ARM/touch, which no sensor"
        " does",
        read_only=True,
    )
    rate: float = parameter(
        1.0,
        "seconds of the plant in one of the machine's: less where the machine is too slow or too"
        " busy for all that looks on",
        within=(0.02, 1.0), read_only=True,
    )  # fmt: skip
    operator: str = parameter(
        "",
        "arm that an operator's hand leads, so that another one that follows it taps and presses;"
        " empty: nobody",
        read_only=True,
    )
    follower: str = parameter("phantom", "operator: the arm that follows", read_only=True)
    thing: str = parameter("object", "operator: what it is to touch", read_only=True)
    operator_seconds: float = parameter(
        10.0, "operator: how long, s", within=(1.0, 600.0), read_only=True
    )
    seed: int = parameter(0, "seed of the noise", within=(0, 2**31 - 1), read_only=True)
    arm_fault: str = parameter("none", "fault of all arms", choices=amplifier.FAULTS)
    sensor_fault: str = parameter("none", "fault of all force sensors", choices=box.FAULTS)


def devices_folder(told: str) -> Path:
    """Folder of the arms' sockets.

    Args:
        told: What a parameter says of it.
    """
    return Path(told) if told else Path(tempfile.gettempdir()) / "pneu-devices"


class HandLab(Node):
    """The node."""

    def __init__(self, **options: Any) -> None:
        """Builds the plant and lets it move.

        Args:
            **options: For the node.

        Raises:
            InputError: A parameter or a file is wrong, or a port or socket cannot be had.
        """
        super().__init__("hand_lab", **options)
        self.plant: PlantProcess | None = None
        try:
            self._set_up()
        except InputError:
            self.destroy_node()
            raise

    def _set_up(self) -> None:
        params = self._params = HandLabParameters.declare(self)
        if not params.hand:
            raise InputError("hand: found nothing, a hand file is needed")
        settings = read_hand(params.hand)
        self._readings: deque[tuple[str, str, int, Floats]] = deque(maxlen=WAITING)
        self._arrived = ExecutorCallback(self, self._on_readings)
        self._publishers_of: dict[tuple[str, str], Any] = {}
        for name in settings.imus:
            self._publishers_of["imu", name] = self.create_publisher(Imu, f"{name}/imu", FAST_QOS)
        for name in settings.poses:
            self._publishers_of["pose", name] = self.create_publisher(
                PoseStamped, f"{name}/pose", FAST_QOS
            )
        if params.tell_touch:
            for name in settings.arms:
                self._publishers_of["touch", name] = self.create_publisher(
                    WrenchStamped, f"{name}/touch", FAST_QOS
                )
        with_sensor = [a for a, its in settings.arms.items() if its.wrench is not None]
        told = {
            "hand": params.hand,
            "truth": params.truth,
            "devices": str(devices_folder(params.devices)),
            "ports": {
                arm: (params.net_ft_port + k, params.net_ft_web_port + k)
                for k, arm in enumerate(with_sensor)
            },
            "seed": params.seed,
            "rate": params.rate,
            "operator": {
                "leader": params.operator,
                "follower": params.follower,
                "thing": params.thing,
                "seconds": params.operator_seconds,
                "seed": params.seed,
            }
            if params.operator
            else None,
            "touch": params.tell_touch,
        }
        names = {
            "imu": list(settings.imus),
            "pose": list(settings.poses),
            "touch": list(settings.arms),
        }
        self.plant = PlantProcess(told, names, self._hear, self._arrived.trigger)
        self._diagnostics = Diagnostics(self, self._report)
        self.add_post_set_parameters_callback(self._on_parameters)
        self._on_parameters([])

    def destroy_node(self) -> None:
        """Ends the plant, then the node."""
        if self.plant is not None:
            self.plant.end()
            self._arrived.destroy()
        super().destroy_node()

    def _hear(self, kind: str, name: str, stamp_ns: int, values: Floats) -> None:
        """Takes a reading in the thread of the link."""
        self._readings.append((kind, name, stamp_ns, values))

    def _on_readings(self) -> None:
        while self._readings:
            kind, name, stamp_ns, values = self._readings.popleft()
            message = MAKE[kind](name, values, to_stamp(stamp_ns))
            self._publishers_of[kind, name].publish(message)

    def _on_parameters(self, parameters: list[Any]) -> None:
        del parameters
        if self.plant is not None:
            self.plant.tell(
                arm_fault=self._params.arm_fault, sensor_fault=self._params.sensor_fault
            )

    def _report(self) -> list[DiagnosticStatus]:
        plant = self.plant
        if plant is None:
            return []
        report = plant.report
        failure = plant.ended or report.get("failure", "")
        values: dict[str, object] = {
            "stood still [s]": report.get("stood_s", 0.0),
            "plant time [s]": report.get("plant_s", 0.0),
            **{f"{arm} let go": count for arm, count in report.get("let_go", {}).items()},
        }
        level = DiagnosticStatus.ERROR if failure else DiagnosticStatus.OK
        text = failure or "works"
        if report.get("stood_s") and not failure:
            level, text = DiagnosticStatus.WARN, "slower than real time: it stood still at times"
        return [status(level, f"{self.get_name()}: plant", text, values, "emulated")]


def main(args: list[str] | None = None) -> None:
    """Runs the node.

    Args:
        args: Command line; None is the process's own.
    """
    node: HandLab | None = None
    try:
        with initialised(args):
            node = HandLab()
            try:
                say_ready(node)
                rclpy.spin(node)
            finally:
                node.destroy_node()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except InputError as error:
        print(" ".join(str(error).split()), file=sys.stderr)
        sys.exit(EXIT_BAD_INPUT)


if __name__ == "__main__":
    main()
