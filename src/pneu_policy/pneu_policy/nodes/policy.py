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
from pneu_policy.control.controllers import Controller, PolicyController, load_controller
from pneu_policy.nodes.control import ControlNode, ControlParameters
from pneu_policy.nodes.running import run_controller


@dataclass
class PolicyParameters(ControlParameters):
    """What the policy node is told."""

    policy: str = parameter(
        "", "File of the controller: a policy (.npz), or a tuned PID (.yaml).", read_only=True
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
        self._controller = controller
        self._tap, self._taps = controller.tap, controller.taps
        self._preview_s, self._period_s = controller.preview_s, controller.period_s

    def _rest(self) -> None:
        if self._controller is not None:
            self._controller.reset()

    def _step(self, stamp_ns: int, pressures_pa: Mapping[str, float]) -> float:
        assert self._controller is not None
        return self._controller.step(pressures_pa, self._targets_at(stamp_ns, self._preview_s))


def main(args: list[str] | None = None) -> None:
    """Runs the node.

    Args:
        args: Command line; None is the process's own.
    """
    run_controller(PolicyNode, args)


if __name__ == "__main__":
    main()
