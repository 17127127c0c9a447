# SPDX-License-Identifier: Apache-2.0
"""What is missing in a model: candidates ranked, and one honest verdict."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from pneu_common.tally import Tally
from pneu_sim.effects.base import POSITION
from pneu_sim.rig.schema import Rig
from pneu_sysid import words
from pneu_sysid.bench import Bench, bench_of
from pneu_sysid.candidates import Score, best_per_place, residual_matrix, scores_of, to_refit
from pneu_sysid.dependence import dependences, seldom
from pneu_sysid.evidence import cosine, lead
from pneu_sysid.fit import sensor_rmse
from pneu_sysid.heading import heading
from pneu_sysid.left_open import left_open
from pneu_sysid.parameter_units import strength_unit
from pneu_sysid.problem import Problem, make_problem
from pneu_sysid.records import Recording
from pneu_sysid.refits import Refit, refit, settled, well_placed
from pneu_sysid.results.base import Verdict
from pneu_sysid.results.compare import Numerics
from pneu_sysid.results.diagnose import Candidate, Dependence, DiagnoseResult
from pneu_sysid.sensor_units import apart
from pneu_sysid.standing import Standing, against_noise, since_calibration, standing_of
from pneu_sysid.thresholds import Thresholds
from pneu_sysid.together import each_of

Floats = NDArray[np.float64]
Progress = Callable[[str, float], None]

NEARLY = 1.5
"""A candidate that leaves no more than so many times the squares of the best one may only be behind
it because of cells: those that candidates are fitted on, and the rig's own."""
RIVALS = 3
"""So many of those at most are fitted once more."""


@dataclass
class Diagnosis:
    """A verdict with everything behind it.

    Attributes:
        verdict: ``nothing_missing``, ``effect``, ``ambiguous`` or ``unknown``.
        sentence: The verdict in words.
        finalists: Refitted candidates: those that are believed, best first, then the others.
        believed: How many are.
        tied: For each finalist the labels of those that this recording cannot tell from it.
        scores: All candidates by their score, one per effect and place.
        rmse: Error per tap and encoder before anything is added, each in its unit.
        depends_on: Variables the residual depends on, for ``unknown``.
        excess: Held-out squared residual over the floor, as a ratio.
        left_over: The same after the best candidate.
        numerics: Whether the grid is to blame.
        bench: What it was found with.
        statements: Of a change since the calibration, and of the noise, a sentence each.
        unchanged: Recordings that the verdict is not about, the model explaining them as it is.
        left_open: Whether what explains it is no more than what the calibration left open.
    """

    verdict: Verdict
    sentence: str
    finalists: list[Refit]
    believed: int
    tied: list[list[str]]
    scores: list[Score]
    rmse: dict[str, float]
    depends_on: list[tuple[str, str, float]]
    excess: float
    left_over: float
    numerics: Numerics | None
    bench: Bench = field(repr=False)
    statements: list[str] = field(default_factory=list)
    unchanged: list[str] = field(default_factory=list)
    left_open: bool = False

    @property
    def problem(self) -> Problem:
        """The problem it was made on."""
        return self.bench.problem

    @property
    def standing(self) -> Standing:
        """How the model stood before."""
        return self.bench.standing

    def alike(self, k: int) -> list[str]:
        """Labels of finalists that the recording cannot tell from finalist ``k``.

        Args:
            k: Index into ``finalists``.
        """
        return self.tied[k]


