# SPDX-License-Identifier: Apache-2.0
"""What the nodes of all controllers of a pressure share; see `pneu_policy.nodes.controlling`.

They command one valve by the readings of taps, and hear a target of one of these. Which voltage is
said by the node of the controller.
"""

import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pneu_msgs.msg import PressureTarget

from pneu_graph.nodes import common
from pneu_graph.nodes.parameters import parameter
from pneu_policy.nodes.controlling import (
    NO_TARGET,
    SHORT_TARGET,
    ControllingNode,
    ControllingParameters,
)


@dataclass
class ControlParameters(ControllingParameters):
    """What the nodes of all controllers of a pressure are told."""

    command: str = parameter("voltage", "Name of the valve command.", read_only=True)


class ControlNode(ControllingNode):
    """A target of a pressure and readings in, a valve command out."""

    parameters = ControlParameters
    _params: ControlParameters

    def __init__(self, name: str, **options: Any) -> None:
        """Declares the parameters; with ``autostart`` it is active at once.

        Args:
            name: Name of the node.
            options: Keywords of ``rclpy.lifecycle.LifecycleNode``.

        Raises:
            InputError: The parameters make no controller.
        """
        self._tap = ""
        self._preview_s: tuple[float, ...] = (0.0,)
        super().__init__(name, **options)

    @abstractmethod
    def _make_one(self) -> None:
        """Makes the controller; sets ``_tap``, ``_taps``, ``_preview_s`` and ``_period_s``.

        Raises:
            InputError: The parameters make none; the node then stays unconfigured.
        """

    @abstractmethod
    def _step(self, stamp_ns: int, pressures_pa: Mapping[str, float]) -> float | None:
        """Voltage for the newest readings; None leaves the one before.

        Args:
            stamp_ns: Time of the reading of the controlled tap, or of another where that is lost,
                ns.
            pressures_pa: Per tap its reading, Pa; NaN of one that is lost and may be.
        """

    def _make(self) -> None:
        self._make_one()
        self._valves = (self._params.command,)

    def _about(self) -> str:
        return self._tap

    def _hear_target(self) -> Any:
        return self.create_subscription(
            PressureTarget, "target", self._on_target, common.COMMAND_QOS
        )

    def _forget_target(self) -> None:
        self._target: tuple[int, float, tuple[float, ...], int] | None = None
        self._error_square = self._error_count = 0.0

    def _target_lost(self, now_ns: int) -> tuple[str, str] | None:
        if self._target is None or now_ns - self._target[3] > self._params.target_timeout_s * 1e9:
            topic = self.resolve_topic_name("target")
            if self._target is None:
                return NO_TARGET, f"never heard one on {topic}"
            return NO_TARGET, f"for {self._params.target_timeout_s:g} s none on {topic}"
        known_s = (len(self._target[2]) - 1) * self._target[1]
        if known_s < self._preview_s[-1] - 1e-9:
            return SHORT_TARGET, f"it tells {known_s:g} s ahead, needed are {self._preview_s[-1]:g}"
        return None

    def _on_target(self, message: PressureTarget) -> None:
        values = tuple(float(v) for v in message.pressure_pa)
        low_pa, high_pa = self._params.lowest_pa, self._params.highest_pa
        usable = bool(values) and all(low_pa <= v <= high_pa for v in values)
        step = math.isfinite(message.step_s) and message.step_s > 0.0
        if message.tap not in ("", self._tap) or not usable or not step:
            # What was heard before stands until it is too old.
            extremes = f" of {min(values):g} to {max(values):g} Pa" if values else ""
            self.get_logger().warning(
                f"target ignored: for tap {message.tap!r}, {len(values)} values{extremes}, step"
                f" {message.step_s} s; possible are {low_pa:g} to {high_pa:g} Pa",
                throttle_duration_sec=1.0,
            )
            return
        stamp = common.from_stamp(message.header.stamp)
        self._target = (stamp, message.step_s, values, self._now_ns())

    def _targets_at(self, stamp_ns: int, ahead_s: Sequence[float]) -> list[float]:
        """The target some times after a reading; beyond what is known, the nearest value."""
        assert self._target is not None
        begin, step_s, values, _ = self._target
        last = len(values) - 1
        since_s = (stamp_ns - begin) * 1e-9
        found = []
        for ahead in ahead_s:
            at = min(max((since_s + ahead) / step_s, 0.0), float(last))
            left = int(at)
            right = min(left + 1, last)
            found.append(values[left] + (values[right] - values[left]) * (at - left))
        return found

    def _asked(self) -> Mapping[str, float] | None:
        there = [t for t in (self._tap, *self._taps) if t in self._taps and t not in self._lost]
        newest = self._readings[there[0]]
        pressures = {
            t: math.nan if t in self._lost else self._readings[t].value for t in self._taps
        }
        volts = self._step(newest.stamp_ns, pressures)
        if volts is None:
            return None
        if there[0] != self._tap:
            return {self._params.command: volts}
        self._error_square += (self._targets_at(newest.stamp_ns, (0.0,))[0] - newest.value) ** 2
        self._error_count += 1.0
        return {self._params.command: volts}

    def _figures(self) -> Mapping[str, object]:
        rms = math.sqrt(self._error_square / self._error_count) if self._error_count else math.nan
        self._error_square = self._error_count = 0.0
        return {"rms error (Pa)": rms}
