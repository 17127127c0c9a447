# SPDX-License-Identifier: Apache-2.0
"""The PID node: tracks a target pressure at a tap by a proportional valve (thesis 8.1.1).

A lifecycle node: it commands the valve while active only, and a deactivation ends with the safe
voltage. Parameters and topics: see ``ros_ws/README.md``.
"""

import math
from collections.abc import Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from pneu_msgs.msg import PressureTarget, ValveCommand
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import JumpThreshold, ROSClock
from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import FluidPressure

from pneu_policy.pid import Gains, Pid
from pneu_sim.errors import InputError
from pneu_sim.nodes import common

GAINS: dict[str, tuple[float, float, float, str]] = {
    "kp_v_per_pa": (1.0e-5, 0.0, 1e-2, "Proportional gain, V/Pa."),
    "ki_v_per_pa_s": (2.0e-5, 0.0, 1e-1, "Integral gain, V/(Pa s)."),
    "kd_v_s_per_pa": (0.0, 0.0, 1e-3, "Derivative gain, V s/Pa."),
    "derivative_hz": (40.0, 0.1, 1000.0, "Cut-off of the derivative's filter, Hz."),
    "target_weight": (1.0, 0.0, 1.0, "Share of the target in the derivative."),
    "null_v": (5.0, -24.0, 24.0, "Voltage at which the valve closes, V."),
    "low_v": (0.0, -24.0, 24.0, "Lowest voltage, V."),
    "high_v": (10.0, -24.0, 24.0, "Highest voltage, V."),
    "integral_v": (1.0, 0.0, 24.0, "Limit of the integral term on either side, V."),
}
"""Default, smallest and largest value, description."""


