# SPDX-License-Identifier: Apache-2.0
"""The policy node: a learned controller, or any other that is read from a file, on the live graph.

A lifecycle node like that of the PID. It steps its controller at the period that the file names,
with the newest reading of each tap that the controller sees. Parameters and topics: see
``ros_ws/README.md``.
"""

from collections.abc import Mapping
from typing import Any

from pneu_common.errors import InputError
from pneu_graph.nodes import common
from pneu_policy.controllers import Controller, PolicyController, load_controller
from pneu_policy.nodes.control import ControlNode
from pneu_policy.nodes.running import run_controller
from pneu_sim.rig import load_rig


class PolicyNode(ControlNode):
    """A controller from a file, stepped at its own period.

    A reading that is no number leads to the safe voltage at once, not after the timeout: a network
    would answer it with a voltage that means nothing.
    """

    takes_nan = True

    def __init__(self, **options: Any) -> None:
        """Declares the parameters; with ``autostart`` it is active at once.

        Args:
            options: Keywords of ``rclpy.lifecycle.LifecycleNode``.

        Raises:
            InputError: It shall start at once, and the file holds no controller of the rig.
        """
        self._controller: Controller | None = None
        super().__init__("policy", **options)

    def _declare(self) -> None:
        self._file = common.declare(
            self,
            "policy",
            "",
            "File of the controller: a policy (.npz), or a tuned PID (.yaml).",
            read_only=True,
        )
        self._rig_file = common.declare(
            self,
            "rig",
            "",
            "Rig file of what is controlled, which the policy must be for; empty is not checked.",
            read_only=True,
        )
        self._declare_common()

    def _make(self) -> None:
        if not self._file:
            raise InputError("parameter policy: found none, needed is the file of a controller")
        controller = load_controller(self._file)
        rig = load_rig(self._rig_file) if self._rig_file else None
        if isinstance(controller, PolicyController):
            policy = controller.policy
            if policy.recipe.line:
                raise InputError(
                    f"{self._file}: this policy sees the gas of lines, which no sensor tells"
                )
            if self._command not in policy.rig["commands"]:
                raise InputError(
                    f"parameter command: found {self._command!r}, the policy commands"
                    f" {', '.join(policy.rig['commands'])}"
                )
            if rig is not None:
                policy.check_rig(rig)
        elif rig is not None and controller.tap not in rig.taps:
            raise InputError(
                f"{self._file}: tap: found {controller.tap!r}, rig {rig.name!r} has"
                f" {', '.join(rig.taps)}"
            )
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
