# SPDX-License-Identifier: Apache-2.0
"""Comparing models with a recording: how large the error is at each tap, and where it arises.

Errors are measured minus model, the sign of what the rig has and the model lacks.
"""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Group, RenderableType

from pneu_common.errors import InputError
from pneu_common.tables import Column, NamedTable
from pneu_common.tally import Tally
from pneu_sim import sensors
from pneu_sim.models import kind_of
from pneu_sim.rig import rig_in_recording
from pneu_sim.rig.build import build
from pneu_sim.rig.plan import plan_grid
from pneu_sim.rig.schema import Rig
from pneu_sim.simulate import TICK_S
from pneu_sysid.problem import Problem, Rollouts, make_problem
from pneu_sysid.records import Recording
from pneu_sysid.regimes import FEWEST, Operation, frequency_shares, operation
from pneu_sysid.results import (
    CompareResult,
    ModelError,
    Numerics,
    Regime,
    Series,
    Stretch,
    TapError,
    pneu_version,
    regime_order,
)
from pneu_sysid.shift import Shift, estimate_shift
from pneu_sysid.thresholds import Thresholds

Floats = NDArray[np.float64]

ATM_PA = 101325.0
BLOCK_S = 0.05
"""Worst stretches are made of blocks of this length."""
STRETCHES = 5
SERIES_POINTS = 30000
"""Readings of all taps together that are kept for plotting."""
GAP_PERIODS = 3.5
"""Readings further apart than this many periods have a gap between them."""


