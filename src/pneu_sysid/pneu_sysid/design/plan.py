# SPDX-License-Identifier: Apache-2.0
"""A plan of an experiment: commands over time, for which rig, and what it is to tell."""

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from pneu_sim.signals import Signal
from pneu_sysid.results.base import Number, Perhaps, Result

Floats = NDArray[np.float64]


class Volts(Result):
    """A command over time, held from one point to the next."""

    time_s: list[Number]
    """Times from the beginning of the plan, rising from 0."""
    volts: list[Number]
    """The command from each on."""


class Separation(Result):
    """How well a plan tells two candidates apart."""

    one: str
    """Effect and place of one of them."""
    other: str
    """Of the other."""
    standard_errors: Perhaps
    """By how many standard errors the right one is expected to lead."""
    needed: Number
    """From how many on they count as told apart."""
    told_apart: bool
    """Whether it is expected to tell them."""
    inseparable: bool = False
    """Whether no experiment within the limits is expected to, of whatever length."""


class Bounds(Result):
    """Limits that a plan keeps to."""

    low_v: dict[str, Number]
    """Lowest voltage of each command."""
    high_v: dict[str, Number]
    """Highest."""
    slew_v_s: Number
    """Fastest change of a command."""
    highest_pa: Number
    """Pressure that nothing may exceed."""
    lowest_pa: Number
    """Pressure that nothing may fall below."""
    joints: dict[str, list[Number]] = {}
    """Per joint how far it may go, rad or m."""
    air_kg: Perhaps = None
    """Air that may be taken from the supplies; null for any amount."""


class Expected(Result):
    """What the model foresees of a plan."""

    highest_pa: dict[str, Perhaps]
    """Highest pressure at each tap."""
    lowest_pa: dict[str, Perhaps]
    """Lowest."""
    fastest_pa_s: dict[str, Perhaps]
    """Fastest change of the pressure at each tap, from reading to reading."""
    joints: dict[str, list[Number]] = {}
    """From where to where each joint goes."""
    air_kg: Perhaps
    """Air that is taken from the supplies."""
    std_errors: dict[str, Perhaps] = {}
    """Standard error of each parameter after a fit to this recording, in its own unit: the middle
    one of rigs as this one may be."""
    std_errors_range: dict[str, list[Number]] = {}
    """The least and the greatest of these rigs."""
    separations: list[Separation] = []
    """Of every two candidates."""
    words: list[str] = []
    """What no such experiment can tell, and the like, a sentence each."""


class Plan(Result):
    """``pneu excite``: what is to be commanded, and what that is to tell."""

    schema_: Literal["pneu.plan/1"] = Field(default="pneu.plan/1", alias="schema")
    """Name and version of this schema."""
    pneu_version: str
    """Version of the program."""
    rig: str
    """Name of the rig that it is for."""
    kind: str
    """How it was made: ``parameters``, ``separate``, or one kind of waves."""
    seconds: Number
    """How long it lasts."""
    seed: int
    """Of its draws."""
    commands: dict[str, Volts]
    """What is commanded."""
    limits: Bounds
    """What it keeps to."""
    expected: Expected
    """What the model foresees."""

    def signals(self) -> dict[str, Signal]:
        """The commands."""
        return {
            name: Signal(np.array(of.time_s, dtype=float), np.array(of.volts, dtype=float))
            for name, of in self.commands.items()
        }

    def volts(self, step_s: float) -> dict[str, Floats]:
        """(T,) volts of each command at even times from the beginning to the end.

        Args:
            step_s: Between them, s.
        """
        at = np.arange(round(self.seconds / step_s)) * step_s
        return {name: signal.held(at) for name, signal in self.signals().items()}


def thinned(volts: Floats, step_s: float) -> Volts:
    """A command without what only repeats it.

    Args:
        volts: (T,) volts.
        step_s: Between them, s.
    """
    rounded = np.round(volts, 4)
    kept = np.flatnonzero(np.concatenate(([True], np.diff(rounded) != 0.0)))
    return Volts(time_s=np.round(kept * step_s, 6).tolist(), volts=rounded[kept].tolist())
