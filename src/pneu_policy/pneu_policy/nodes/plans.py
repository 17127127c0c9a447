# SPDX-License-Identifier: Apache-2.0
"""What the nodes of predictive controllers share: the process that plans, time, what they tell."""

import contextlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from pneu_msgs.msg import ValveCommand
from rclpy.node import Node

from pneu_graph.nodes import common
from pneu_hw_bridge.priority import precedence
from pneu_policy.control.planning import PLANS, PLANS_LATE
from pneu_policy.control.predictive import PredictiveController
from pneu_sim import topics

MOST_LATE_S = 0.05
"""An age of readings that is beyond this is that of another clock."""
LATEST_NS = 100_000_000
"""A reading that is older than the last one by no more than this is late, else the clock jumped."""


class Plans:
    """The plans of a predictive controller, made beside a node; of any other there are none.

    Attributes:
        controller: The controller.
    """

    def __init__(self) -> None:
        """Has no controller yet."""
        self.controller: PredictiveController | None = None
        self._first = contextlib.ExitStack()
        self._stepped_ns: int | None = None

    def begin(self, controller: PredictiveController) -> None:
        """Has plans of a controller be made by a process beside.

        Args:
            controller: The controller.

        Raises:
            InputError: The process does not come up.
        """
        # late commands are wrong ones; the process that plans inherits it
        self._first.enter_context(precedence())
        controller.plan_beside()
        controller.deferred = True
        self.controller = controller

    def end(self) -> None:
        """Ends the process, if there is one."""
        if self.controller is not None:
            self.controller.end()
            self.controller = None
            self._first.close()

    def rest(self) -> None:
        """Forgets when it was stepped last, and the state; what the rig is like it still knows."""
        self._stepped_ns = None
        if self.controller is not None:
            self.controller.pause()

    def listen(self, node: Node) -> list[Any]:
        """Hears what is applied, for a predictive controller.

        Args:
            node: Who listens.

        Returns:
            The subscriptions.
        """
        if self.controller is None:
            return []
        return [
            node.create_subscription(
                ValveCommand, topics.APPLIED_TOPIC, self._on_applied, common.READINGS_QOS
            )
        ]

    def _on_applied(self, message: ValveCommand) -> None:
        """Takes what was applied."""
        if self.controller is not None and self._stepped_ns is not None:
            volts = dict(zip(message.name, message.voltage_v, strict=False))
            ago_s = 1e-9 * (self._stepped_ns - common.from_stamp(message.header.stamp))
            self.controller.applied(ago_s, volts)

    def follow(self) -> None:
        """Does what need not be done before the voltages go out."""
        if self.controller is not None:
            self.controller.follow()

    def timed(self, stamp_ns: int, now_ns: int) -> tuple[bool, float | None, float]:
        """When the readings of a step are of.

        Args:
            stamp_ns: Stamp of the newest, ns.
            now_ns: Now, by the same clock, ns.

        Returns:
            Whether they are newer than those of the last step; the time since those, s; and how
            old they are, s.
        """
        assert self.controller is not None
        before, new = self._stepped_ns, True
        if before is not None and 0 <= before - stamp_ns <= LATEST_NS:
            # nothing new, or of before what has been foreseen already
            stamp_ns, new = before + round(self.controller.period_s * 1e9), False
        self._stepped_ns = stamp_ns
        since_s = None if before is None else (stamp_ns - before) * 1e-9
        late_s = 1e-9 * (now_ns - stamp_ns)
        return new, since_s, min(max(late_s, 0.0), MOST_LATE_S)

    def figures(self, lost: Mapping[str, tuple[str, str]]) -> dict[str, object]:
        """What is told of it in /diagnostics.

        Args:
            lost: By sensor what is wrong with its readings.
        """
        controller = self.controller
        if controller is None:
            return {}
        took, observer = np.array(controller.took_s or [np.nan]), controller.observer
        told: dict[str, object] = {
            "plan, 99 of 100 (ms)": 1e3 * float(np.quantile(took, 0.99)),
            PLANS: controller.asked,
            PLANS_LATE: controller.missed,
            "model": "; ".join(observer.watch.wrong) or "holds",
        }
        for name in controller.taps:
            matter = lost[name][0] if name in lost else observer.trust.matter(name)
            if matter:
                told[f"{'tap' if name in observer.rig.taps else 'encoder'} {name}"] = matter
        return told
