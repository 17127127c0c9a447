# SPDX-License-Identifier: Apache-2.0
"""The whole loop: name what is missing, add it, refit, until nothing more is worth adding."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sim.effects import find_effect
from pneu_sim.effects.base import FREQUENCY, POSITION
from pneu_sim.models import kind_of
from pneu_sim.rig import save_rig
from pneu_sim.rig.schema import AttachedEffect, Rig
from pneu_sysid.along import positions
from pneu_sysid.bench import Bench
from pneu_sysid.candidates import best_per_place, residual_matrix, scores_of, sensitivities
from pneu_sysid.compare import findings_of
from pneu_sysid.diagnose import Diagnosis, diagnose_apart, look
from pneu_sysid.evidence import lead
from pneu_sysid.fit import fit_rig, sensor_rmse, sensor_times_noise
from pneu_sysid.gauss_newton import Estimate
from pneu_sysid.heading import heading
from pneu_sysid.parameter_units import strength_unit
from pneu_sysid.parameters import default_parameters
from pneu_sysid.problem import Problem, make_problem
from pneu_sysid.records import Recording
from pneu_sysid.refits import effect_variables, refit_effects
from pneu_sysid.results.base import Verdict
from pneu_sysid.results.files import write_json
from pneu_sysid.results.learn import Experiment, LearnResult, Step
from pneu_sysid.sensor_units import apart
from pneu_sysid.sites import all_sites
from pneu_sysid.spectrum import lines_of
from pneu_sysid.thresholds import Thresholds
from pneu_sysid.words import strength_in_words

Floats = NDArray[np.float64]
Progress = Callable[[str, float], None]

SOMEWHERE_M = 10.0
"""A place that is known no better is not told with its error."""
ADDED_ITERATIONS = 4
ADDED_ENOUGH = 5e-3
"""Effects that were added are fitted for so many iterations at most, as long as the error falls by
such a share."""
MATES = 3
"""Look-alikes of an added effect that are tried again in its place after the next addition."""


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
        alike: What this recording cannot tell from what was added.
    """

    rig: Rig
    steps: list[Step]
    diagnoses: list[Diagnosis]
    verdict: Verdict
    sentence: str
    rigs: list[Rig] = field(default_factory=list)
    alike: list[str] = field(default_factory=list)


def _errors(
    problem: Problem, rig: Rig, readings: Floats | None = None
) -> tuple[Floats, dict[str, float], dict[str, float]]:
    """Residual, and error per sensor on the used and on the held-out part."""
    y = problem.predict([rig])[0] if readings is None else readings
    used = ~problem.held_out
    return (
        residual_matrix(problem, y),
        sensor_rmse(problem, y, used),
        sensor_rmse(problem, y, ~used),
    )


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
    places = effect.available_places(rig)
    if not places:
        raise InputError(
            f"effect {name!r}: rig {rig.name!r} has no place for it in its model {rig.model!r}"
        )
    if place is not None and place not in places:
        raise InputError(f"effect {name!r}: place {place!r} is not one of {', '.join(places)}")
    problem = make_problem(rig, recording, workers=workers)
    before, rmse, held = _errors(problem, rig)
    first = _step(0, problem, rig, before, rmse, held)
    # A pulsation begins at the strongest line of the residual.
    default = [p.typical for p in effect.parameters if p.name == FREQUENCY]
    pulses_hz = [line.frequency_hz for line in lines_of(problem, before)] if default else []
    sites = [
        s
        for s in all_sites(rig, pulses_hz=next(iter(pulses_hz + default), None))
        if s.effect.name == name and (place is None or s.place == place)
    ]
    if position_m is not None:
        sites = [
            type(s)(s.effect, s.place, {**s.shape, POSITION: position_m})
            for s in sites[:1]
            if POSITION in s.shape
        ] or sites
    known = sensitivities(problem, rig, sites, Thresholds())
    best = best_per_place(scores_of(before, known))[0]
    strength = effect.strength
    low, high = effect.limits(strength, rig, best.site.place)
    start = best.strength
    if abs(start - strength.absent) < 0.25 * strength.typical:
        start = strength.absent + 0.25 * strength.typical
    better, estimate = refit_effects(
        problem, best.site.attached(rig, float(np.clip(start, low, high))), [len(rig.effects)]
    )
    after, rmse, held = _errors(problem, better)
    second = _step(1, problem, better, after, rmse, held, better.effects[-1], estimate.std_errors)
    return better, first, second


