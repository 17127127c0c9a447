# SPDX-License-Identifier: Apache-2.0
"""What ``pneu friction`` finds of a seal."""

from typing import Literal

from pydantic import Field

from pneu_sysid.results.base import Number, Perhaps, Result, Verdict
from pneu_sysid.results.head import Head


class FrictionStrength(Result):
    """A term of the friction that is named."""

    path: str
    """Dotted path into the rig file."""
    value: Number
    """Estimate."""
    std_error: Perhaps
    """Standard error; strokes, recordings and places along the bore vary as they were found to."""
    unit: str
    """Unit of both."""


class FrictionLevel(Result):
    """The strokes of one recording at one pressure."""

    name: str
    """Name of the recording, with the pressure where it has several."""
    gauge_pa: Number
    """Mean gauge pressure of the measured side."""
    cycles: int
    """Cycles to and fro."""
    half_difference_n: Perhaps
    """Half the difference of the force, pressed in and drawn out, without gas and spring."""
    spread_n: Perhaps
    """Standard deviation of that from cycle to cycle; null for a single one."""
    friction_n: Number
    """The same by the friction that is named."""
    without_n: tuple[Number, Number]
    """Error without friction, root mean square, as the rod is pressed in and as it is drawn out."""
    with_n: tuple[Number, Number]
    """Error with the friction that is named, likewise."""
    noise_n: Number
    """White noise of force and pressure together."""


class FrictionStep(Result):
    """Errors after a term was added."""

    added: str | None
    """The term; null for the model without friction."""
    rmse_n: Number
    """Root mean square error where it was fitted."""
    held_out_rmse_n: Perhaps
    """The same on strokes kept aside; null where there are too few."""
    times_noise: Perhaps
    """That error in noise deviations."""


class FrictionLaw(Result):
    """A friction law that was tried."""

    terms: list[str]
    """Its terms: ``constant``, ``pressure``, ``viscous``, ``breakaway``."""
    behind: Number
    """By how much more weighted squares it leaves than the one that is named, with what its terms
    have to earn; below 6 it is as good."""


class FrictionResult(Head):
    """``pneu friction --json``: the friction of a cylinder's seals, from drag tests."""

    schema_: Literal["pneu.friction/1"] = Field(default="pneu.friction/1", alias="schema")
    """Name and version of this schema."""
    rig: str
    """Rig file."""
    output: str | None
    """Rig file that was written."""
    noise_n: Number
    """White noise of one reading of force and pressure together, one sigma."""
    levels: list[FrictionLevel]
    """Recordings, by pressure."""
    steps: list[FrictionStep]
    """Errors as terms are added, the one that helps most first."""
    strengths: list[FrictionStrength]
    """The friction that is named."""
    base_n: Perhaps
    """Friction at no gauge pressure and the usual speed, F0; null where one pressure alone cannot
    tell."""
    base_std_error_n: Perhaps
    """Its standard error."""
    per_bar_n: Perhaps
    """Growth of the friction per bar of gauge pressure of the measured side, k; 0 where it does not
    grow, null where one pressure alone cannot tell."""
    per_bar_std_error_n: Perhaps
    """Its standard error."""
    gain: Number
    """Share of the gas's force that is too much in the force: area, force and pressure together."""
    gain_std_error: Number
    """Its standard error."""
    zero_n: Number
    """Zero of the force: what is in it beside gas and friction."""
    own_rmse_n: Perhaps
    """Error with the friction that the rig file had; null where it had none."""
    explained: Number
    """Share of the squared error without friction that is taken away, on strokes kept aside."""
    left_n: dict[str, Number]
    """What varies beside the friction that is named, by what it varies with, one sigma."""
    laws: list[FrictionLaw]
    """Every law that was tried, the one that is named first."""
    verdict: Verdict
    """One of four: nothing is missing, an effect is, several are equally good, or none explains."""
    sentence: str
    """The same in words."""
    statements: list[str] = []
    """What else the strokes say, or cannot."""
