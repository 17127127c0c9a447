# SPDX-License-Identifier: Apache-2.0
"""The PID node: tracks a target pressure at a tap by a proportional valve (thesis 8.1.1).

A lifecycle node: it commands the valve while active only, and a deactivation ends with the safe
voltage. Parameters and topics: see ``ros_ws/README.md``.
"""

from collections.abc import Mapping
from typing import Any

from rcl_interfaces.msg import SetParametersResult

from pneu_common.errors import InputError
from pneu_graph.nodes import common
from pneu_policy.nodes.control import ControlNode
from pneu_policy.nodes.running import run_controller
from pneu_policy.pid import Gains, Pid

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


class PidNode(ControlNode):
    """A PID, stepped by each new reading."""

    def __init__(self, **options: Any) -> None:
        """Declares the parameters; with ``autostart`` it is active at once.

        Args:
            options: Keywords of ``rclpy.lifecycle.LifecycleNode``.

        Raises:
            InputError: The gains make no controller.
        """
        super().__init__("pid", **options)

    def _declare(self) -> None:
        self._tap = common.declare(
            self,
            "tap",
            "end",
            "Tap whose pressure is controlled; read from taps/<tap>/pressure.",
            read_only=True,
        )
        self._rate_hz = common.declare(
            self, "rate_hz", 250.0, "Control rate, Hz.", (1.0, 2000.0), read_only=True
        )
        self._declare_common()
        values = {
            name: common.declare(self, name, default, text, (low, high))
            for name, (default, low, high, text) in GAINS.items()
        }
        self._pid = Pid(Gains(**values))
        self.add_on_set_parameters_callback(self._check_gains)
        self.add_post_set_parameters_callback(self._take_gains)

    def _make(self) -> None:
        self._taps = (self._tap,)
        self._period_s = 1.0 / self._rate_hz

    def _rest(self) -> None:
        self._pid.reset()
        self._used_ns: int | None = None

    def _step(self, stamp_ns: int, pressures_pa: Mapping[str, float]) -> float | None:
        dt_s = 0.0 if self._used_ns is None else (stamp_ns - self._used_ns) * 1e-9
        if self._used_ns is not None and dt_s == 0.0:
            return None  # nothing new: the voltage stands
        if dt_s < 0.0:
            self._pid.reset()
        self._used_ns = stamp_ns
        (target_pa,) = self._targets_at(stamp_ns, (0.0,))
        return self._pid.step(target_pa, pressures_pa[self._tap], dt_s)

    def _figures(self) -> Mapping[str, object]:
        return {"integral (V)": self._pid.integral_v}

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
    run_controller(PidNode, args)


if __name__ == "__main__":
    main()
