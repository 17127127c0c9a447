# SPDX-License-Identifier: Apache-2.0
"""The node between the graph and an arm that is driven by torques, with its force sensor.

Topics: takes ``<arm>/command`` (JointState: torque as effort; where there is a position or a
velocity, springs and dampers to it, closed at the rate of the loop); gives ``<arm>/joint_states``,
whose effort is the torque that was given, ``<arm>/wrench``, and the state of the emergency stop,
``e_stop``. Services: ``~/e_stop`` and ``~/reset_e_stop``. Life cycle: configure opens the device,
torques at zero; activate lets commands through; all else ends them.
"""

import math
import time
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import WrenchStamped
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from sensor_msgs.msg import JointState

from pneu_common.errors import InputError
from pneu_graph.nodes.common import (
    COMMAND_QOS,
    FAST_QOS,
    pause,
    status,
    steady_clock,
    to_stamp,
)
from pneu_graph.nodes.executor_callback import ExecutorCallback
from pneu_hw_bridge.device_clock import DeviceClock
from pneu_hw_bridge.nodes.bridge import Bridge, run_bridge
from pneu_hw_bridge.nodes.phantom_settings import PhantomParameters
from pneu_hw_bridge.nodes.writers import Writers
from pneu_hw_bridge.phantom.governor import STATES, State
from pneu_hw_bridge.phantom.net_ft import Calibration, read_calibration
from pneu_hw_bridge.phantom.process import ServoProcess
from pneu_hw_bridge.phantom.wire import JointSample, WrenchSample
from pneu_sim.hand.drive import JointCommand
from pneu_sim.hand.settings import ArmSettings, read_hand
from pneu_sim.nodes.hand_messages import command_of

LOOK_S = 0.05
"""Period with which the publishers of commands are looked at, s."""
REOPEN_S = 0.5
"""How often a device that was lost is looked for."""

AGAIN_S = 0.2
"""Between two looks for devices at the start."""

WAITING = 4096
"""Samples that may wait for the executor."""


