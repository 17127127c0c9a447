# SPDX-License-Identifier: Apache-2.0
"""What an unexplained residual depends on: one variable at a time, judged on data kept aside."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from pneu_sysid.problem import Problem
from pneu_sysid.spectrum import lines_of
from pneu_sysid.thresholds import Thresholds
from pneu_sysid.ticks import STILL

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

BINS = 16
FOLDS = 4
TOGETHER_S = 0.25
"""Times that are no further apart are told as one."""
SMOOTHING_S = 0.02
"""Positions are averaged over this time before they are differentiated."""


def _variables(problem: Problem, tap: int, predicted: Floats) -> dict[str, Floats]:
    """(n_stretches, horizon) series a residual may be a function of; NaN where there is none."""
    time = problem.time_s[:, :, tap]
    period = float(problem.periods_s()[tap])
    rate = np.full(time.shape, np.nan)
    if time.shape[1] > 2:
        # the last readings of a stretch may be missing, and their rate with them
        with np.errstate(invalid="ignore", divide="ignore"):
            rate[:, 1:-1] = (predicted[:, 2:] - predicted[:, :-2]) / (time[:, 2:] - time[:, :-2])
            rate[:, 0] = (predicted[:, 1] - predicted[:, 0]) / (time[:, 1] - time[:, 0])
    out = {"pressure": predicted, "rate of pressure": rate}
    if any(problem.taps[tap] in recording.encoders for recording in problem.recordings):
        out = {}  # its own position and speed are among those of all encoders
    for encoder in dict.fromkeys(e for r in problem.recordings for e in r.encoders):
        out |= _motion(problem, encoder, time)
    for name in problem.recordings[0].commands:
        value, since = np.full(time.shape, np.nan), np.full(time.shape, np.nan)
        for c, recording in enumerate(problem.recordings):
            mine = (problem.of == c)[:, None] & np.isfinite(time)
            signal = recording.commands[name]
            value[mine] = signal.held(time[mine])
            # when the command last moved by more than a hundredth of its range
            step = np.abs(np.diff(signal.values)) > 0.01 * (np.ptp(signal.values) + 1e-12)
            moved = np.concatenate([signal.time_s[:1], signal.time_s[1:][step]])
            last = np.searchsorted(moved, time[mine] + 0.5 * min(period, 1e-6), side="right") - 1
            since[mine] = time[mine] - moved[np.maximum(last, 0)]
        out[f"command {name}"] = value
        out[f"time since {name} moved"] = since
    out["time"] = time
    return out


def _motion(problem: Problem, encoder: str, time: Floats) -> dict[str, Floats]:
    """(n_stretches, horizon) what an encoder tells of the motion at the readings of a sensor."""
    names = [f"{what} of {encoder}" for what in ("position", "speed", "direction")]
    out = {name: np.full(time.shape, np.nan) for name in names}
    for c, recording in enumerate(problem.recordings):
        signal = recording.encoders.get(encoder)
        if signal is None or len(signal) < 3:
            continue
        period = float(np.median(np.diff(signal.time_s)))
        width = max(3, round(SMOOTHING_S / period))
        smooth = uniform_filter1d(signal.values, width, mode="nearest")
        speed = np.gradient(smooth, signal.time_s)
        still = STILL * float(np.percentile(np.abs(speed), 99))
        direction = np.sign(np.where(np.abs(speed) > still, speed, 0.0))
        mine = (problem.of == c)[:, None] & np.isfinite(time)
        for name, values in zip(names, (signal.values, speed, direction), strict=True):
            out[name][mine] = np.interp(time[mine], signal.time_s, values)
    out[names[2]] = np.round(out[names[2]])
    return out


def dependences(
    problem: Problem, residual: Floats, thresholds: Thresholds
) -> list[tuple[str, str, float]]:
    """Names the variables that predict a residual on stretches kept aside.

    For each sensor and variable, the mean residual in quantile bins of the variable is learnt on
    some stretches and tried on the others; the gain is the fraction of squared residual it removes
    there.

    Args:
        problem: The problem.
        residual: (n_stretches, horizon * n_taps) in noise units.
        thresholds: What decides.

    Returns:
        (variable, sensor, gain), largest first; only gains worth naming.
    """
    r = residual.reshape(problem.measured.shape)
    fold = np.arange(problem.stretches) % FOLDS
    found = []
    for t, tap in enumerate(problem.taps):
        e = r[:, :, t]
        total = float(np.sum(e**2))
        there = np.isfinite(problem.measured[:, :, t])
        if total <= 1.5 * there.sum():
            continue
        predicted = problem.measured[:, :, t] - e * problem.noise_pa[t]
        for name, x in _variables(problem, t, predicted).items():
            if not np.isfinite(x).any():
                continue
            edges = np.unique(np.nanquantile(x, np.linspace(0.0, 1.0, BINS + 1)[1:-1]))
            which = np.searchsorted(edges, np.nan_to_num(x))
            left = 0.0
            for k in range(FOLDS):
                train, test = fold != k, fold == k
                count = np.bincount(which[train].ravel(), minlength=edges.size + 1)
                sums = np.bincount(
                    which[train].ravel(), weights=e[train].ravel(), minlength=edges.size + 1
                )
                mean = sums / np.maximum(count, 1)
                left += float(np.sum((e[test] - mean[which[test]]) ** 2))
            gain = 1.0 - left / total
            if gain >= thresholds.named:
                found.append((name, tap, gain))
    for line in lines_of(problem, residual):
        if line.share >= thresholds.named:
            found.append((f"a pulsation of {line.frequency_hz:.3g} Hz", line.tap, line.share))
    return sorted(found, key=lambda item: -item[2])


def seldom(
    problem: Problem, residual: Floats, blocks: Ints, thresholds: Thresholds
) -> list[tuple[str, float, float]]:
    """Where in time a residual is, if it is almost nowhere else.

    Args:
        problem: The problem.
        residual: (n_stretches, m) in noise units.
        blocks: (n_stretches, m) block of time of each reading.
        thresholds: What decides.

    Returns:
        Recording, beginning and end in s, of each part of it in order of time; none where the
        residual is spread over time.
    """
    measured = np.isfinite(problem.measured).reshape(residual.shape)
    time = problem.time_s.reshape(residual.shape)
    square = np.bincount(blocks[measured], weights=residual[measured] ** 2)
    order = np.argsort(-square)
    count = int(np.searchsorted(np.cumsum(square[order]), thresholds.most_of_it * square.sum())) + 1
    if count > thresholds.seldom * np.unique(blocks[measured]).size:
        return []
    spans = []
    for k in order[:count]:
        mine = measured & (blocks == k)
        of = int(problem.of[np.flatnonzero(mine.any(axis=1))[0]])
        spans.append((of, float(time[mine].min()), float(time[mine].max())))
    out: list[tuple[int, float, float]] = []
    for of, begin, end in sorted(spans):
        if out and out[-1][0] == of and begin - out[-1][2] < TOGETHER_S:
            out[-1] = (of, out[-1][1], end)
        else:
            out.append((of, begin, end))
    return [(problem.recordings[of].name, begin, end) for of, begin, end in out]