def compare(
    source: Problem | Recording | Sequence[Recording],
    rigs: Sequence[tuple[str, Rig, str | None]],
    refine: bool = True,
    progress: Callable[[float], None] | None = None,
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

    Returns:
        The errors.

    Raises:
        InputError: There is no rig, a rig lacks a command or all taps of the recording, or a model
            cannot be run.
    """
    if not rigs:
        raise InputError("compare: no rig was given, at least one is needed")
    recordings = _recordings(source)
    names = _distinct(rigs)
    models = [rig for _, rig, _ in rigs]
    taps = _common_taps(recordings, names, models)
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

    with ThreadPoolExecutor(min(len(models), first.workers or os.cpu_count() or 1)) as pool:
        outs = list(pool.map(run, range(len(models))))
    readings = [
        {tap: out.readings[0, :, :, problem.taps.index(tap)] for tap in taps}
        for out, problem in zip(outs, problems, strict=True)
    ]
    work = operation(first, models[0], outs[0])
    noise = {tap: float(first.noise_pa[first.taps.index(tap)]) for tap in taps}
    entries = [
        _model_error(name, kind, file, noise, taps, problem, rig, out, work)
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
    return CompareResult(
        pneu_version=pneu_version(),
        recording=first.name,
        recordings=[r.name for r in recordings],
        rigs=names,
        taps=taps,
        noise_floor_pa=dict(noise),
        findings=findings_of(first)
        + [
            f"{tap}: not every rig has this tap, so it was left out"
            for tap in dict.fromkeys(tap for r in recordings for tap in r.pressures)
            if tap not in taps and any(tap in rig.taps for rig in models)
        ],
        models=entries,
        numerics=numerics,
        series=_series(problems, taps, names, readings, entries),
    )


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


def _common_taps(
    recordings: Sequence[Recording], names: list[str], rigs: Sequence[Rig]
) -> list[str]:
    """Taps that the recordings and every rig have."""
    for recording in recordings:
        for name, rig in zip(names, rigs, strict=True):
            for valve in rig.valves.values():
                if valve.command not in recording.commands:
                    raise InputError(
                        f"rig {name!r}: command {valve.command!r} is not in recording"
                        f" {recording.name!r} ({', '.join(recording.commands) or 'no commands'})"
                    )
    recorded = {tap for r in recordings for tap, signal in r.pressures.items() if len(signal)}
    taps = [tap for tap in rigs[0].taps if all(tap in rig.taps for rig in rigs) and tap in recorded]
    if not taps:
        raise InputError(
            f"recording {recordings[0].name!r}: no tap is in it and in every rig"
            f" (recorded: {', '.join(sorted(recorded)) or 'none'};"
            f" rig {names[0]!r}: {', '.join(rigs[0].taps)})"
        )
    return taps


def _problems(
    source: Problem | Recording | Sequence[Recording], rigs: Sequence[Rig]
) -> list[Problem]:
    """A problem per rig, on the stretches of the first."""
    if isinstance(source, Problem) and source.taps == list(rigs[0].taps):
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
    names: list[str],
    problem: Problem,
    rig: Rig,
    out: Rollouts,
    work: Operation,
) -> ModelError:
    taps: dict[str, TapError] = {}
    regimes: list[Regime] = []
    for tap in names:
        t = problem.taps.index(tap)
        error = problem.measured[:, :, t] - out.readings[0, :, :, t]
        shift = _shift(problem, rig, out, t)
        taps[tap] = _tap_error(error, noise[tap], tap, problem, shift, work)
        regimes += _regimes(error, noise[tap], tap, problem, work)
    return ModelError(
        name=name,
        model=kind,
        file=file,
        taps=taps,
        regimes=sorted(regimes, key=lambda r: (regime_order(r.model_dump()), names.index(r.tap))),
        rmse_pa=_rms(np.array([t.rmse_pa for t in taps.values()], dtype=float)),
        times_noise=_rms(np.array([t.times_noise for t in taps.values()], dtype=float)),
        by_recording={
            recording.name: _rms(
                np.concatenate(
                    [
                        (
                            (problem.measured - out.readings[0])[problem.of == c][
                                :, :, problem.taps.index(tap)
                            ]
                            / noise[tap]
                        ).ravel()
                        for tap in names
                    ]
                )
            )
            for c, recording in enumerate(problem.recordings)
        },
    )


def _shift(problem: Problem, rig: Rig, out: Rollouts, t: int) -> Shift | None:
    """How much later the measurement of a tap is than the prediction, and how much larger."""
    dense = []
    for recording, along in zip(problem.recordings, out.along, strict=True):
        model = build(rig_in_recording(rig, recording.name), plan_grid(rig, problem.dx_m))
        dense.append((along.tick_s, sensors.read(model, along.taps[0], TICK_S)[:, t]))
    return estimate_shift(problem.measured[:, :, t], problem.time_s[:, :, t], dense, problem.of)


def _tap_error(
    error: Floats, noise: float, tap: str, problem: Problem, shift: Shift | None, work: Operation
) -> TapError:
    good = np.isfinite(error)
    if not good.any():
        return TapError(
            rmse_pa=None,
            rmse_atm=None,
            normalised=None,
            times_noise=None,
            bias_pa=None,
            lag_s=None,
            gain=None,
            noise_floor_pa=noise,
            worst=[],
        )
    rmse = _rms(error)
    spread = float(np.std(problem.measured[:, :, problem.taps.index(tap)][good]))
    return TapError(
        rmse_pa=rmse,
        rmse_atm=rmse / ATM_PA,
        normalised=rmse / spread if spread > 0.0 else None,
        times_noise=rmse / noise,
        bias_pa=float(np.mean(error[good])),
        lag_s=None if shift is None else shift.lag_s,
        gain=None if shift is None else shift.gain,
        noise_floor_pa=noise,
        worst=_worst(error, tap, problem, work),
    )


def _regimes(
    error: Floats, noise: float, tap: str, problem: Problem, work: Operation
) -> list[Regime]:
    """Error of one tap by regime."""
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
            Regime(
                kind=samples.kind,
                label=samples.label,
                of=samples.of,
                lower=samples.lower,
                upper=samples.upper,
                tap=tap,
                rmse_pa=rmse,
                bias_pa=float(np.mean(error[mask])),
                share=part / total,
                samples=n,
                times_noise=rmse / noise,
            )
        )
    time = problem.time_s[:, :, problem.taps.index(tap)]
    for band in frequency_shares(error, time):
        rmse = float(np.sqrt(band.share * total / count))
        out.append(
            Regime(
                kind="frequency",
                label=band.label,
                lower=band.low_hz,
                upper=band.high_hz,
                tap=tap,
                rmse_pa=rmse,
                share=band.share,
                samples=count,
                times_noise=rmse / (noise * float(np.sqrt(band.white))),
            )
        )
    return out


def _worst(error: Floats, tap: str, problem: Problem, work: Operation) -> list[Stretch]:
    """The worst blocks of a tap's error, neighbours merged."""
    t = problem.taps.index(tap)
    time = problem.time_s[:, :, t]
    period = float(problem.periods_s()[t])
    length = max(BLOCK_S, 4.0 * period)
    found = []
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
                Stretch(
                    recording=recording.name if len(problem.recordings) > 1 else None,
                    start_s=float(time[inside].min()),
                    end_s=float(time[inside].max()) + period,
                    rmse_pa=_rms(error[inside]),
                    doing=_doing(recording, tap, inside, time, work),
                )
            )
    return sorted(found, key=lambda s: -s.rmse_pa)[:STRETCHES]


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
    for kind in ("flow_direction", "opening"):
        sets = [s for s in work.sets(tap) if s.kind == kind]
        held = [int(s.mask[inside].sum()) for s in sets]
        # Each valve has its own bands, so all that hold most of the time are named.
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
        readings: Per tap its (n_stretches, horizon) predictions on the present grid, Pa.
        progress: Called with the fraction done.

    Returns:
        The judgement. A scheme of order p whose error e falls to e / 2^p changes by (1 - 2^-p) e
        (Richardson). The grid is blamed where that e, in units of noise and over the taps that are
        not at their noise anyway, exceeds half of the error above noise.
    """
    limits = Thresholds()
    dx = problem.dx_m or rig.grid.dx_m
    finer = problem.with_grid(0.5 * dx).simulate([rig], progress=progress).readings[0]
    remaining = 1.0 - 0.5**rig.grid.order
    change: dict[str, float] = {}
    part: dict[str, float] = {}
    rmse: dict[str, tuple[float, float]] = {}
    of_grid = above_noise = 0.0
    for tap, coarse in readings.items():
        t = problem.taps.index(tap)
        noise = float(problem.noise_pa[t])
        target = problem.target()[:, :, t]
        change[tap] = _rms(finer[:, :, t] - coarse)
        rmse[tap] = _rms(target - coarse), _rms(target - finer[:, :, t])
        if rmse[tap][0] > limits.at_noise * noise:
            grid_error = change[tap] / remaining
            excess = float(np.sqrt(rmse[tap][0] ** 2 - noise**2))
            part[tap] = grid_error / excess
            of_grid += (grid_error / noise) ** 2
            above_noise += (excess / noise) ** 2
    share = float(np.sqrt(of_grid / above_noise)) if above_noise > 0.0 else 0.0
    head = f"On cells of half the length ({50.0 * dx:.3g} instead of {100.0 * dx:.3g} cm)"
    guilty = sorted((tap for tap in part if part[tap] > limits.of_grid), key=lambda t: -part[t])
    if share > limits.of_grid:
        tap = guilty[0]
        before, after = rmse[tap]
        turn = (
            f"falls from {before:.0f} to {after:.0f} Pa: refine the grid"
            if after < before
            else f"rises from {before:.0f} to {after:.0f} Pa: refine the grid and fit again"
        )
        sentence = (
            f"{head} the prediction at {tap} changes by {change[tap]:.0f} Pa: about"
            f" {min(100.0 * share, 100.0):.0f} % of the error above noise is discretisation rather"
            f" than physics. The error at {tap} {turn}."
        )
    else:
        tap = max(change, key=lambda name: change[name])
        but = f", except at {', '.join(guilty)}" if guilty else ""
        sentence = (
            f"{head} predictions change by at most {change[tap]:.3g} Pa (at {tap}), so the error is"
            f" not one of the grid{but}."
        )
    return Numerics(
        dx_m=dx,
        refined_dx_m=0.5 * dx,
        change_pa=dict(change),
        discretisation=share > limits.of_grid,
        sentence=sentence,
    )


def _series(
    problems: list[Problem],
    taps: list[str],
    names: list[str],
    readings: list[dict[str, Floats]],
    entries: list[ModelError],
) -> Series:
    """Signals for plotting: all readings, or those of the worst stretches and a thinned rest.

    The recordings follow one another, each as long after the one before as ``begins_s`` says.
    """
    first = problems[0]
    begins, at = [], 0.0
    for recording in first.recordings:
        begins.append(round(at, 9))
        at += np.ceil(recording.end_s + 1.0)
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

    def pascals(values: Floats, tap: str) -> list[float | None]:
        out = np.full(shown.size, np.nan)
        k = taps.index(tap)
        out[np.searchsorted(shown, np.round(times[k], 9))] = values
        return np.round(out, 1).tolist()

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
    return Series(
        time_s=shown.tolist(),
        command=commands,
        measured={
            tap: pascals(first.measured[:, :, first.taps.index(tap)][kept[tap]], tap)
            for tap in taps
        },
        model={
            name: {tap: pascals(_like(predicted[tap], kept[tap])[kept[tap]], tap) for tap in taps}
            for name, predicted in zip(names, readings, strict=True)
        },
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
    stretches = [s for e in entries for t in e.taps.values() for s in t.worst]
    for s in sorted(stretches, key=lambda s: -s.rmse_pa):
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
        Errors per tap and model, where each model fails, the worst stretches, and the grid.
    """
    errors = NamedTable(
        f"{result.recording}: measured minus model",
        [
            Column("model"),
            Column("tap"),
            Column("RMSE Pa", "number"),
            Column("atm", "number", drop=3),
            Column("% of std", "number", drop=2),
            Column("x noise", "number"),
            Column("bias Pa", "number"),
            Column("lag ms", "number"),
            Column("gain", "number", drop=1),
        ],
        SIGNS,
    )
    for model in result.models:
        for i, (tap, e) in enumerate(model.taps.items()):
            errors.add_row(
                f"{model.name} ({model.model})" if i == 0 else "",
                tap,
                _figure(e.rmse_pa),
                _figure(e.rmse_atm, ".4f"),
                _figure(e.normalised, ".2f", 100.0),
                _figure(e.times_noise, ".2f"),
                _figure(e.bias_pa, "+.0f"),
                _figure(e.lag_s, "+.2f", 1e3),
                _figure(e.gain, ".3f"),
                end_section=i == len(model.taps) - 1,
            )
    where = NamedTable(
        "where it fails: the worst regime of each kind",
        [
            Column("model"),
            Column("by", drop=2),
            Column("regime"),
            Column("tap"),
            Column("RMSE Pa", "number"),
            Column("bias Pa", "number"),
            Column("x noise", "number"),
            Column("share %", "number", drop=1),
        ],
        "Bias is measured minus model.",
    )
    worst = NamedTable(
        "worst stretches",
        [
            Column("model"),
            Column("tap"),
            Column("from s", "number"),
            Column("to s", "number"),
            Column("RMSE Pa", "number"),
            Column("what the valve did", "words"),
        ],
    )
    for model in result.models:
        kinds = [kind for kind in _KINDS if any(r.kind == kind for r in model.regimes)]
        for i, kind in enumerate(kinds):
            r = max(
                (r for r in model.regimes if r.kind == kind), key=lambda r: r.times_noise or 0.0
            )
            where.add_row(
                model.name if i == 0 else "",
                _KINDS[kind],
                r.label,
                r.tap,
                f"{r.rmse_pa:.0f}",
                _figure(r.bias_pa, "+.0f"),
                _figure(r.times_noise, ".2f"),
                f"{100.0 * r.share:.0f}",
                end_section=i == len(kinds) - 1,
            )
        for i, (s, taps) in enumerate(named := _merged(model, result.noise_floor_pa)):
            worst.add_row(
                model.name if i == 0 else "",
                ", ".join(taps),
                f"{s.start_s:.2f}",
                f"{s.end_s:.2f}",
                f"{s.rmse_pa:.0f}",
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


def _merged(model: ModelError, noise: dict[str, float | None]) -> list[tuple[Stretch, list[str]]]:
    """The worst stretches of a model, each with all taps that are bad at that time."""
    stretches = [(s, tap) for tap, e in model.taps.items() for s in e.worst]
    stretches.sort(key=lambda pair: -pair[0].rmse_pa / (noise[pair[1]] or 1.0))
    out: list[tuple[Stretch, list[str]]] = []
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
