# SPDX-License-Identifier: Apache-2.0
"""What an unexplained residual depends on: one variable at a time, judged on data kept aside."""

import numpy as np
from numpy.typing import NDArray

from pneu_sysid.problem import Problem

Floats = NDArray[np.float64]

BINS = 16
FOLDS = 4
WORTH = 0.02
"""Cross-validated gain below which a variable is not named."""


def _variables(problem: Problem, tap: int) -> dict[str, Floats]:
    """(n_starts, horizon) series a residual may be a function of."""
    w = problem.windows()
    p = problem.smooth[:, tap]
    rate = np.gradient(p) / problem.dt_s
    out = {"pressure": p[w], "rate of pressure": rate[w]}
    for name, series in problem.recording.commands.items():
        out[f"command {name}"] = series[w]
        step = np.concatenate([[0.0], np.diff(series)])
        # time since the command last moved by more than a hundredth of its range
        moved = np.abs(step) > 0.01 * (np.ptp(series) + 1e-12)
        index = np.arange(series.size)
        last = np.maximum.accumulate(np.where(moved, index, 0))
        out[f"time since {name} moved"] = ((index - last) * problem.dt_s)[w]
    out["time"] = (w * problem.dt_s).astype(float)
    out["time in roll-out"] = np.broadcast_to(
        np.arange(problem.horizon) * problem.dt_s, w.shape
    ).copy()
    return out


def dependences(problem: Problem, residual: Floats) -> list[tuple[str, str, float]]:
    """Names the variables that predict a residual on roll-outs kept aside.

    For each tap and variable, the mean residual in quantile bins of the variable is learnt on some
    roll-outs and tried on the others; the gain is the fraction of squared residual it removes
    there.

    Args:
        problem: The problem.
        residual: (n_starts, horizon * n_taps) in noise units.

    Returns:
        (variable, tap, gain), largest first; only gains worth naming.
    """
    r = residual.reshape(len(problem.starts), problem.horizon, len(problem.taps))
    fold = np.arange(len(problem.starts)) % FOLDS
    found = []
    for t, tap in enumerate(problem.taps):
        e = r[:, :, t]
        total = float(np.sum(e**2))
        if total <= 1.5 * e.size:
            continue
        for name, x in _variables(problem, t).items():
            edges = np.unique(np.nanquantile(x, np.linspace(0.0, 1.0, BINS + 1)[1:-1]))
            which = np.searchsorted(edges, np.nan_to_num(x))
            left = 0.0
            for k in range(FOLDS):
                train, test = fold != k, fold == k
                if not test.any() or not train.any():
                    continue
                count = np.bincount(which[train].ravel(), minlength=edges.size + 1)
                sums = np.bincount(
                    which[train].ravel(), weights=e[train].ravel(), minlength=edges.size + 1
                )
                mean = sums / np.maximum(count, 1)
                left += float(np.sum((e[test] - mean[which[test]]) ** 2))
            gain = 1.0 - left / total
            if gain >= WORTH:
                found.append((name, tap, gain))
    return sorted(found, key=lambda item: -item[2])
