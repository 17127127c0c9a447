# SPDX-License-Identifier: Apache-2.0
"""What ``pneu learn`` did: effects added step by step, and experiments on the way."""

from typing import Literal

from pydantic import Field

from pneu_sysid.results.base import Number, Perhaps, Result, Verdict
from pneu_sysid.results.head import Head


class Step(Result):
    """The model after one effect more."""

    step: int
    """0 is the base."""
    added: str | None
    """Effect; null for the base."""
    place: str | None = None
    """Where it was added."""
    strength: Perhaps = None
    """Its strength."""
    unit: str | None = None
    """Unit of the strength."""
    std_error: Perhaps = None
    """Standard error of the strength."""
    position_error_m: Perhaps = None
    """Standard error of its position, or as far as the recording does not tell; null for none."""
    rmse_pa: dict[str, Perhaps]
    """Per tap the error on the part that was used."""
    held_out_rmse_pa: dict[str, Perhaps]
    """Per tap the error on the part kept aside."""
    rmse: dict[str, Perhaps] = {}
    """Per encoder the error on the part that was used, in its unit."""
    held_out_rmse: dict[str, Perhaps] = {}
    """Per encoder the error on the part kept aside."""
    total_times_noise: Perhaps
    """Error over noise, root mean square over taps and encoders, on the part used."""
    held_out_times_noise: Perhaps
    """The same on the part kept aside."""

    @property
    def errors(self) -> dict[str, float | None]:
        """Error of every sensor on the part kept aside, or, where none is, on the part used."""
        return {**self.held_out_rmse_pa, **self.held_out_rmse} or {**self.rmse_pa, **self.rmse}


class ToldApart(Result):
    """Two candidates that an experiment was to tell apart."""

    one: str
    """Effect and place of one of them."""
    other: str
    """Of the other."""
    expected: Perhaps
    """By how many standard errors the right one was expected to lead."""
    found: Perhaps
    """By how many the first leads now; negative where the other does. Null where one of them was
    not refitted, having little to say."""
    needed: Number
    """From how many on they count as told apart."""


class Experiment(Result):
    """An experiment: what it was expected to tell, and what it told."""

    plan: str
    """File of its plan."""
    kind: str
    """How that was made."""
    seconds: Number
    """How long it lasts."""
    told_apart: list[ToldApart] = []
    """Candidates that it was to tell apart."""
    words: list[str] = []
    """What was said of it before."""


class LearnResult(Head):
    """``pneu learn --json``: effect after effect, the error after each."""

    schema_: Literal["pneu.learn/1"] = Field(default="pneu.learn/1", alias="schema")
    """Name and version of this schema."""
    steps: list[Step]
    """What was added, in order; the base first."""
    verdict: Verdict
    """What the last diagnosis said."""
    sentence: str
    """The same in words."""
    output: str | None
    """Folder that was written."""
    experiments: list[Experiment] = []
    """Experiments that were designed for it, as far as their plans were given."""
