# SPDX-License-Identifier: Apache-2.0
"""The samples of one channel as they arrived, before any repair."""

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

# Damaged stamps may hold any 64 bits; within this, differences of stamps do not overflow.
STAMP_LIMIT_NS = 2**62

GAP_PERIODS = 3.0
"""Sample periods between neighbours above which there is a gap between them."""
LONGEST_STEP = GAP_PERIODS + 0.05
"""The same with what clocks jitter."""

Role = Literal["command", "pressure", "encoder", "position"]
READ: tuple[Role, ...] = ("pressure", "encoder")
"""What models are compared with."""


@dataclass(frozen=True)
class Stream:
    """Samples of one channel in order of arrival.

    Attributes:
        name: Name of the command or tap, or ``valve.position``.
        role: Whether the channel is held from sample to sample (command) or read; of what is read,
            a recording may lack positions of spools.
        source: Where it comes from, worded for messages.
        arrival: Position in the file of each sample, shape (n,), increasing.
        log_ns: Recorder's clock in ns, shape (n,).
        header_ns: Stamp inside each message in ns, shape (n,), or None.
        values: Values in SI units, shape (n,).
        stamp_ns: The clock in use in ns, shape (n,): one of the two above.
        applied: Whether each value is known to have taken effect at its stamp.
    """

    name: str
    role: Role
    source: str
    arrival: NDArray[np.int64]
    log_ns: NDArray[np.int64]
    header_ns: NDArray[np.int64] | None
    values: NDArray[np.float64]
    stamp_ns: NDArray[np.int64]
    applied: bool = False

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.values)

    def pick(self, index: NDArray[Any] | slice) -> "Stream":
        """Return the stream with the samples that a mask, index array or slice selects.

        Args:
            index: Which samples.
        """
        header_ns = None if self.header_ns is None else self.header_ns[index]
        return replace(
            self,
            arrival=self.arrival[index],
            log_ns=self.log_ns[index],
            header_ns=header_ns,
            values=self.values[index],
            stamp_ns=self.stamp_ns[index],
        )

    @property
    def label(self) -> str:
        """Name of the channel for messages."""
        kind = "tap" if self.role == "pressure" else self.role
        return f"{kind} '{self.name}' ({self.source})"


def median_period_ns(stamp_ns: NDArray[np.int64]) -> float:
    """Return the median of the positive steps between stamps in ns (0.0 without any).

    Args:
        stamp_ns: (n,) stamps, ns.
    """
    steps = np.diff(stamp_ns)
    steps = steps[steps > 0]
    return float(np.median(steps)) if steps.size else 0.0
