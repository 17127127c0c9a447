# SPDX-License-Identifier: Apache-2.0
"""What `pneu tune` is asked for: which controller, on what rigs and targets, how long."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from pneu_common.validation import Settings
from pneu_policy.task.ranges import DelayRange, Kinds, Seed

PidKind = Literal["pid", "feed_forward"]


class TuneSettings(Settings):
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
    seed: Seed = 0
    tap: str = "end"
    period_s: Annotated[float, Field(gt=0.0)] = 0.004
    kinds: Kinds = ("smooth", "jagged")
    low_pa: float = 150e3
    high_pa: float = 550e3
    target_period_s: float = 0.3
    jitter: float = 0.6
    trials: Annotated[int, Field(ge=1, le=1000)] = 6
    seconds: float = 2.0
    spread: float = 1.0
    delay_s: DelayRange = (0.002, 0.01)
    noise_pa: Annotated[float, Field(ge=0.0)] = 250.0
    dx_m: float = 0.15
    candidates: Annotated[int, Field(ge=5, le=1000)] = 20
    generations: Annotated[int, Field(ge=1, le=1000)] = 35

    @model_validator(mode="after")
    def _lasts(self) -> Self:
        if self.seconds < self.period_s:
            raise ValueError(f"seconds: found {self.seconds:g}, needed is a period or more")
        return self
