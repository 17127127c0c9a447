# SPDX-License-Identifier: Apache-2.0
"""The JSON results of ``compare``, ``fit``, ``diagnose`` and others: schema, read and written.

These models are the only source of the schema; ``docs/json.md`` is made from them
(`pneu_sysid.result_page`). A number that is
not finite becomes null on the way in, so no file ever holds NaN.
"""

import importlib.metadata
import json
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, get_args

from pydantic import Field, ValidationError

from pneu_common.errors import InputError
from pneu_common.files import write_whole
from pneu_common.validation import sentence
from pneu_sysid.design.plan import Plan
from pneu_sysid.result_base import Number, Perhaps, Result, Verdict
from pneu_sysid.scene_results import (
    SceneCompareResult,
    SceneDiagnoseResult,
    SceneFitResult,
    SceneLearnResult,
)
from pneu_sysid.sensor_units import EncoderUnit


class Head(Result):
    """What every result begins with."""

    pneu_version: str
    """Version of the program."""
    recording: str
    """Name of the recording; of several, all in one line."""
    recordings: list[str] = []
    """Names of the recordings."""
    rigs: list[str]
    """Names of the rigs."""
    taps: list[str]
    """Taps that are compared."""
    encoders: dict[str, EncoderUnit] = {}
    """Encoders that are compared, and the unit of all that is told of each."""
    noise_floor_pa: dict[str, Perhaps]
    """Per tap the sensor's white noise with quantisation, one sigma."""
    noise_floor: dict[str, Perhaps] = {}
    """The same per encoder, in its unit."""
    findings: list[str] = []
    """What was wrong with the recording and how it was handled."""

    @property
    def sensors(self) -> list[str]:
        """Taps, then encoders."""
        return [*self.taps, *self.encoders]

    @property
    def noise_of(self) -> dict[str, float | None]:
        """The noise of every sensor, each in its unit: Pa, rad or m."""
        return {**self.noise_floor_pa, **self.noise_floor}


# ---- compare -------------------------------------------------------------------------------


class Stretch(Result):
    """A stretch of time in which one tap is predicted worst."""

    recording: str | None = None
    """Which recording it is in, where there are several."""
    start_s: Number
    """Begin, from the start of the recording."""
    end_s: Number
    """End."""
    rmse_pa: Number
    """Error within it."""
    doing: str = ""
    """What the valve was doing."""

    @property
    def rmse(self) -> float:
        """Error within it, Pa."""
        return self.rmse_pa


class EncoderStretch(Result):
    """A stretch of time in which one encoder is predicted worst."""

    recording: str | None = None
    """Which recording it is in, where there are several."""
    start_s: Number
    """Begin, from the start of the recording."""
    end_s: Number
    """End."""
    rmse: Number
    """Error within it, in the encoder's unit."""
    doing: str = ""
    """What the valve was doing."""


class TapError(Result):
    """Error of one model at one tap, over all stretches."""

    rmse_pa: Perhaps
    """Root mean square of measured minus model."""
    rmse_atm: Perhaps
    """The same in standard atmospheres."""
    normalised: Perhaps
    """RMSE over the standard deviation of what was measured."""
    times_noise: Perhaps
    """RMSE over the noise floor; 1 is as good as the sensor can tell."""
    bias_pa: Perhaps
    """Mean of measured minus model: positive where the sensor reads above the model."""
    lag_s: Perhaps
    """How much later the measurement is than the model, by the time shift that fits best; null
    where the pressure moves too little to tell."""
    gain: Perhaps
    """Measured change per predicted change, at that shift; null likewise."""
    noise_floor_pa: Perhaps
    """The sensor's noise."""
    worst: list[Stretch]
    """Worst stretches, worst first."""

    @property
    def rmse(self) -> float | None:
        """Root mean square of measured minus model, Pa."""
        return self.rmse_pa

    @property
    def bias(self) -> float | None:
        """Mean of measured minus model, Pa."""
        return self.bias_pa


