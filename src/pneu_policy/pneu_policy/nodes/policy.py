# SPDX-License-Identifier: Apache-2.0
"""The policy node: a learned controller, or any other that is read from a file, on the live graph.

A lifecycle node like that of the PID. It steps its controller at the period that the file names,
with the newest reading of each tap that the controller sees. Parameters and topics: see
``ros_ws/README.md``.
"""

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pneu_common.errors import InputError
from pneu_graph.nodes.parameters import parameter
from pneu_hw_bridge.priority import precedence
from pneu_policy.control.controllers import Controller, PolicyController, load_controller
from pneu_policy.control.planning import PLANS, PLANS_LATE
from pneu_policy.control.predictive import PredictiveController
from pneu_policy.control.virtual import VirtualTaps
from pneu_policy.nodes.control import ControlNode, ControlParameters
from pneu_policy.nodes.running import run_controller

MOST_LATE_S = 0.05
"""An age of readings that is beyond this is that of another clock."""
LATEST_NS = 100_000_000
"""A reading that is older than the last one by no more than this is late, else the clock jumped."""


@dataclass
class PolicyParameters(ControlParameters):
    """What the policy node is told."""

    policy: str = parameter(
        "",
        "File of the controller: a policy (.npz), a tuned PID or a predictive one (.yaml).",
        read_only=True,
    )
    virtual_for_s: float = parameter(
        3.0,
        "A predictive controller goes on without its controlled tap for so long, by what the"
        " others and the model say, s; then the safe voltage is published.",
        within=(0.0, 3600.0),
        read_only=True,
    )


class PolicyNode(ControlNode):
    """A controller from a file, stepped at its own period.

    A reading that is no number leads to the safe voltage at once, not after the timeout: a network
    would answer it with a voltage that means nothing.
    """

    parameters = PolicyParameters
    takes_nan = True
    _params: PolicyParameters

    def __init__(self, **options: Any) -> None:
        """Declares the parameters; with ``autostart`` it is active at once.

        Args:
            options: Keywords of ``rclpy.lifecycle.LifecycleNode``.

        Raises:
            InputError: It shall start at once, and the file holds no controller of the rig.
        """
        self._controller: Controller | None = None
        self._predictive: PredictiveController | None = None
        self._first = contextlib.ExitStack()
        super().__init__("policy", **options)

    def _make_one(self) -> None:
        if not self._params.policy:
            raise InputError("parameter policy: found none, needed is the file of a controller")
        controller = load_controller(self._params.policy)
        rig = self._rig
        if isinstance(controller, PolicyController):
            policy = controller.policy
            if policy.recipe.line:
                raise InputError(
                    f"{self._params.policy}: this policy sees the gas of lines, which no sensor"
                    " tells"
                )
            if self._params.command not in policy.rig["commands"]:
                raise InputError(
                    f"parameter command: found {self._params.command!r}, the policy commands"
                    f" {', '.join(policy.rig['commands'])}"
                )
            if rig is not None:
                policy.check_rig(rig)
        self._end_planning()
        if isinstance(controller, PredictiveController):
            self._check_model(controller)
            # late commands are wrong ones; the process that plans inherits it
            self._first.enter_context(precedence())
            controller.plan_beside()
            controller.deferred = True
            self._predictive = controller
            self._spare = frozenset(controller.taps)
        if isinstance(controller, VirtualTaps) and rig is not None:
            controller.check_rig(rig, self._params.policy)
        self._controller = controller
        self._tap, self._taps = controller.tap, controller.taps
        self._preview_s, self._period_s = controller.preview_s, controller.period_s

    def _check_model(self, controller: PredictiveController) -> None:
        """Raises InputError where a controller plans on another rig or command than it has."""
        commands = list(controller.rig.commands)
        if self._params.command not in commands:
            raise InputError(
                f"parameter command: found {self._params.command!r}, the controller's rig has"
                f" {', '.join(commands)}"
            )
        if self._rig is not None:
            controller.check_rig(self._rig, self._params.policy)

    def _end_planning(self) -> None:
        if self._predictive is not None:
            self._predictive.end()
            self._predictive = None
            self._first.close()

    def destroy_node(self) -> None:
        """Ends planning, then the node."""
        self._end_planning()
        super().destroy_node()

    def _rest(self) -> None:
        self._stepped_ns: int | None = None
        self._blind_ns: int | None = None
        if self._controller is not None:
            self._controller.reset()

    def _step(self, stamp_ns: int, pressures_pa: Mapping[str, float]) -> float:
        assert self._controller is not None
        targets = self._targets_at(stamp_ns, self._preview_s)
        if isinstance(self._controller, PredictiveController):
            return self._step_predictive(self._controller, stamp_ns, pressures_pa, targets)
        return self._controller.step(pressures_pa, targets)

    def _step_predictive(
        self,
        controller: PredictiveController,
        stamp_ns: int,
        pressures_pa: Mapping[str, float],
        targets: Sequence[float],
    ) -> float:
        period_ns = round(controller.period_s * 1e9)
        before = self._stepped_ns
        if before is not None and 0 <= before - stamp_ns <= LATEST_NS:
            # nothing new, or of before what has been foreseen already
            stamp_ns, pressures_pa = before + period_ns, {}
        self._stepped_ns = stamp_ns
        since_s = None if before is None else (stamp_ns - before) * 1e-9
        late_s = 1e-9 * (int(self.get_clock().now().nanoseconds) - stamp_ns)
        return controller.step(pressures_pa, targets, since_s, min(max(late_s, 0.0), MOST_LATE_S))

    def _afterwards(self) -> None:
        if self._predictive is not None:
            self._predictive.follow()

    def _target_lost(self, now_ns: int) -> tuple[str, str] | None:
        """Also where the controlled tap has been lost for too long."""
        if self._tap not in self._lost:
            self._blind_ns = None
        elif self._blind_ns is None:
            self._blind_ns = now_ns
        elif now_ns - self._blind_ns > self._params.virtual_for_s * 1e9:
            return self._lost[self._tap]
        return super()._target_lost(now_ns)

    def _figures(self) -> Mapping[str, object]:
        told = dict(super()._figures())
        controller = self._controller
        if isinstance(controller, PredictiveController):
            took = np.array(controller.took_s or [np.nan])
            told["plan, 99 of 100 (ms)"] = 1e3 * float(np.quantile(took, 0.99))
            told[PLANS], told[PLANS_LATE] = controller.asked, controller.missed
            observer = controller.observer
            told["model"] = "; ".join(observer.watch.wrong) or "holds"
            for name in controller.taps:
                matter = self._lost[name][0] if name in self._lost else observer.trust.matter(name)
                if matter:
                    told[f"tap {name}"] = matter
        return told


def main(args: list[str] | None = None) -> None:
    """Runs the node.

    Args:
        args: Command line; None is the process's own.
    """
    run_controller(PolicyNode, args)


if __name__ == "__main__":
    main()
