# SPDX-License-Identifier: Apache-2.0
"""What `pneu tune` is asked for: which controller, on what rigs and targets, how long."""

import math
from dataclasses import dataclass
from typing import Literal, get_args

from pneu_common.errors import InputError
from pneu_policy.targets import KINDS, Kind

PidKind = Literal["pid", "feed_forward"]


@dataclass(frozen=True)
class TuneSettings:
    """What is tuned, and on what.

    Attributes:
        rig: Rig file.
        kind: ``pid`` or ``feed_forward``.
        seed: Seed of the search and of all that is drawn.
        tap: Tap whose pressure is controlled.
        period_s: Control period, s.
        kinds: Kinds of target, in turn.
        low_pa: Lowest target, Pa.
        high_pa: Highest target, Pa.
        target_period_s: Typical time between a target's extremes, s.
        jitter: Share of that by which corners of jagged targets are moved.
        trials: Runs of each candidate, each with a rig and a target of its own.
        seconds: Length of a run, s.
        spread: Rigs are drawn by this many standard errors of the calibration; 0 takes it as is.
        delay_s: Least and most delay of commands, s.
        noise_pa: Noise of the readings, one sigma, Pa.
        dx_m: Cell length of the full model, m. With 0.15 instead of 0.025 the pressures at the end
            of the tubes of 2.5 and 5 m differ by 0.3 kPa rms under steps of the command.
        candidates: Candidates of a generation.
        generations: Generations.
    """

    rig: str
    kind: PidKind = "pid"
    seed: int = 0
    tap: str = "end"
    period_s: float = 0.004
    kinds: tuple[Kind, ...] = ("smooth", "jagged")
    low_pa: float = 150e3
    high_pa: float = 550e3
    target_period_s: float = 0.3
    jitter: float = 0.6
    trials: int = 6
    seconds: float = 2.0
    spread: float = 1.0
    delay_s: tuple[float, float] = (0.002, 0.01)
    noise_pa: float = 250.0
    dx_m: float = 0.15
    candidates: int = 20
    generations: int = 35

    def __post_init__(self) -> None:
        """Raises InputError where a number is out of range."""
        if self.kind not in get_args(PidKind):
            allowed = ", ".join(get_args(PidKind))
            raise InputError(f"kind: found {self.kind!r}, allowed are {allowed}")
        if not self.kinds or any(kind not in KINDS for kind in self.kinds):
            raise InputError(f"kinds: found {list(self.kinds)}, allowed are {', '.join(KINDS)}")
        for name, low, high in (
            ("seed", 0, 2**31 - 1),
            ("trials", 1, 1000),
            ("candidates", 5, 1000),
            ("generations", 1, 1000),
        ):
            if not low <= getattr(self, name) <= high:
                raise InputError(
                    f"{name}: found {getattr(self, name)}, allowed are {low} to {high}"
                )
        if not (math.isfinite(self.seconds) and self.seconds >= self.period_s > 0.0):
            raise InputError(f"seconds: found {self.seconds:g}, needed is a period or more")
        if not (math.isfinite(self.noise_pa) and self.noise_pa >= 0.0):
            raise InputError(f"noise_pa: found {self.noise_pa}, it must not be negative")
        least, most = self.delay_s
        if not 0.0 <= least <= most <= 0.2:
            raise InputError(f"delay_s: found {least:g} to {most:g}, allowed are 0 to 0.2 s")