class EncoderError(Result):
    """Error of one model at one encoder, over all stretches, in the encoder's unit."""

    unit: EncoderUnit
    """Unit of the errors and the noise."""
    rmse: Perhaps
    """Root mean square of measured minus model."""
    normalised: Perhaps
    """RMSE over the standard deviation of what was measured."""
    times_noise: Perhaps
    """RMSE over the noise floor; 1 is as good as the sensor can tell."""
    bias: Perhaps
    """Mean of measured minus model: positive where the sensor reads above the model."""
    lag_s: Perhaps
    """How much later the measurement is than the model, by the time shift that fits best; null
    where the joint moves too little to tell."""
    gain: Perhaps
    """Measured change per predicted change, at that shift; null likewise."""
    noise_floor: Perhaps
    """The sensor's noise."""
    worst: list[EncoderStretch]
    """Worst stretches, worst first."""


RegimeKind = Literal[
    "flow_direction",
    "choked",
    "opening",
    "pressure",
    "frequency",
    "time",
    "position",
    "motion",
    "speed",
    "load",
    "stop",
]


def regime_order(regime: Mapping[str, Any]) -> tuple[Any, ...]:
    """Where a regime stands among others: by kind, part of the rig, and then by its numbers.

    Args:
        regime: A `Regime` as plain data. One without bounds, of an older file, stands where the
            numbers in its label put it.
    """
    kinds = get_args(RegimeKind)
    kind, label = str(regime.get("kind")), str(regime.get("label"))
    lower, upper = regime.get("lower"), regime.get("upper")
    if lower is None and upper is None and kind in ("pressure", "frequency", "time"):
        numbers = [float(n) for n in re.findall(r"(?<![\d.])-?\d+(?:\.\d+)?", label)]
        if label.startswith("below"):
            numbers = [-math.inf, *numbers]
        lower, upper = (*numbers, None, None)[:2]
    return (
        kinds.index(kind) if kind in kinds else len(kinds),
        kind,
        by_number(str(regime.get("of") or "")),
        -math.inf if lower is None else lower,
        math.inf if upper is None else upper,
        by_number(label),
    )


def by_number(name: str) -> tuple[tuple[str, int], ...]:
    """Sort key of a name in which numbers count as such: valve_2 before valve_10.

    Args:
        name: The name.
    """
    parts = [*re.split(r"(\d+)", name), ""]
    return tuple(
        (text, int(digits or 0)) for text, digits in zip(parts[::2], parts[1::2], strict=True)
    )


class Regime(Result):
    """Error of one model at one tap in one regime of operation."""

    kind: RegimeKind
    """By what the samples are divided."""
    label: str
    """Which part of them this is."""
    of: str = ""
    """The valve, port, joint, cylinder or recording that it is about; empty where it is the tap
    itself."""
    lower: Perhaps = None
    """Where the part begins on its scale: opening as a fraction, Pa, Hz, s, rad/s or m/s, N m or N;
    null without one."""
    upper: Perhaps = None
    """Where it ends; null where it is open to that side."""
    tap: str
    """The tap."""
    rmse_pa: Number
    """Error within the regime (for a frequency band, of the error's part in that band)."""
    bias_pa: Perhaps = None
    """Mean of measured minus model within it; null for a frequency band."""
    share: Number
    """Share of the tap's squared error."""
    samples: int
    """Samples in the regime."""
    times_noise: Perhaps
    """RMSE over what sensor noise alone gives in the regime."""

    @property
    def sensor(self) -> str:
        """The tap."""
        return self.tap

    @property
    def rmse(self) -> float:
        """Error within the regime, Pa."""
        return self.rmse_pa

    @property
    def bias(self) -> float | None:
        """Mean of measured minus model within it, Pa."""
        return self.bias_pa


