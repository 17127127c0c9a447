# SPDX-License-Identifier: Apache-2.0
"""A controller that sees virtual taps: what an observer says of them, from fewer that are there.

Any controller will do. It is told of every tap what the observer estimates, of those that are there
too, and does not know the difference; a policy that sees the gas of lines is told that as well.
"""

from collections.abc import Mapping, Sequence

from pneu_common.errors import InputError
from pneu_policy.control.controller import Controller
from pneu_policy.control.followed import Followed, FollowedSettings
from pneu_policy.control.identity import OF_LINES, check_same, rig_identity
from pneu_policy.control.learned import PolicyController
from pneu_sim.rig.schema import Rig


class VirtualTaps:
    """Another controller, told what an observer sees.

    Attributes:
        name: What to call it.
        tap: Tap whose pressure it controls.
        taps: Taps that are there.
        preview_s: Times ahead at which it is told the target, s.
        period_s: Time from one step to the next, s.
        controller: The other controller.
        rig: The model.
        followed: What follows the state.
    """

    def __init__(
        self, controller: Controller, rig: Rig, settings: FollowedSettings, name: str = "virtual"
    ) -> None:
        """Builds the observer.

        Args:
            controller: The controller that commands.
            rig: The rig, calibrated.
            settings: Taps that are there, and how the state is followed.
            name: What to call it.

        Raises:
            InputError: The rig lacks a tap or a pipe, or cannot be followed.
        """
        self.name, self.controller, self.rig = name, controller, rig
        self.tap, self.taps = controller.tap, settings.taps
        self.preview_s, self.period_s = controller.preview_s, controller.period_s
        for tap in controller.taps:
            if tap not in rig.taps:
                raise InputError(f"taps: {tap!r}: rig {rig.name!r} has {', '.join(rig.taps)}")
        self.followed = Followed(rig, settings, self.period_s)
        self._policy = controller if isinstance(controller, PolicyController) else None
        self._points = () if self._policy is None else self._policy.policy.recipe.line
        if self._points:
            self.followed.line(self._points)  # raises where there is no such pipe
        self.reset()

    def check_rig(self, rig: Rig, who: str) -> None:
        """Refuses a rig that it does not observe.

        Args:
            rig: The rig it shall run on.
            who: What to call it.

        Raises:
            InputError: It has other commands, taps or pipes.
        """
        check_same(rig_identity(self.rig), rig_identity(rig), OF_LINES, who, "observes")

    def reset(self) -> None:
        """Forgets the past."""
        self.controller.reset()
        self.followed.reset()

    def step(self, taps_pa: Mapping[str, float], targets_pa: Sequence[float]) -> float:
        """Voltage for the next period; see `Controller.step`.

        Args:
            taps_pa: Per tap its newest reading, Pa; one that is not finite is not there.
            targets_pa: Target at the times ahead, Pa.
        """
        told = self.followed.look(taps_pa)
        seen = {tap: told[tap] for tap in self.controller.taps}
        if self._policy is not None and self._points:
            volts = self._policy.step(seen, targets_pa, self.followed.line(self._points))
        else:
            volts = self.controller.step(seen, targets_pa)
        self.followed.acted(volts)
        return volts
