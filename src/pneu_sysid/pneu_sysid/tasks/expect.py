# SPDX-License-Identifier: Apache-2.0
"""How long tasks can be expected to take: from how long one run of the model took here."""

import math
import time
from dataclasses import dataclass, field

from pneu_common.progress import clock

EXPECTED = "expected.json"
"""File of what a look expects of the tasks that may follow it."""
RUNS: dict[str, tuple[float, float]] = {"suspect": (8.0, 35.0), "add": (2.0, 10.0)}
MOVING_RUNS: dict[str, tuple[float, float]] = {"suspect": (20.0, 120.0), "add": (10.0, 40.0)}
"""How many times as long as one run of the model over the recordings a task takes, at least and at
most; the latter where the rig moves something, whose refits have more to find. On lines and
networks, 6 to 17 s of recording, it was 9 to 31 times for what is missing (less where nothing is,
more the more candidates have to be refitted) and 2 to 8 for what is added; on a joint 86 and 25."""


@dataclass
class RunClock:
    """Times a run of the model that tells how far it is.

    What goes before the first part that is done is not taken for the model's: there, kernels are
    compiled.

    Attributes:
        told: Times by the monotonic clock, s, and the fractions that were done by then.
    """

    told: list[tuple[float, float]] = field(default_factory=lambda: [(time.monotonic(), 0.0)])

    def tell(self, done: float, now_s: float | None = None) -> None:
        """Takes down how far it is.

        Args:
            done: Fraction that is done.
            now_s: By the monotonic clock, s; now unless it is given.
        """
        self.told.append((time.monotonic() if now_s is None else now_s, done))

    @property
    def run_s(self) -> float:
        """How long one run takes, s; NaN where none was told to have ended."""
        (end_s, last), (begun_s, first) = self.told[-1], self.told[0]
        if last <= 0.0:
            return math.nan
        for then_s, done in self.told:
            if 0.0 < done < 0.5 * last:
                begun_s, first = then_s, done
                break
        return (end_s - begun_s) / (last - first)


def expected_s(task: str, run_s: float, moves: bool) -> tuple[float, float] | None:
    """How long a task can be expected to take, s, at least and at most.

    Args:
        task: One of `RUNS`; of others nothing is expected.
        run_s: How long one run of the model over the recordings took, s.
        moves: Whether the rig moves something.
    """
    runs = MOVING_RUNS if moves else RUNS
    if task not in runs or not math.isfinite(run_s) or run_s <= 0.0:
        return None
    least, most = runs[task]
    return least * run_s, most * run_s


def expected_words(expected: tuple[float, float]) -> str:
    """A time to be expected in words, such as `0:20 to 1:30`.

    Args:
        expected: At least and at most, s.
    """
    least, most = (clock(_round(x)) for x in expected)
    return least if least == most else f"{least} to {most}"


def _round(seconds: float) -> float:
    """To two digits or less: no more is known."""
    for limit, step in ((10.0, 1.0), (60.0, 5.0), (600.0, 30.0), (3600.0, 60.0)):
        if seconds < limit:
            return max(step * round(seconds / step), 1.0)
    return 600.0 * round(seconds / 600.0)