class EncoderRegime(Result):
    """Error of one model at one encoder in one regime of operation, in the encoder's unit."""

    kind: RegimeKind
    """By what the samples are divided."""
    label: str
    """Which part of them this is."""
    of: str = ""
    """The valve, port, joint, cylinder or recording that it is about; empty where it is the encoder
    itself."""
    lower: Perhaps = None
    """Where the part begins on its scale: opening as a fraction, rad or m, Hz, s, rad/s or m/s, N m
    or N; null without one."""
    upper: Perhaps = None
    """Where it ends; null where it is open to that side."""
    encoder: str
    """The encoder."""
    rmse: Number
    """Error within the regime (for a frequency band, of the error's part in that band)."""
    bias: Perhaps = None
    """Mean of measured minus model within it; null for a frequency band."""
    share: Number
    """Share of the encoder's squared error."""
    samples: int
    """Samples in the regime."""
    times_noise: Perhaps
    """RMSE over what sensor noise alone gives in the regime."""

    @property
    def sensor(self) -> str:
        """The encoder."""
        return self.encoder


class ModelError(Result):
    """How one model does."""

    name: str
    """Name of the rig, or of the file where two rigs have one name."""
    model: str
    """Kind of model: ``pde``, ``thin_plate`` or ``delay_line``."""
    file: str | None
    """Rig file."""
    taps: dict[str, TapError]
    """Error per tap."""
    encoders: dict[str, EncoderError] = {}
    """Error per encoder."""
    regimes: list[Regime]
    """Where it fails: by kind, then by valve, port or recording, then as their numbers rise, and
    then by tap."""
    encoder_regimes: list[EncoderRegime] = []
    """The same of the encoders."""
    rmse_pa: Perhaps
    """Root mean square over the taps."""
    times_noise: Perhaps
    """Root mean square of the taps' and the encoders' ``times_noise``."""
    by_recording: dict[str, Perhaps] = {}
    """The same for each recording."""

    @property
    def sensors(self) -> dict[str, TapError | EncoderError]:
        """Error per sensor: taps, then encoders."""
        return {**self.taps, **self.encoders}

    @property
    def all_regimes(self) -> list[Regime | EncoderRegime]:
        """Regimes of taps, then of encoders."""
        return [*self.regimes, *self.encoder_regimes]


class Numerics(Result):
    """Whether the grid is fine enough, from one run on cells of half the length."""

    dx_m: Perhaps
    """Cell length; null where no model has a grid."""
    refined_dx_m: Perhaps
    """Cell length of the second run; null where none was made."""
    change_pa: dict[str, Perhaps]
    """Per tap the root mean square change of the prediction."""
    change: dict[str, Perhaps] = {}
    """The same per encoder, in its unit."""
    discretisation: bool
    """Whether the error is mostly one of the grid rather than of the physics."""
    sentence: str
    """The same in words."""


class Series(Result):
    """Signals for plotting, thinned outside the worst stretches."""

    time_s: list[Number]
    """Times of the readings of all taps; not uniform."""
    command: dict[str, list[Perhaps]]
    """Per command its volts."""
    measured: dict[str, list[Perhaps]]
    """Per tap the readings, Pa; null where the tap was not read at that time."""
    model: dict[str, dict[str, list[Perhaps]]]
    """Per model and tap the predicted readings, Pa."""
    measured_encoders: dict[str, list[Perhaps]] = {}
    """Per encoder the readings, in its unit; null likewise."""
    model_encoders: dict[str, dict[str, list[Perhaps]]] = {}
    """Per model and encoder the predicted readings, in its unit."""
    gap_s: dict[str, Perhaps] = {}
    """Per tap and encoder how far apart readings are that have a gap between them, s."""
    begins_s: list[Number] = []
    """When each recording begins on these times, which run through all of them, s."""
    segments: list[tuple[Number, Number]]
    """Begin and end of each stretch, s; every third is kept aside where something is fitted."""


class CompareResult(Head):
    """``pneu compare --json``: how far each model is from the recording, and where."""

    schema_: Literal["pneu.compare/1"] = Field(default="pneu.compare/1", alias="schema")
    """Name and version of this schema."""
    models: list[ModelError]
    """The models, in the order given."""
    numerics: Numerics
    """The check of the grid."""
    series: Series
    """Signals for plotting."""


# ---- fit -----------------------------------------------------------------------------------


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


# ---- diagnose ------------------------------------------------------------------------------


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


# ---- learn ---------------------------------------------------------------------------------


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


# ---- friction ------------------------------------------------------------------------------


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


# ---- observe -------------------------------------------------------------------------------