class PidNode(LifecycleNode):
    """A target in, a valve command out."""

    def __init__(self, **options: Any) -> None:
        """Declares the parameters; with ``autostart`` it is active at once.

        Args:
            options: Keywords of ``rclpy.lifecycle.LifecycleNode``.

        Raises:
            InputError: The gains make no controller.
        """
        super().__init__("pid", **options)
        try:
            self._declare()
            if self._autostart:
                self.trigger_configure()
                self.trigger_activate()
        except InputError:
            self.destroy_node()
            raise

    def _declare(self) -> None:
        self._tap = common.declare(
            self,
            "tap",
            "end",
            "Tap whose pressure is controlled; read from taps/<tap>/pressure.",
            read_only=True,
        )
        self._command = common.declare(
            self, "command", "voltage", "Name of the valve command.", read_only=True
        )
        self._rate_hz = common.declare(
            self, "rate_hz", 250.0, "Control rate, Hz.", (1.0, 2000.0), read_only=True
        )
        self._sensor_timeout_s = common.declare(
            self,
            "sensor_timeout_s",
            0.05,
            "Age of the newest reading at which the safe voltage is published, s.",
            (0.001, 1.0),
            read_only=True,
        )
        self._target_timeout_s = common.declare(
            self,
            "target_timeout_s",
            0.25,
            "Age of the newest target at which the safe voltage is published, s.",
            (0.001, 10.0),
            read_only=True,
        )
        self._safe_v = common.declare(
            self,
            "safe_voltage_v",
            5.0,
            "Published while sensor or target are stale, and on deactivation, V.",
            (-24.0, 24.0),
            read_only=True,
        )
        self._autostart = common.declare(
            self, "autostart", False, "Configure and activate at start.", read_only=True
        )
        values = {
            name: common.declare(self, name, default, text, (low, high))
            for name, (default, low, high, text) in GAINS.items()
        }
        self._pid = Pid(Gains(**values))
        self._state = "inactive"
        self._commands = self._sensor_losses = self._target_losses = self._jumps = 0
        self._reported_ns: int | None = None
        self._forget()
        self.add_on_set_parameters_callback(self._check_gains)
        self.add_post_set_parameters_callback(self._take_gains)

    # ---- lifecycle -----------------------------------------------------------------------------

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Creates publishers, subscriptions and diagnostics.

        Args:
            state: Where it comes from.
        """
        self._publisher = self.create_lifecycle_publisher(
            ValveCommand, "valve/command", common.COMMAND_QOS
        )
        self._subscriptions_made = [
            self.create_subscription(
                FluidPressure,
                f"taps/{self._tap}/pressure",
                self._on_pressure,
                qos_profile_sensor_data,
            ),
            self.create_subscription(PressureTarget, "target", self._on_target, common.COMMAND_QOS),
        ]
        # Created while inactive, so that activation waits for nothing.
        self._timer = self.create_timer(1.0 / self._rate_hz, self._tick)
        self._timer.cancel()
        self._diagnostics = common.Diagnostics(self, self._report)
        threshold = JumpThreshold(
            min_forward=None, min_backward=Duration(nanoseconds=-1), on_clock_change=True
        )
        self._jump = self.get_clock().create_jump_callback(threshold, post_callback=self._on_jump)
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begins to command the valve.

        Args:
            state: Where it comes from.
        """
        self._forget()
        self._state = "waiting"
        self._timer.reset()
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Commands the safe voltage once, then nothing.

        Args:
            state: Where it comes from.
        """
        self._timer.cancel()
        self._publish(self._safe_v)
        self._state = "inactive"
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Gives up publishers and subscriptions.

        Args:
            state: Where it comes from.
        """
        self._close()
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Commands the safe voltage where it was active, and gives up everything.

        Args:
            state: Where it comes from.
        """
        if self._state != "inactive":
            self._publish(self._safe_v)
        self._state = "inactive"
        if state.label != "unconfigured":
            self._close()
        return TransitionCallbackReturn.SUCCESS

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Commands the safe voltage and starts over unconfigured.

        Args:
            state: Where it comes from.
        """
        return self.on_shutdown(state)

    def _close(self) -> None:
        self.destroy_timer(self._timer)
        self._diagnostics.close()
        for subscription in self._subscriptions_made:
            self.destroy_subscription(subscription)
        self.destroy_lifecycle_publisher(self._publisher)
        self._jump.unregister()

    # ---- callbacks -----------------------------------------------------------------------------

    def _forget(self) -> None:
        """Forgets all that belongs to the past, as after a jump of the clock."""
        self._pid.reset()
        self._pressure: tuple[int, float, int] | None = None  # stamp, Pa, arrival
        self._used_ns: int | None = None
        self._target: tuple[int, float, tuple[float, ...], int] | None = None
        self._volts = self._safe_v
        self._error_square = self._error_count = 0.0

    def _now_ns(self) -> int:
        """The clock that ages are told by: steady, or simulated where that is in use."""
        clock = self.get_clock()
        simulated = isinstance(clock, ROSClock) and clock.ros_time_is_active
        return int((clock if simulated else self._steady).now().nanoseconds)

    _steady = common.steady_clock()

    def _on_jump(self, jump: Any) -> None:
        self._jumps += 1
        self._forget()

    def _on_pressure(self, message: FluidPressure) -> None:
        if not math.isfinite(message.fluid_pressure):
            return
        stamp = common.from_stamp(message.header.stamp)
        self._pressure = (stamp, message.fluid_pressure, self._now_ns())

    def _on_target(self, message: PressureTarget) -> None:
        values = tuple(float(v) for v in message.pressure_pa)
        usable = all(math.isfinite(v) and v > 0.0 for v in values) and values
        if message.tap not in ("", self._tap) or not usable or not message.step_s > 0.0:
            self.get_logger().warning(
                f"target ignored: for tap {message.tap!r}, {len(values)} values,"
                f" step {message.step_s} s",
                throttle_duration_sec=1.0,
            )
            return
        stamp = common.from_stamp(message.header.stamp)
        self._target = (stamp, message.step_s, values, self._now_ns())

    def _target_at(self, stamp_ns: int) -> float:
        """The target at the time of a reading; beyond what is known, the nearest value."""
        assert self._target is not None
        begin, step_s, values, _ = self._target
        at = min(max((stamp_ns - begin) * 1e-9 / step_s, 0.0), len(values) - 1.0)
        left = int(at)
        right = min(left + 1, len(values) - 1)
        return values[left] + (values[right] - values[left]) * (at - left)

    def _tick(self) -> None:
        now = self._now_ns()
        if self._pressure is None or now - self._pressure[2] > self._sensor_timeout_s * 1e9:
            self._lose("no pressure reading")
        elif self._target is None or now - self._target[3] > self._target_timeout_s * 1e9:
            self._lose("no target")
        else:
            self._control(*self._pressure[:2])
        self._publish(self._volts)

    def _lose(self, what: str) -> None:
        if self._state != what:
            self._sensor_losses += what == "no pressure reading"
            self._target_losses += what == "no target"
            self.get_logger().warning(f"{what}: safe voltage of {self._safe_v:g} V")
            self._state = what
            self._pid.reset()
            self._used_ns = None
        self._volts = self._safe_v

    def _control(self, stamp_ns: int, pressure_pa: float) -> None:
        if self._state != "tracking":
            self.get_logger().info("tracking")
            self._state = "tracking"
        dt_s = 0.0 if self._used_ns is None else (stamp_ns - self._used_ns) * 1e-9
        if self._used_ns is not None and dt_s == 0.0:
            return  # nothing new: the voltage stands
        if dt_s < 0.0:
            self._pid.reset()
        self._used_ns = stamp_ns
        self._volts = self._pid.step(self._target_at(stamp_ns), pressure_pa, dt_s)
        self._error_square += self._pid.error_pa**2
        self._error_count += 1.0

    def _publish(self, volts: float) -> None:
        message = ValveCommand(name=[self._command], voltage_v=[volts])
        message.header.stamp = self.get_clock().now().to_msg()
        self._publisher.publish(message)
        self._commands += 1

    def _report(self) -> list[DiagnosticStatus]:
        level = DiagnosticStatus.OK
        if self._state.startswith("no "):
            level = DiagnosticStatus.WARN
        rms = math.sqrt(self._error_square / self._error_count) if self._error_count else math.nan
        self._error_square = self._error_count = 0.0
        values: Mapping[str, object] = {
            "voltage (V)": self._volts,
            "rms error (Pa)": rms,
            "integral (V)": self._pid.integral_v,
            "commands": self._commands,
            "readings lost": self._sensor_losses,
            "targets lost": self._target_losses,
            "jumps of the clock": self._jumps,
        }
        text = self._state if level == DiagnosticStatus.OK else f"{self._state}: safe voltage"
        # Reports are timed by the steady clock, control by this one: then no command is sent.
        before_ns, self._reported_ns = self._reported_ns, self._now_ns()
        if self._reported_ns == before_ns and self._state != "inactive":
            level, text = DiagnosticStatus.WARN, "the clock stands still: no commands"
        return [common.status(level, f"{self.get_name()}: control", text, values, self._tap)]

    # ---- parameters ----------------------------------------------------------------------------

    def _with(self, parameters: list[Any]) -> Gains | None:
        changed = {p.name: float(p.value) for p in parameters if p.name in GAINS}
        return Gains(**{**vars(self._pid.gains), **changed}) if changed else None

    def _check_gains(self, parameters: list[Any]) -> SetParametersResult:
        try:
            self._with(parameters)
        except InputError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _take_gains(self, parameters: list[Any]) -> None:
        gains = self._with(parameters)
        if gains is not None:
            self._pid.gains = gains


def main(args: list[str] | None = None) -> None:
    """Runs the node.

    Args:
        args: Command line; None is the process's own.
    """
    common.run_node(PidNode, args)


if __name__ == "__main__":
    main()
