# SPDX-License-Identifier: Apache-2.0
"""The play node: commands a rig as a plan of `pneu excite` has it, once, and ends.

It begins when every sensor of the rig is heard and the bridge follows its commands, or no bridge
has told of itself in the time that discovery takes. A plan that was broken off tells nothing that
it promised, so anything wrong after that ends it for good: a sensor that falls silent, a bridge
that trips or is stopped, or one that is heard for the first time and does not follow. Its last word
is the safe voltage; its exit status is 0 where all was played, else another, which says whether
only time failed it, as on a busy machine, so that the plan may be played again
(`design/played.py`).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.task import Future

from pneu_common.errors import InputError
from pneu_graph.nodes.discovery import patience_s
from pneu_graph.nodes.parameters import parameter
from pneu_policy.nodes.controlling import (
    NO_CLOCK,
    NO_READING,
    OLD_READING,
    ControllingNode,
    ControllingParameters,
)
from pneu_policy.nodes.running import run_controller
from pneu_sysid.design.plan import Plan
from pneu_sysid.design.plan_file import check_plan, load_plan
from pneu_sysid.design.played import BROKEN_OFF, UNTIMELY

SAFETY = ": safety"
"""How the status of a bridge ends that says whether its commands are followed."""
TELLS_S = 2.0
"""Within so long a bridge tells of itself once participants know each other, s: it does so every
second."""
TRIPPED = 2
"""Level of such a status from which on the bridge does not follow until somebody releases it."""


@dataclass
class PlayParameters(ControllingParameters):
    """What the play node is told."""

    plan: str = parameter("", "Plan of `pneu excite` (JSON).", read_only=True)
    settle_s: float = parameter(
        2.0,
        "So long the safe voltage is commanded before, for the bridge to follow and the gas to come"
        " to rest, s.",
        within=(0.0, 600.0),
        read_only=True,
    )
    begin_within_s: float = parameter(
        60.0,
        "A plan that cannot begin for so long, by the machine's time, is given up, s: no sensors,"
        " or a bridge that was stopped and waits to be released.",
        within=(0.1, 3600.0),
        read_only=True,
    )
    autostart: bool = parameter(True, "Configure and activate at start.", read_only=True)
    clock_window_s: float = parameter(
        10.0,
        "The rate of simulated time is looked at over so long, s of the machine's time. A rig whose"
        " clock stands still for a moment stands still too, and the plan with both.",
        within=(0.01, 60.0),
        read_only=True,
    )
    rate_hz: float = parameter(500.0, "Commands per second.", within=(50.0, 2000.0), read_only=True)
    sensor_timeout_s: float = parameter(
        0.5,
        "Age of the newest reading at which the plan is broken off, s. The bridge, which is"
        " nearer, vents long before; what it then applies is recorded, and a plan goes on over a"
        " short gap.",
        within=(0.001, 1.0),
        read_only=True,
    )
    frozen_after_s: float = parameter(
        0.0,
        "A tap whose readings stay the same for so long while the valve is driven is dead, s; 0"
        " leaves that to the bridge, since a plan holds still at times.",
        within=(0.0, 10.0),
        read_only=True,
    )


class PlayNode(ControllingNode):
    """The node.

    Attributes:
        done: Set once the plan has ended, with whether all of it was played.
        status: Exit status where it was not.
    """

    parameters = PlayParameters
    _params: PlayParameters

    def __init__(self, **options: Any) -> None:
        """Reads the plan.

        Args:
            options: Keywords of ``rclpy.lifecycle.LifecycleNode``.

        Raises:
            InputError: A parameter or a file is wrong, or the plan is for another rig.
        """
        self.done: Future = Future()
        self.status = BROKEN_OFF
        self._plan: Plan | None = None
        self._settled_ns = self._begun_ns = self._waiting_ns = math.nan
        self._why = ""
        self._levels: dict[str, int] = {}
        super().__init__("play", **options)

    def _make(self) -> None:
        p = self._params
        if not p.plan:
            raise InputError("parameter plan: found nothing, it must be the path of a plan")
        if self._rig is None:
            raise InputError("parameter rig: found nothing, it must be the path of a rig file")
        self._plan = load_plan(Path(p.plan))
        check_plan(self._plan, self._rig, p.plan)
        self._signals = self._plan.signals()
        self._taps = tuple(self._rig.taps)
        self._encoders = tuple(self._rig.encoders)
        self._valves = tuple(self._rig.commands)
        self._period_s = 1.0 / p.rate_hz

    def _rest(self) -> None:
        self._settled_ns = math.nan

    def _hear_target(self) -> Any:
        return self.create_subscription(DiagnosticArray, "/diagnostics", self._on_status, 10)

    def _forget_target(self) -> None:
        pass  # the plan is not heard

    def _target_lost(self, now_ns: int) -> tuple[str, str] | None:
        return None

    def _on_status(self, message: Any) -> None:
        for status in message.status:
            if status.name.endswith(SAFETY):
                level, first = status.level, status.name not in self._levels
                self._levels[status.name] = level[0] if isinstance(level, bytes) else int(level)
                if self._levels[status.name] != 0:
                    self._why = f"{status.name}: {status.message}"
                if self._levels[status.name] >= TRIPPED:
                    self._break_off(self._why)
                elif first and self._levels[status.name] != 0:
                    self._break_off(f"begun before this was known: {self._why}", untimely=True)

    def _tick(self) -> None:
        super()._tick()
        if not math.isnan(self._begun_ns) or self.done.done():
            return
        now_ns = self._steady.now().nanoseconds
        if math.isnan(self._waiting_ns):
            self._waiting_ns = now_ns
        if now_ns - self._waiting_ns > 1e9 * self._params.begin_within_s:
            why = self._detail or self._why or "no bridge has told whether it follows"
            self.get_logger().error(
                f"given up after {self._params.begin_within_s:g} s without a beginning: {why}"
            )
            self.done.set_result(False)

    @property
    def _playing(self) -> bool:
        return not math.isnan(self._begun_ns) and not self.done.done()

    def _asked(self) -> Mapping[str, float] | None:
        assert self._plan is not None
        now_ns = self._now_ns()
        if self.done.done():
            return self._safe()
        if not self._playing:
            followed = self._bridges_are_known() and not any(self._levels.values())
            if math.isnan(self._settled_ns):
                self._settled_ns = now_ns
            if not followed or now_ns - self._settled_ns < 1e9 * self._params.settle_s:
                return self._safe()
            self._begun_ns = now_ns
            self.get_logger().info(f"playing {self._plan.seconds:g} s of {self._params.plan}")
        since_s = 1e-9 * (now_ns - self._begun_ns)
        if since_s >= self._plan.seconds:
            self._volts = self._safe()
            self.get_logger().info("played to the end")
            self.done.set_result(True)
            return self._safe()
        return {name: float(signal.held(since_s)) for name, signal in self._signals.items()}

    def _bridges_are_known(self) -> bool:
        """Whether one has told of itself, or had the time to."""
        waited_ns = self._steady.now().nanoseconds - self._waiting_ns
        return bool(self._levels) or waited_ns > 1e9 * patience_s(TELLS_S)

    def _lose(self, what: str, detail: str) -> None:
        super()._lose(what, detail)
        self._break_off(f"{what} ({detail})", untimely=what in (NO_CLOCK, NO_READING, OLD_READING))

    def _on_jump(self, jump: Any) -> None:
        super()._on_jump(jump)
        self._break_off("the clock jumped", untimely=True)

    def _break_off(self, why: str, untimely: bool = False) -> None:
        """Ends for good what was begun; before that it is waited on."""
        if not self._playing:
            return
        self.status = UNTIMELY if untimely else BROKEN_OFF
        since_s = 1e-9 * (self._now_ns() - self._begun_ns)
        self.get_logger().error(f"broken off after {since_s:.2f} s: {why}")
        self._volts = self._safe()
        self.done.set_result(False)

    def _figures(self) -> Mapping[str, object]:
        if self._plan is None or math.isnan(self._begun_ns):
            return {}
        played = min(1e-9 * (self._now_ns() - self._begun_ns), self._plan.seconds)
        return {"played (s)": round(played, 2), "of (s)": self._plan.seconds}


def main(args: list[str] | None = None) -> None:
    """Runs the node.

    Args:
        args: Command line; None is the process's own.
    """
    run_controller(PlayNode, args)


if __name__ == "__main__":
    main()
