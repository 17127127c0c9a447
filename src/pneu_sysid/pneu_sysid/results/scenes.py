# SPDX-License-Identifier: Apache-2.0
"""The JSON results of commands on a scene: what touches, fitted, foretold and diagnosed."""

from typing import Literal

from pydantic import Field

from pneu_sysid.results.base import Number, Perhaps, Result, Verdict


class SceneHead(Result):
    """What every result of a scene begins with."""

    pneu_version: str
    """Version of the program."""
    scene: str
    """Scene file."""
    recordings: list[str]
    """Names of the recordings."""
    sensors: dict[str, str]
    """Sensors that are compared, and the unit of how far each is off."""
    findings: list[str] = []
    """What was wrong with the recordings and how it was handled."""


class Misread(Result):
    """How far a sensor is off over a recording that is foretold from its beginning."""

    mean: Perhaps
    """Mean length of the difference, or mean angle; null where the model ran away."""
    rms: Perhaps
    """Root mean square of the same."""
    last: Perhaps
    """At the end."""


class SceneCompareResult(SceneHead):
    """``pneu compare --json`` with a scene: whole recordings foretold from how they begin."""

    schema_: Literal["pneu.scene_compare/1"] = Field(default="pneu.scene_compare/1", alias="schema")
    """Name and version of this schema."""
    start_s: Number
    """How much of each recording the model was shown, s."""
    off: dict[str, dict[str, Misread]]
    """Per recording, per sensor."""
    mean: dict[str, Perhaps]
    """Per sensor the mean over recordings of their means."""
    median: dict[str, Perhaps]
    """Per sensor the median of the same."""


class SceneParameter(Result):
    """A quantity of the scene that was fitted."""

    effect: str
    """Name in the catalogue of scenes."""
    place: str
    """Where."""
    value: Perhaps
    """What was found."""
    std_error: Perhaps
    """Standard error, by leaving out one recording after another."""
    start: Perhaps
    """What the scene had."""
    unit: str
    """Unit."""
    at_bound: bool
    """Whether it sits on a bound."""


class SceneFitResult(SceneHead):
    """``pneu fit --json`` with a scene: trajectories and parameters together."""

    schema_: Literal["pneu.scene_fit/1"] = Field(default="pneu.scene_fit/1", alias="schema")
    """Name and version of this schema."""
    output: str | None
    """Scene file that was written."""
    parameters: list[SceneParameter]
    """What was fitted."""
    unknowns: int
    """Of trajectories and parameters together."""
    history: list[Perhaps]
    """Cost of the last estimate after each iteration, its start first."""
    converged: bool
    """Whether that settled."""
    loss: dict[str, Perhaps]
    """Per recording the mean Huber loss of predictions, in squares of what they are usually off by;
    of a scene without a horizon its cost per reading."""
    force: dict[str, Perhaps]
    """Per direction of motion the root mean square of forces that nobody applied, N or N m."""
    rmse: dict[str, Perhaps]
    """Per sensor the root mean square residual along the estimated trajectory."""
    notes: list[str] = []
    """What was noticed."""
    seconds: Perhaps = None
    """How long it took, s."""


class SceneCandidate(Result):
    """An effect at a place that could be missing in a scene."""

    effect: str
    """Name in the catalogue of scenes."""
    title: str
    """The same in a few words."""
    place: str
    """Where."""
    unit: str
    """Unit of its strength."""
    score: Perhaps
    """What it would add to the logarithm of the likelihood, to first order."""
    step: Perhaps
    """By how much it would change, to first order; its logarithm where that is estimated."""
    step_t: Perhaps
    """That step over its standard error."""
    strength: Perhaps = None
    """What it was found to be; null where it was only scored."""
    std_error: Perhaps = None
    """Standard error of that."""
    held_out_gain: Perhaps = None
    """Share by which the cost of recordings kept aside falls."""
    significance: Perhaps = None
    """That fall in standard errors over those recordings."""
    indistinguishable_from: list[str] = []
    """Candidates that explain as much."""
    tested: bool
    """Whether it was refitted, or only scored."""


class SceneDiagnoseResult(SceneHead):
    """``pneu diagnose --json`` with a scene: what its model is missing."""

    schema_: Literal["pneu.scene_diagnose/1"] = Field(
        default="pneu.scene_diagnose/1", alias="schema"
    )
    """Name and version of this schema."""
    verdict: Verdict
    """As of a rig."""
    sentence: str
    """The verdict in words."""
    used: list[str]
    """Recordings, or stretches of them, that were fitted."""
    aside: list[str]
    """Those kept aside, by which candidates are judged."""
    candidates: list[SceneCandidate]
    """Candidates, best first."""


class SceneStep(Result):
    """A scene after one effect more."""

    step: int
    """0 is the base."""
    added: str | None
    """Effect; null for the base."""
    place: str | None = None
    """Where."""
    strength: Perhaps = None
    """What it was found to be."""
    std_error: Perhaps = None
    """Standard error of that."""
    unit: str | None = None
    """Its unit."""
    held_out_loss: Perhaps
    """Cost per knot of recordings kept aside, the geometric mean over them and kinds of motion."""


class SceneLearnResult(SceneHead):
    """``pneu learn --json`` with a scene: effect after effect."""

    schema_: Literal["pneu.scene_learn/1"] = Field(default="pneu.scene_learn/1", alias="schema")
    """Name and version of this schema."""
    steps: list[SceneStep]
    """What was added, in order; the base first."""
    verdict: Verdict
    """Over all that was added."""
    sentence: str
    """The same in words."""
    output: str | None
    """Folder that was written."""
