# SPDX-License-Identifier: Apache-2.0
"""The policy node: a learned controller, or any other that is read from a file, on the live graph.

A lifecycle node like that of the PID. It steps its controller at the period that the file names,
with the newest reading of each tap that the controller sees. Parameters and topics: see
``ros_ws/README.md``.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pneu_common.errors import InputError
from pneu_graph.nodes.parameters import parameter
from pneu_policy.control.controllers import Controller, load_controller
from pneu_policy.control.learned import PolicyController
from pneu_policy.control.predictive import PredictiveController
from pneu_policy.control.virtual import VirtualTaps
from pneu_policy.nodes.control import ControlNode, ControlParameters
from pneu_policy.nodes.plans import Plans
from pneu_policy.nodes.running import run_controller


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
        self._plans = Plans()
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
                    " tells; an observer does, by a controller of kind `virtual`"
                )
            if self._params.command not in policy.rig["commands"]:
                raise InputError(
                    f"parameter command: found {self._params.command!r}, the policy commands"
                    f" {', '.join(policy.rig['commands'])}"
                )
            if rig is not None:
                policy.check_rig(rig)
        self._plans.end()
        if isinstance(controller, PredictiveController):
            self._check_model(controller)
            self._plans.begin(controller)
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

    def destroy_node(self) -> None:
        """Ends planning, then the node."""
        self._plans.end()
        super().destroy_node()

    def _rest(self) -> None:
        self._blind_ns: int | None = None
        if self._plans.controller is not None:
            self._plans.rest()
        elif self._controller is not None:
            self._controller.reset()

    def _hear_more(self) -> list[Any]:
        return self._plans.listen(self)

    def _step(self, stamp_ns: int, pressures_pa: Mapping[str, float]) -> float:
        assert self._controller is not None
        targets = self._targets_at(stamp_ns, self._preview_s)
        if not isinstance(self._controller, PredictiveController):
            return self._controller.step(pressures_pa, targets)
        now_ns = int(self.get_clock().now().nanoseconds)
        new, since_s, late_s = self._plans.timed(stamp_ns, now_ns)
        return self._controller.step(pressures_pa if new else {}, targets, since_s, late_s)

    def _afterwards(self) -> None:
        self._plans.follow()

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
        return {**super()._figures(), **self._plans.figures(self._lost)}


def main(args: list[str] | None = None) -> None:
    """Runs the node.

    Args:
        args: Command line; None is the process's own.
    """
    run_controller(PolicyNode, args)


if __name__ == "__main__":
    main()
