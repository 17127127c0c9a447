# SPDX-License-Identifier: Apache-2.0
"""Predictive control of a robot's joint by the two valves of its cylinder.

One valve opens as far as the other closes, as in thesis eq. 9.2; the observer follows gas, joint
and valves by the taps and the encoder that are told.
"""

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from pneu_policy.control.drive import Drive
from pneu_policy.control.predictive import PredictiveController
from pneu_policy.control.predictive_settings import JointPredictiveSettings
from pneu_sim.rig.schema import Rig

Floats = NDArray[np.float64]


class PredictiveJoint:
    """A predictive controller behind the interface of robots; see `RobotController`.

    Attributes:
        inner: What observes and plans.
    """

    def __init__(
        self, drive: Drive, rig: Rig, settings: JointPredictiveSettings, name: str = "predictive"
    ) -> None:
        """Builds the model.

        Args:
            drive: The joint.
            rig: The rig, as far as it is known.
            settings: How plans are made.
            name: What to call it.

        Raises:
            InputError: The rig cannot be followed, or has other valves as well.
        """
        self.name, self.taps = name, drive.taps
        self.tracked: tuple[str, ...] = (drive.encoder,)
        self.encoders: tuple[str, ...] = self.tracked
        self.commands: tuple[str, ...] = (drive.head_command, drive.rod_command)
        signs = dict(zip(self.commands, (1.0, -1.0), strict=True))
        settings = settings.model_copy(update={"null_v": drive.null_v})
        told = (*drive.taps, drive.encoder)
        self.inner = PredictiveController(rig, drive.encoder, told, settings, name, signs)
        self.period_s = settings.period_s
        self._null_v = drive.null_v
        self._preview = np.array(self.inner.preview_s)
        self.reach = math.ceil(self._preview[-1] / self.period_s - 1e-9) + 1

    def reset(self) -> None:
        """Forgets the past."""
        self.inner.reset()

    def step(
        self,
        positions: Mapping[str, float],
        taps_pa: Mapping[str, float],
        targets: Floats,
        since_s: float | None = None,
        late_s: float = 0.0,
    ) -> dict[str, float]:
        """Voltages for the next period; see `RobotController.step`.

        Args:
            positions: By encoder.
            taps_pa: By tap.
            targets: (1, reach).
            since_s: Time since the readings of the last step, s; None is a period.
            late_s: How old the readings are, s.
        """
        course = targets[0]
        ahead = np.interp(self._preview, self.period_s * np.arange(course.size), course)
        volts = self.inner.step({**taps_pa, **positions}, ahead.tolist(), since_s, late_s)
        return dict(zip(self.commands, (volts, 2.0 * self._null_v - volts), strict=True))
