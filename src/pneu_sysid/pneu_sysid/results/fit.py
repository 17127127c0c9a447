# SPDX-License-Identifier: Apache-2.0
"""What ``pneu fit`` finds: parameters, how well they are known, and where it stops short."""

from typing import Literal

from pydantic import Field

from pneu_sysid.results.base import Number, Perhaps, Result
from pneu_sysid.results.head import Head


class FittedParameter(Result):
    """A number of the rig after the fit."""

    path: str
    """Dotted path into the rig file."""
    recording: str | None = None
    """The recording it is for, where it has one value in each."""
    value: Number
    """Estimate."""
    start: Number
    """Value before."""
    std_error: Perhaps
    """Standard error; null where the recording does not constrain it."""
    expected_error: Perhaps = None
    """Standard error that the plan of the recording promised; null where there was none."""
    expected_range: list[Number] = []
    """From where to where it went among the rigs as this one might have been."""
    unit: str | None = None
    """Unit of the value, its start, error and bounds, powers after a caret (``m^3/(s Pa)``); ``1``
    for a pure number, null where it is not known."""
    at_bound: bool
    """Whether the estimate sits on a bound."""
    identified: bool
    """Whether the recording constrains it."""
    held: bool = False
    """Whether the rig file held it at its value."""
    lower: Number
    """Lower bound."""
    upper: Number
    """Upper bound."""


class Correlation(Result):
    """Two estimates the recording hardly tells apart."""

    a: str
    """Path of the one."""
    b: str
    """Path of the other."""
    value: Number
    """Correlation, at least 0.9 in size."""


class FitShortfall(Result):
    """Where a calibration stops short of the noise."""

    times_noise: dict[str, Number]
    """Times the noise at each tap and encoder where that is more than twice."""
    sentence: str
    """That it stops short."""
    where: list[str]
    """Per tap the regime and the time in which most of it is left."""
    help: list[str]
    """What would help."""


class FitResult(Head):
    """``pneu fit --json``: the fitted parameters and how well they are known."""

    schema_: Literal["pneu.fit/1"] = Field(default="pneu.fit/1", alias="schema")
    """Name and version of this schema."""
    rig: str
    """Rig file the fit started from."""
    output: str | None
    """Rig file that was written."""
    parameters: list[FittedParameter]
    """What was fitted."""
    correlations: list[Correlation]
    """Pairs that are hard to tell apart, strongest first."""
    condition: Perhaps
    """Condition number of the scaled Jacobian."""
    warnings: list[str]
    """What the recording cannot identify, in plain words."""
    shortfall: FitShortfall | None = None
    """Where the fit stops short of the noise; null where every sensor is within twice its noise."""
    rmse_pa: dict[str, Perhaps]
    """Per tap the error on the part that was used."""
    held_out_rmse_pa: dict[str, Perhaps]
    """Per tap the error on the part kept aside; empty where none was."""
    rmse: dict[str, Perhaps] = {}
    """Per encoder the error on the part that was used, in its unit."""
    held_out_rmse: dict[str, Perhaps] = {}
    """Per encoder the error on the part kept aside; empty where none was."""

    @property
    def rmse_of(self) -> dict[str, float | None]:
        """Error of every sensor on the part that was used, each in its unit."""
        return {**self.rmse_pa, **self.rmse}

    @property
    def held_out_rmse_of(self) -> dict[str, float | None]:
        """The same on the part kept aside."""
        return {**self.held_out_rmse_pa, **self.held_out_rmse}

    history: list[Perhaps]
    """Cost after each iteration of the last step, its start first."""
    seconds: Perhaps = None
    """How long the fit took, s."""
