# SPDX-License-Identifier: Apache-2.0
"""Parts of recordings by what the rig was doing, told at every tick of a model's run."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pneu_sysid.results.compare import RegimeKind

Mask = NDArray[np.bool_]

STILL = 0.02
"""A flow, a speed or a rate of change below this part of its 99th percentile counts as none."""


@dataclass(frozen=True)
class Ticks:
    """Something that is so or not at every tick of every recording.

    Attributes:
        kind: By what the ticks are divided.
        label: Which part this is.
        masks: Per recording (ticks,) which belong to it.
        of: The valve, port, cylinder or joint that it is about; empty where it is the sensor
            itself.
        lower: Where the part begins on its scale (opening, N, rad/s); None where it has none.
        upper: Where it ends.
    """

    kind: RegimeKind
    label: str
    masks: list[Mask]
    of: str = ""
    lower: float | None = None
    upper: float | None = None
