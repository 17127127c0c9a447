# SPDX-License-Identifier: Apache-2.0
"""What a scene's model is missing: candidates scored, refitted and judged on what is kept aside."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pneu_sysid.contacts.candidates import SceneScore, Scores, scored
from pneu_sysid.contacts.chain import Chain
from pneu_sysid.contacts.estimate import Parameter, Problem, State, Tell
from pneu_sysid.contacts.fit import SceneFit, begun, fit_scene, smoothed
from pneu_sysid.contacts.physics import Physics
from pneu_sysid.contacts.rollouts import losses, predicted
from pneu_sysid.contacts.scene import Loaded, Value
from pneu_sysid.contacts.track import Track
from pneu_sysid.result_base import Verdict

Floats = NDArray[np.float64]

FINALISTS = 6
"""Candidates that are refitted."""
WORTH = 0.03
"""Share by which what is misread on what is kept aside must fall."""
SURE = 2.5
"""Standard errors, over what is kept aside, by which it must."""
TIED = 1.5
"""Standard errors within which two candidates explain what is kept aside equally well."""
ALIKE = 0.95
"""Cosine between columns above which two candidates are one to these recordings."""
MOST = 16
"""Recordings that candidates are judged by, evenly from those given: every second is kept aside."""


@dataclass
class Finalist:
    """A candidate that was refitted.

    Attributes:
        score: What it promised.
        fit: The scene with it.
        strength: What it was found to be.
        std_error: Of that.
        held: (aside,) mean loss of each recording kept aside.
        gain: Share by which that falls, over all.
        lead: The fall, in standard errors over the recordings.
        alike: Labels of finalists that explain as much.
    """

    score: SceneScore
    fit: SceneFit
    strength: float
    std_error: float
    held: Floats
    gain: float
    lead: float
    alike: list[str] = field(default_factory=list)

    @property
    def label(self) -> str:
        """Its effect and place."""
        return self.score.parameter.label

    @property
    def words(self) -> str:
        """What it is, where, and how strong."""
        effect = self.score.parameter.effect
        unit = f" {effect.unit}" if effect.unit else ""
        return (
            f"{effect.title} at {self.score.parameter.place}, {self.strength:.3g} ±"
            f" {self.std_error:.1g}{unit}"
        )


@dataclass
class SceneDiagnosis:
    """What is missing.

    Attributes:
        verdict: As of a rig.
        sentence: In words.
        base: The scene as it is, fitted.
        scores: All candidates by their score.
        finalists: Those that were refitted, best on what is kept aside first.
        held: (aside,) mean loss of the base on each recording kept aside.
        used: Names of the recordings that were fitted.
        aside: Names of those kept aside.
    """

    verdict: Verdict
    sentence: str
    base: SceneFit
    scores: Scores
    finalists: list[Finalist]
    held: Floats
    used: list[str]
    aside: list[str]


def divided(loaded: Loaded, tracks: Sequence[Track]) -> tuple[list[Track], list[Track]]:
    """Recordings to fit, and recordings to judge by; one alone is cut into stretches.

    Args:
        loaded: The scene.
        tracks: The recordings.
    """
    if len(tracks) < 4:
        parts = []
        for track in tracks:
            begin, end = track.span_s
            count = max(4 // len(tracks), round((end - begin) / loaded.scene.segment_s))
            edges = np.linspace(begin, end, count + 1)
            parts += [
                track.between(a, b, f"{track.name} {a:.2f} to {b:.2f} s")
                for a, b in pairwise(edges)
            ]
        tracks = parts
    if len(tracks) > MOST:
        tracks = [tracks[int(k)] for k in np.linspace(0, len(tracks) - 1, MOST).round()]
    return list(tracks[::2]), list(tracks[1::2])


def held_loss(
    fit: SceneFit, chains: Sequence[Chain], q: tuple[Floats, ...], physics: Physics
) -> Floats:
    """(chains,) loss of a fitted scene on other recordings, trajectories estimated anew.

    Args:
        fit: The scene.
        chains: The recordings.
        q: Trajectories to start from.
        physics: What evaluates models.
    """
    held = tuple(v.but(fit=False) for v in fit.values)
    smooth, at, found = smoothed(fit.loaded, chains, held, q, physics)
    if fit.scales is None or fit.loaded.scene.horizon_s is None:
        readings = [sum(len(c.knots) * c.size for c in chain.channels) for chain in chains]
        return found.costs / np.array(readings)
    problem = Problem(fit.loaded, smooth, held, [], physics)
    model, setup = problem.model(np.zeros(0))
    return losses(predicted(problem, model, setup, at, fit.loaded.scene.horizon_s), fit.scales)


def diagnose_scene(
    loaded: Loaded,
    tracks: Sequence[Track],
    values: tuple[Value, ...] | None = None,
    physics: Physics | None = None,
    tell: Tell | None = None,
    finalists: int = FINALISTS,
) -> SceneDiagnosis:
    """Says which effect a scene's model is missing.

    Args:
        loaded: The scene.
        tracks: The recordings.
        values: Its effects; the scene's own unless given.
        physics: What evaluates models.
        tell: Called with a note and the fraction done.
        finalists: How many candidates are refitted.

    Returns:
        The diagnosis.
    """
    physics = physics or Physics()
    values = loaded.scene.values if values is None else values
    used, aside = divided(loaded, tracks)
    said = tell or (lambda note, done: None)
    said("the model as it is", 0.0)
    base = fit_scene(loaded, used, values, physics)
    other = begun(loaded, aside, base.values, physics)
    held = held_loss(base, *other, physics)
    said("candidates", 0.15)
    scores = scored(
        Problem(loaded, base.chains, base.values, base.parameters, physics),
        State(base.q, base.x),
        candidates_of(loaded, base.values, base.parameters),
    )
    found: list[Finalist] = []
    for number, score in enumerate(shortlist(scores, finalists)):
        said(score.parameter.label, 0.2 + 0.8 * number / finalists)
        found.append(_refitted(loaded, used, aside, base, score, held, physics))
    found.sort(key=lambda f: float(np.mean(f.held)))
    _tie(found, scores)
    verdict, sentence = _verdict(found, held)
    return SceneDiagnosis(
        verdict, sentence, base, scores, found, held,
        [t.name for t in used], [t.name for t in aside],
    )  # fmt: skip


def candidates_of(
    loaded: Loaded, values: tuple[Value, ...], fitted: Sequence[Parameter]
) -> list[Parameter]:
    """Every effect that a scene could have and does not fit.

    Without a sensor of force and without actuators all masses may be twice what they are: forces
    that nobody applied would be too. They are no candidates then.

    Args:
        loaded: The scene.
        values: Its effects.
        fitted: What it fits.
    """
    setup = loaded.setup(values)
    own = {(p.effect.name, p.place) for p in fitted} | {
        (v.effect, v.at) for v in values if not v.fit
    }
    kinds = ("force", "torque", "actuatorfrc", "jointactuatorfrc")
    felt = bool(loaded.scene.controls) or any(
        setup.spec.sensor(name).type.name.removeprefix("mjSENS_").lower() in kinds
        for name in loaded.names
    )
    return [
        Parameter(effect, place, effect.lower, effect.upper)
        for effect, place in loaded.candidates(setup)
        if (effect.name, place) not in own and (felt or effect.name != "body_mass")
    ]


def shortlist(scores: Scores, count: int) -> list[SceneScore]:
    """The candidates that are worth a refit: by gain, one of those that are alike at a time.

    Args:
        scores: All.
        count: How many.
    """
    chosen: list[int] = []
    for k, score in enumerate(scores.scores):
        if score.gain <= 0.0 or score.share < 1e-4:
            continue
        if any(abs(scores.alike[k, j]) > 0.999 for j in chosen):
            continue
        chosen.append(k)
        if len(chosen) == count:
            break
    return [scores.scores[k] for k in chosen]


def _refitted(
    loaded: Loaded,
    used: Sequence[Track],
    aside: Sequence[Track],
    base: SceneFit,
    score: SceneScore,
    held: Floats,
    physics: Physics,
) -> Finalist:
    p = score.parameter
    now = p.effect.value(loaded.setup(base.values), p.place)
    start = p.value(p.coordinate(now) + score.step)
    reach = 3.0 * p.effect.typical
    if p.effect.logarithmic:
        start = float(np.clip(start, now / 10.0, now * 10.0))
    else:
        start = float(np.clip(start, now - reach, now + reach))
    if p.effect.absent is not None and abs(start - p.effect.absent) < 0.1 * p.effect.typical:
        start = p.effect.absent + 0.1 * p.effect.typical * (np.sign(score.step) or 1.0)
    start = float(np.clip(start, p.lower, p.upper))
    values = (
        *(v for v in base.values if (v.effect, v.at) != (p.effect.name, p.place)),
        Value(effect=p.effect.name, at=p.place, value=start),
    )
    fit = fit_scene(
        loaded,
        used,
        values,
        physics,
        start=begun(loaded, used, values, physics),
        scales=base.scales,
        starts=0,
    )
    k = len(fit.parameters) - 1
    strength, error = fit.told(k)
    fit = replace(fit, scales=base.scales)
    loss = held_loss(fit, *begun(loaded, aside, fit.values, physics), physics)
    fall = held - loss
    spread = float(np.std(fall, ddof=1) / np.sqrt(len(fall))) if len(fall) > 1 else np.inf
    return Finalist(
        score, fit, strength, error, loss,
        float(1.0 - np.mean(loss) / np.mean(held)),
        float(np.mean(fall) / spread) if spread > 0.0 else 0.0,
    )  # fmt: skip


def _tie(found: list[Finalist], scores: Scores) -> None:
    order = {s.parameter.label: k for k, s in enumerate(scores.scores)}
    if not found:
        return
    best = found[0]
    for other in found[1:]:
        apart = other.held - best.held
        spread = float(np.std(apart, ddof=1) / np.sqrt(len(apart))) if len(apart) > 1 else np.inf
        near = float(np.mean(apart)) < TIED * spread
        cosine = abs(scores.alike[order[best.label], order[other.label]])
        if other.gain >= WORTH and other.lead >= SURE and (near or cosine > ALIKE):
            best.alike.append(other.label)


def _verdict(found: list[Finalist], held: Floats) -> tuple[Verdict, str]:
    good = [f for f in found if f.gain >= WORTH and f.lead >= SURE]
    if not good or found[0] not in good:
        best = f"; the best, {found[0].label}, by {100 * found[0].gain:.0f} %" if found else ""
        return (
            "nothing_missing",
            "No effect of the catalogue makes what is kept aside better predicted by more than"
            f" chance would{best}.",
        )
    best_one = found[0]
    sentence = (
        f"Missing: {best_one.words}; with it what is kept aside is misread by"
        f" {100 * best_one.gain:.0f} % less"
    )
    if best_one.alike:
        return "ambiguous", f"{sentence}; not to be told from {', '.join(best_one.alike)}."
    return "effect", f"{sentence}."
