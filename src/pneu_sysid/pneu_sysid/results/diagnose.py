# SPDX-License-Identifier: Apache-2.0
"""What ``pneu diagnose`` finds: candidates for what a model is missing."""

from typing import Literal

from pydantic import Field

from pneu_sysid.results.base import Number, Perhaps, Result, Verdict
from pneu_sysid.results.compare import Numerics
from pneu_sysid.results.head import Head


class Candidate(Result):
    """An effect at a place that could explain the residual."""

    effect: str
    """Name in the catalogue."""
    title: str
    """The same in a few words."""
    place: str
    """Part of the rig."""
    position_m: Perhaps = None
    """Where along a pipe; null where that has no meaning."""
    position_error_m: Perhaps = None
    """Standard error of that; null where it was not fitted."""
    places_m: list[Number] | None = None
    """From where to where along the pipe it explains nearly as much; null where that was not looked
    at: it is for candidates that are hard to tell apart."""
    strength: Perhaps
    """Estimated strength."""
    unit: str
    """Its unit."""
    std_error: Perhaps
    """Standard error of the strength."""
    explained_fraction: Perhaps
    """Share of the residual's excess over noise that it would explain, to first order."""
    refit_fraction: Perhaps = None
    """Share that it explains after a quick refit; null where none was made."""
    held_out_gain: Perhaps = None
    """Share by which the squared error falls on the part kept aside."""
    significance: Perhaps = None
    """Strength over its standard error."""
    indistinguishable_from: list[str] = []
    """Other candidates (effect@place) that this recording cannot tell it from."""
    next_experiment: str = ""
    """Recording that would tell them apart."""
    tested: bool
    """Whether it was refitted, or only scored."""
    parameters: dict[str, Perhaps] = {}
    """All its numbers as a rig file has them, the strength among them, where it was refitted."""


class Dependence(Result):
    """A variable that an unexplained residual depends on."""

    variable: str
    """Flow direction, opening, pressure, position, speed, frequency, time or another tap."""
    tap: str
    """Tap or encoder whose residual depends on it."""
    gain: Perhaps
    """Share of that residual's variance it explains."""


class DiagnoseResult(Head):
    """``pneu diagnose --json``: what is missing in the model, and where."""

    schema_: Literal["pneu.diagnose/1"] = Field(default="pneu.diagnose/1", alias="schema")
    """Name and version of this schema."""
    verdict: Verdict
    """``nothing_missing``; ``effect``: the first candidate; ``ambiguous``: several are equally
    good; ``unknown``: something that the catalogue does not hold."""
    sentence: str
    """The verdict in words."""
    statements: list[str] = []
    """What changed since the calibration, and whether the model explains the measurement to the
    noise, a sentence each; where only some recordings differ, which the verdict is about."""
    unchanged: list[str] = []
    """Recordings that the verdict is not about."""
    times_noise: Perhaps = None
    """Error of the rig as it is over the noise, root mean square over taps, encoders and
    recordings."""
    rmse_pa: dict[str, Perhaps]
    """Per tap the error of the rig as it is."""
    rmse: dict[str, Perhaps] = {}
    """The same per encoder, in its unit."""
    candidates: list[Candidate]
    """Candidates, best first."""
    depends_on: list[Dependence] = []
    """For ``unknown``: what the residual depends on, strongest first."""
    numerics: Numerics
    """The check of the grid."""
