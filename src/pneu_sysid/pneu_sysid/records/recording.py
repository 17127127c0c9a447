# SPDX-License-Identifier: Apache-2.0
"""A recording on one uniform time grid, and the findings made while it was read."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Finding:
    """One defect or peculiarity of a recording, and how it was handled.

    Attributes:
        channel: Name of the command or tap, or of the file.
        kind: One of ``truncated``, ``no_metadata``, ``no_definition``, ``no_header_stamp``,
            ``clock_offset``, ``clock_rate``, ``clock_jump``, ``out_of_order``,
            ``duplicate``, ``not_finite``, ``unreadable``, ``short_row``, ``irregular``,
            ``missing``, ``gap``, ``event_driven``, ``interpolated``, ``frozen``,
            ``constant``, ``cropped``, ``suspicious_unit``.
        count: Number of samples, gaps or rows concerned.
        action: What was found in figures and what was done, in one sentence.
    """

    channel: str
    kind: str
    count: int
    action: str

    def __str__(self) -> str:
        """Return the finding as one line."""
        return f"{self.channel}: {self.kind} ({self.count}): {self.action}"


@dataclass
class Recording:
    """Signals of one recording on a common uniform grid, in SI units.

    Attributes:
        name: File or folder name without suffix.
        time_s: Grid of shape (T,), uniform, from 0.
        commands: Valve commands by name, each of shape (T,), held between samples; no NaN.
        pressures: Absolute pressures in Pa by tap, each of shape (T,), NaN where missing.
        rate_hz: Grid rate.
        report: What was detected while reading, and how it was handled.
        start_time_s: Clock time of ``time_s[0]`` (Unix time for stamped bags).
    """

    name: str
    time_s: NDArray[np.float64]
    commands: dict[str, NDArray[np.float64]]
    pressures: dict[str, NDArray[np.float64]]
    rate_hz: float
    report: list[Finding] = field(default_factory=list)
    start_time_s: float = 0.0
