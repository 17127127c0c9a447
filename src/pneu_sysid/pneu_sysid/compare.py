# SPDX-License-Identifier: Apache-2.0
"""Comparing models with a recording: how large the error is at each sensor, and where it arises.

Errors are measured minus model, the sign of what the rig has and the model lacks; those of encoders
are in rad or m, beside those of taps in Pa.
"""

import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Group, RenderableType

from pneu_common.errors import InputError
from pneu_common.installed import version
from pneu_common.tables import Column, NamedTable
from pneu_common.tally import Tally
from pneu_sim import sensors
from pneu_sim.models import kind_of
from pneu_sim.rig import rig_in_recording
from pneu_sim.rig.build import build
from pneu_sim.rig.model import Model
from pneu_sim.rig.plan import plan_grid
from pneu_sim.rig.schema import Rig
from pneu_sim.simulate import TICK_S, Prediction
from pneu_sysid.problem import Problem, Rollouts, make_problem
from pneu_sysid.records import Recording, begins_of
from pneu_sysid.regimes import FEWEST, Operation, frequency_shares, operation
from pneu_sysid.results.compare import (
    CompareResult,
    EncoderError,
    EncoderRegime,
    EncoderStretch,
    ModelError,
    Numerics,
    Regime,
    Series,
    Stretch,
    TapError,
    regime_order,
)
from pneu_sysid.sensor_units import Unit, apart, encoder_units, shared, unit_of
from pneu_sysid.shift import Shift, estimate_shift
from pneu_sysid.thresholds import Thresholds

Floats = NDArray[np.float64]

ATM_PA = 101325.0
BLOCK_S = 0.05
"""Worst stretches are made of blocks of this length."""
STRETCHES = 5
SERIES_POINTS = 30000
"""Readings of all sensors together that are kept for plotting."""
PLACES = {"Pa": 1, "rad": 7, "m": 8}
"""Decimals of what is kept for plotting."""
GAP_PERIODS = 3.5
"""Readings further apart than this many periods have a gap between them."""


def compare(
    source: Problem | Recording | Sequence[Recording],
    rigs: Sequence[tuple[str, Rig, str | None]],
    refine: bool = True,
    progress: Callable[[float], None] | None = None,
    ran: Sequence[Rollouts] | None = None,
) -> CompareResult:
    """Runs models along recordings and takes their errors apart.

    All models are asked for the same readings, in the stretches of the first. What the rig was
    doing (flow direction, choking, opening) is the first model's word too, so that a regime is the
    same readings for all.

    Args:
        source: The recordings, or the first rig's problem on them.
        rigs: Name, rig and file of each model.
        refine: Whether to run the first model that has a grid again on cells of half the length.
        progress: Called with the fraction done.
        ran: What each model predicts along the problem that is the source, flows included, where
            that is known already; they are run unless it is.

    Returns:
        The errors.

    Raises:
        InputError: There is no rig, a rig lacks a command or all sensors of the recording, or a
            model cannot be run.
    """
    if not rigs:
        raise InputError("compare: no rig was given, at least one is needed")
    recordings = _recordings(source)
    names = _distinct(rigs)
    models = [rig for _, rig, _ in rigs]
    compared = _common_sensors(recordings, names, models)
    encoders = {n: unit for n, unit in encoder_units(models[0]).items() if n in compared}
    problems = _problems(source, models)
    first = problems[0]
    kinds = [rig.model for rig in models]
    along_lines = [k for k, rig in enumerate(models) if kind_of(rig).along_lines]
    gridded = along_lines[0] if refine and along_lines else None
    # The second run has half the cells' length and half the time step: four times the work.
    weights = [1.0] * len(models) + ([4.0] if gridded is not None else [])
    tally = Tally(weights, progress)

    def run(k: int) -> Rollouts:
        return problems[k].simulate([models[k]], progress=tally.of(k), flows=True)

    if ran is not None:
        outs = list(ran)
    else:
        with ThreadPoolExecutor(min(len(models), first.workers or os.cpu_count() or 1)) as pool:
            outs = list(pool.map(run, range(len(models))))
    readings = [
        {name: out.readings[0, :, :, problem.taps.index(name)] for name in compared}
        for out, problem in zip(outs, problems, strict=True)
    ]
    work = operation(first, models[0], outs[0])
    noise = {name: float(first.noise_pa[first.taps.index(name)]) for name in compared}
    entries = [
        _model_error(name, kind, file, noise, encoders, problem, rig, out, work)
        for name, kind, (_, rig, file), problem, out in zip(
            names, kinds, rigs, problems, outs, strict=True
        )
    ]
    if gridded is None:
        reason = "The grid was not checked." if not refine else "No model here has a grid."
        numerics = Numerics(
            dx_m=None, refined_dx_m=None, change_pa={}, discretisation=False, sentence=reason
        )
    else:
        numerics = grid_check(
            problems[gridded], models[gridded], readings[gridded], tally.of(len(models))
        )
    of_taps, of_encoders = apart(noise, encoders)
    return CompareResult(
        pneu_version=version(),
        recording=first.name,
        recordings=[r.name for r in recordings],
        rigs=names,
        taps=list(of_taps),
        encoders=encoders,
        noise_floor_pa=dict(of_taps),
        noise_floor=dict(of_encoders),
        findings=findings_of(first) + _left_out(recordings, compared, models),
        models=entries,
        numerics=numerics,
        series=_series(problems, compared, encoders, names, readings, entries),
    )


