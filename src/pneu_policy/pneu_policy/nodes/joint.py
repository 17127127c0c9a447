# SPDX-License-Identifier: Apache-2.0
"""The joint node: moves a joint about random targets by the valves on both sides of its cylinder.

It closes the loop over the encoder and the pressures at the cylinder (thesis 9.2), so that a robot
goes all over its range, in jumps and slowly, as identification needs it. It commands at readings
alone: where they stop, so do the commands, and the watchdog behind the topic vents. Parameters and
topics: see ``ros_ws/README.md``.
"""

import functools
import math
from collections.abc import Iterable
from dataclasses import dataclass, fields
from typing import Any

from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data

from pneu_common.errors import InputError
from pneu_graph.nodes import common
from pneu_graph.nodes.parameters import Parameters, parameter
from pneu_policy.control.joint import JointGains, JointPid
from pneu_policy.task.joint_targets import JointTargets
from pneu_sim import topics
from pneu_sim.rig import load_rig

GAINS = tuple(f.name for f in fields(JointGains))
TARGET_TOPIC = "joint_targets"
LOST_S = 0.2
"""Readings further apart than this begin anew."""


@dataclass
class JointParameters(Parameters):
    """What the joint node is told."""

    rig: str = parameter("", "Rig file, whose channels say on which topics.", read_only=True)
    encoder: str = parameter("elbow", "Encoder of the joint.", read_only=True)
    cylinder: str = parameter("forearm", "Cylinder that turns it.", read_only=True)
    head_tap: str = parameter("head_port", "Tap at the cylinder's head.", read_only=True)
    rod_tap: str = parameter("rod_port", "Tap at its rod side.", read_only=True)
    head_command: str = parameter("head", "Command of the head's valve.", read_only=True)
    rod_command: str = parameter("rod", "Command of the rod side's valve.", read_only=True)
    lower: float = parameter(
        -0.8, "Lowest target, rad or m.", within=(-100.0, 100.0), read_only=True
    )
    upper: float = parameter(
        0.8, "Highest target, rad or m.", within=(-100.0, 100.0), read_only=True
    )
    seed: int = parameter(0, "Seed of the targets.", within=(0, 2**31 - 1), read_only=True)
    rate_hz: float = parameter(250.0, "Commands per second.", within=(10.0, 1000.0), read_only=True)
    null_v: float = parameter(
        5.0, "Voltage at which a valve closes, V.", within=(-24.0, 24.0), read_only=True
    )
    kp_v: float = parameter(4.0, "Proportional gain, V/rad.", within=(0.0, 1e4), read_only=True)
    ki_v_s: float = parameter(2.0, "Integral gain, V/(rad s).", within=(0.0, 1e4), read_only=True)
    kd_v_s: float = parameter(0.2, "Gain of the speed, V s/rad.", within=(0.0, 1e3), read_only=True)
    kf_v_n: float = parameter(
        0.01, "Gain of the gas's force, V/N.", within=(0.0, 1.0), read_only=True
    )
    derivative_hz: float = parameter(
        30.0, "Cut-off of the speed's filter, Hz.", within=(0.1, 1000.0), read_only=True
    )
    integral_v: float = parameter(
        1.5, "Limit of the integral term, V.", within=(0.0, 24.0), read_only=True
    )
    most_v: float = parameter(
        5.0, "Limit on either side of null_v, V.", within=(0.1, 24.0), read_only=True
    )


