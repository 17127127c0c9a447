# SPDX-License-Identifier: Apache-2.0
"""The PID node: tracks a target pressure at a tap by a proportional valve (thesis 8.1.1).

A lifecycle node: it commands the valve while active only, and a deactivation ends with the safe
voltage. Parameters and topics: see ``ros_ws/README.md``.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from rcl_interfaces.msg import SetParametersResult

from pneu_common.errors import InputError
from pneu_graph.nodes.parameters import parameter
from pneu_policy.control.pid import Gains, Pid
from pneu_policy.nodes.control import ControlNode, ControlParameters
from pneu_policy.nodes.running import run_controller

GAINS = tuple(f.name for f in fields(Gains))


@dataclass
class PidParameters(ControlParameters):
    """What the PID node is told; gains may be set while it runs."""

    tap: str = parameter(
        "end", "Tap whose pressure is controlled; read from taps/<tap>/pressure.", read_only=True
    )
    rate_hz: float = parameter(250.0, "Control rate, Hz.", within=(1.0, 2000.0), read_only=True)
    kp_v_per_pa: float = parameter(1.0e-5, "Proportional gain, V/Pa.", within=(0.0, 1e-2))
    ki_v_per_pa_s: float = parameter(2.0e-5, "Integral gain, V/(Pa s).", within=(0.0, 1e-1))
    kd_v_s_per_pa: float = parameter(0.0, "Derivative gain, V s/Pa.", within=(0.0, 1e-3))
    derivative_hz: float = parameter(
        40.0, "Cut-off of the derivative's filter, Hz.", within=(0.1, 1000.0)
    )
    target_weight: float = parameter(
        1.0, "Share of the target in the derivative.", within=(0.0, 1.0)
    )
    null_v: float = parameter(5.0, "Voltage at which the valve closes, V.", within=(-24.0, 24.0))
    low_v: float = parameter(0.0, "Lowest voltage, V.", within=(-24.0, 24.0))
    high_v: float = parameter(10.0, "Highest voltage, V.", within=(-24.0, 24.0))
    integral_v: float = parameter(
        1.0, "Limit of the integral term on either side, V.", within=(0.0, 24.0)
    )


class PidNode(ControlNode):
    """A PID, stepped by each new reading."""

    parameters = PidParameters
    _params: PidParameters

    def __init__(self, **options: Any) -> None:
        """Declares the parameters; with ``autostart`` it is active at once.

        Args:
            options: Keywords of ``rclpy.lifecycle.LifecycleNode``.

        Raises:
            InputError: The gains make no controller.
        """
        super().__init__("pid", **options)

    def _set_up(self) -> None:
        self._tap = self._params.tap
        self._pid = Pid(Gains(**{name: getattr(self._params, name) for name in GAINS}))
        self.add_on_set_parameters_callback(self._check_gains)
        self.add_post_set_parameters_callback(self._take_gains)

    def _make_one(self) -> None:
        self._taps = (self._tap,)
        self._period_s = 1.0 / self._params.rate_hz

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
        return {**super()._figures(), "integral (V)": self._pid.integral_v}

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