def _left_out(
    recordings: Sequence[Recording], compared: list[str], rigs: Sequence[Rig]
) -> list[str]:
    """What is recorded and not compared, a sentence each."""
    return [
        f"{name}: not every rig has this {'encoder' if name in recording.encoders else 'tap'}, so"
        " it was left out"
        for name, recording in {
            name: r for r in reversed(recordings) for name in r.readings
        }.items()
        if name not in compared and any(name in rig.taps or name in rig.encoders for rig in rigs)
    ]


def _distinct(rigs: Sequence[tuple[str, Rig, str | None]]) -> list[str]:
    """Names of the models: the rig's, else its file's, else numbered."""
    names = [name for name, _, _ in rigs]
    out: list[str] = []
    for name, _, file in rigs:
        wanted = name if names.count(name) == 1 or file is None else Path(file).stem
        number, free = 2, wanted
        while free in out:
            free, number = f"{wanted} ({number})", number + 1
        out.append(free)
    return out


def _recordings(source: Problem | Recording | Sequence[Recording]) -> list[Recording]:
    if isinstance(source, Problem):
        return source.recordings
    return [source] if isinstance(source, Recording) else list(source)


def findings_of(problem: Problem) -> list[str]:
    """What was found while reading recordings, and what is to be said of the sensors' noise.

    Args:
        problem: The problem.
    """
    several = len(problem.recordings) > 1
    out = [
        f"{recording.name}: {finding}" if several else str(finding)
        for recording in problem.recordings
        for finding in recording.report
    ]
    return out + [f"{tap}: noise: {words}" for tap, words in problem.noise_words.items()]


def _common_sensors(
    recordings: Sequence[Recording], names: list[str], rigs: Sequence[Rig]
) -> list[str]:
    """Taps, then encoders, that the recordings and every rig have."""
    for recording in recordings:
        for name, rig in zip(names, rigs, strict=True):
            for valve in rig.valves.values():
                if valve.command not in recording.commands:
                    raise InputError(
                        f"rig {name!r}: command {valve.command!r} is not in recording"
                        f" {recording.name!r} ({', '.join(recording.commands) or 'no commands'})"
                    )
    recorded = {name for r in recordings for name, signal in r.readings.items() if len(signal)}
    found = [
        name
        for name in (*rigs[0].taps, *rigs[0].encoders)
        if all((name in rig.taps) == (name in rigs[0].taps) for rig in rigs)
        and all(name in rig.taps or name in rig.encoders for rig in rigs)
        and name in recorded
    ]
    if not found:
        raise InputError(
            f"recording {recordings[0].name!r}: no tap is in it and in every rig"
            f" (recorded: {', '.join(sorted(recorded)) or 'none'};"
            f" rig {names[0]!r}: {', '.join((*rigs[0].taps, *rigs[0].encoders))})"
        )
    return found


