# SPDX-License-Identifier: Apache-2.0
"""How a predictive controller is set; see `pneu_policy.control.predictive`."""

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import Field, field_validator, model_validator

from pneu_common.validation import Listed, Settings
from pneu_policy.control.shooting import SCALE_PA
from pneu_sim.observe.settings import LOAD_S, Drift, ObserverSettings

Method = Literal["gauss_newton", "mppi", "adaptive"]
"""``gauss_newton``: steps by differences between rigs side by side; ``mppi``: path integral, plans
drawn about the last one and weighed by their costs (Williams et al. 2017); ``adaptive``: the same,
the variances of the draws learnt as well (Stulp and Sigaud 2012)."""


ADAPTING = ObserverSettings(
    members=32,
    fewest_cells=1,
    flow=Drift(std=0.03, time_s=0.02),
    gain=Drift(std=0.1, time_s=20.0),
    null=Drift(std=0.05, time_s=20.0),
    delay=Drift(std=0.002, time_s=20.0),
    dead_band=Drift(std=0.1, time_s=20.0),
    hysteresis=Drift(std=0.1, time_s=20.0),
    lag=Drift(std=0.002, time_s=20.0),
    timing_s=1e-3,
)
"""An observer that finds out, while it controls, by what the valve and the taps differ from the rig
file: what is not known of a real rig is of this size."""


def as_given(value: Any, usual: ObserverSettings) -> Any:
    """Settings of an observer of which a file gives some: the others are the usual ones.

    Args:
        value: What is given.
        usual: The usual ones.
    """
    if not isinstance(value, Mapping):
        return value
    return {**usual.model_dump(exclude_defaults=True), **value}


class PredictiveSettings(Settings):
    """How plans are made.

    Attributes:
        period_s: A command is held for so long, s.
        every: Periods from one plan to the next; a plan may take so long.
        sample_s: Errors count at this interval, s; divides the period.
        holds: Periods that each voltage of a plan is held for, one after the other: the horizon.
        dx_m: Cell length of the model, m; None is the rig's own. Coarse ones serve, as targets are
            far slower than the waves that they blur.
        delay_s: How late commands reach the valve beyond what the rig file knows, s.
        low_v: Lowest voltage, V.
        high_v: Highest voltage, V.
        null_v: Voltage at which the valve closes, V.
        most_rate_v_s: Fastest change of the voltage, V/s; None is none.
        smooth_pa_per_v: What a volt of change from one voltage to the next counts as, Pa.
        method: How plans are improved.
        rounds: Improvements per plan at most; fewer where time is up.
        plans: Plans side by side of ``mppi`` and ``adaptive``.
        spread_v: Standard deviation with which those are drawn at first, V.
        temperature: Their costs are weighed by the exponential of their difference from the least
            over this times their standard deviation.
        share: Share of the time for a plan after which no further improvement begins.
        observer: How the state is followed.
    """

    period_s: Annotated[float, Field(gt=0.0, le=1.0)] = 0.01
    every: Annotated[int, Field(ge=1, le=10)] = 1
    sample_s: Annotated[float, Field(gt=0.0)] = 0.002
    holds: Annotated[tuple[int, ...], Listed] = (1, 1, 1, 1, 2, 2, 4)
    dx_m: Annotated[float, Field(gt=0.0)] | None = 0.25
    delay_s: Annotated[float, Field(ge=0.0)] = 0.004
    low_v: float = 0.0
    high_v: float = 10.0
    null_v: float = 5.0
    most_rate_v_s: Annotated[float, Field(gt=0.0)] | None = None
    smooth_pa_per_v: Annotated[float, Field(ge=0.0)] = 100.0
    method: Method = "gauss_newton"
    rounds: Annotated[int, Field(ge=1)] = 1
    plans: Annotated[int, Field(ge=4, le=8192)] = 32
    spread_v: Annotated[float, Field(gt=0.0)] = 0.3
    temperature: Annotated[float, Field(gt=0.0)] = 0.1
    share: Annotated[float, Field(gt=0.0, le=1.0)] = 0.5
    observer: ObserverSettings = ADAPTING

    @field_validator("observer", mode="before")
    @classmethod
    def _given(cls, value: Any) -> Any:
        return as_given(value, cls.model_fields["observer"].default)

    @model_validator(mode="after")
    def _check(self) -> Self:
        whole = self.period_s / self.sample_s
        if abs(whole - round(whole)) > 1e-6 or whole < 0.5:
            raise ValueError(
                f"sample_s: found {self.sample_s:g}, it must divide the period of"
                f" {self.period_s:g} s"
            )
        if not self.holds or min(self.holds) < 1:
            raise ValueError(f"holds: found {list(self.holds)}, needed are periods of 1 or more")
        if self.every > self.periods:
            raise ValueError(f"every: found {self.every}, a plan has {self.periods} periods")
        if not self.low_v < self.null_v < self.high_v or not math.isfinite(self.high_v):
            raise ValueError(
                f"low_v, null_v, high_v: found {self.low_v:g}, {self.null_v:g}, {self.high_v:g},"
                " they must rise"
            )
        return self

    @property
    def scale(self) -> float:
        """The unit that errors are told in, Pa."""
        return SCALE_PA

    @property
    def weight(self) -> float:
        """What a volt of change from one voltage to the next counts as, in that unit."""
        return self.smooth_pa_per_v / SCALE_PA

    @property
    def samples(self) -> int:
        """Samples of a period."""
        return round(self.period_s / self.sample_s)

    @property
    def periods(self) -> int:
        """Periods that a plan looks ahead, from where it can begin to act."""
        return sum(self.holds)


ADAPTING_LOADED = ADAPTING.model_copy(update={"load": Drift(std=0.2, time_s=LOAD_S)})
"""The same of a robot, which may carry something: what a hand takes up."""
SCALE_JOINT = 0.01
"""Errors of a joint are told in this, rad or m."""


class JointPredictiveSettings(PredictiveSettings):
    """The same for a joint.

    Attributes:
        smooth_per_v: What a volt of change from one voltage to the next counts as, rad or m.
    """

    delay_s: Annotated[float, Field(ge=0.0)] = 0.006
    smooth_per_v: Annotated[float, Field(ge=0.0)] = 0.002
    observer: ObserverSettings = ADAPTING_LOADED

    @property
    def scale(self) -> float:
        """The unit that errors are told in, rad or m."""
        return SCALE_JOINT

    @property
    def weight(self) -> float:
        """What a volt of change from one voltage to the next counts as, in that unit."""
        return self.smooth_per_v / SCALE_JOINT
