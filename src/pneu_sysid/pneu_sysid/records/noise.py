# SPDX-License-Identifier: Apache-2.0
"""White sensor noise of a tap, apart from what its pressure does, from readings at any instants."""

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import fdtrc, gammainc, gammaincinv, gammaln, ndtri

from pneu_sim.signals import Floats
from pneu_sysid.records.stream import LONGEST_STEP

_DEGREE = 3  # of the polynomial taken out: with five readings, the prediction of one from four
_STRIDES = {16: 8, 8: 4, 6: 2}  # readings in a window, and from one window to the next
_FEWEST = _DEGREE + 2
_SHARES = (1.0, 0.5, 0.25)  # of the windows, those with the least curvature
_LEAST_FREEDOM = 16.0
_MOST_WINDOWS = 20_000
_KEPT = 0.95
_FIRST_GUESS = 0.25
_LEAST_KEPT = 0.3
_ROUNDS = 50
_WORSE = 2.8  # standard deviations by which a calmer selection must be lower to be believed
_STUCK = 16
# Where the signal's motion counts as what is seen: shares of windows as quiet as the estimate, of
# those nearly so, and standard deviations of a trend. Set on labelled recordings thinned to 20 Hz,
# and on white noise.
_HARDLY_QUIET, _PARTLY_QUIET, _TREND = 0.45, 0.65, 3.5
_NEAR, _SCATTER = 9.0, 0.13
_STEADY = 0.85
_STEEP, _UNLIKELY = 2.0, 1e-3  # ratio of the lowest power left to the others, and its chance


@dataclass(frozen=True)
class NoiseFloor:
    """Noise of a sensor, as its readings show it.

    Attributes:
        sigma_pa: Standard deviation of the white noise, quantisation included, in the unit of the
            readings; 0 where they never change, NaN where there are too few.
        std_error_pa: Standard error of ``sigma_pa``, from the readings that it rests on.
        resolution_pa: Step of the readings' scale; 0 where they stand on none.
        motion: Whether the signal itself moves so much between readings that ``sigma_pa`` is only
            an upper bound.
        sentence: All this in plain words.
    """

    sigma_pa: float
    std_error_pa: float
    resolution_pa: float
    motion: bool
    sentence: str


@dataclass(frozen=True)
class _Windows:
    """Windows of equally many readings, without their cubic trend.

    Attributes:
        size: Readings per window.
        freedom: Degrees of freedom left in each.
        overlap: Factor on the variance of a mean over windows, as they share readings.
        curved: (w,) part of the trend that is no straight line, squared.
        squares: (w,) mean square of what is left of the readings.
        lowest: (w,) of it, what a fourth power would take, squared.
    """

    size: int
    freedom: int
    overlap: float
    curved: Floats
    squares: Floats
    lowest: Floats


@dataclass(frozen=True)
class _Estimate:
    """Variance from the calmest windows of one size.

    Attributes:
        windows: All windows of this size.
        chosen: Indices of those it rests on, the least curved first.
        variance: The estimate.
        error: Its standard error, relative.
    """

    windows: _Windows
    chosen: NDArray[np.intp]
    variance: float
    error: float


