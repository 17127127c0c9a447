# SPDX-License-Identifier: Apache-2.0
"""The robot node: a controller of joints that is read from a file, on the live graph (thesis 9.2).

A lifecycle node like those of pressures. It steps its controller at the period that the file names,
with the newest reading of each tap and encoder that it asks for; targets come as a
`trajectory_msgs/JointTrajectory` whose points tell what lies ahead. Parameters and topics: see
``ros_ws/README.md``.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from trajectory_msgs.msg import JointTrajectory

from pneu_common.errors import InputError
from pneu_graph.nodes import common
from pneu_graph.nodes.parameters import parameter
from pneu_policy.control.predictive_joint import PredictiveJoint
from pneu_policy.control.robot_controllers import RobotController, load_robot_controller
from pneu_policy.nodes.controlling import (
    NO_TARGET,
    SHORT_TARGET,
    ControllingNode,
    ControllingParameters,
)
from pneu_policy.nodes.plans import Plans
from pneu_policy.nodes.running import run_controller

Floats = NDArray[np.float64]

TARGET_TOPIC = "joint_target"


@dataclass
class RobotParameters(ControllingParameters):
    """What the robot node is told."""

    controller: str = parameter(
        "",
        "File of the controller: a policy (.npz), a tuned or a predictive one (.yaml).",
        read_only=True,
    )


@dataclass(frozen=True)
class Target:
    """The newest target.

    Attributes:
        begin_ns: Time from which its points count, ns.
        at_s: (points,) when each is due, s.
        values: (tracked, points) rad or m.
        arrival_ns: When it came, by the clock that ages go by, ns.
    """

    begin_ns: int
    at_s: Floats
    values: Floats
    arrival_ns: int


class RobotNode(ControllingNode):
    """Targets of joints, encoders and pressures in, valve commands out."""

    parameters = RobotParameters
    takes_nan = True
    _params: RobotParameters

    def __init__(self, **options: Any) -> None:
        """Declares the parameters; with ``autostart`` it is active at once.

        Args:
            options: Keywords of ``rclpy.lifecycle.LifecycleNode``.

        Raises:
            InputError: It shall start at once, and the file holds no controller of the rig.
        """
        self._controller: RobotController | None = None
        self._plans = Plans()
        super().__init__("robot", **options)

    def _make(self) -> None:
        for name in ("rig", "controller"):
            if not getattr(self._params, name):
                raise InputError(f"parameter {name}: found nothing, it must be the path of a file")
        assert self._rig is not None
        self._plans.end()
        one = self._controller = load_robot_controller(self._params.controller, self._rig)
        if isinstance(one, PredictiveJoint):
            self._plans.begin(one.inner)
        self._taps, self._encoders, self._valves = one.taps, one.encoders, one.commands
        self._period_s = one.period_s

    def destroy_node(self) -> None:
        """Ends planning, then the node."""
        self._plans.end()
        super().destroy_node()

    def _rest(self) -> None:
        if self._plans.controller is not None:
            self._plans.rest()
        elif self._controller is not None:
            self._controller.reset()

    def _hear_more(self) -> list[Any]:
        return self._plans.listen(self)

    def _about(self) -> str:
        return "" if self._controller is None else self._controller.name

    def _hear_target(self) -> Any:
        return self.create_subscription(
            JointTrajectory, TARGET_TOPIC, self._on_target, common.COMMAND_QOS
        )

    def _forget_target(self) -> None:
        self._target: Target | None = None
        self._error_square = self._error_count = 0.0

    def _on_target(self, message: JointTrajectory) -> None:
        assert self._controller is not None
        tracked, names = self._controller.tracked, list(message.joint_names)
        wrong = ""
        for name in tracked:
            if names.count(name) != 1:
                wrong = f"joint_names: found {', '.join(names) or 'none'}, needed is {name}"
        at_s = np.array(
            [p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in message.points]
        )
        if not wrong and (len(at_s) == 0 or np.any(np.diff(at_s) <= 0.0)):
            wrong = f"points: found {len(at_s)}, needed are some whose times rise"
        for point in message.points if not wrong else ():
            if len(point.positions) != len(names) or not all(map(math.isfinite, point.positions)):
                wrong = f"positions: found {list(point.positions)}, needed is one number a joint"
                break
        if wrong:  # what was heard before stands until it is too old
            self.get_logger().warning(f"target ignored: {wrong}", throttle_duration_sec=1.0)
            return
        order = [names.index(name) for name in tracked]
        values = np.array([[p.positions[k] for p in message.points] for k in order])
        begin_ns = common.from_stamp(message.header.stamp)
        self._target = Target(begin_ns, at_s, values, self._now_ns())

    def _target_lost(self, now_ns: int) -> tuple[str, str] | None:
        target, timeout_s = self._target, self._params.target_timeout_s
        topic = self.resolve_topic_name(TARGET_TOPIC)
        if target is None:
            return NO_TARGET, f"never heard one on {topic}"
        if now_ns - target.arrival_ns > timeout_s * 1e9:
            return NO_TARGET, f"for {timeout_s:g} s none on {topic}"
        assert self._controller is not None
        needed_s = (self._controller.reach - 1) * self._period_s
        known_s = float(target.at_s[-1] - target.at_s[0])
        if known_s < needed_s - 1e-9:
            return SHORT_TARGET, f"it tells {known_s:g} s ahead, needed are {needed_s:g}"
        return None

    def _asked(self) -> Mapping[str, float] | None:
        one, target = self._controller, self._target
        assert one is not None and target is not None
        newest_ns = max(self._readings[name].stamp_ns for name in self._encoders)
        ahead = np.arange(one.reach) * self._period_s
        at = (newest_ns - target.begin_ns) * 1e-9 + ahead
        wanted = np.stack([np.interp(at, target.at_s, values) for values in target.values])
        positions = {name: self._readings[name].value for name in self._encoders}
        taps_pa = {name: self._readings[name].value for name in self._taps}
        if isinstance(one, PredictiveJoint):
            now_ns = int(self.get_clock().now().nanoseconds)
            new, since_s, late_s = self._plans.timed(newest_ns, now_ns)
            told = (positions, taps_pa) if new else ({}, {})
            volts = one.step(*told, wanted, since_s, late_s)
        else:
            volts = one.step(positions, taps_pa, wanted)
        off = wanted[:, 0] - np.array([positions[name] for name in one.tracked])
        self._error_square += float(np.sum(off**2))
        self._error_count += 1.0
        return volts

    def _figures(self) -> Mapping[str, object]:
        rms = math.sqrt(self._error_square / self._error_count) if self._error_count else math.nan
        self._error_square = self._error_count = 0.0
        return {"rms error (rad or m)": rms, **self._plans.figures(self._lost)}

    def _afterwards(self) -> None:
        self._plans.follow()


def main(args: list[str] | None = None) -> None:
    """Runs the node.

    Args:
        args: Command line; None is the process's own.
    """
    run_controller(RobotNode, args)


if __name__ == "__main__":
    main()