def diagnose(
    rig: Rig,
    recording: Recording | Sequence[Recording],
    finalists: int | None = None,
    refine: bool = True,
    workers: int | None = None,
    progress: Progress | None = None,
    thresholds: Thresholds | None = None,
    without: Collection[str] = (),
    aside: Sequence[tuple[float, float]] = (),
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
        thresholds: What decides.
        without: Names of effects that are not tried.
        aside: Parts that are kept aside for judging, see `make_problem`.

    Returns:
        The diagnosis.
    """
    tell = progress or (lambda stage, done: None)
    limits = thresholds or Thresholds()
    if finalists is not None:
        limits = replace(limits, finalists=finalists)
    bench = bench_of(rig, recording, refine, workers, tell, limits, without, aside)
    found = look(bench, rig, bench.readings, tell)
    tell("grid", 0.0)
    found.numerics = bench.numerics.result()
    tell("grid", 1.0)
    names = [r.name for r in bench.problem.recordings]
    something = found.verdict in ("effect", "ambiguous", "unknown")
    found.statements = [
        since_calibration(bench.standing, names, something),
        against_noise(bench.standing, limits),
    ]
    if found.left_open:
        found.statements[0] = "Nothing is known to have changed since the calibration."
    if found.verdict == "ambiguous":
        found.statements.append(words.to_tell_apart(found.finalists[0]))
    return found


def diagnose_apart(
    rig: Rig,
    recordings: Sequence[Recording],
    finalists: int | None = None,
    refine: bool = True,
    workers: int | None = None,
    progress: Progress | None = None,
    thresholds: Thresholds | None = None,
    without: Collection[str] = (),
    aside: Sequence[tuple[float, float]] = (),
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
        thresholds: What decides.
        without: Names of effects that are not tried.
        aside: Parts that are kept aside for judging, see `make_problem`; where there are any, all
            recordings are diagnosed together.

    Returns:
        The diagnosis, its problem on the recordings that it is about.
    """
    limits = thresholds or Thresholds()
    if len(recordings) > 1 and not aside:
        problem = make_problem(rig, recordings, workers=workers)
        base = residual_matrix(problem, problem.predict([rig])[0])
        whole = standing_of(rig, problem, base, limits)
        if whole.changed and len(whole.changed) < len(recordings):
            differ = [r for r in recordings if r.name in whole.changed]
            found = diagnose(rig, differ, finalists, refine, workers, progress, limits, without)
            names = [r.name for r in recordings]
            if not found.left_open:
                found.statements[0] = since_calibration(whole, names, True)
            found.statements.append(
                f"The verdict is of {', '.join(whole.changed)}; the model without it explains"
                f" {', '.join(n for n in names if n not in whole.changed)}."
            )
            found.unchanged = [n for n in names if n not in whole.changed]
            found.sentence = f"In {', '.join(whole.changed)} alone: {found.sentence}"
            return found
    return diagnose(rig, recordings, finalists, refine, workers, progress, limits, without, aside)


def look(
    bench: Bench,
    rig: Rig,
    readings: Floats,
    tell: Progress,
    taken: float = 0.0,
    work: Callable[..., Refit] = refit,
) -> Diagnosis:
    """Looks for the effect that a rig lacks most.

    Args:
        bench: What was made ready.
        rig: The rig of the bench, perhaps with effects added.
        readings: (n_stretches, horizon, n_taps) what it predicts, Pa.
        tell: Called with a stage's name and the fraction done.
        taken: Squared error on what is kept aside that the effects added so far took away.
        work: What refits a candidate.

    Returns:
        The diagnosis, without what is only said once.
    """
    limits = bench.thresholds
    base = residual_matrix(bench.problem, readings)
    best = best_per_place(scores_of(base, bench.known, bench.project))
    first, others = to_refit(best, limits)
    # One that is much stronger than what was scored has a score that says little.
    weaker = [s for s in best if s.explained > 0.0 and s not in first and s not in others]
    coarser: list[Problem] = []

    def refitted(chosen: list[Score], ladder: bool) -> list[Refit]:
        if not chosen:
            return []
        if not coarser:
            coarser.append(bench.coarser(rig, readings))
        tally = Tally([1.0] * len(chosen), lambda f: tell("refits", f))

        def try_out(shared: Problem, item: tuple[int, Score]) -> Refit:
            k, candidate = item
            found = work(shared, rig, base, candidate, limits, bench.project, ladder)
            tally.reached(k, 1.0)
            return found

        return each_of(list(enumerate(chosen)), coarser[0], try_out)

    refits = refitted(first, False)
    result = _judge(bench, base, refits, best, readings, taken)
    # As long as the best is not the answer: those that look like it, those that were scored lower,
    # and the first again, from other strengths.
    for more in (others[: limits.finalists], weaker[: limits.finalists], first):
        if more and not _is_answer(result, bench):
            parts = [score.site.part for score in more]
            before = {r.site.part: r for r in refits if r.site.part in parts}
            refits = [r for r in refits if r.site.part not in parts]
            for again in refitted(more, True):
                known = before.get(again.site.part)
                refits.append(
                    again if known is None or again.explained > known.explained else known
                )
            result = _judge(bench, base, refits, best, readings, taken)
    # None is named while another that changes the prediction alike was only scored.
    more = _alike_but_scored(result, refits, best, limits)
    if more:
        refits += refitted(more, False)
        result = _judge(bench, base, refits, best, readings, taken)
    # Nor while cells may be what sets it apart from another: how they smear a volume in a line is
    # no small part of what tells it from a longer line.
    near = _nearly_as_good(result)
    if near and coarser and coarser[0] is not bench.problem:

        def settle(shared: Problem, found: Refit) -> Refit:
            return settled(shared.mended(found.rig), base, found, bench.project)

        def place(shared: Problem, found: Refit) -> Refit:
            return settle(shared, well_placed(shared, found, bench.blocks, bench.project))

        todo = near
        for work_on in (settle, place):  # a place is dear, and a clear winner needs none
            if todo:
                tell("rivals", 0.0)
                instead = dict(zip(todo, each_of(todo, bench.problem, work_on), strict=True))
                refits = [instead.get(r, r) for r in refits]
                result = _judge(bench, base, refits, best, readings, taken)
                todo = [r for r in _to_place(result) if r in instead.values()]
    return result


def _to_place(result: Diagnosis) -> list[Refit]:
    """Believed candidates with a place, but for one that leads all others."""
    believed = result.finalists[: result.believed]
    first = 0 if result.verdict == "ambiguous" else 1
    return [r for r in believed[first:] if POSITION in r.site.shape]


def _nearly_as_good(result: Diagnosis) -> list[Refit]:
    """The candidate that is named alone, and those that leave little more than it does."""
    if result.verdict not in ("effect", "ambiguous"):
        return []
    top, *others = result.finalists[: result.believed]
    most = NEARLY * float(np.sum(top.residual**2))
    near = [r for r in others if float(np.sum(r.residual**2)) <= most]
    return [top, *near[:RIVALS]] if near else []


def _alike_but_scored(
    result: Diagnosis, refits: list[Refit], best: list[Score], limits: Thresholds
) -> list[Score]:
    """Candidates that were not refitted and change the prediction as the best one does."""
    if not result.believed:
        return []
    top, tried = result.finalists[0].site.part, {r.site.part for r in refits}
    own = next((score.projected for score in best if score.site.part == top), None)
    if own is None:
        return []
    least = limits.contender * best[0].explained
    return [
        score
        for score in best
        if score.site.part not in tried
        and score.explained >= least
        and abs(cosine(score.projected, own)) >= limits.alike
    ][: limits.finalists]


def _is_answer(result: Diagnosis, bench: Bench) -> bool:
    """Whether nothing need be looked for that explains more than the best candidate.

    It need not where that leaves what may be left, and besides most of the error is gone or nothing
    more would be looked for; and where its strength is not as far as it goes.
    """
    limits, floor = bench.thresholds, bench.floor
    if not result.believed:
        return result.verdict == "nothing_missing"
    top = result.finalists[0]
    most = top.held_out >= limits.mostly or result.left_over <= limits.settled
    return (
        most
        and not top.at_bound
        and result.left_over * floor <= bench.allowed(result.excess * floor)
    )


def _believed(bench: Bench, r: Refit, base: Floats, before: float, taken: float) -> bool:
    """Whether a candidate is more than chance, the calibration's rest, or another's shadow."""
    limits = bench.thresholds
    gain = r.held_out * before
    discrepancy = max(bench.floor - bench.readings_held, 0.0)
    return (
        r.t >= limits.significant
        # where it was fitted it explains at least as much, or it explains something else
        and min(r.held_out, r.explained) >= limits.worth
        and gain >= limits.share_of_discrepancy * discrepancy + limits.chance * bench.readings_held
        and gain >= limits.accuracy**2 * taken
        and lead(r.residual, base, bench.blocks) >= limits.significant
    )


def _is_special(candidate: Refit, believed: list[Refit], bench: Bench) -> bool:
    """Whether a candidate is no more than a special case of it: a relief valve that never shuts."""
    return any(
        other.site.effect.name == candidate.site.effect.contains
        and lead(candidate.residual, other.residual, bench.blocks) < bench.thresholds.tied
        for other in believed
    )


def _in_order(believed: list[Refit], bench: Bench) -> list[Refit]:
    """Candidates by what they leave; of those that leave the same the simplest first.

    A relief valve that opens at once is a leak: with more parameters it is never worse. The same is
    what one parameter may take away by chance (ln n of the mean square: Schwarz 1978).
    """
    out = sorted(believed, key=lambda c: float(np.sum(c.residual**2)))
    if not out:
        return out
    least = float(np.sum(out[0].residual ** 2))
    count = int(np.isfinite(bench.problem.measured).sum())
    most = least * (1.0 + np.log(count) / count)
    equal = [c for c in out if float(np.sum(c.residual**2)) <= most]
    equal.sort(key=lambda c: (len(c.site.effect.fitted(c.rig, c.site.place)), c.site.effect.order))
    return equal + [c for c in out if c not in equal]


def _judge(
    bench: Bench,
    base: Floats,
    refits: list[Refit],
    scores: list[Score],
    readings: Floats,
    taken: float,
) -> Diagnosis:
    limits, problem, standing = bench.thresholds, bench.problem, bench.standing
    r = base if bench.project is None else bench.project(base)
    floor = bench.floor
    before = bench.held_sum(r)
    believed = [c for c in refits if _believed(bench, c, r, before, taken)]
    believed = _in_order([c for c in believed if not _is_special(c, believed, bench)], bench)
    finalists = believed + sorted(
        (c for c in refits if c not in believed), key=lambda c: -c.held_out
    )
    doubtful = bench.doubtful
    tied = [
        [
            other.site.label
            for other in believed
            if other is not one
            and one.site.part != other.site.part
            and one in believed
            and abs(lead(one.residual, other.residual, bench.blocks, doubtful)) < limits.tied
        ]
        for one in finalists
    ]
    top = believed[0] if believed else None
    left = before * (1.0 - top.held_out) if top else before
    result = Diagnosis(
        verdict="unknown",
        sentence="",
        finalists=finalists,
        believed=len(believed),
        tied=tied,
        scores=scores,
        rmse=sensor_rmse(problem, readings, np.ones(problem.stretches, dtype=bool)),
        depends_on=[],
        excess=before / max(floor, 1e-300),
        left_over=left / max(floor, 1e-300),
        numerics=None,
        bench=bench,
    )
    if top is not None:
        explained = left <= bench.allowed(before)
        if explained and left_open(top.rig):
            result.verdict, result.believed, result.left_open = "nothing_missing", 0, True
            result.sentence = words.left_open(top)
            return result
        mostly = top.held_out >= limits.mostly
        if explained or mostly or _second_helps(bench, top, scores):
            result.verdict = "ambiguous" if tied[0] else "effect"
            result.sentence = words.missing(top, tied[0], explained)
    elif not bench.unexplained(r):
        result.verdict = "nothing_missing"
        times = float(np.sqrt(before / max(bench.readings_held, 1)))
        result.sentence = words.nothing_missing(standing, times)
    if result.verdict == "unknown":
        rest = r if top is None else top.residual
        result.depends_on = dependences(problem, rest, limits)
        result.sentence = words.unknown(
            top, result.depends_on, seldom(problem, rest, bench.blocks, limits)
        )
    return result


def _second_helps(bench: Bench, top: Refit, scores: list[Score]) -> bool:
    """Whether a second effect of the catalogue explains much of what the best one leaves."""
    rest = top.residual
    total = float(np.sum(rest**2))
    noise = float(np.isfinite(bench.problem.measured).sum())
    best = 0.0
    for item in scores:
        if item.site.part == top.site.part:
            continue
        b = float(np.sum(item.projected**2))
        if b > 0.0:
            best = max(best, float(np.sum(item.projected * rest)) ** 2 / b)
    return best >= bench.thresholds.second * max(total - noise, 0.0)


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
                position_error_m=r.position_error_m,
                places_m=None if r.places_m is None else list(r.places_m),
                strength=r.strength,
                unit=strength_unit(r.rig, effect, r.site.place),
                std_error=r.std_error,
                explained_fraction=r.score_explained,
                refit_fraction=r.explained,
                held_out_gain=r.held_out,
                significance=r.t,
                indistinguishable_from=found.alike(k),
                next_experiment=effect.next_experiment,
                tested=True,
                parameters=dict(r.rig.effects[-1].parameters),
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
                unit=strength_unit(found.bench.rig, effect, s.site.place),
                std_error=abs(s.strength) / s.t if s.t > 0.0 else None,
                explained_fraction=s.explained,
                significance=s.t,
                next_experiment=effect.next_experiment,
                tested=False,
            )
        )
    problem = found.problem
    rmse_pa, of_encoders = apart(found.rmse, found.bench.rig.encoders)
    return DiagnoseResult(
        **heading(problem, found.bench.rig, name, findings),
        verdict=found.verdict,
        sentence=found.sentence,
        statements=found.statements,
        unchanged=found.unchanged,
        times_noise=found.standing.times_noise,
        rmse_pa=dict(rmse_pa),
        rmse=dict(of_encoders),
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