class JointNode(Node):
    """Seeded targets, an encoder and two pressures in, two valve commands out."""

    def __init__(self, **options: Any) -> None:
        """Starts to command with the first readings.

        Args:
            options: Keywords of ``rclpy.node.Node``.

        Raises:
            InputError: The parameters or the rig file are wrong.
        """
        super().__init__("joint", **options)
        try:
            self._set_up()
        except InputError:
            self.destroy_node()
            raise

    def _set_up(self) -> None:
        p = self._params = JointParameters.declare(self)
        if not p.rig:
            raise InputError("parameter rig: found nothing, it must be the path of a rig file")
        if not p.lower < p.upper:
            raise InputError(f"lower: found {p.lower:g}, allowed is below upper {p.upper:g}")
        rig = load_rig(p.rig)
        known: dict[str, Iterable[str]] = {
            "encoder": rig.encoders,
            "cylinder": rig.cylinders,
            "head_tap": rig.taps,
            "rod_tap": rig.taps,
            "head_command": rig.commands,
            "rod_command": rig.commands,
        }
        for name, there in known.items():
            _check_known(name, getattr(p, name), there, rig.name)
        self._head_m2, self._rod_m2 = rig.cylinders[p.cylinder].areas
        self._room_n = rig.ambient.pressure_pa * (self._head_m2 - self._rod_m2)
        self._pid = JointPid(JointGains(**{name: getattr(p, name) for name in GAINS}))
        self._targets = JointTargets(p.lower, p.upper, p.seed)
        self._pressures_pa: dict[str, float] = {}
        self._begun_ns = self._used_ns = -1
        (of_encoder,) = topics.only(topics.encoder_topics(rig), {p.encoder})
        self._told_on = [
            (t, self.create_publisher(topics.message_class(t.type), t.name, common.COMMAND_QOS))
            for t in topics.only(topics.command_topics(rig), {p.head_command, p.rod_command})
        ]
        self._target_topic = topics.Topic(TARGET_TOPIC, of_encoder.type, of_encoder.signals)
        self._target_publisher = self.create_publisher(
            topics.message_class(of_encoder.type), TARGET_TOPIC, common.READINGS_QOS
        )
        for topic in topics.only(topics.tap_topics(rig), {p.head_tap, p.rod_tap}):
            self.create_subscription(
                topics.message_class(topic.type),
                topic.name,
                functools.partial(self._on_pressures, topic),
                qos_profile_sensor_data,
            )
        self.create_subscription(
            topics.message_class(of_encoder.type),
            of_encoder.name,
            functools.partial(self._on_position, of_encoder),
            qos_profile_sensor_data,
        )

    def _on_pressures(self, topic: topics.Topic, message: Any) -> None:
        self._pressures_pa |= topic.read(message)

    def _on_position(self, topic: topics.Topic, message: Any) -> None:
        p = self._params
        position = topic.read(message).get(p.encoder, math.nan)
        ends_pa = [self._pressures_pa.get(tap, math.nan) for tap in (p.head_tap, p.rod_tap)]
        if not all(map(math.isfinite, (position, *ends_pa))):
            return
        header = getattr(message, "header", None)
        stamp = header.stamp if header is not None else self.get_clock().now().to_msg()
        now_ns = common.from_stamp(stamp)
        dt_s = (now_ns - self._used_ns) * 1e-9
        if self._used_ns < 0 or not 0.0 <= dt_s < LOST_S:
            self._pid.reset()
        elif dt_s < (1.0 - 1e-3) / p.rate_hz:
            return
        if self._begun_ns < 0 or now_ns < self._begun_ns:
            self._begun_ns = now_ns
            self._targets = JointTargets(p.lower, p.upper, p.seed)
        self._used_ns = now_ns
        target = self._targets.at((now_ns - self._begun_ns) * 1e-9)
        force_n = ends_pa[0] * self._head_m2 - ends_pa[1] * self._rod_m2 - self._room_n
        volts = self._pid.step(target, position, force_n, dt_s)
        values = {p.head_command: p.null_v + volts, p.rod_command: p.null_v - volts}
        for told, publisher in self._told_on:
            publisher.publish(told.message(values, stamp))
        self._target_publisher.publish(self._target_topic.message({p.encoder: target}, stamp))


def _check_known(name: str, given: str, there: Iterable[str], rig: str) -> None:
    """Raises InputError where the rig does not have what a parameter names.

    Args:
        name: Of the parameter.
        given: What it says.
        there: What the rig has.
        rig: Name of the rig.
    """
    if given not in there:
        raise InputError(
            f"parameter {name}: found {given!r}, rig {rig!r} has {', '.join(there) or 'none'}"
        )


def main(args: list[str] | None = None) -> None:
    """Runs the node.

    Args:
        args: Command line; None is the process's own.
    """
    common.run_node(JointNode, args)


if __name__ == "__main__":
    main()