def noise_floor(time_s: ArrayLike, values: ArrayLike) -> NoiseFloor:
    """Estimate the white noise of readings taken at any instants.

    In windows of 16, 8 or 6 successive readings a cubic in their own times is taken out. What is
    left is spanned by the normalised errors of predicting each reading from its four neighbours
    (Lagrange), is free of all that is smooth, and has n - 4 degrees of freedom. Windows are
    chosen by how little curved the cubic is: for white noise this is independent of what is left
    (Cochran's theorem), so that choosing costs no bias, and rests between moves are found. Over
    the chosen windows the mean square is taken below the 95 % point of what white noise of that
    strength would give, corrected for the cut, until it settles. Of all sizes and shares the most
    precise estimate counts that no calmer selection contradicts (a test after Hausman,
    doi:10.2307/1913827, by the chi-squared distribution). Noise finer than the resolution q counts
    as q/sqrt(12).

    Motion that never rests and of which successive readings share nothing looks like noise, and
    is taken for it.

    Args:
        time_s: (n,) increasing times, s.
        values: (n,) readings; any that are not finite are left out.

    Returns:
        The noise, how well it is known, and whether motion hides it.
    """
    time = np.asarray(time_s, dtype=np.float64)
    series = np.asarray(values, dtype=np.float64)
    good = np.isfinite(time) & np.isfinite(series)
    time, series = time[good], series[good]
    if series.size and np.all(series == series[0]):
        return NoiseFloor(0.0, 0.0, 0.0, False, f"all {series.size} readings are equal")
    resolution = _resolution(series)
    estimates = _estimates(time, series)
    if not estimates:
        note = f"too few of the {series.size} readings follow one another to tell their noise"
        return NoiseFloor(float("nan"), float("nan"), resolution, False, note)
    best, excess = _most_precise(estimates)
    sigma = float(np.sqrt(best.variance))
    rounding = resolution / float(np.sqrt(12.0))
    error = 0.5 * best.error * max(sigma, rounding)
    if sigma <= rounding:
        note = (
            f"the noise is finer than the readings' scale of {_words(resolution)} Pa, whose"
            f" rounding counts as {_words(rounding)} Pa"
        )
        return NoiseFloor(rounding, error, resolution, False, note)
    quiet, motion = _judge(best, excess, float(np.ptp(series)))
    if motion:
        note = (
            f"the noise is at most {_words(sigma)} Pa: the pressure itself moves between readings"
            f" in {100.0 * (1.0 - quiet):.0f} % of the time, which hides it"
        )
    else:
        note = (
            f"the noise is {_words(sigma)} Pa with a standard error of {_words(error)} Pa, from"
            f" stretches of {best.windows.size} readings"
        )
    return NoiseFloor(sigma, error, resolution, motion, note)


def _words(pressure_pa: float) -> str:
    """Three digits of a pressure, and no power of ten where none is needed."""
    return f"{pressure_pa:.0f}" if pressure_pa >= 100.0 else f"{pressure_pa:.3g}"


def _estimates(time: Floats, values: Floats) -> list[_Estimate]:
    """Estimates of all window sizes and shares, the most precise first."""
    found: list[_Estimate] = []
    reserve: _Estimate | None = None
    for size, stride in (*_STRIDES.items(), (_FEWEST, 1)):
        if size == _FEWEST and found:
            break  # one degree of freedom per window is for want of anything else
        windows = _windows(time, values, size, stride)
        if windows is None:
            continue
        order = np.argsort(windows.curved, kind="stable")
        for share in _SHARES:
            estimate = _settle(windows, order[: max(round(share * order.size), 1)])
            enough = 2.0 / estimate.error**2 >= _LEAST_FREEDOM and estimate.chosen.size >= 4
            if enough:
                found.append(estimate)
            elif share == 1.0 and (reserve is None or estimate.error < reserve.error):
                reserve = estimate
    if not found and reserve is not None:
        found = [reserve]
    return sorted(found, key=lambda estimate: estimate.error)


def _windows(time: Floats, values: Floats, size: int, stride: int) -> _Windows | None:
    """Cut readings into windows and take a cubic out of each; None where none is whole."""
    if values.size < size:
        return None
    stride = max(stride, -(-values.size // _MOST_WINDOWS))
    starts = np.arange(0, values.size - size + 1, stride)
    steps = np.diff(time)
    bad = np.concatenate(([0], np.cumsum(steps > LONGEST_STEP * np.median(steps))))
    whole = bad[starts + size - 1] == bad[starts]
    # A stuck sensor tells nothing of its noise; rests below the resolution are usual and stay.
    still = _stuck(values)[starts] & _stuck(values)[starts + size - 1]
    still &= values[starts] == values[starts + size - 1]
    if (whole & ~still).any():
        whole &= ~still
    if not whole.any():
        return None
    index = starts[whole, None] + np.arange(size)
    at = time[index]
    at = (at - at.mean(axis=1, keepdims=True)) / np.ptp(at, axis=1)[:, None]
    left = values[index] - values[index].mean(axis=1, keepdims=True)
    basis = [np.full_like(at, 1.0 / np.sqrt(size))]
    curved = np.zeros(len(index))
    squares = lowest = np.zeros(len(index))
    freedom = size - _DEGREE - 1
    for degree in range(1, _DEGREE + 2):
        column = at * basis[-1]
        for _ in range(2):  # once more, for what rounding left
            for other in basis:
                column = column - (column * other).sum(axis=1, keepdims=True) * other
        column /= np.sqrt((column**2).sum(axis=1, keepdims=True))
        basis.append(column)
        part = (left * column).sum(axis=1, keepdims=True)
        if degree > _DEGREE:
            squares = (left**2).sum(axis=1) / freedom
            lowest = part[:, 0] ** 2
            break
        left = left - part * column
        if degree > 1:
            curved += part[:, 0] ** 2
    return _Windows(size, freedom, _overlap(size, stride), curved, squares, lowest)


@functools.cache
def _overlap(size: int, stride: int) -> float:
    """Factor on the variance of a mean of squares, as windows share (even) readings."""
    basis, _ = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, size), _DEGREE + 1))
    left = np.eye(size) - basis @ basis.T
    shared = sum(
        float(np.sum((left[:, k:] @ left[: size - k]) ** 2)) for k in range(stride, size, stride)
    )
    return 1.0 + 2.0 * shared / (size - _DEGREE - 1)