class PhantomBridge(Bridge):
    """The node; what it decides is in the governor, in the process of the loop."""

    def __init__(self, **options: Any) -> None:
        """Declares parameters and offers the emergency stop; opens nothing yet.

        Args:
            **options: For the node, such as its context or its parameter overrides.

        Raises:
            InputError: The node was told to use simulated time.
        """
        self._servo: ServoProcess | None = None
        self._writers: Writers | None = None
        super().__init__("phantom_bridge", **options)
        self._params = PhantomParameters.declare(self)
        self._settings: dict[str, Any] = {}
        self._joint_names: tuple[str, ...] = ()
        self._calibration: Calibration | None = None
        self._active = False
        self._state: tuple[int, str] = (-1, "")
        self._reopen_s = 0.0
        self._sensor_clock = DeviceClock()
        self._joints: deque[JointSample] = deque(maxlen=WAITING)
        self._wrenches: deque[WrenchSample] = deque(maxlen=WAITING)

    # Life cycle

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Opens the device, torques at zero.

        Args:
            state: The state before.
        """
        try:
            name, arm = self._arm()
            self._joint_names = tuple(arm.joints)
            self._emergency.recall(f"{self._params.device} {name}")
            self._arrived = ExecutorCallback(self, self._on_samples)
            self._entities.append((ExecutorCallback.destroy, self._arrived))
            self._open_patiently(arm)
        except InputError as error:
            self.get_logger().error(str(error))
            self._close()
            return TransitionCallbackReturn.FAILURE
        self._to_joints = self.create_publisher(JointState, f"{name}/joint_states", FAST_QOS)
        self._to_wrench = self.create_publisher(WrenchStamped, f"{name}/wrench", FAST_QOS)
        self._frame = self._params.frame_id or f"{name}_wrench"
        self._topic = f"{name}/command"
        listener = self.create_subscription(JointState, self._topic, self._on_command, COMMAND_QOS)
        self._writers = Writers(self, {self._topic: listener}, self._params.commander)
        look = self.create_timer(LOOK_S, self._look_around, clock=steady_clock())
        self._entities += [
            (self.destroy_publisher, self._to_joints),
            (self.destroy_publisher, self._to_wrench),
            (self.destroy_subscription, listener),
            (self.destroy_timer, look),
        ]
        return super().on_configure(state)

    def _let_through(self) -> None:
        """Lets commands through from now on."""
        self._active = True
        self._look_around()
        if self._servo is not None:
            self._servo.tell(enable=True)

    def make_safe(self, why: str) -> None:
        """Ends torques.

        Args:
            why: For the log.
        """
        self._active = False
        if self._servo is not None and not self._servo.ended:
            answer = self._servo.ask(enable=False)
            if answer.get("zero") or self._servo.ended:
                gone = f" ({self._servo.ended})" if self._servo.ended else ""
                self.get_logger().info(f"{why}: torques are zero{gone}")
            else:
                self.get_logger().error(f"{why}: the loop did not answer; its process is ended")
                self._close_servo()
        self._emergency.driving = False
        self._emergency.keep()

    def destroy_node(self) -> None:
        """Closes the device, then ends the node."""
        self._close()
        super().destroy_node()

    def _arm(self) -> tuple[str, ArmSettings]:
        if not self._params.hand:
            raise InputError("hand: found nothing, a hand file is needed")
        arms = read_hand(self._params.hand).arms
        name = self._params.arm or (next(iter(arms)) if len(arms) == 1 else "")
        if name not in arms:
            raise InputError(f"arm: found {name!r}, {self._params.hand} has {', '.join(arms)}")
        return name, arms[name]

    def _told(self, arm: ArmSettings) -> dict[str, Any]:
        """What the process of the loop is told."""
        p = self._params
        sensor = None
        if arm.wrench is not None:
            if not p.net_ft_host:
                raise InputError(
                    "net_ft_host: found nothing; the arm has a force sensor in the hand file"
                )
            self._calibration = read_calibration(p.net_ft_host, p.net_ft_web_port)
            sensor = {
                "host": p.net_ft_host,
                "port": p.net_ft_port,
                "calibration": asdict(self._calibration),
            }
        return {
            "joints": {name: joint.model_dump() for name, joint in arm.joints.items()},
            "watchdog_s": p.watchdog_s,
            "device_timeout_s": p.device_timeout_s,
            "sensor_timeout_s": p.sensor_timeout_s,
            "dwell_s": p.dwell_s,
            "device": p.device,
            "library": p.library,
            "sensor": sensor,
            "rate_hz": p.rate_hz,
            "every": max(1, round(p.rate_hz / p.publish_rate_hz)),
        }

    def _open_patiently(self, arm: ArmSettings) -> None:
        """Opens device and force sensor, which may still be starting."""
        end_s = time.monotonic() + self._params.wait_s
        while True:
            try:
                self._settings = self._told(arm)
                self._open()
                return
            except InputError:
                if time.monotonic() > end_s:
                    raise
            pause(AGAIN_S)

    def _open(self) -> None:
        """Starts the process of the loop."""
        self._sensor_clock = DeviceClock()
        self._servo = ServoProcess(self._settings, self._on_arrived, self._arrived.trigger)
        latches = self._emergency.latches
        if latches.e_stop:
            self._servo.tell(e_stop=latches.e_stop)
        if latches.trip:
            self._servo.tell(trip=latches.trip)
        self._look_at_writers()
        self._servo.tell(enable=self._active)

    def _close_servo(self) -> None:
        servo, self._servo = self._servo, None
        if servo is not None:
            servo.end()

    def _close(self) -> None:
        """Ends the process and destroys what configuring created."""
        self._close_servo()
        super()._close()
        self._writers = None

    # Graph

    def _on_command(self, message: JointState, info: dict[str, Any]) -> None:
        servo, writers = self._servo, self._writers
        if servo is None or writers is None:
            return
        if not writers.is_known(self._topic, info):
            self._look_at_writers(info)  # before anything of a new one is followed
        servo.command(self._asked(message), writers.sent_s(info))

    def _asked(self, message: JointState) -> list[JointCommand]:
        """What a message asks of each joint; of a joint that is none of the arm's, the impossible.

        Who commands a joint that is not there means another arm.
        """
        asked = command_of(message, self._joint_names)
        return asked or [JointCommand(effort_n_m=math.inf)] * len(self._joint_names)

    def _on_arrived(self, joints: Sequence[JointSample], wrenches: Sequence[WrenchSample]) -> None:
        """Takes samples in the thread of the link."""
        self._joints.extend(joints)
        self._wrenches.extend(wrenches)
        self._arrived.trigger()

    def _on_samples(self) -> None:
        while self._joints:
            sample = self._joints.popleft()
            self._to_joints.publish(joint_state(sample, self._joint_names))
        while self._wrenches and self._calibration is not None:
            record = self._wrenches.popleft()
            device_ns = round(1e9 * record.sample / self._calibration.sample_hz)
            self._sensor_clock.observe(device_ns, record.host_ns, record.steady_s)
            felt_ns = self._sensor_clock.stamp(device_ns)
            if felt_ns is None:
                continue
            wrench = WrenchStamped()
            wrench.header.stamp = to_stamp(felt_ns)
            wrench.header.frame_id = self._frame
            force, torque = wrench.wrench.force, wrench.wrench.torque
            force.x, force.y, force.z, torque.x, torque.y, torque.z = record.values
            self._to_wrench.publish(wrench)
        self._look_at_servo()

    def _look_at_servo(self) -> None:
        """Reports changes of state, and that the loop has ended."""
        servo = self._servo
        if servo is None:
            return
        report, latches = servo.report, self._emergency.latches
        if report:
            latches.e_stop = latches.e_stop or report["e_stop"]
            latches.trip = latches.trip or report["trip"]
            now = (report["state"], report["why"].split(" for ")[0])
            if now != self._state:
                self._state = now
                state = STATES[report["state"]]
                text = f"{state.value}{': ' if report['why'] else ''}{report['why']}"
                if state in (State.E_STOP, State.TRIPPED):
                    self.get_logger().error(text)
                elif state is State.HOLDING:
                    self.get_logger().warning(text)
                else:
                    self.get_logger().info(text)
                self._emergency.keep()
                self._diagnostics.publish()
        if servo.ended:
            self.get_logger().error(f"{servo.ended}: torques are zero; it is looked for")
            self._close_servo()
            self._reopen_s = time.monotonic() + REOPEN_S
            self._diagnostics.publish()

    def _look_around(self) -> None:
        self._look_at_writers()
        self._look_at_servo()
        if self._servo is None and time.monotonic() > self._reopen_s:
            try:
                self._open()
                self.get_logger().info("the device is there again")
            except InputError as error:
                self._reopen_s = time.monotonic() + REOPEN_S
                self.get_logger().error(str(error), throttle_duration_sec=5.0)
        while self._sensor_clock.told:
            told = self._sensor_clock.told.popleft()
            self.get_logger().warning(f"force sensor: {told}: the clocks are compared anew")

    def _look_at_writers(self, info: Mapping[str, Any] | None = None) -> None:
        """Looks who may command, and tells the loop.

        Args:
            info: What the middleware tells of a message whose publisher is in question.
        """
        if self._writers is None:
            return
        count, wrong = self._writers.look(info)
        if self._servo is not None:
            self._servo.tell(publishers=[count, wrong])

    def _stop(self, reason: str) -> tuple[bool, str]:
        """Stops until it is reset, from any thread."""
        latches = self._emergency.latches
        latches.e_stop = latches.e_stop or reason
        servo = self._servo
        if servo is None or servo.ended:
            return True, "latched; the device is not open"
        answer = servo.ask(e_stop=reason)
        if answer.get("zero"):
            return True, "torques are zero"
        return False, "the loop did not answer"

    def _reset(self) -> str:
        """Releases the stop; returns why not, or nothing."""
        latches = self._emergency.latches
        servo = self._servo
        if servo is None or servo.ended:
            if latches.trip:
                return "the device is not open, so the joints' positions are not known"
        else:
            answer = servo.ask(reset=True)
            if not answer:
                return "the loop did not answer"
            if answer["refused"]:
                return str(answer["refused"])
            servo.report = {}
        latches.e_stop = latches.trip = ""
        return ""

    def _report(self) -> list[DiagnosticStatus]:
        name, stopped = self.get_name(), self._emergency.latches.e_stop
        servo = self._servo
        if servo is None or not servo.report:
            wrong = bool(stopped) or self._writers is not None
            message = f"e-stop: {stopped}" if stopped else "not open"
            level = DiagnosticStatus.ERROR if wrong else DiagnosticStatus.OK
            return [status(level, f"{name}: safety", message, {}, "phantom")]
        report = servo.report
        state = STATES[report["state"]]
        level = {
            State.FOLLOWING: DiagnosticStatus.OK,
            State.DISABLED: DiagnosticStatus.OK,
            State.HOLDING: DiagnosticStatus.WARN,
        }.get(state, DiagnosticStatus.ERROR)
        why = report["why"]
        lines = [
            status(
                level,
                f"{name}: safety",
                f"{state.value}{': ' if why else ''}{why}",
                report["counters"],
                "phantom",
            )
        ]
        values = {
            "ticks": report["ticks"],
            "ticks missed": report["missed"],
            "longest tick [s]": float(report["longest_s"]),
            "samples dropped": report["dropped"],
        }
        lines.append(status(DiagnosticStatus.OK, f"{name}: loop", "works", values, "phantom"))
        if "sensor" in report:
            text = report["sensor_error"]
            level = DiagnosticStatus.ERROR if text else DiagnosticStatus.OK
            lines.append(
                status(level, f"{name}: force sensor", text or "works", report["sensor"], "phantom")
            )
        return lines


def joint_state(sample: JointSample, names: Sequence[str]) -> JointState:
    """A sample as a message, stamped by the device's clock where it has one.

    Args:
        sample: The sample.
        names: Of the joints.
    """
    message = JointState(
        name=list(names),
        position=list(sample.position_rad),
        velocity=list(sample.velocity_rad_s),
        effort=list(sample.effort_n_m),
    )
    stamp_ns = sample.host_ns if sample.device_ns < 0 else sample.device_ns
    message.header.stamp = to_stamp(stamp_ns)
    return message


def main(args: list[str] | None = None) -> None:
    """Runs the node.

    Args:
        args: Command line; None is the process's own.
    """
    run_bridge(PhantomBridge, args)


if __name__ == "__main__":
    main()
