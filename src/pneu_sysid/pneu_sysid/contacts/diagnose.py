# SPDX-License-Identifier: Apache-2.0
"""What a scene's model is missing: candidates scored, refitted and judged on what is kept aside."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pneu_sysid.contacts.anew import counts_of
from pneu_sysid.contacts.candidates import SceneScore, Scores, Seen, scored, seen
from pneu_sysid.contacts.estimate import (
    Parameter,
    Problem,
    State,
    Tell,
)
from pneu_sysid.contacts.judge import WORTH, Aside, Judge, divided
from pneu_sysid.contacts.physics import Physics
from pneu_sysid.contacts.scene import Loaded, Value
from pneu_sysid.contacts.sureness import falls_of, lead_of, trimmed
from pneu_sysid.contacts.together import SceneFit
from pneu_sysid.contacts.track import Track
from pneu_sysid.results.base import Verdict

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

FINALISTS = 6
"""Candidates that are refitted."""
STRONG = 0.1
"""Share of the cost kept aside from which candidates are told apart by what each leaves: what they
would add by slopes says little so far from where those were taken."""
SURE = 2.5
"""Standard errors, over what is kept aside, by which its likelihood must rise."""
TIED = 1.5
"""Standard errors within which two candidates explain what is kept aside equally well; `SURE`,
where their columns are alike."""
ALIKE = 0.95
"""Cosine between columns above which two candidates are one to these recordings."""
LESS = 0.5
"""Of what one explains: another that explains a smaller share may be told from it by a sum."""
VALLEYS = 2
"""Better fits of the scene as it is that are taken from a candidate's, at most."""


@dataclass
class Finalist:
    """A candidate that was refitted.

    Attributes:
        score: What it promised.
        fit: The scene with it.
        strength: What it was found to be.
        std_error: Of that.
        held: (aside, kinds) cost per knot of each recording kept aside.
        gain: Share by which that falls, the mean of logarithms.
        worth: The same of the kind of motion in which it falls most.
        falls: (aside,) by which the logarithm of each one's cost falls, the mean over kinds.
        rise: (aside,) by which the logarithm of each one's likelihood rises.
        lead: That rise, in standard errors over the recordings.
        alike: Labels of finalists that explain as much.
    """

    score: SceneScore
    fit: SceneFit
    strength: float
    std_error: float
    held: Floats
    gain: float
    worth: float
    falls: Floats
    rise: Floats
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
        held: (aside, kinds) cost per knot of the base on each recording kept aside.
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
    judge = Judge(loaded, used, aside, values, physics)
    base, known = judge.base()
    valleys = 0
    while True:
        begin = 0.15 + 0.85 * (1.0 - 0.5**valleys)
        span = 0.85 * 0.5 ** (valleys + 1)
        told = _within(said, begin, span)
        scores, found, better = _round(judge, base, known, finalists, told, valleys < VALLEYS)
        if better is None:
            break
        base, known = better
        valleys += 1
    by_falls = _order(found)
    _tie(found, scores, by_falls)
    verdict, sentence = _verdict(found)
    return SceneDiagnosis(
        verdict, sentence, base, scores, found, known.kinds,
        [t.name for t in used], [t.name for t in aside],
    )  # fmt: skip


def _within(said: Tell, begin: float, span: float) -> Tell:
    return lambda note, done: said(note, begin + span * done)


def _order(found: list[Finalist]) -> bool:
    """Puts the best first; returns whether they are told apart by what each leaves."""
    by_falls = any(_good(f) and f.gain >= STRONG for f in found)
    found.sort(key=lambda f: (not _good(f), -trimmed(f.falls if by_falls else f.rise)[0]))
    return by_falls


def _round(
    judge: Judge, base: SceneFit, known: Aside, finalists: int, tell: Tell, may_leave: bool
) -> tuple[Scores, list[Finalist], tuple[SceneFit, Aside] | None]:
    """Candidates scored and refitted about one fit of the scene as it is.

    A candidate's other parameters may end in another valley than they began in, and what that
    alone explains is not the candidate's: the scene without it is fitted from there as well. Where
    that leaves less, it is what the scene is without, and all candidates are looked at anew.

    Args:
        judge: Fits and judges.
        base: The scene as it is.
        known: What it leaves aside.
        finalists: How many candidates are refitted.
        tell: Called with a note and the fraction done.
        may_leave: Whether another valley is looked for.

    Returns:
        Scores, finalists in the order of their scores, and the scene as it is where another valley
        leaves less, with what it leaves; the finalists are not complete then.
    """
    loaded, physics = judge.loaded, judge.physics
    tell("candidates", 0.0)
    candidates = candidates_of(loaded, base.values, base.parameters)
    scores = scored(
        Problem(loaded, base.chains, base.values, base.parameters, physics),
        State(base.q, base.x),
        candidates,
    )
    chosen = shortlist(scores, finalists)
    others = seen(
        Problem(loaded, known.chains, base.values, base.parameters, physics),
        State(known.q, base.x),
        [s.parameter for s in chosen],
    )
    found: list[Finalist] = []
    left: list[str] = []

    def valley(finalist: Finalist) -> tuple[SceneFit, Aside] | None:
        left.append(finalist.label)
        tell(f"without {finalist.label}", (len(found) + 0.5) / (len(chosen) + 1))
        return judge.without(base, known, finalist.fit, finalist.score.parameter)

    for number, score in enumerate(chosen):
        tell(score.parameter.label, number / (len(chosen) + 1))
        found.append(_refitted(judge, base, score, known, _foretold(scores, others, score)))
        if may_leave and base.parameters and not left and _good(found[-1]):  # the first that is
            better = valley(found[-1])
            if better is not None:
                return scores, found, better
    if may_leave and base.parameters:
        _order(found)
        if found and _good(found[0]) and found[0].label not in left:
            return scores, found, valley(found[0])
    return scores, found, None


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


