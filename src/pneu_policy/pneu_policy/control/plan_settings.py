# SPDX-License-Identifier: Apache-2.0
"""How a plan leads a joint to its target; see `pneu_policy.control.planner`."""

from typing import Annotated

from pydantic import Field

from pneu_common.validation import Settings


class PlanSettings(Settings):
    """How a joint is led to its target.

    Attributes:
        joining_hz: Natural frequency of the spring and damper.
        damping: Damping ratio.
        most_rad_s2: Greatest acceleration, rad/s^2 or m/s^2.
        strength: Share of the greatest forces that reservoirs can make which a plan may ask for.
        smoothed_s: Speeds and accelerations of the target are means over so long to either side.
        speed_hz: Cut-off of the first-order filter of the measured speed.
    """

    joining_hz: Annotated[float, Field(gt=0.0)] = 3.5
    damping: Annotated[float, Field(gt=0.0)] = 0.7
    most_rad_s2: Annotated[float, Field(gt=0.0)] = 200.0
    strength: Annotated[float, Field(gt=0.0, le=1.0)] = 0.9
    smoothed_s: Annotated[float, Field(gt=0.0)] = 0.04
    speed_hz: Annotated[float, Field(gt=0.0)] = 30.0
