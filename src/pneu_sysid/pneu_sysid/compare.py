# SPDX-License-Identifier: Apache-2.0
"""Comparing models with a recording: how large the error is at each tap, and where it arises.

Errors are measured minus predicted, the sign of what the rig has and the model lacks.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Group, RenderableType
from rich.table import Table

from pneu_sim.errors import InputError
from pneu_sim.rig.schema import Rig
from pneu_sysid.problem import Problem, make_problem
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
)
from pneu_sysid.shift import estimate_shift

Floats = NDArray[np.float64]

ATM_PA = 101325.0
BLOCK_S = 0.05
"""Worst stretches are made of blocks of this length."""
STRETCHES = 5
SERIES_POINTS = 6000
DISCRETISATION = 0.5
"""Part of the error above noise that the grid's own error must exceed to be called its cause."""
AT_NOISE = 1.2
"""Up to this many times the noise there is no error to explain."""


def compare(
    source: Problem | Recording,
    rigs: Sequence[tuple[str, Rig, str | None]],
    refine: bool = True,
    progress: Callable[[float], None] | None = None,
) -> CompareResult:
    """Rolls models out along a recording and takes their errors apart.

    All models see the same roll-outs, those of the first. What the rig was doing (flow direction,
    choking, opening) is the first model's word too, so that a regime is the same samples for all.

    Args:
        source: The recording, or the first rig's problem on it.
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
    recording = source.recording if isinstance(source, Problem) else source
    names = _distinct(rigs)
    models = [rig for _, rig, _ in rigs]
    taps = _common_taps(recording, names, models)
    problems = _problems(source, models)
    first = problems[0]
    kinds = [str(getattr(rig, "model", "pde")) for rig in models]
    gridded = kinds.index("pde") if refine and "pde" in kinds else None
    # The second run has half the cells' length and half the time step: four times the work.
    weights = [1.0] * len(models) + ([4.0] if gridded is not None else [])
    done = np.concatenate([[0.0], np.cumsum(weights)]) / sum(weights)

    def part(k: int) -> Callable[[float], None] | None:
        if progress is None:
            return None
        return lambda fraction: progress(float(done[k] + fraction * (done[k + 1] - done[k])))

    outs = [
        problem.simulate([rig], progress=part(k))
        for k, (problem, rig) in enumerate(zip(problems, models, strict=True))
    ]
    readings = [
        {tap: out.readings[0, :, :, problem.taps.index(tap)] for tap in taps}
        for out, problem in zip(outs, problems, strict=True)
    ]
    work = operation(first, models[0], outs[0])
    measured = dict(zip(first.taps, np.moveaxis(first.target(), 2, 0), strict=True))
    noise = {tap: float(first.noise_pa[first.taps.index(tap)]) for tap in taps}
    entries = [
        _model_error(
            name, kind, file, {tap: measured[tap] for tap in taps}, predicted, noise, first, work
        )
        for name, kind, (_, _, file), predicted in zip(names, kinds, rigs, readings, strict=True)
    ]
    if gridded is None:
        reason = "The grid was not checked." if not refine else "No model here has a grid."
        numerics = Numerics(
            dx_m=None, refined_dx_m=None, change_pa={}, discretisation=False, sentence=reason
        )
    else:
        numerics = grid_check(
            problems[gridded], models[gridded], readings[gridded], part(len(models))
        )
    if progress is not None:
        progress(1.0)
    return CompareResult(
        pneu_version=pneu_version(),
        recording=recording.name,
        rigs=names,
        taps=taps,
        noise_floor_pa=dict(noise),
        findings=[str(finding) for finding in recording.report]
        + [
            f"{tap}: not every rig has this tap, so it was left out"
            for tap in recording.pressures
            if tap not in taps and any(tap in rig.taps for rig in models)
        ],
        models=entries,
        numerics=numerics,
        series=_series(first, taps, names, readings, entries),
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


def _common_taps(recording: Recording, names: list[str], rigs: Sequence[Rig]) -> list[str]:
    """Taps that the recording and every rig have."""
    for name, rig in zip(names, rigs, strict=True):
        for valve in rig.valves.values():
            if valve.command not in recording.commands:
                raise InputError(
                    f"rig {name!r}: command {valve.command!r} is not in recording"
                    f" {recording.name!r} ({', '.join(recording.commands) or 'no commands'})"
                )
    taps = [
        tap
        for tap in rigs[0].taps
        if all(tap in rig.taps for rig in rigs)
        and tap in recording.pressures
        and np.isfinite(recording.pressures[tap]).any()
    ]
    if not taps:
        raise InputError(
            f"recording {recording.name!r}: no tap is in it and in every rig"
            f" (recorded: {', '.join(recording.pressures) or 'none'};"
            f" rig {names[0]!r}: {', '.join(rigs[0].taps)})"
        )
    return taps


def _problems(source: Problem | Recording, rigs: Sequence[Rig]) -> list[Problem]:
    """A problem per rig, on the roll-outs of the first."""
    if isinstance(source, Problem) and source.taps == list(rigs[0].taps):
        first = source
    else:
        recording = source.recording if isinstance(source, Problem) else source
        first = make_problem(rigs[0], recording)
    out = [first]
    for rig in rigs[1:]:
        same_cut = rig.model_copy(update={"fit": rigs[0].fit})
        other = make_problem(same_cut, first.recording, workers=first.workers)
        out.append(
            replace(
                other,
                starts=first.starts,
                warm_up=first.warm_up,
                horizon=first.horizon,
                nudge_s=first.nudge_s,
            )
        )
    return out


def _rms(x: Floats) -> float:
    """Root mean square of what is finite; NaN of nothing."""
    x = x[np.isfinite(x)]
    return float(np.sqrt(np.mean(x * x))) if x.size else float("nan")


def _model_error(
    name: str,
    kind: str,
    file: str | None,
    measured: dict[str, Floats],
    predicted: dict[str, Floats],
    noise: dict[str, float],
    problem: Problem,
    work: Operation,
) -> ModelError:
    taps = {
        tap: _tap_error(measured[tap], predicted[tap], noise[tap], tap, problem, work)
        for tap in measured
    }
    regimes = [
        regime
        for tap in measured
        for regime in _regimes(measured[tap] - predicted[tap], noise[tap], tap, problem.dt_s, work)
    ]
    return ModelError(
        name=name,
        model=kind,
        file=file,
        taps=taps,
        regimes=sorted(regimes, key=lambda r: -(r.times_noise or 0.0)),
        rmse_pa=_rms(np.array([t.rmse_pa for t in taps.values()], dtype=float)),
        times_noise=_rms(np.array([t.times_noise for t in taps.values()], dtype=float)),
    )


def _tap_error(
    measured: Floats, predicted: Floats, noise: float, tap: str, problem: Problem, work: Operation
) -> TapError:
    error = measured - predicted
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
    spread = float(np.std(measured[good]))
    shift = estimate_shift(measured, predicted, problem.dt_s)
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


def _regimes(error: Floats, noise: float, tap: str, dt_s: float, work: Operation) -> list[Regime]:
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
                tap=tap,
                rmse_pa=rmse,
                share=part / total,
                samples=n,
                times_noise=rmse / noise,
            )
        )
    for label, share, white in frequency_shares(np.where(good, error, 0.0), dt_s):
        rmse = float(np.sqrt(share * total / count))
        out.append(
            Regime(
                kind="frequency",
                label=label,
                tap=tap,
                rmse_pa=rmse,
                share=share,
                samples=count,
                times_noise=rmse / (noise * float(np.sqrt(white))),
            )
        )
    return out


def _worst(error: Floats, tap: str, problem: Problem, work: Operation) -> list[Stretch]:
    """The worst blocks of a tap's error, neighbours merged."""
    good = np.isfinite(error)
    block = np.floor(work.time_s / BLOCK_S + 1e-6).astype(np.int64)  # edges are whole samples
    count = np.bincount(block[good])
    square = np.bincount(block[good], weights=error[good] ** 2)
    mean = np.divide(square, count, out=np.zeros_like(square), where=count > 0)
    overall = float(square.sum() / count.sum())
    order = np.argsort(-mean)[: 3 * STRETCHES]
    chosen = np.sort(order[(mean[order] > 2.0 * overall) | (np.arange(order.size) == 0)])
    stretches = []
    for run in np.split(chosen, np.flatnonzero(np.diff(chosen) > 1) + 1):
        inside = (block >= run[0]) & (block <= run[-1])
        times = work.time_s[inside]
        stretches.append(
            Stretch(
                start_s=float(times.min()),
                end_s=float(times.max()) + problem.dt_s,
                rmse_pa=_rms(error[inside]),
                doing=_doing(problem, tap, inside, work),
            )
        )
    return sorted(stretches, key=lambda s: -s.rmse_pa)[:STRETCHES]