def _problems(
    source: Problem | Recording | Sequence[Recording], rigs: Sequence[Rig]
) -> list[Problem]:
    """A problem per rig, on the stretches of the first."""
    if isinstance(source, Problem) and source.taps == [*rigs[0].taps, *rigs[0].encoders]:
        first = source
    else:
        first = make_problem(rigs[0], _recordings(source))
    out = [first]
    for rig in rigs[1:]:
        same_cut = rig.model_copy(update={"fit": rigs[0].fit})
        other = make_problem(same_cut, first.recordings, pull_s=first.pull_s, workers=first.workers)
        out.append(other)
    return out


def _rms(x: Floats) -> float:
    """Root mean square of what is finite; NaN of nothing."""
    x = x[np.isfinite(x)]
    return float(np.sqrt(np.mean(x * x))) if x.size else float("nan")


def _model_error(
    name: str,
    kind: str,
    file: str | None,
    noise: dict[str, float],
    encoders: Mapping[str, str],
    problem: Problem,
    rig: Rig,
    out: Rollouts,
    work: Operation,
) -> ModelError:
    taps: dict[str, TapError] = {}
    of_encoders: dict[str, EncoderError] = {}
    regimes: list[Regime] = []
    encoder_regimes: list[EncoderRegime] = []
    over_noise: dict[str, Floats] = {}
    for sensor, sigma in noise.items():
        t = problem.taps.index(sensor)
        error = problem.measured[:, :, t] - out.readings[0, :, :, t]
        over_noise[sensor] = error / sigma
        found = _error(error, sigma, sensor, problem, _shift(problem, rig, out, t))
        worst = _worst(error, sensor, problem, work)
        parts = _regimes(error, sigma, sensor, problem, work)
        if sensor in encoders:
            of_encoders[sensor] = EncoderError(
                **found,
                unit=encoders[sensor],  # type: ignore[arg-type]
                noise_floor=sigma,
                worst=[EncoderStretch(**w) for w in worst],
            )
            encoder_regimes += [EncoderRegime(**part, encoder=sensor) for part in parts]
        else:
            rmse = found["rmse"]
            taps[sensor] = TapError(
                **_of_tap(found),
                rmse_atm=None if rmse is None else rmse / ATM_PA,
                noise_floor_pa=sigma,
                worst=[Stretch(**_of_tap(w)) for w in worst],
            )
            regimes += [Regime(**_of_tap(part), tap=sensor) for part in parts]
    order = list(noise)
    both = [e.times_noise for e in taps.values()] + [e.times_noise for e in of_encoders.values()]
    return ModelError(
        name=name,
        model=kind,
        file=file,
        taps=taps,
        encoders=of_encoders,
        regimes=sorted(regimes, key=lambda r: (regime_order(r.model_dump()), order.index(r.tap))),
        encoder_regimes=sorted(
            encoder_regimes, key=lambda r: (regime_order(r.model_dump()), order.index(r.encoder))
        ),
        rmse_pa=_rms(np.array([t.rmse_pa for t in taps.values()], dtype=float)),
        times_noise=_rms(np.array(both, dtype=float)),
        by_recording={
            recording.name: _rms(
                np.concatenate([e[problem.of == c].ravel() for e in over_noise.values()])
            )
            for c, recording in enumerate(problem.recordings)
        },
    )


def _of_tap(figures: Mapping[str, Any]) -> dict[str, Any]:
    """Figures under the keys that they have where they are pascals."""
    return {f"{k}_pa" if k in ("rmse", "bias") else k: value for k, value in figures.items()}


