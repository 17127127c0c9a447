# SPDX-License-Identifier: Apache-2.0
"""The whole loop: name what is missing, add it, refit, until nothing more is worth adding."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pneu_sim.effects import find_effect
from pneu_sim.effects.base import POSITION
from pneu_sim.errors import InputError
from pneu_sim.rig import save_rig, with_parameters
from pneu_sim.rig.schema import AttachedEffect, Rig
from pneu_sysid.candidates import all_sites, best_per_place, residual_matrix, score
from pneu_sysid.compare import findings_of
from pneu_sysid.diagnose import (
    EQUALLY_GOOD,
    FINALISTS,
    REFIT_CELLS,
    WORTH,
    Diagnosis,
    diagnose,
    diagnose_apart,
)
from pneu_sysid.fit import fit_rig, tap_rmse
from pneu_sysid.gauss_newton import Estimate, Variable, huber_cost, minimise
from pneu_sysid.parameters import default_parameters
from pneu_sysid.problem import Problem, make_problem
from pneu_sysid.records import Recording
from pneu_sysid.results import LearnResult, Step, Verdict, pneu_version, write_json
from pneu_sysid.stages import residual_function
from pneu_sysid.standing import floor_of

Floats = NDArray[np.float64]
Progress = Callable[[str, float], None]

MOST_EFFECTS = 4
MATES = 3
"""Look-alikes of an added effect that are tried again in its place after the next addition."""
UNEXPLAINED = 0.35
"""Part of the excess that must remain for the catalogue to be called insufficient."""
CREDIBLE_UNKNOWN = 0.5
"""What a candidate must explain of the held-out error while more than the catalogue is missing."""
AT_FLOOR = 1.1
"""A squared error within this multiple of the floor needs no further diagnosis."""


@dataclass
class Learned:
    """Outcome of the loop.

    Attributes:
        rig: The rig with all effects that were worth adding.
        steps: What was added, and the error after it.
        diagnoses: The diagnosis before each addition, and the last one.
        verdict: As `diagnose.Diagnosis`, over the whole loop.
        sentence: In words.
        rigs: Rig after each step, the base first.
    """

    rig: Rig
    steps: list[Step]
    diagnoses: list[Diagnosis]
    verdict: Verdict
    sentence: str
    rigs: list[Rig] = field(default_factory=list)


def effect_variables(rig: Rig, index: int) -> list[Variable]:
    """Strength and position of an attached effect as variables named by their paths.

    Args:
        rig: The rig.
        index: Which of ``rig.effects``.
    """
    attached = rig.effects[index]
    effect = find_effect(attached.effect)
    bare = rig.model_copy(update={"effects": rig.effects[:index]})
    out = []
    for p in (effect.strength, *(q for q in effect.parameters[1:] if q.name == POSITION)):
        low, high = effect.limits(p, bare, attached.place)
        step = p.step if p.name != POSITION else min(0.05, 0.05 * (high - low))
        value = float(np.clip(attached.parameters.get(p.name, p.absent), low, high))
        out.append(Variable(f"effects.{index}.parameters.{p.name}", value, low, high, step))
    return out


def refit_effects(
    problem: Problem, rig: Rig, indices: list[int], iterations: int = 4
) -> tuple[Rig, Estimate]:
    """Fits strengths and positions of attached effects together.

    Args:
        problem: The problem; what it holds out is not used.
        rig: Rig with the effects attached.
        indices: Which of them to fit.
        iterations: Gauss-Newton iterations.

    Returns:
        The fitted rig and the estimate, whose variables are those of `effect_variables` in order.
    """
    variables = [v for i in indices for v in effect_variables(rig, i)]
    # A parameter left at its default is not in the file yet.
    rig = rig.model_copy(deep=True)
    for v in variables:
        _, i, _, name = v.name.split(".")
        rig.effects[int(i)].parameters.setdefault(name, v.value)

    def rig_of(x: Floats) -> Rig:
        return with_parameters(
            rig, {v.name: float(value) for v, value in zip(variables, x, strict=True)}
        )

    rough = problem
    if rig.model == "pde":
        rough = problem.coarsened(rig, REFIT_CELLS)
    estimate = minimise(
        residual_function(rough, ~problem.held_out, rig_of),
        variables,
        iterations=iterations,
        tolerance=2e-3,
        # whatever else is wrong in the recording must not bend the estimate
        robust=True,
    )
    return rig_of(estimate.values), estimate


def _errors(
    problem: Problem, rig: Rig, readings: Floats | None = None
) -> tuple[Floats, dict[str, float], dict[str, float]]:
    """Residual, and error per tap on the used and on the held-out part."""
    y = problem.predict([rig])[0] if readings is None else readings
    used = ~problem.held_out
    return residual_matrix(problem, y), tap_rmse(problem, y, used), tap_rmse(problem, y, ~used)


def _rms(problem: Problem, residual: Floats, chosen: NDArray[np.bool_]) -> float:
    """Root mean square residual over the readings of chosen stretches."""
    count = int(np.isfinite(problem.measured[chosen]).sum())
    return float(np.sqrt(np.sum(residual[chosen] ** 2) / count)) if count else float("nan")


def add_effect(
    rig: Rig,
    recording: Recording | Sequence[Recording],
    name: str,
    place: str | None = None,
    position_m: float | None = None,
    workers: int | None = None,
) -> tuple[Rig, Step, Step]:
    """Adds one effect to a rig and refits it.

    Args:
        rig: The rig.
        recording: The recording.
        name: Name of the effect.
        place: Where; None takes the place that explains most.
        position_m: Position along a pipe; None takes the best.
        workers: Threads of a batch.

    Returns:
        The better rig, and the errors before and after as steps.

    Raises:
        InputError: The effect or the place is unknown.
    """
    effect = find_effect(name)
    places = effect.places(rig)
    if place is not None and place not in places:
        raise InputError(
            f"effect {name!r}: place {place!r} is not one of {', '.join(places) or 'none here'}"
        )
    problem = make_problem(rig, recording, workers=workers)
    before, rmse, held = _errors(problem, rig)
    first = _step(0, problem, before, rmse, held)
    sites = [
        s for s in all_sites(rig) if s.effect.name == name and (place is None or s.place == place)
    ]
    if position_m is not None:
        sites = [
            type(s)(s.effect, s.place, {**s.shape, POSITION: position_m})
            for s in sites[:1]
            if POSITION in s.shape
        ] or sites
    if not sites:
        raise InputError(f"effect {name!r}: this rig has no place for it")
    _, scores = score(problem, rig, sites)
    best = best_per_place(scores)[0]
    strength = effect.strength
    low, high = effect.limits(strength, rig, best.site.place)
    start = best.strength
    if abs(start - strength.absent) < 0.25 * strength.typical:
        start = strength.absent + 0.25 * strength.typical
    better, estimate = refit_effects(
        problem, best.site.attached(rig, float(np.clip(start, low, high))), [len(rig.effects)]
    )
    after, rmse, held = _errors(problem, better)
    second = _step(1, problem, after, rmse, held, better.effects[-1], estimate.std_errors[0])
    return better, first, second


def _step(
    number: int,
    problem: Problem,
    residual: Floats,
    rmse: dict[str, float],
    held: dict[str, float],
    added: AttachedEffect | None = None,
    std_error: float | None = None,
) -> Step:
    effect = find_effect(added.effect) if added is not None else None
    place = None if added is None else _label(added).split("@", 1)[1]
    strength = None
    if added is not None and effect is not None:
        strength = added.parameters.get(effect.strength.name)
    used, kept = ~problem.held_out, problem.held_out
    return Step(
        step=number,
        added=added.effect if added is not None else None,
        place=place,
        strength=strength,
        unit=effect.strength.unit if effect is not None else None,
        std_error=std_error,
        rmse_pa=dict(rmse),
        held_out_rmse_pa=dict(held),
        total_times_noise=_rms(problem, residual, used),
        held_out_times_noise=_rms(problem, residual, kept),
    )


def learn(
    rig: Rig,
    recording: Recording | Sequence[Recording],
    out: Path | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Learned:
    """Adds effect after effect until nothing more is worth adding by held-out error.

    Args:
        rig: The rig; one that was never calibrated is fitted to the recording first.
        recording: The recording, or several. Where only some of them differ from the calibration,
            what is added is in those alone.
        out: Folder that receives ``step_<n>.yaml`` and ``learn.json`` after every step, so that an
            interrupted run leaves its last complete step.
        workers: Threads of a batch.
        progress: Called with a stage's name and the fraction done.

    Returns:
        What was learned.
    """
    tell = progress or (lambda stage, done: None)
    # no more than a datasheet leaves open: delays and limits may be what is missing
    listed = rig.fit.parameters or default_parameters(rig)
    if rig.calibration is None and listed:
        tell("fit", 0.0)
        rig = fit_rig(rig, recording, listed, hold_out=True, workers=workers).rig
        tell("fit", 1.0)
    recordings = [recording] if isinstance(recording, Recording) else list(recording)
    first = diagnose_apart(rig, recordings, FINALISTS, True, workers, progress)
    problem = first.problem
    differ = problem.recordings
    residual, rmse, held = _errors(problem, rig, first.readings)
    steps = [_step(0, problem, residual, rmse, held)]
    state = Learned(rig, steps, [first], "nothing_missing", "", [rig])
    given = len(rig.effects)
    mates: list[list[AttachedEffect]] = []
    _save(state, problem, out)
    while True:
        count = len(state.rig.effects) - given
        if count and _at_floor(problem, state.rig, residual):
            break
        found = first
        if count:
            found = diagnose(
                state.rig, differ, FINALISTS // 2, refine=False, workers=workers, progress=progress
            )
            state.diagnoses.append(found)
        if count >= MOST_EFFECTS or not _worth_adding(found):
            break
        tell("refit", 0.0)
        better, estimate = refit_effects(
            problem, found.finalists[0].rig, list(range(given, given + count + 1)), iterations=3
        )
        after, rmse, held = _errors(problem, better)
        tell("refit", 1.0)
        if _held_out_gain(problem, residual, after) < WORTH:
            break
        labels = set(found.alike(0))
        alike = [r for r in found.finalists[1:] if r.site.label in labels][:MATES]
        mates.append([r.rig.effects[-1] for r in alike])
        if count:
            better, estimate, after, mates = _reconsider(
                problem, better, estimate, after, given, mates
            )
            after, rmse, held = _errors(problem, better)
            state.steps[1:] = _steps_anew(problem, better, given, state.steps[1:])
        added = better.effects[-1]
        strength = f"effects.{len(better.effects) - 1}.parameters."
        strength += find_effect(added.effect).strength.name
        errors = dict(zip(_names(better, given, count), estimate.std_errors, strict=True))
        state.steps.append(
            _step(count + 1, problem, after, rmse, held, added, float(errors[strength]))
        )
        state.rig, residual = better, after
        state.rigs.append(better)
        _conclude(state, given, [_label(e) for options in mates for e in options])
        _save(state, problem, out)
    _conclude(state, given, [_label(e) for options in mates for e in options])
    if first.unchanged and state.steps[1:]:
        state.sentence = f"In {', '.join(r.name for r in differ)} alone: {state.sentence}"
        state.rig = _without_effects(state.rig, given, first.unchanged)
        state.rigs[-1] = state.rig
    _save(state, problem, out)
    return state


def _without_effects(rig: Rig, given: int, recordings: list[str]) -> Rig:
    """The rig with its later effects absent in some recordings."""
    own = {name: dict(values) for name, values in rig.recordings.items()}
    rig = rig.model_copy(deep=True)
    for k, attached in enumerate(rig.effects[given:], start=given):
        strength = find_effect(attached.effect).strength
        attached.parameters.setdefault(strength.name, strength.absent)
        for name in recordings:
            own.setdefault(name, {})[f"effects.{k}.parameters.{strength.name}"] = strength.absent
    return rig.model_copy(update={"recordings": own})


def _worth_adding(found: Diagnosis) -> bool:
    """Whether the best candidate of a diagnosis explains enough of what was held out."""
    credible = [r for r in found.finalists if r.held_out >= WORTH]
    if found.verdict == "nothing_missing" or not credible:
        return False
    return found.verdict != "unknown" or credible[0].held_out >= CREDIBLE_UNKNOWN


def _held_out_gain(problem: Problem, before: Floats, after: Floats) -> float:
    """Part of the held-out squared error that an addition takes away."""
    held = problem.held_out
    return 1.0 - float(np.sum(after[held] ** 2)) / float(np.sum(before[held] ** 2))


def _steps_anew(problem: Problem, rig: Rig, given: int, steps: list[Step]) -> list[Step]:
    """Steps as they would have been with the effects that stand in their places now.

    From the first that is another than its step says, on, each is fitted without the later ones.
    """
    out: list[Step] = []
    swapped = False
    for k, step in enumerate(steps):
        now = rig.effects[given + k]
        stood = (step.added, str(step.place).split(":", 1)[0])
        swapped = swapped or (now.effect, now.place) != stood
        if not swapped:
            out.append(step)
            continue
        so_far = rig.model_copy(update={"effects": rig.effects[: given + k + 1]})
        fitted, estimate = refit_effects(problem, so_far, list(range(given, given + k + 1)))
        after, rmse, held = _errors(problem, fitted)
        # strength leads among the variables of an effect
        last = -len(effect_variables(fitted, given + k))
        added = fitted.effects[-1]
        out.append(
            _step(step.step, problem, after, rmse, held, added, float(estimate.std_errors[last]))
        )
    return out


def _label(effect: AttachedEffect) -> str:
    place = effect.place
    if POSITION in effect.parameters:
        place += f":{effect.parameters[POSITION]:.2f}"
    return f"{effect.effect}@{place}"


def _reconsider(
    problem: Problem,
    rig: Rig,
    estimate: Estimate,
    residual: Floats,
    given: int,
    mates: list[list[AttachedEffect]],
) -> tuple[Rig, Estimate, Floats, list[list[AttachedEffect]]]:
    """Tries the look-alikes of earlier additions again, now that another effect is in the model.

    What could not be told apart while something else was missing often can be afterwards.
    """
    indices = list(range(given, len(rig.effects)))
    kept = [list(options) for options in mates]
    for k, options in enumerate(mates[:-1]):
        still: list[AttachedEffect] = []
        for option in options:
            effects = list(rig.effects)
            replaced, effects[given + k] = effects[given + k], option
            other, found = refit_effects(
                problem, rig.model_copy(update={"effects": effects}), indices, iterations=3
            )
            r = residual_matrix(problem, problem.predict([other])[0])
            new, old = huber_cost(r), huber_cost(residual)
            if new < old:
                if old <= EQUALLY_GOOD * new:
                    still.append(replaced)
                else:
                    still = []
                rig, estimate, residual = other, found, r
            elif new <= EQUALLY_GOOD * old:
                still.append(option)
        kept[k] = still
    return rig, estimate, residual, kept


def _at_floor(problem: Problem, rig: Rig, residual: Floats) -> bool:
    """Whether the held-out error is what noise and calibration leave anyway."""
    held = problem.held_out
    count = np.isfinite(problem.measured[held]).sum(axis=(0, 1))
    floor = floor_of(rig, problem)
    return float(np.sum(residual[held] ** 2)) <= AT_FLOOR * float(np.sum(count * floor**2))


def _names(rig: Rig, given: int, count: int) -> list[str]:
    return [v.name for i in range(given, given + count + 1) for v in effect_variables(rig, i)]


def _conclude(state: Learned, given: int, ambiguous: list[str]) -> None:
    last = state.diagnoses[-1] if state.diagnoses else None
    added = state.rig.effects[given:]
    if not added:
        state.verdict = last.verdict if last is not None else "nothing_missing"
        state.sentence = last.sentence if last is not None else ""
        return
    parts = []
    for step in state.steps[1:]:
        effect = find_effect(str(step.added))
        parts.append(f"{effect.title} at {step.place} ({step.strength:.3g} {step.unit})")
    before, after = state.steps[0], state.steps[-1]
    state.verdict = "ambiguous" if ambiguous else "effect"
    state.sentence = (
        f"Missing: {' and '.join(parts)}; with that the held-out error falls from"
        f" {before.held_out_times_noise:.2f} to {after.held_out_times_noise:.2f} times the noise"
    )
    if ambiguous:
        state.sentence += f"; not to be told from {', '.join(sorted(set(ambiguous)))}"
    start = state.diagnoses[0].excess - 1.0 if state.diagnoses else 0.0
    if (
        last is not None
        and last.verdict == "unknown"
        and last.excess - 1.0 > max(1.0, UNEXPLAINED * start)
    ):
        state.verdict = "unknown"
        state.sentence += "; more is missing that the catalogue does not hold"
    state.sentence += "."


def result_of_learning(
    name: str, learned: Learned, problem: Problem, findings: list[str], output: str | None
) -> LearnResult:
    """The JSON result of the loop.

    Args:
        name: Name of the rig.
        learned: The outcome.
        problem: The problem.
        findings: What was found while reading the recording.
        output: Folder of the results.
    """
    return LearnResult(
        pneu_version=pneu_version(),
        recording=problem.name,
        recordings=[r.name for r in problem.recordings],
        rigs=[name],
        taps=problem.taps,
        noise_floor_pa=dict(zip(problem.taps, problem.noise_pa.tolist(), strict=True)),
        findings=findings,
        steps=learned.steps,
        verdict=learned.verdict,
        sentence=learned.sentence,
        output=output,
    )


def _save(state: Learned, problem: Problem, out: Path | None) -> None:
    """Writes the last complete step."""
    if out is None:
        return
    number = len(state.steps) - 1
    save_rig(state.rig, out / f"step_{number}.yaml")
    findings = findings_of(problem)
    result = result_of_learning(state.rig.name, state, problem, findings, str(out))
    write_json(out / "learn.json", result)
