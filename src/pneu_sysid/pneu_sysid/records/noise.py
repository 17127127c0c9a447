# SPDX-License-Identifier: Apache-2.0
"""White sensor noise of a pressure series, estimated from high differences."""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import chi2

_WINDOW = 64
_FIRST_GUESS = 0.25
_KEPT = 0.95
_ROUNDS = 20
_DIFF4_GAIN = 70.0  # sum of the squared weights 1, -4, 6, -4, 1
_DIFF4_CORRELATION = 12870.0 / 4900.0  # sum over all lags of their squared autocorrelation


def noise_floor_pa(series: ArrayLike) -> float:
    """Return the standard deviation of the white noise in a series, quantisation included.

    Fourth differences remove all that is smooth on the scale of five samples and leave
    white noise amplified by sqrt(70). Their mean square is taken in windows of 64. The
    lower quartile over windows is the first guess; then the mean is taken over the
    windows below the 95 % point of what white noise of that strength would give
    (chi-squared, with the degrees of freedom that the correlation of the differences
    leaves, and corrected for the cut), until it settles. Windows a transient passes
    through so drop out. A series whose noise is finer than its resolution q gets
    q/sqrt(12).

    Args:
        series: Uniform samples of shape (n,), NaN where missing.

    Returns:
        Standard deviation in the unit of the series; 0 for a constant series, NaN where
        no five successive samples are finite.
    """
    values = np.asarray(series, dtype=np.float64)
    finite = values[np.isfinite(values)]
    steps = np.abs(np.diff(finite))
    steps = steps[steps > 0]
    fourth = np.diff(values, n=4)
    if not np.isfinite(fourth).any():
        return float("nan")
    if not steps.size:
        return 0.0
    # Values that come back are readings on a scale; those that never do, computed numbers.
    on_scale = 2 * len(np.unique(finite)) <= len(finite)
    resolution = float(steps.min()) if on_scale else 0.0

    count = max(len(fourth) // _WINDOW, 1)
    size = min(_WINDOW, len(fourth))
    windows = fourth[: count * size].reshape(count, size) ** 2
    # A stretch that stands still is below the resolution or stuck; it tells nothing of noise.
    moves = (np.diff(values) != 0.0)[: count * size].reshape(count, size).any(axis=1)
    usable = np.isfinite(windows).all(axis=1) & moves
    if usable.any():
        variance = _quiet_mean(windows[usable].mean(axis=1), size / _DIFF4_CORRELATION)
    else:
        variance = float(np.nanmean(fourth**2))
    return max(float(np.sqrt(variance / _DIFF4_GAIN)), resolution / float(np.sqrt(12.0)))


def _quiet_mean(squares: NDArray[np.float64], freedom: float) -> float:
    """Return the mean of chi-squared mean squares among which some are too large."""
    limit = float(chi2.ppf(_KEPT, freedom))
    cut_mean = float(chi2.cdf(limit, freedom + 2.0)) / _KEPT  # of those below the limit
    guess = np.quantile(squares, _FIRST_GUESS) * freedom / chi2.ppf(_FIRST_GUESS, freedom)
    variance = max(float(guess), float(squares.min()))
    for _ in range(_ROUNDS):
        kept = squares[squares <= max(variance * limit / freedom, squares.min())]
        settled = float(kept.mean()) / cut_mean
        if settled == variance:
            break
        variance = settled
    return variance
