# SPDX-License-Identifier: Apache-2.0
"""What controllers are tried on: the targets of an evaluation, and its conditions."""

from dataclasses import asdict, dataclass
from typing import Any, cast

from pneu_common.errors import InputError
from pneu_policy.judge.metrics import LATE_S, Metrics, Track, measure
from pneu_policy.task.targets import KINDS, Kind, Target

LONGEST_S = 3600.0
"""Longest run, s."""
NOISE_PA = 250.0
"""Noise of the sensors, one sigma: what the calibrations of the rigs found as noise floor."""


@dataclass(frozen=True)
class Tasks:
    """What controllers are tried on.

    Attributes:
        kinds: Kinds of target.
        seeds: Seeds of the targets; each is a run.
        low_pa: Lowest target, Pa.
        high_pa: Highest target, Pa.
        period_s: Typical time between a target's extremes, s.
        jitter: Share of that by which corners of jagged targets are moved.
        duration_s: Length of a run, s.
        skip_s: Beginning that is not judged, s.
        null_v: Voltage at which the valve closes, V.
    """

    kinds: tuple[Kind, ...] = ("smooth", "jagged")
    seeds: tuple[int, ...] = (0, 1, 2, 3, 4)
    low_pa: float = 150e3
    high_pa: float = 550e3
    period_s: float = 0.3
    jitter: float = 0.6
    duration_s: float = 12.0
    skip_s: float = 1.0
    null_v: float = 5.0

    def __post_init__(self) -> None:
        """Raises InputError where the numbers make no runs."""
        for kind in self.kinds:
            if kind not in KINDS:
                raise InputError(f"targets: found {kind!r}, allowed are {', '.join(KINDS)}")
        if not self.kinds or not self.seeds:
            raise InputError("targets, seeds: found none, needed is at least one of each")
        if len(set(self.kinds)) < len(self.kinds) or len(set(self.seeds)) < len(self.seeds):
            raise InputError("targets, seeds: found one twice, each is run once")
        if not 0.0 < self.duration_s <= LONGEST_S:
            raise InputError(
                f"duration_s: found {self.duration_s:g}, allowed are up to {LONGEST_S:g} s"
            )
        if not LATE_S <= self.skip_s < self.duration_s - 0.5:
            raise InputError(
                f"skip_s: found {self.skip_s:g}, allowed are {LATE_S:g} s to half a second before"
                f" the end at {self.duration_s:g} s"
            )
        self.target(self.kinds[0], self.seeds[0])

    @property
    def band_hz(self) -> float:
        """Upper end of the targets' band: twice the fastest sine of a smooth one."""
        return 3.0 / self.period_s

    def target(self, kind: str, seed: int) -> Target:
        """The target of a run.

        Args:
            kind: Its kind.
            seed: Its seed.
        """
        return Target(
            cast(Kind, kind), self.low_pa, self.high_pa, self.period_s, seed, jitter=self.jitter
        )  # fmt: skip

    def judge(self, track: Track) -> Metrics:
        """The figures of a run.

        Args:
            track: What it left; the target began at time zero.

        Raises:
            ValueError: The run cannot be judged.
        """
        return measure(track, self.skip_s, self.duration_s, self.null_v, self.band_hz)

    def to_dict(self) -> dict[str, Any]:
        """Returns the tasks as plain data."""
        data = asdict(self)
        return {k: list(v) if isinstance(v, tuple) else v for k, v in data.items()}


@dataclass(frozen=True)
class Conditions:
    """What lies between a simulated rig and its controller.

    Attributes:
        noise_pa: Noise of the readings, one sigma, Pa.
        delay_s: Delay of commands beyond the rig's own, s.
        dx_m: Cell length that replaces the rig's, m.
        start_pa: Pressure behind the valve at the start, Pa; None is the room's.
    """

    noise_pa: float = NOISE_PA
    delay_s: float = 0.004
    dx_m: float | None = None
    start_pa: float | None = None