def _shift(problem: Problem, rig: Rig, out: Rollouts, t: int) -> Shift | None:
    """How much later the measurement of a sensor is than the prediction, and how much larger."""
    dense = []
    for recording, along in zip(problem.recordings, out.along, strict=True):
        model = build(rig_in_recording(rig, recording.name), plan_grid(rig, problem.dx_m))
        if t < len(rig.taps):
            shown = sensors.read(model, along.taps[0], TICK_S)[:, t]
        elif along.joints.shape[1]:
            shown = _positions(model, along)[:, t - len(rig.taps)]
        else:  # of a model in which nothing moves
            return None
        dense.append((along.tick_s, shown))
    return estimate_shift(problem.measured[:, :, t], problem.time_s[:, :, t], dense, problem.of)


def _positions(model: Model, along: Prediction) -> Floats:
    """(ticks, n_encoders) what the encoders of a rig show along a recording, rad or m."""
    at = [
        along.joints[0, :, k, 0] if k >= 0 else along.cylinders[0, :, -1 - k, 0]
        for k in model.plan.encoder_of.tolist()
    ]
    # Lag, clock, gain and bias are those of a tap whose pressure is measured from nothing.
    as_taps = replace(model, sensor=model.encoder, ambient=np.zeros_like(model.ambient))
    return sensors.read(as_taps, np.stack(at, axis=-1), TICK_S)


def _error(
    error: Floats, noise: float, sensor: str, problem: Problem, shift: Shift | None
) -> dict[str, Any]:
    """The figures of one sensor, in its own unit; None where it has no reading."""
    good = np.isfinite(error)
    if not good.any():
        return dict.fromkeys(("rmse", "normalised", "times_noise", "bias", "lag_s", "gain"))
    rmse = _rms(error)
    spread = float(np.std(problem.measured[:, :, problem.taps.index(sensor)][good]))
    return {
        "rmse": rmse,
        "normalised": rmse / spread if spread > 0.0 else None,
        "times_noise": rmse / noise,
        "bias": float(np.mean(error[good])),
        "lag_s": None if shift is None else shift.lag_s,
        "gain": None if shift is None else shift.gain,
    }


def _regimes(
    error: Floats, noise: float, tap: str, problem: Problem, work: Operation
) -> list[dict[str, Any]]:
    """Error of one sensor by regime, in its own unit."""
    good = np.isfinite(error)
    square = np.where(good, error, 0.0) ** 2
    total, count = float(square.sum()), int(good.sum())
    if total == 0.0:
        return []
    out = []
    for samples in work.sets(tap):
        mask = samples.mask & good
        n = int(mask.sum())
        if n < FEWEST:
            continue
        part = float(square[mask].sum())
        rmse = float(np.sqrt(part / n))
        out.append(
            dict(
                kind=samples.kind,
                label=samples.label,
                of=samples.of,
                lower=samples.lower,
                upper=samples.upper,
                rmse=rmse,
                bias=float(np.mean(error[mask])),
                share=part / total,
                samples=n,
                times_noise=rmse / noise,
            )
        )
    time = problem.time_s[:, :, problem.taps.index(tap)]
    for band in frequency_shares(error, time):
        rmse = float(np.sqrt(band.share * total / count))
        out.append(
            dict(
                kind="frequency",
                label=band.label,
                lower=band.low_hz,
                upper=band.high_hz,
                rmse=rmse,
                bias=None,
                share=band.share,
                samples=count,
                times_noise=rmse / (noise * float(np.sqrt(band.white))),
            )
        )
    return out