@functools.cache
def _cut(freedom: int) -> tuple[float, float, float]:
    """The 95 % point of a mean square of variance 1, the mean below it, and what cutting costs.

    The last is the variance of the estimate that solves for its own cut, times the number of
    windows (delta method).
    """
    limit = float(_chi2_quantile(_KEPT, freedom)) / freedom
    first = float(_chi2_below(limit * freedom, freedom + 2))
    second = (1.0 + 2.0 / freedom) * float(_chi2_below(limit * freedom, freedom + 4))
    mean = first / _KEPT
    slope = (
        first - (limit - mean) * limit * float(_chi2_density(limit * freedom, freedom)) * freedom
    )
    return limit, mean, (second - 2.0 * mean * first + mean**2 * _KEPT) / slope**2


def _settle(windows: _Windows, chosen: NDArray[np.intp]) -> _Estimate:
    """Mean of mean squares among which some are too large."""
    limit, cut_mean, cost = _cut(windows.freedom)
    ranked = np.sort(windows.squares[chosen])
    if ranked.size < 4:
        error = float(np.sqrt(cost * windows.overlap / ranked.size))
        return _Estimate(windows, chosen, float(ranked.mean()), error)
    quantile = float(_chi2_quantile(_FIRST_GUESS, windows.freedom)) / windows.freedom
    variance = float(np.quantile(ranked, _FIRST_GUESS)) / quantile
    least = max(3, int(_LEAST_KEPT * ranked.size))
    for _ in range(_ROUNDS):
        kept = max(int(np.searchsorted(ranked, variance * limit, "right")), least)
        settled = float(ranked[:kept].mean()) / cut_mean
        if settled == variance:
            break
        variance = settled
    # Where more than the cut explains is left out, only what is kept tells of noise.
    count = min(kept / _KEPT, ranked.size)
    error = float(np.sqrt(cost * windows.overlap / count))
    return _Estimate(windows, chosen, variance, error)


def _most_precise(estimates: list[_Estimate]) -> tuple[_Estimate, float]:
    """The most precise estimate that no calmer one contradicts, and by how much one does.

    Args:
        estimates: The most precise first.
    """
    for i, estimate in enumerate(estimates):
        excess = max((_excess(estimate, other) for other in estimates[i + 1 :]), default=0.0)
        if excess < _WORSE:
            return estimate, max(excess, 0.0)
    raise AssertionError("the last has nothing to contradict it")


def _excess(precise: _Estimate, calm: _Estimate) -> float:
    """Standard deviations by which a calmer estimate lies below a more precise one."""
    # Of two estimates of which one is efficient, the difference has the difference of variances.
    variance = max(calm.error**2 - precise.error**2, 0.25 * calm.error**2)
    if precise.variance <= 0.0:
        return 0.0
    freedom = 2.0 / variance
    return -float(ndtri(_chi2_below(freedom * calm.variance / precise.variance, freedom)))


