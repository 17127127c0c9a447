# SPDX-License-Identifier: Apache-2.0
"""Pressing with a force that is wanted: the tip is led along a line as force is missing."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pneu_sim.hand.paths import Kinematics

Floats = NDArray[np.float64]

LONGEST_S = 0.02
"""A step that took longer counts as so long: what is missing was not known meanwhile."""


@dataclass(frozen=True)
class PressSettings:
    """How an arm presses.

    Attributes:
        mean_n: Force that is wanted, mean.
        swing_n: How far it swings about the mean.
        swing_hz: How often.
        gain_m_s_n: How fast the tip is led on for each newton that is missing.
        lead_m_n: How far it is led on at once.
    """

    mean_n: float = 0.35
    swing_n: float = 0.15
    swing_hz: float = 0.5
    gain_m_s_n: float = 0.1
    lead_m_n: float = 0.01

    def wanted_n(self, time_s: float) -> float:
        """Force that is wanted.

        Args:
            time_s: Since pressing began.
        """
        return float(self.mean_n + self.swing_n * np.sin(2.0 * np.pi * self.swing_hz * time_s))


class Press:
    """Leads a tip along a line (admittance control).

    Attributes:
        along: (3,) direction of the line.
        depth_m: How far along the tip was led.
    """

    def __init__(self, settings: PressSettings, kinematics: Kinematics, along: Floats) -> None:
        """Begins where the tip is with all angles zero.

        Args:
            settings: How it presses.
            kinematics: The arm's.
            along: (3,) direction of the line.
        """
        self.settings, self.along = settings, along
        self.depth_m = 0.0
        self._kinematics = kinematics
        self._near = np.zeros(len(kinematics.lower_rad))
        self._start = kinematics.tip(self._near)

    def angles(self, time_s: float, step_s: float, force_n: float) -> Floats:
        """(j,) angles to go to.

        Args:
            time_s: Since pressing began.
            step_s: Since the last call.
            force_n: Force on the thing along the line, as it is known.
        """
        missing = self.settings.wanted_n(time_s) - force_n
        self.depth_m += self.settings.gain_m_s_n * missing * min(step_s, LONGEST_S)
        self.depth_m = float(np.clip(self.depth_m, -0.01, 0.1))
        place = self._start + (self.depth_m + self.settings.lead_m_n * missing) * self.along
        self._near = self._kinematics.angles(place, self._near)
        return self._near