def _worst(error: Floats, tap: str, problem: Problem, work: Operation) -> list[dict[str, Any]]:
    """The worst blocks of a sensor's error, neighbours merged."""
    if not np.isfinite(error).any():
        return []
    t = problem.taps.index(tap)
    time = problem.time_s[:, :, t]
    period = float(problem.periods_s()[t])
    length = max(BLOCK_S, 4.0 * period)
    found: list[dict[str, Any]] = []
    for c, recording in enumerate(problem.recordings):
        mine = np.isfinite(error) & (problem.of == c)[:, None]
        if not mine.any():
            continue
        block = np.where(mine, np.floor(np.nan_to_num(time) / length + 1e-6), 0).astype(np.int64)
        count = np.bincount(block[mine])
        square = np.bincount(block[mine], weights=error[mine] ** 2)
        mean = np.divide(square, count, out=np.zeros_like(square), where=count > 0)
        overall = float(square.sum() / count.sum())
        order = np.argsort(-mean)[: 3 * STRETCHES]
        chosen = np.sort(order[(mean[order] > 2.0 * overall) | (np.arange(order.size) == 0)])
        for run in np.split(chosen, np.flatnonzero(np.diff(chosen) > 1) + 1):
            inside = mine & (block >= run[0]) & (block <= run[-1])
            found.append(
                dict(
                    recording=recording.name if len(problem.recordings) > 1 else None,
                    start_s=float(time[inside].min()),
                    end_s=float(time[inside].max()) + period,
                    rmse=_rms(error[inside]),
                    doing=_doing(recording, tap, inside, time, work),
                )
            )
    return sorted(found, key=lambda s: -s["rmse"])[:STRETCHES]


def _doing(
    recording: Recording, tap: str, inside: NDArray[np.bool_], time: Floats, work: Operation
) -> str:
    """What the valves did during some readings, in words."""
    words = []
    begin, end = float(time[inside].min()), float(time[inside].max())
    for name, signal in recording.commands.items():
        volts = np.append(signal.within(begin, end).values, signal.held(begin))
        low, high = float(volts.min()), float(volts.max())
        words.append(f"{name} {low:.2f} V" if low == high else f"{name} {low:.2f} to {high:.2f} V")
    for kind in ("flow_direction", "opening", "motion"):
        sets = [s for s in work.sets(tap) if s.kind == kind]
        held = [int(s.mask[inside].sum()) for s in sets]
        # Each valve and piston has its own bands, so all that hold most of the time are named.
        words += [s.label for s, n in zip(sets, held, strict=True) if 2 * n > inside.sum()]
    return ", ".join(words)