def refit_added(
    problem: Problem,
    rig: Rig,
    added: int,
    told: Callable[[float, dict[str, float]], object],
) -> Rig:
    """Fits the effects that were added last together.

    Args:
        problem: The problem.
        rig: Rig with the effects; they begin as strong as it has them.
        added: How many of its effects, from the last.
        told: Called with the fraction done and the error of each sensor over its noise, on the
            part that is used: first without the last effect, then with it, then as it falls.

    Returns:
        The fitted rig.
    """
    used = ~problem.held_out

    def error(of: Rig, done: float) -> float:
        times = sensor_times_noise(problem, problem.predict([of])[0], used)
        told(done, times)
        return float(np.sqrt(np.mean(np.square(list(times.values())))))

    error(rig.model_copy(update={"effects": rig.effects[:-1]}), 0.0)
    before = error(rig, 0.0)
    indices = list(range(len(rig.effects) - added, len(rig.effects)))
    for k in range(ADDED_ITERATIONS):
        better, _ = refit_effects(problem, rig, indices, 1)
        after = error(better, (k + 1) / ADDED_ITERATIONS)
        if not after < before:
            break
        rig, gone, before = better, 1.0 - after / before, after
        if gone < ADDED_ENOUGH:
            break
    return rig


def _step(
    number: int,
    problem: Problem,
    rig: Rig,
    residual: Floats,
    rmse: dict[str, float],
    held: dict[str, float],
    added: AttachedEffect | None = None,
    std_errors: Floats | None = None,
    untold_m: float = 0.0,
) -> Step:
    effect = find_effect(added.effect) if added is not None else None
    place = None if added is None else _label(added).split("@", 1)[1]
    strength = None
    if added is not None and effect is not None:
        strength = added.parameters.get(effect.strength.name)
    used, kept = ~problem.held_out, problem.held_out
    rmse_pa, of_encoders = apart(rmse, rig.encoders)
    held_pa, held_encoders = apart(held, rig.encoders)
    return Step(
        step=number,
        added=added.effect if added is not None else None,
        place=place,
        strength=strength,
        unit=None if effect is None or added is None else strength_unit(rig, effect, added.place),
        std_error=None if std_errors is None else float(std_errors[0]),
        position_error_m=_position_error(rig, added, std_errors, untold_m),
        rmse_pa=dict(rmse_pa),
        held_out_rmse_pa=dict(held_pa),
        rmse=dict(of_encoders),
        held_out_rmse=dict(held_encoders),
        total_times_noise=_rms(problem, residual, used),
        held_out_times_noise=_rms(problem, residual, kept),
    )


def _position_error(
    rig: Rig, added: AttachedEffect | None, std_errors: Floats | None, untold_m: float
) -> float | None:
    """Standard error of an effect's position; the strength's leads, then what else is fitted.

    No less than the distance over which positions are not told apart.
    """
    if added is None or std_errors is None:
        return None
    names = [p.name for p in find_effect(added.effect).fitted(rig, added.place)]
    if POSITION not in names:
        return None
    return max(untold_m, float(std_errors[1 + names.index(POSITION)]))


