# SPDX-License-Identifier: Apache-2.0
"""What ``pneu compare`` finds: errors of models, where and when they are largest."""

import math
import re
from collections.abc import Mapping
from typing import Any, Literal, get_args

from pydantic import Field

from pneu_sysid.results.base import Number, Perhaps, Result
from pneu_sysid.results.head import Head
from pneu_sysid.sensor_units import EncoderUnit


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