def _doing(problem: Problem, tap: str, inside: NDArray[np.bool_], work: Operation) -> str:
    """What the valves did during some samples, in words."""
    words = []
    samples = problem.windows()[inside]
    for name, volts in problem.recording.commands.items():
        low, high = float(volts[samples].min()), float(volts[samples].max())
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
        problem: The roll-outs.
        rig: The model.
        readings: Per tap its (n_starts, horizon) predictions on the present grid, Pa.
        progress: Called with the fraction done.

    Returns:
        The judgement. A scheme of order p whose error e falls to e / 2^p changes by (1 - 2^-p) e
        (Richardson). The grid is blamed where that e, in units of noise and over the taps that are
        not at their noise anyway, exceeds half of the error above noise.
    """
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
        if rmse[tap][0] > AT_NOISE * noise:
            grid_error = change[tap] / remaining
            excess = float(np.sqrt(rmse[tap][0] ** 2 - noise**2))
            part[tap] = grid_error / excess
            of_grid += (grid_error / noise) ** 2
            above_noise += (excess / noise) ** 2
    share = float(np.sqrt(of_grid / above_noise)) if above_noise > 0.0 else 0.0
    head = f"On cells of half the length ({50.0 * dx:.3g} instead of {100.0 * dx:.3g} cm)"
    guilty = sorted((tap for tap in part if part[tap] > DISCRETISATION), key=lambda t: -part[t])
    if share > DISCRETISATION:
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
        discretisation=share > DISCRETISATION,
        sentence=sentence,
    )


def _series(
    problem: Problem,
    taps: list[str],
    names: list[str],
    readings: list[dict[str, Floats]],
    entries: list[ModelError],
) -> Series:
    """Signals for plotting: all of them, or the worst stretches and a thinned rest."""
    windows = problem.windows()
    time = problem.recording.time_s[windows]
    flat = windows.ravel()
    worst = np.zeros(flat.size, dtype=bool)
    if flat.size > SERIES_POINTS:
        stretches = [(s.rmse_pa, s) for e in entries for t in e.taps.values() for s in t.worst]
        for _, s in sorted(stretches, key=lambda pair: -pair[0]):
            mask = worst | ((time.ravel() >= s.start_s) & (time.ravel() < s.end_s))
            if mask.sum() <= SERIES_POINTS // 2:
                worst = mask
        room = SERIES_POINTS - int(worst.sum())
        regular = np.zeros_like(worst)
        regular[:: int(np.ceil(flat.size / room))] = True
        keep = np.flatnonzero(worst | regular)
    else:
        keep = np.arange(flat.size)

    def pascals(x: Floats) -> list[float | None]:
        return np.round(x.ravel()[keep], 1).tolist()

    measured = problem.target()
    return Series(
        time_s=np.round(time.ravel()[keep], 9).tolist(),
        command={
            name: np.round(volts[flat][keep], 6).tolist()
            for name, volts in problem.recording.commands.items()
        },
        measured={tap: pascals(measured[:, :, problem.taps.index(tap)]) for tap in taps},
        model={
            name: {tap: pascals(predicted[tap]) for tap in taps}
            for name, predicted in zip(names, readings, strict=True)
        },
        segments=[
            (round(float(row[0]), 9), round(float(row[-1]) + problem.dt_s, 9)) for row in time
        ],
    )


# ---- for people ----------------------------------------------------------------------------

_KINDS = {
    "flow_direction": "flow",
    "choked": "choking",
    "opening": "valve",
    "pressure": "pressure",
    "frequency": "frequency",
    "time": "time",
}


def _figure(value: float | None, form: str = ".0f", factor: float = 1.0) -> str:
    return "-" if value is None else f"{factor * value:{form}}"


def compare_table(result: CompareResult) -> RenderableType:
    """Tables of a comparison for the terminal.

    Args:
        result: The comparison.

    Returns:
        Errors per tap and model, where each model fails, the worst stretches, and the grid.
    """
    errors = Table(title=f"{result.recording}: measured against predicted", title_justify="left")
    for heading in ("model", "tap"):
        errors.add_column(heading)
    for heading in ("RMSE Pa", "atm", "% of std", "x noise", "bias Pa", "lag ms", "gain"):
        errors.add_column(heading, justify="right")
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
    where = Table(title="where it fails: the worst regime of each kind", title_justify="left")
    for heading in ("model", "by", "regime", "tap"):
        where.add_column(heading)
    for heading in ("RMSE Pa", "x noise", "share %"):
        where.add_column(heading, justify="right")
    worst = Table(title="worst stretches", title_justify="left")
    for heading in ("model", "tap"):
        worst.add_column(heading)
    for heading in ("from s", "to s", "RMSE Pa"):
        worst.add_column(heading, justify="right")
    worst.add_column("what the valve did")
    for model in result.models:
        kinds = dict.fromkeys(r.kind for r in model.regimes)
        for i, kind in enumerate(kinds):
            r = next(r for r in model.regimes if r.kind == kind)
            where.add_row(
                model.name if i == 0 else "",
                _KINDS[kind],
                r.label,
                r.tap,
                f"{r.rmse_pa:.0f}",
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
                s.doing,
                end_section=i == len(named) - 1,
            )
    return Group(errors, where, worst, result.numerics.sentence)


def _merged(model: ModelError, noise: dict[str, float | None]) -> list[tuple[Stretch, list[str]]]:
    """The worst stretches of a model, each with all taps that are bad at that time."""
    stretches = [(s, tap) for tap, e in model.taps.items() for s in e.worst]
    stretches.sort(key=lambda pair: -pair[0].rmse_pa / (noise[pair[1]] or 1.0))
    out: list[tuple[Stretch, list[str]]] = []
    for s, tap in stretches:
        for other, taps in out:
            if s.start_s < other.end_s and other.start_s < s.end_s:
                if tap not in taps:
                    taps.append(tap)
                break
        else:
            out.append((s, [tap]))
    return out[:STRETCHES]