def grid_check(
    problem: Problem,
    rig: Rig,
    readings: dict[str, Floats],
    progress: Callable[[float], None] | None = None,
) -> Numerics:
    """Runs a model again on cells of half the length and judges the change.

    Args:
        problem: The problem.
        rig: The model.
        readings: Per sensor its (n_stretches, horizon) predictions on the present grid.
        progress: Called with the fraction done.

    Returns:
        The judgement. A scheme of order p whose error e falls to e / 2^p changes by (1 - 2^-p) e
        (Richardson). The grid is blamed where that e, in units of noise and over the sensors that
        are not at their noise anyway, exceeds half of the error above noise.
    """
    limits = Thresholds()
    dx = problem.dx_m or rig.grid.dx_m
    finer = problem.with_grid(0.5 * dx).simulate([rig], progress=progress).readings[0]
    remaining = 1.0 - 0.5**rig.grid.order
    change: dict[str, float] = {}
    part: dict[str, float] = {}
    rmse: dict[str, tuple[float, float]] = {}
    noise_of = dict(zip(problem.taps, problem.noise_pa.tolist(), strict=True))
    of_grid = above_noise = 0.0
    for tap, coarse in readings.items():
        t = problem.taps.index(tap)
        noise = noise_of[tap]
        target = problem.target()[:, :, t]
        change[tap] = _rms(finer[:, :, t] - coarse)
        rmse[tap] = _rms(target - coarse), _rms(target - finer[:, :, t])
        if rmse[tap][0] > limits.at_noise * noise:
            grid_error = change[tap] / remaining
            excess = float(np.sqrt(rmse[tap][0] ** 2 - noise**2))
            part[tap] = grid_error / excess
            of_grid += (grid_error / noise) ** 2
            above_noise += (excess / noise) ** 2
    encoders = encoder_units(rig)
    share = float(np.sqrt(of_grid / above_noise)) if above_noise > 0.0 else 0.0
    head = f"On cells of half the length ({50.0 * dx:.3g} instead of {100.0 * dx:.3g} cm)"
    guilty = sorted((tap for tap in part if part[tap] > limits.of_grid), key=lambda t: -part[t])
    if share > limits.of_grid:
        tap = guilty[0]
        before, after = rmse[tap]
        unit = unit_of(tap, encoders)
        from_to = f"from {unit.figure(before)} to {unit.words(after)}: refine the grid"
        turn = f"falls {from_to}" if after < before else f"rises {from_to} and fit again"
        sentence = (
            f"{head} the prediction at {tap} changes by {unit.words(change[tap])}: about"
            f" {min(100.0 * share, 100.0):.0f} % of the error above noise is discretisation rather"
            f" than physics. The error at {tap} {turn}."
        )
    else:
        one = shared(encoders, change)
        tap = max(change, key=lambda name: change[name] / (1.0 if one else noise_of[name]))
        unit = unit_of(tap, encoders)
        size = f"{unit.scale * change[tap]:.3g} {unit.told}"
        most = f"by at most {size} (at {tap})" if one else f"most at {tap}, by {size}"
        but = f", except at {', '.join(guilty)}" if guilty else ""
        sentence = f"{head} predictions change {most}, so the error is not one of the grid{but}."
    of_taps, of_encoders = apart(change, encoders)
    return Numerics(
        dx_m=dx,
        refined_dx_m=0.5 * dx,
        change_pa=dict(of_taps),
        change=dict(of_encoders),
        discretisation=share > limits.of_grid,
        sentence=sentence,
    )