def _judge(best: _Estimate, excess: float, span: float) -> tuple[float, bool]:
    """Share of all windows that are as quiet as an estimate says, and whether motion rules it.

    Args:
        best: The estimate.
        excess: Standard deviations by which a calmer one is lower.
        span: Range of the readings.
    """
    limit = _cut(best.windows.freedom)[0]
    quiet = float(np.mean(best.windows.squares <= limit * best.variance))
    if best.chosen.size < 4 or best.variance <= 0.0:
        return quiet, False
    # White noise alone spans less than its twelvefold. Where the pressure moves, a noise of a
    # hundredth of its range is more likely motion faster than the readings, unless it never varies.
    strength = float(np.sqrt(best.variance))
    if 12.0 * strength < span < 100.0 * strength and quiet < _STEADY:
        return quiet, True
    # Between rests and moves there is little; motion that never rests comes in all strengths.
    near = float(np.mean(best.windows.squares <= _NEAR * limit * best.variance))
    scattered = 1.0 - quiet / near > _SCATTER
    if quiet < _HARDLY_QUIET and scattered:
        return quiet, True
    squares = best.windows.squares[best.chosen]
    below = squares <= limit * best.variance
    kept = squares[below]
    # Noise is as strong in every power of time; motion falls off from the lowest.
    freedom = best.windows.freedom
    if freedom > 1 and kept.size > 1:
        lowest = float(best.windows.lowest[best.chosen][below].mean())
        others = (float(kept.mean()) * freedom - lowest) / (freedom - 1)
        count = kept.size / best.windows.overlap
        slope = lowest / others if others > 0.0 else 1.0
        if slope > _STEEP and fdtrc(count, count * (freedom - 1), slope) < _UNLIKELY:
            return quiet, True
    lost = squares.size - kept.size
    expected = (1.0 - _KEPT) * squares.size
    surplus = (lost - expected) / np.sqrt(_KEPT * expected)
    # Noise does not know how curved its window is; motion does.
    rank = np.arange(kept.size) - 0.5 * (kept.size - 1)
    spread = float(np.sqrt(np.sum(rank**2) * kept.var()))
    trend = float(rank @ (kept - kept.mean())) / spread if spread > 0.0 else 0.0
    # Strengths that vary leave more windows far below the mean than one strength does.
    tenth = float(_chi2_quantile(0.1 * _KEPT, freedom)) / freedom
    low = float(np.mean(kept < tenth * best.variance)) - 0.1
    low *= np.sqrt(kept.size / best.windows.overlap / 0.09)
    partly = scattered and quiet < _PARTLY_QUIET and surplus > 3.0
    return quiet, partly and trend + excess + max(low, 0.0) > _TREND


def _stuck(values: Floats) -> NDArray[np.bool_]:
    """Whether each reading stands in a run of equal ones far longer than usual."""
    starts = np.concatenate(([0], np.flatnonzero(np.diff(values) != 0.0) + 1, [values.size]))
    lengths = np.diff(starts)
    usual = float(np.percentile(lengths, 99))
    return np.repeat(lengths > max(_STUCK, 10.0 * usual), lengths)


def _resolution(values: Floats) -> float:
    """Step of the scale that readings stand on, 0 where they stand on none."""
    levels = np.unique(values)
    if levels.size < 2:
        return 0.0
    steps = np.diff(levels)
    step = float(steps.min())
    # Values that come back are readings on a scale; those that never do, computed numbers.
    if 2 * levels.size <= values.size:
        return step
    # Few readings of many levels hardly come back, but their steps are multiples of one.
    turns = np.count_nonzero(np.diff(np.sign(np.diff(values))))
    even = np.abs(steps / step - np.rint(steps / step)).max() < 0.01
    return step if even and turns >= 20 else 0.0


# Of scipy.special, which is loaded all the same: scipy.stats takes a second at each start.


def _chi2_below(x: float, freedom: float) -> float:
    """Probability that a chi-square variable is not above a number."""
    return float(gammainc(0.5 * freedom, 0.5 * x))


def _chi2_quantile(part: float, freedom: float) -> float:
    """What a chi-square variable is not above with a probability."""
    return float(2.0 * gammaincinv(0.5 * freedom, part))


def _chi2_density(x: float, freedom: float) -> float:
    """Density of a chi-square variable."""
    half = 0.5 * freedom
    return float(np.exp((half - 1.0) * np.log(0.5 * x) - 0.5 * x - gammaln(half)) / 2.0)