class ObservedSensor(Result):
    """A sensor beside what an observer says of it."""

    name: str
    """Tap or encoder."""
    used: bool
    """Whether its readings were taken; else it was only compared."""
    rmse: Perhaps
    """Error, in the sensor's unit; null where it was not recorded."""
    times_noise: Perhaps
    """Error over the sensor's noise."""
    within_90: Perhaps
    """Share of its readings within the 90 % intervals."""
    std: Number
    """Standard deviation that the observer gives its estimate, root mean square."""


class Drifting(Result):
    """A number of the rig that an observer lets drift, as it is at the end."""

    name: str
    """Its path in the rig, and what of it."""
    unit: str
    """Its unit."""
    value: Number
    """By how much it is off what the rig file says."""
    std: Number
    """Standard deviation that the observer gives it."""
    times: Number
    """Its value over how far it is allowed to drift, one standard deviation."""


class Said(Result):
    """Something that an observer said to be wrong."""

    kind: Literal["model", "sensor"]
    """With what: the model, or one sensor."""
    subject: str
    """The sensor, or what was said of the model without its numbers."""
    start_s: Number
    """From when on."""
    end_s: Number
    """Until when."""
    words: str
    """What was said, at last."""


class ObserveResult(Head):
    """``pneu observe --json``: what an observer says along a recording."""

    schema_: Literal["pneu.observe/1"] = Field(default="pneu.observe/1", alias="schema")
    """Name and version of this schema."""
    rig: str
    """Rig file."""
    begin_s: Number
    """Errors count from here on."""
    smooth_s: Number = 0.0
    """So much later readings count too."""
    observed: list[ObservedSensor]
    """Every sensor of the rig."""
    said: list[Said]
    """What was said to be wrong, in the order of time."""
    drifting: list[Drifting] = []
    """What drifts slowly, at the end."""


RESULTS: tuple[type[Result], ...] = (
    CompareResult,
    FitResult,
    DiagnoseResult,
    LearnResult,
    FrictionResult,
    ObserveResult,
    SceneCompareResult,
    SceneFitResult,
    SceneDiagnoseResult,
    SceneLearnResult,
    Plan,
)


def pneu_version() -> str:
    """Version of the installed program, for the head of a result."""
    for distribution in ("pneu", "pneu_sysid"):  # installed by pip, or by colcon
        try:
            return importlib.metadata.version(distribution)
        except importlib.metadata.PackageNotFoundError:
            continue
    return "(not installed)"


def result_of(data: dict[str, Any]) -> Any:
    """Checks plain data against the schema it names.

    Args:
        data: A result, as read from its file.

    Returns:
        The result.

    Raises:
        InputError: The schema is unknown, or the data do not follow it.
    """
    name = data.get("schema")
    kinds = {kind.model_fields["schema_"].default: kind for kind in RESULTS}
    if name not in kinds:
        raise InputError(f"schema: found {name!r}, known are {', '.join(kinds)}")
    try:
        return kinds[name].model_validate(data)
    except ValidationError as error:
        raise InputError(f"result of schema {name}: {sentence(error, kinds[name])}") from None


def read_json(path: Path) -> Any:
    """Reads a result file.

    Args:
        path: The file.

    Returns:
        The result.

    Raises:
        InputError: It cannot be read, or is no result.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    except ValueError as error:  # bytes that are no text, too
        raise InputError(f"{path}: is no JSON ({error})") from None
    try:
        return result_of(data if isinstance(data, dict) else {})
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def write_json(path: str | Path, result: Result | dict[str, Any]) -> None:
    """Writes a result file, whole or not at all.

    Args:
        path: Where; its folder must exist.
        result: The result; plain data are checked first.

    Raises:
        InputError: The file cannot be written, or the data do not follow their schema.
    """
    path = Path(path)
    checked = result if isinstance(result, Result) else result_of(result)
    data = checked.as_dict()
    data = {"schema": data.pop("schema"), **data}
    lines = [f"  {json.dumps(k)}: {json.dumps(v, allow_nan=False)}" for k, v in data.items()]
    write_whole(path, "{\n" + ",\n".join(lines) + "\n}\n")