def learn(
    rig: Rig,
    recording: Recording | Sequence[Recording],
    out: Path | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
    thresholds: Thresholds | None = None,
    without: Collection[str] = (),
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
        thresholds: What decides.
        without: Names of effects that are not tried.

    Returns:
        What was learned.
    """
    tell = progress or (lambda stage, done: None)
    limits = thresholds or Thresholds()
    # no more than a datasheet leaves open: delays and limits may be what is missing
    listed = rig.fit.parameters or default_parameters(rig)
    if rig.calibration is None and listed:
        tell("fit", 0.0)
        rig = fit_rig(rig, recording, listed, hold_out=True, workers=workers).rig
        tell("fit", 1.0)
    recordings = [recording] if isinstance(recording, Recording) else list(recording)
    first = diagnose_apart(rig, recordings, None, True, workers, progress, limits, without)
    bench = first.bench
    problem, differ = bench.problem, bench.problem.recordings
    model = _Model(rig, bench.readings, bench.residual(bench.readings))
    state = Learned(rig, [_step_of(0, bench, model)], [first], "nothing_missing", "", [rig])
    given = len(rig.effects)
    start = bench.held_sum(model.residual)
    mates: list[list[AttachedEffect]] = []
    _save(state, problem, out)
    found = first
    while True:
        count = len(model.rig.effects) - given
        if count:
            if bench.held_sum(model.residual) <= limits.settled * bench.floor:
                break
            taken = start - bench.held_sum(model.residual)
            found = look(bench, model.rig, model.readings, tell, taken)
            state.diagnoses.append(found)
        if count >= limits.most_effects or not _worth_adding(found, bench):
            break
        tell("refit", 0.0)
        better, estimate = _together(bench, found.finalists[0].rig, given, 3)
        tell("refit", 1.0)
        gone = 1.0 - bench.held_sum(better.residual) / bench.held_sum(model.residual)
        if gone < limits.worth:
            break
        labels = set(found.alike(0))
        alike = [r for r in found.finalists[1:] if r.site.label in labels][:MATES]
        mates.append([r.rig.effects[-1] for r in alike])
        if count:
            better, estimate, mates = _reconsider(bench, better, estimate, given, mates)
            better, estimate, mates = _needed(bench, better, estimate, given, mates)
        better, estimate = _placed(bench, better, estimate, given)
        model = better
        state.steps = _steps(bench, state.steps, model, estimate, given)
        state.rig = model.rig
        state.rigs = [*state.rigs[: len(state.steps) - 1], model.rig]
        left = bench.held_sum(model.residual)
        _conclude(state, bench, given, start, left, [_label(e) for o in mates for e in o])
        _save(state, problem, out)
        if len(model.rig.effects) - given <= count:
            break  # what was added last made another superfluous: no more is to be had
    left = bench.held_sum(model.residual)
    _conclude(state, bench, given, start, left, [_label(e) for o in mates for e in o])
    if first.unchanged and state.steps[1:]:
        state.sentence = f"In {', '.join(r.name for r in differ)} alone: {state.sentence}"
        state.rig = _without_effects(state.rig, given, first.unchanged)
        state.rigs[-1] = state.rig
    _save(state, problem, out)
    return state


@dataclass
class _Model:
    """A rig, what it predicts, and what that leaves without what is uncertain anyway.

    Where its last effect sits on a pipe, also how far from there it may be just as well.
    """

    rig: Rig
    readings: Floats
    residual: Floats
    untold_m: float = 0.0


def _together(bench: Bench, rig: Rig, given: int, iterations: int = 4) -> tuple[_Model, Estimate]:
    """Fits all effects that were added, together."""
    indices = list(range(given, len(rig.effects)))
    fitted, estimate = refit_effects(bench.coarser(rig), rig, indices, iterations, bench.project)
    readings = bench.problem.predict([fitted])[0]
    return _Model(fitted, readings, bench.residual(readings)), estimate


def _placed(bench: Bench, model: _Model, estimate: Estimate, given: int) -> tuple[_Model, Estimate]:
    """Fits what was added last once more, on cells that are true to it, wherever on its pipe."""
    problem, wrong = bench.faithful(model.rig, model.readings)
    last = len(model.rig.effects) - 1
    indices = list(range(given, last + 1))

    def refitted(rig: Rig) -> tuple[_Model, Estimate]:
        fitted, found = refit_effects(problem, rig, indices, 3, bench.project)
        readings = bench.problem.predict([fitted])[0]
        return _Model(fitted, readings, bench.residual(readings)), found

    if problem is bench.problem and kind_of(model.rig).along_lines:
        model, estimate = refitted(model.rig)
    along = positions(problem, model.rig, last, bench.blocks, bench.project, wrong)
    if along.better is not None:
        other, found = refitted(along.better)
        if bench.held_sum(other.residual) < bench.held_sum(model.residual):
            model, estimate = other, found
            along = positions(problem, model.rig, last, bench.blocks, bench.project, wrong)
    model.untold_m = along.untold_m
    return model, estimate


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


def _worth_adding(found: Diagnosis, bench: Bench) -> bool:
    """Whether the best candidate of a diagnosis is to be added.

    While more is missing than the catalogue explains, only one that explains most of it.
    """
    if found.verdict == "nothing_missing" or not found.believed:
        return False
    if found.verdict != "unknown":
        return True
    return found.finalists[0].held_out >= bench.thresholds.nearest


def _steps(
    bench: Bench, before: list[Step], model: _Model, estimate: Estimate, given: int
) -> list[Step]:
    """The way from the base to a model, effect by effect.

    Steps that still hold are kept; from the first that is another than it was, each is fitted
    without the later ones.
    """
    rig = model.rig
    out = [before[0]]
    count = len(rig.effects) - given
    swapped = False
    for k in range(count - 1):
        now = rig.effects[given + k]
        if k + 1 < len(before) and not swapped:
            stood = (before[k + 1].added, str(before[k + 1].place).split(":", 1)[0])
            if (now.effect, now.place) == stood:
                out.append(before[k + 1])
                continue
        swapped = True
        so_far = rig.model_copy(update={"effects": rig.effects[: given + k + 1]})
        fitted, found = _placed(bench, *_together(bench, so_far, given), given)
        out.append(_step_of(len(out), bench, fitted, found))
    out.append(_step_of(len(out), bench, model, estimate))
    return out


def _step_of(number: int, bench: Bench, model: _Model, estimate: Estimate | None = None) -> Step:
    """A step to a model; its last effect is the one that was added."""
    problem = bench.problem
    residual, rmse, held = _errors(problem, model.rig, model.readings)
    if estimate is None:
        return _step(number, problem, model.rig, residual, rmse, held)
    index = len(model.rig.effects) - 1
    errors = estimate.std_errors[-len(effect_variables(model.rig, index)) :]
    added = model.rig.effects[index]
    return _step(number, problem, model.rig, residual, rmse, held, added, errors, model.untold_m)


def _label(effect: AttachedEffect) -> str:
    place = effect.place
    if POSITION in effect.parameters:
        place += f":{effect.parameters[POSITION]:.2f}"
    return f"{effect.effect}@{place}"


def _reconsider(
    bench: Bench,
    model: _Model,
    estimate: Estimate,
    given: int,
    mates: list[list[AttachedEffect]],
) -> tuple[_Model, Estimate, list[list[AttachedEffect]]]:
    """Tries the look-alikes of earlier additions again, now that another effect is in the model.

    What could not be told apart while something else was missing often can be afterwards.
    """
    kept = [list(options) for options in mates]
    for k, options in enumerate(mates[:-1]):
        still: list[AttachedEffect] = []
        for option in options:
            effects = list(model.rig.effects)
            effects[given + k] = option
            other, found = _together(
                bench, model.rig.model_copy(update={"effects": effects}), given, 3
            )
            ahead = lead(other.residual, model.residual, bench.blocks)
            tied = abs(ahead) < bench.thresholds.tied
            if tied:  # what stands stays: rounding would choose between them
                still.append(option)
            elif ahead > 0.0:
                still = []
                model, estimate = other, found
        kept[k] = still
    return model, estimate, kept


def _needed(
    bench: Bench,
    model: _Model,
    estimate: Estimate,
    given: int,
    mates: list[list[AttachedEffect]],
) -> tuple[_Model, Estimate, list[list[AttachedEffect]]]:
    """Drops effects that the later ones have made superfluous."""
    limits = bench.thresholds
    k = 0
    while k < len(model.rig.effects) - given - 1:
        effects = [e for i, e in enumerate(model.rig.effects) if i != given + k]
        other, found = _together(bench, model.rig.model_copy(update={"effects": effects}), given)
        held, alone = bench.held_sum(model.residual), bench.held_sum(other.residual)
        if (
            alone - held < limits.worth * alone
            or lead(model.residual, other.residual, bench.blocks) < limits.significant
        ):
            model, estimate = other, found
            mates = [options for i, options in enumerate(mates) if i != k]
        else:
            k += 1
    return model, estimate, mates


def _conclude(
    state: Learned, bench: Bench, given: int, start: float, left: float, alike: list[str]
) -> None:
    """Verdict and sentence over all that was added, which left so much of what there was."""
    last = state.diagnoses[-1]
    if not state.rig.effects[given:]:
        state.verdict, state.sentence = last.verdict, last.sentence
        return
    parts = []
    for step in state.steps[1:]:
        effect = find_effect(str(step.added))
        strength = strength_in_words(
            step.strength or 0.0, step.std_error or float("nan"), step.unit or ""
        )
        place = str(step.place)
        if step.position_error_m is not None and step.position_error_m < SOMEWHERE_M:
            place += f" ± {step.position_error_m:.2f} m"
        parts.append(f"{effect.title} at {place}, {strength}")
    before, after = state.steps[0], state.steps[-1]
    state.verdict = "ambiguous" if alike else "effect"
    state.alike = alike
    # A single stretch leaves nothing to hold out.
    held = before.held_out_times_noise, after.held_out_times_noise
    whole = before.total_times_noise, after.total_times_noise
    of, (first, now) = ("error", whole) if None in held else ("held-out error", held)
    state.sentence = (
        f"Missing: {' and '.join(parts)}; with that the {of} falls from"
        f" {first:.2f} to {now:.2f} times the noise"
    )
    if alike:
        state.sentence += f"; not to be told from {', '.join(sorted(set(alike)))}"
    if left > bench.allowed(start):
        state.verdict = "unknown"
        state.sentence += "; more is missing that the catalogue does not hold"
    state.sentence += "."


def result_of_learning(
    name: str,
    learned: Learned,
    problem: Problem,
    findings: list[str],
    output: str | None,
    experiments: Sequence[Experiment] = (),
) -> LearnResult:
    """The JSON result of the loop.

    Args:
        name: Name of the rig.
        learned: The outcome.
        problem: The problem.
        findings: What was found while reading the recording.
        output: Folder of the results.
        experiments: Those that were designed for it.
    """
    return LearnResult(
        **heading(problem, learned.rig, name, findings),
        steps=learned.steps,
        verdict=learned.verdict,
        sentence=learned.sentence,
        output=output,
        experiments=list(experiments),
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