def _series(
    problems: list[Problem],
    taps: list[str],
    encoders: Mapping[str, str],
    names: list[str],
    readings: list[dict[str, Floats]],
    entries: list[ModelError],
) -> Series:
    """Signals for plotting: all readings, or those of the worst stretches and a thinned rest.

    The recordings follow one another, each as long after the one before as ``begins_s`` says.
    """
    first = problems[0]
    begins = begins_of(first.recordings)
    since = np.array(begins)[first.of][:, None]
    share = SERIES_POINTS // len(taps)
    times: list[Floats] = []
    kept: dict[str, NDArray[np.bool_]] = {}
    gaps: dict[str, float | None] = {}
    for tap in taps:
        t = first.taps.index(tap)
        time = first.time_s[:, :, t]
        there = np.isfinite(first.measured[:, :, t])
        keep = there.copy()
        stride = 1
        if there.sum() > share:
            keep = _worst_of(there, time, first, entries, share // 2)
            rest = np.flatnonzero((there & ~keep).ravel())
            stride = int(np.ceil(rest.size / max(share - int(keep.sum()), 1)))
            keep.ravel()[rest[::stride]] = True
        kept[tap] = keep
        gaps[tap] = float(GAP_PERIODS * stride * first.periods_s()[t])
        times.append((time + since)[keep])
    shown = np.unique(np.round(np.concatenate(times), 9))

    def told(values: Floats, tap: str) -> list[float | None]:
        out = np.full(shown.size, np.nan)
        k = taps.index(tap)
        out[np.searchsorted(shown, np.round(times[k], 9))] = values
        return np.round(out, PLACES[unit_of(tap, encoders).si]).tolist()

    commands: dict[str, list[float | None]] = {}
    of = np.clip(np.searchsorted(begins, shown, side="right") - 1, 0, len(begins) - 1)
    for name in first.recordings[0].commands:
        volts = np.full(shown.size, np.nan)
        for c, recording in enumerate(first.recordings):
            if name in recording.commands:
                mine = of == c
                volts[mine] = recording.commands[name].held(shown[mine] - begins[c])
        commands[name] = np.round(volts, 6).tolist()
    edges = first.span_s + since
    measured, of_encoders = apart(
        {tap: told(first.measured[:, :, first.taps.index(tap)][kept[tap]], tap) for tap in taps},
        encoders,
    )
    predictions = [
        apart(
            {tap: told(_like(predicted[tap], kept[tap])[kept[tap]], tap) for tap in taps}, encoders
        )
        for predicted in readings
    ]
    return Series(
        time_s=shown.tolist(),
        command=commands,
        measured=measured,
        model={name: of for name, (of, _) in zip(names, predictions, strict=True)},
        measured_encoders=of_encoders,
        model_encoders={name: of for name, (_, of) in zip(names, predictions, strict=True)}
        if encoders
        else {},
        gap_s=gaps,
        begins_s=begins,
        segments=[(round(float(a), 9), round(float(b), 9)) for a, b in edges],
    )


def _like(values: Floats, mask: NDArray[np.bool_]) -> Floats:
    """Predictions of a model that may have been asked for fewer readings a stretch."""
    out = np.full(mask.shape, np.nan)
    out[:, : values.shape[1]] = values[:, : mask.shape[1]]
    return out


def _worst_of(
    there: NDArray[np.bool_],
    time: Floats,
    problem: Problem,
    entries: list[ModelError],
    most: int,
) -> NDArray[np.bool_]:
    """Readings in the worst stretches of all models, no more than some number."""
    names = [recording.name for recording in problem.recordings]
    chosen = np.zeros_like(there)
    noise = dict(zip(problem.taps, problem.noise_pa.tolist(), strict=True))
    stretches = [
        (s.rmse / noise[name], s) for m in entries for name, e in m.sensors.items() for s in e.worst
    ]
    for _, s in sorted(stretches, key=lambda pair: -pair[0]):
        of = names.index(s.recording) if s.recording is not None else 0
        with np.errstate(invalid="ignore"):
            mask = there & (time >= s.start_s) & (time < s.end_s) & (problem.of == of)[:, None]
        if (chosen | mask).sum() <= most:
            chosen |= mask
    return chosen


# ---- for people ----------------------------------------------------------------------------

_KINDS = {
    "flow_direction": "flow",
    "choked": "choking",
    "opening": "valve",
    "pressure": "pressure",
    "frequency": "frequency",
    "time": "time",
    "position": "position",
    "motion": "motion",
    "speed": "speed",
    "load": "load",
    "stop": "ends",
}


SIGNS = "Bias is measured minus model; a positive lag: the measurement comes later."
"""What the signs in the tables mean."""


def _figure(value: float | None, form: str = ".0f", factor: float = 1.0) -> str:
    return "-" if value is None else f"{factor * value:{form}}"


def compare_table(result: CompareResult) -> RenderableType:
    """Tables of a comparison for the terminal.

    Args:
        result: The comparison.

    Returns:
        Errors per sensor and model, where each model fails, the worst stretches, and the grid. A
        unit stands in the headings, or in a column of its own where there are several.
    """
    encoders = result.encoders
    one = shared(encoders, result.sensors)

    def headed(name: str) -> str:
        return f"{name} {one.told}" if one else name

    def told(sensor: str) -> Unit:
        return unit_of(sensor, encoders)

    def in_column(sensor: str) -> tuple[str, ...]:
        return () if one else (told(sensor).told,)

    units = [] if one else [Column("unit")]
    errors = NamedTable(
        f"{result.recording}: measured minus model",
        [
            Column("model"),
            Column("sensor" if encoders else "tap"),
            Column(headed("RMSE"), "number"),
            *units,
            Column("atm", "number", drop=3),
            Column("% of std", "number", drop=2),
            Column("x noise", "number"),
            Column(headed("bias"), "number"),
            Column("lag ms", "number"),
            Column("gain", "number", drop=1),
        ],
        SIGNS,
    )
    for model in result.models:
        for i, (name, e) in enumerate(model.sensors.items()):
            errors.add_row(
                f"{model.name} ({model.model})" if i == 0 else "",
                name,
                told(name).figure(e.rmse),
                *in_column(name),
                _figure(e.rmse_atm if isinstance(e, TapError) else None, ".4f"),
                _figure(e.normalised, ".2f", 100.0),
                _figure(e.times_noise, ".2f"),
                told(name).figure(e.bias, signed=True),
                _figure(e.lag_s, "+.2f", 1e3),
                _figure(e.gain, ".3f"),
                end_section=i == len(model.sensors) - 1,
            )
    where = NamedTable(
        "where it fails: the worst regime of each kind",
        [
            Column("model"),
            Column("by", drop=2),
            Column("regime"),
            Column("sensor" if encoders else "tap"),
            Column(headed("RMSE"), "number"),
            Column(headed("bias"), "number"),
            *units,
            Column("x noise", "number"),
            Column("share %", "number", drop=1),
        ],
        "Bias is measured minus model.",
    )
    worst = NamedTable(
        "worst stretches",
        [
            Column("model"),
            Column("sensor" if encoders else "tap"),
            Column("from s", "number"),
            Column("to s", "number"),
            Column(headed("RMSE"), "number"),
            *units,
            Column("what the valve did", "words"),
        ],
    )
    for model in result.models:
        kinds = [kind for kind in _KINDS if any(r.kind == kind for r in model.all_regimes)]
        for i, kind in enumerate(kinds):
            r = max(
                (r for r in model.all_regimes if r.kind == kind),
                key=lambda r: r.times_noise or 0.0,
            )
            where.add_row(
                model.name if i == 0 else "",
                _KINDS[kind],
                r.label,
                r.sensor,
                told(r.sensor).figure(r.rmse),
                told(r.sensor).figure(r.bias, signed=True),
                *in_column(r.sensor),
                _figure(r.times_noise, ".2f"),
                f"{100.0 * r.share:.0f}",
                end_section=i == len(kinds) - 1,
            )
        for i, (s, taps) in enumerate(named := _merged(model, result.noise_of)):
            worst.add_row(
                model.name if i == 0 else "",
                ", ".join(taps),
                f"{s.start_s:.2f}",
                f"{s.end_s:.2f}",
                told(taps[0]).figure(s.rmse),
                *in_column(taps[0]),
                s.doing if s.recording is None else f"{s.recording}: {s.doing}",
                end_section=i == len(named) - 1,
            )
    parts: list[RenderableType] = [errors, where, worst]
    if len(result.recordings) > 1:
        parts.insert(1, recordings_table(result))
    return Group(*parts, result.numerics.sentence)


def recordings_table(result: CompareResult) -> NamedTable:
    """How every model does on every recording, in multiples of the noise.

    Args:
        result: The comparison.
    """
    table = NamedTable(
        "every model on every recording, x noise over all taps",
        [Column("recording"), *(Column(model.name, "number") for model in result.models)],
    )
    for name in result.recordings:
        table.add_row(name, *(_figure(m.by_recording.get(name), ".2f") for m in result.models))
    return table


def _merged(
    model: ModelError, noise: dict[str, float | None]
) -> list[tuple[Stretch | EncoderStretch, list[str]]]:
    """The worst stretches of a model, each with all sensors that are bad at that time.

    The error told is that of the first.
    """
    stretches = [(s, name) for name, e in model.sensors.items() for s in e.worst]
    stretches.sort(key=lambda pair: -pair[0].rmse / (noise[pair[1]] or 1.0))
    out: list[tuple[Stretch | EncoderStretch, list[str]]] = []
    for s, tap in stretches:
        for other, taps in out:
            together = s.recording == other.recording
            if together and s.start_s < other.end_s and other.start_s < s.end_s:
                if tap not in taps:
                    taps.append(tap)
                break
        else:
            out.append((s, [tap]))
    return out[:STRETCHES]