def _foretold(scores: Scores, others: Seen, score: SceneScore) -> Floats:
    """(aside,) what the step of a candidate adds to the likelihood of what is kept aside.

    To second order about trajectories of the scene as it is: no valley that one model happened to
    find, and the other did not, counts for either.
    """
    label = score.parameter.label
    at, step = scores.seen.step(label)
    with_it = others.rise(_among(at, scores.seen, others, label), step)
    plain, rest = scores.seen.step(None)
    return with_it - others.rise(plain, rest)


def _among(at: Ints, own: Seen, others: Seen, label: str) -> Ints:
    """Numbers of the same parameters among those of others."""
    return np.append(at[: own.fitted], others.fitted + others.labels.index(label))


def _refitted(
    judge: Judge, base: SceneFit, score: SceneScore, known: Aside, foretold: Floats
) -> Finalist:
    p = score.parameter
    now = p.effect.value(judge.loaded.setup(base.values), p.place)
    start = p.value(p.coordinate(now) + score.step)
    reach = 3.0 * p.effect.typical
    if p.effect.logarithmic:
        start = float(np.clip(start, now / 10.0, now * 10.0))
    else:
        start = float(np.clip(start, now - reach, now + reach))
    fit = judge.refitted(base, p, float(np.clip(start, p.lower, p.upper)))
    strength, error = fit.told(len(fit.parameters) - 1)
    before, after = judge.pair(base, known, fit)
    falls = falls_of(before.kinds, after.kinds)
    each = np.nanmean(falls, axis=1)
    mean, spread = trimmed(each)
    by_kind = [trimmed(k[np.isfinite(k)])[0] for k in falls.T if np.isfinite(k).sum() > 1]
    # a weak effect is told by slopes, a strong one by what it leaves where slopes no longer hold
    ways = [foretold, np.nansum(falls * counts_of(after.chains), axis=1)]
    leads = [lead_of(way) for way in ways]
    best = int(np.argmax(leads))
    if mean < -spread:  # estimated anew it does harm, whatever slopes say
        best, leads = 1, [-np.inf, lead_of(ways[1])]
    return Finalist(
        score, fit, strength, error, after.kinds, float(1.0 - np.exp(-mean)),
        float(1.0 - np.exp(-max([mean, *by_kind]))), each, ways[best], leads[best],
    )  # fmt: skip


def _good(found: Finalist) -> bool:
    return found.worth >= WORTH and found.lead >= SURE


def _nearly(other: Finalist, best: Finalist) -> bool:
    """Whether one that is not sure by itself explains about as much as the best all the same."""
    return other.worth >= WORTH and other.lead >= TIED and other.gain >= LESS * best.gain


def _tie(found: list[Finalist], scores: Scores, by_falls: bool) -> None:
    """Tells the best which others explain as much.

    They need not be as sure as it must be: one that misses that by little, and explains as much,
    is not ruled out by having missed it.
    """
    order = {s.parameter.label: k for k, s in enumerate(scores.scores)}
    best = next((f for f in found if _good(f)), None)
    if best is None:
        return
    for other in found:
        if other is best or not (_good(other) or _nearly(other, best)):
            continue
        cosine = abs(scores.alike[order[best.label], order[other.label]])
        if _apart(best, other, by_falls) < (SURE if cosine > ALIKE else TIED):
            best.alike.append(other.label)


def _apart(best: Finalist, other: Finalist, by_falls: bool) -> float:
    """Standard errors by which one explains more than another.

    Two that explain nearly as much are told apart by the mean over recordings alone: what sums of
    them say surely may be what neither of the two models knows.
    """
    way = best.falls - other.falls if by_falls else best.rise - other.rise
    if other.gain < LESS * best.gain:
        return lead_of(way)
    mean, spread = trimmed(way)
    return mean / spread if spread > 0.0 else 0.0


def _verdict(found: list[Finalist]) -> tuple[Verdict, str]:
    good = [f for f in found if _good(f)]
    if not good:
        best = (
            f"; the best, {found[0].label}, by {100 * found[0].gain:.0f} %,"
            f" {found[0].lead:.1f} standard errors"
            if found
            else ""
        )
        return (
            "nothing_missing",
            "No effect of the catalogue explains what is kept aside better than chance"
            f" would{best}.",
        )
    best_one = good[0]
    of, share = "", best_one.gain
    if share < WORTH:  # it shows in one kind of motion
        of, share = " of flights or of contacts", best_one.worth
    sentence = (
        f"Missing: {best_one.words}; with it what is kept aside{of} is explained by"
        f" {100 * share:.0f} % better"
    )
    if best_one.alike:
        return "ambiguous", f"{sentence}; not to be told from {', '.join(best_one.alike)}."
    return "effect", f"{sentence}."
