# SPDX-License-Identifier: Apache-2.0
"""What is missing in a model: candidates ranked, and one honest verdict."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pneu_sim.effects.base import POSITION
from pneu_sim.rig.schema import Rig
from pneu_sim.tally import Tally
from pneu_sysid.candidates import (
    Refit,
    Score,
    all_sites,
    best_per_place,
    cosine,
    refit,
    residual_matrix,
    score,
)
from pneu_sysid.compare import grid_check
from pneu_sysid.dependence import dependences
from pneu_sysid.fit import tap_rmse
from pneu_sysid.nuisance import nuisance_of
from pneu_sysid.problem import Problem, make_problem
from pneu_sysid.records import Recording
from pneu_sysid.results import (
    Candidate,
    Dependence,
    DiagnoseResult,
    Numerics,
    Verdict,
    pneu_version,
)
from pneu_sysid.standing import (
    WITHIN_FLOOR,
    Standing,
    against_noise,
    since_calibration,
    standing_of,
)
from pneu_sysid.together import each_of

Floats = NDArray[np.float64]
Progress = Callable[[str, float], None]

FINALISTS = 8
"""Candidates that are refitted."""
WORTH = 0.10
"""A held-out gain below this fraction of the squared residual is not worth a parameter."""
BEYOND_CALIBRATION = 0.25
"""... nor is one below this fraction of what the calibration itself left over."""
SIGNIFICANT = 3.0
"""Jackknife t below which a candidate is not believed."""
ALIKE = 0.95
"""Cosine above which two effects change the prediction alike."""
EQUALLY_GOOD = 1.25
"""A rival is as good if it leaves at most this multiple of what the best leaves, held out."""
REFIT_CELLS, SCORE_CELLS = 2.0, 4.0
"""Candidates are refitted and scored on cells so many times as long: only what they change of the
prediction counts."""
CONTENDER = 0.35
"""Only candidates with this fraction of the best score are refitted, but at least three."""
MOST = 0.5
"""An effect must explain this fraction of the excess over the floor to be the answer by itself."""


@dataclass
class Diagnosis:
    """A verdict with everything behind it.

    Attributes:
        verdict: ``nothing_missing``, ``effect``, ``ambiguous`` or ``unknown``.
        sentence: The verdict in words.
        finalists: Refitted candidates, best first.
        scores: All candidates by their score, one per effect and place.
        rmse_pa: Error per tap before anything is added.
        depends_on: Variables the residual depends on, for ``unknown``.
        excess: Held-out squared residual over the floor, as a ratio.
        left_over: The same after the best candidate.
        numerics: Whether the grid is to blame.
        problem: The problem it was made on.
        readings: What the model predicts on it before anything is added.
        standing: How the model stood before.
        statements: Of a change since the calibration, and of the noise, a sentence each.
        unchanged: Recordings that the verdict is not about, the model explaining them as it is.
    """

    verdict: Verdict
    sentence: str
    finalists: list[Refit]
    scores: list[Score]
    rmse_pa: dict[str, float]
    depends_on: list[tuple[str, str, float]]
    excess: float
    left_over: float
    numerics: Numerics | None
    problem: Problem = field(repr=False)
    readings: Floats = field(repr=False)
    standing: Standing = field(repr=False)
    statements: list[str] = field(default_factory=list)
    unchanged: list[str] = field(default_factory=list)

    def alike(self, k: int) -> list[str]:
        """Labels of finalists that the recording cannot tell from finalist ``k``.

        Args:
            k: Index into ``finalists``.
        """
        me = self.finalists[k]
        return [
            other.site.label
            for i, other in enumerate(self.finalists)
            if i != k
            and 1.0 - other.held_out <= EQUALLY_GOOD * (1.0 - me.held_out)
            and cosine(other.change, me.change) >= ALIKE
        ]


def diagnose(
    rig: Rig,
    recording: Recording | Sequence[Recording],
    finalists: int = FINALISTS,
    refine: bool = True,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Diagnosis:
    """Ranks every candidate effect and place, and says what is missing.

    Scores come from one batched call; the best are refitted on two
    thirds of the stretches and judged on the rest.

    Args:
        rig: The rig, usually fitted to a recording without the fault.
        recording: The recording.
        finalists: Candidates to refit.
        refine: Check the grid.
        workers: Threads of a batch.
        progress: Called with a stage's name and the fraction done.

    Returns:
        The diagnosis.
    """
    tell = progress or (lambda stage, done: None)
    tell("base", 0.0)
    own = make_problem(rig, recording, workers=workers)
    readings = own.predict([rig])[0]
    rmse = tap_rmse(own, readings, np.ones(own.stretches, dtype=bool))
    base = residual_matrix(own, readings)
    # The check of the grid is one long run; it fills what the search leaves of the processor.
    checking = ThreadPoolExecutor(1)
    grid = checking.submit(_grid, own, rig, readings, refine)
    checking.shutdown(wait=False)
    problem = rough = own
    if rig.model == "pde":
        with ThreadPoolExecutor(2) as pool:
            problem, rough = pool.map(
                lambda cells: own.coarsened(rig, cells, readings), (REFIT_CELLS, SCORE_CELLS)
            )
    nuisance = nuisance_of(rig, rough)
    project = None if nuisance is None else nuisance.without(~own.held_out)
    _, scores = score(rough, rig, all_sites(rig), project, lambda f: tell("scores", f))
    best = best_per_place(scores)
    chosen = [
        s
        for k, s in enumerate(best[:finalists])
        if s.explained > 0.0 and (k < 3 or s.explained >= CONTENDER * best[0].explained)
    ]
    tally = Tally([1.0] * len(chosen), lambda f: tell("refits", f))

    def try_out(shared: Problem, item: tuple[int, Score]) -> Refit:
        k, candidate = item
        found = refit(shared, rig, base, candidate, project)
        tally.reached(k, 1.0)
        return found

    refits = each_of(list(enumerate(chosen)), problem, try_out)
    refits.sort(key=lambda r: (-round(r.held_out, 3), r.site.effect.order, r.site.label))
    tell("grid", 0.0)
    numerics = grid.result()
    tell("grid", 1.0)
    standing = standing_of(rig, own, base)
    judged = base if project is None else project(base)
    result = _judge(own, standing, judged, refits, best, rmse, numerics, readings)
    names = [r.name for r in own.recordings]
    found = result.verdict in ("effect", "ambiguous", "unknown")
    result.statements = [since_calibration(standing, names, found), against_noise(standing)]
    return result


def _grid(own: Problem, rig: Rig, readings: Floats, refine: bool) -> Numerics | None:
    """Whether the grid is fine enough, where that is asked and there is one."""
    if not refine or rig.model != "pde":
        return None
    compared = {
        tap: readings[:, :, k]
        for k, tap in enumerate(own.taps)
        if np.isfinite(own.measured[:, :, k]).any()
    }
    return grid_check(own, rig, compared)


def diagnose_apart(
    rig: Rig,
    recordings: Sequence[Recording],
    finalists: int = FINALISTS,
    refine: bool = True,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Diagnosis:
    """Diagnoses recordings together, or those alone that differ from the rest.

    A leak that began on Tuesday is in the recordings since; with those from before, it would only
    be half as large.

    Args:
        rig: The rig.
        recordings: The recordings.
        finalists: Candidates to refit.
        refine: Check the grid.
        workers: Threads of a batch.
        progress: Called with a stage's name and the fraction done.

    Returns:
        The diagnosis, its problem on the recordings that it is about.
    """
    if len(recordings) > 1:
        problem = make_problem(rig, recordings, workers=workers)
        base = residual_matrix(problem, problem.predict([rig])[0])
        whole = standing_of(rig, problem, base)
        if whole.changed and len(whole.changed) < len(recordings):
            differ = [r for r in recordings if r.name in whole.changed]
            found = diagnose(rig, differ, finalists, refine, workers, progress)
            names = [r.name for r in recordings]
            found.statements[0] = since_calibration(whole, names, True)
            found.statements.append(
                f"The verdict is of {', '.join(whole.changed)}; the model without it explains"
                f" {', '.join(n for n in names if n not in whole.changed)}."
            )
            found.unchanged = [n for n in names if n not in whole.changed]
            found.sentence = f"In {', '.join(whole.changed)} alone: {found.sentence}"
            return found
    return diagnose(rig, recordings, finalists, refine, workers, progress)


def _judge(
    problem: Problem,
    standing: Standing,
    base: Floats,
    refits: list[Refit],
    scores: list[Score],
    rmse: dict[str, float],
    numerics: Numerics | None,
    readings: Floats,
) -> Diagnosis:
    held = problem.held_out if problem.held_out.any() else np.ones(base.shape[0], dtype=bool)
    weight = np.isfinite(problem.target()[held]).sum(axis=(0, 1))
    floor_sum = float(np.sum(weight * standing.floor**2))
    held_sum = float(np.sum(base[held] ** 2))
    excess = held_sum / max(floor_sum, 1e-300)
    credible = [
        r
        for r in refits
        if r.t >= SIGNIFICANT
        and r.held_out >= WORTH
        and r.held_out * held_sum >= BEYOND_CALIBRATION * floor_sum
    ]
    top = credible[0] if credible else None
    left = excess * (1.0 - top.held_out) if top else excess
    finalists = credible + [r for r in refits if r not in credible]
    result = Diagnosis(
        verdict="unknown",
        sentence="",
        finalists=finalists,
        scores=scores,
        rmse_pa=rmse,
        depends_on=[],
        excess=excess,
        left_over=left,
        numerics=numerics,
        problem=problem,
        readings=readings,
        standing=standing,
    )
    over = held_sum - floor_sum
    rest = left * floor_sum - floor_sum
    alone = rest <= (1.0 - MOST) * over
    if top is not None and (alone or _second_helps(problem, base, top, scores)):
        alike = result.alike(0)
        result.verdict = "ambiguous" if alike else "effect"
        result.sentence = _sentence(result, top, alike, alone)
    elif excess <= WITHIN_FLOOR:
        result.verdict = "nothing_missing"
        left_times = float(np.sqrt(held_sum / max(int(weight.sum()), 1)))
        result.sentence = _nothing_sentence(standing, left_times)
    if result.verdict == "unknown":
        change = top.change if top is not None else np.zeros_like(base)
        result.depends_on = dependences(problem, base - change)
        result.sentence = _unknown_sentence(result, top)
    return result


def _nothing_sentence(standing: Standing, left_times: float) -> str:
    """Nothing was found: of a change since the calibration, or of the noise."""
    if standing.explains:
        return "Nothing is missing: the model explains the recording to the sensor noise."
    if standing.calibrated and not standing.own:
        return (
            "Nothing changed since the calibration: the model explains the recording as well as"
            " the one it was calibrated on."
        )
    return (
        f"No effect is missing: of the {standing.times_noise:.2f} times the noise that the model"
        f" leaves, {left_times:.2f} would be left if its base parameters were fitted here."
    )


def _second_helps(problem: Problem, base: Floats, top: Refit, scores: list[Score]) -> bool:
    """Whether a second effect of the catalogue explains much of what the best one leaves."""
    rest = base - top.change
    total = float(np.sum(rest**2))
    noise = float(np.isfinite(problem.measured).sum())
    best = 0.0
    for item in scores:
        if item.site.effect.name == top.site.effect.name and item.site.place == top.site.place:
            continue
        b = float(np.sum(item.sensitivity**2))
        if b > 0.0:
            best = max(best, float(np.sum(item.sensitivity * rest)) ** 2 / b)
    return best >= 0.3 * max(total - noise, 0.0)


def _strength(r: Refit) -> str:
    p = r.site.effect.strength
    return f"{r.strength:.3g} {p.unit}".strip() + f" (± {r.std_error:.1g})"


def _where(r: Refit) -> str:
    if POSITION in r.site.shape:
        return f"in {r.site.place} at {r.site.shape[POSITION]:.2f} m"
    return f"at {r.site.place}"


def _sentence(result: Diagnosis, top: Refit, alike: list[str], alone: bool) -> str:
    text = (
        f"Missing: {top.site.effect.title} {_where(top)}, {_strength(top)}; it explains"
        f" {100.0 * top.held_out:.0f} % of the held-out squared residual"
    )
    if alike:
        text += f"; this recording cannot tell it from {', '.join(alike)}"
    if not alone:
        text += "; more is missing besides"
    return text + "."


def _unknown_sentence(result: Diagnosis, top: Refit | None) -> str:
    text = "Something is missing that the catalogue does not hold"
    if top is not None:
        text += (
            f" (the nearest, {top.site.label}, explains only {100.0 * top.held_out:.0f} % of the"
            " held-out squared residual)"
        )
    if result.depends_on:
        named = ", ".join(f"{v} at {tap}" for v, tap, _ in result.depends_on[:3])
        text += f"; the residual depends on {named}"
    return text + "."


def result_of_diagnosis(name: str, found: Diagnosis, findings: list[str]) -> DiagnoseResult:
    """The JSON result of a diagnosis.

    Args:
        name: Name of the rig.
        found: The diagnosis.
        findings: What was found while reading the recording.
    """
    candidates = []
    for k, r in enumerate(found.finalists):
        effect = r.site.effect
        candidates.append(
            Candidate(
                effect=effect.name,
                title=effect.title,
                place=r.site.place,
                position_m=r.site.shape.get(POSITION),
                strength=r.strength,
                unit=effect.strength.unit,
                std_error=r.std_error,
                explained_fraction=r.score_explained,
                refit_fraction=r.explained,
                held_out_gain=r.held_out,
                significance=r.t,
                indistinguishable_from=found.alike(k),
                next_experiment=effect.next_experiment,
                tested=True,
            )
        )
    refitted = {(r.site.effect.name, r.site.place) for r in found.finalists}
    for s in found.scores:
        if (s.site.effect.name, s.site.place) in refitted:
            continue
        effect = s.site.effect
        candidates.append(
            Candidate(
                effect=effect.name,
                title=effect.title,
                place=s.site.place,
                position_m=s.site.shape.get(POSITION),
                strength=s.strength,
                unit=effect.strength.unit,
                std_error=abs(s.strength) / s.t if s.t > 0.0 else None,
                explained_fraction=s.explained,
                significance=s.t,
                next_experiment=effect.next_experiment,
                tested=False,
            )
        )
    problem = found.problem
    return DiagnoseResult(
        pneu_version=pneu_version(),
        recording=problem.name,
        recordings=[r.name for r in problem.recordings],
        rigs=[name],
        taps=problem.taps,
        noise_floor_pa=dict(zip(problem.taps, problem.noise_pa.tolist(), strict=True)),
        findings=findings,
        verdict=found.verdict,
        sentence=found.sentence,
        statements=found.statements,
        unchanged=found.unchanged,
        times_noise=found.standing.times_noise,
        rmse_pa=dict(found.rmse_pa),
        candidates=candidates,
        depends_on=[
            Dependence(variable=v, tap=tap, gain=gain) for v, tap, gain in found.depends_on
        ],
        numerics=found.numerics
        or Numerics(
            dx_m=problem.dx_m,
            refined_dx_m=None,
            change_pa={},
            discretisation=False,
            sentence="The grid was not checked.",
        ),
    )
