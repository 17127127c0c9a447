# SPDX-License-Identifier: Apache-2.0
"""What ``pneu observe`` finds: errors of sensors, what drifts, and what was said to be wrong."""

from typing import Literal

from pydantic import Field

from pneu_sysid.results.base import Number, Perhaps, Result
from pneu_sysid.results.head import Head


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
