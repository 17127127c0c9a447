# SPDX-License-Identifier: Apache-2.0
"""Signals thinned for a screen: nothing that one could see is lost."""

import numpy as np
import pytest

from pneu_workbench.traces import Pyramid, packed

N = 500_000


def _walk(seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(0.5e-3, 1.5e-3, N))
    return time, np.cumsum(rng.normal(size=N))


@pytest.mark.parametrize("columns", [320, 1000, 3840])
@pytest.mark.parametrize(
    ("begin", "end"), [(0, N), (7, N - 3), (100_003, 250_001), (123_400, 143_900), (N // 2, N)]
)
def test_every_column_is_as_narrow_as_asked_with_its_own_least_and_most(
    columns: int, begin: int, end: int
) -> None:
    """Columns are cut at the times that are told; each is compared with all its readings."""
    time, values = _walk()
    values[123_456] = 1e6  # a single reading that stands out
    values[400_001] = -1e6
    at, shown = Pyramid(time, values).shown(time[begin], time[end - 1], columns)
    assert at.size == shown.size == 2 * columns
    cuts = np.searchsorted(time, at[::2])
    assert np.array_equal(time[cuts], at[::2])
    per = (end - begin) / columns
    # a level's entries are at most a third of a column, by which each end may be off
    assert begin - 2 - per / 3 <= cuts[0] <= begin
    assert np.diff(cuts).min() >= per * 2 / 3 - 2 and np.diff(cuts).max() <= per * 4 / 3 + 2
    single = values.astype(np.float32)
    # the last column may go on to the end of an entry
    least = np.minimum.reduceat(single, cuts)[:-1]
    most = np.maximum.reduceat(single, cuts)[:-1]
    pairs = shown.reshape(-1, 2)
    np.testing.assert_array_equal(pairs.min(axis=1)[:-1], least)
    np.testing.assert_array_equal(pairs.max(axis=1)[:-1], most)
    assert pairs[-1].min() <= single[cuts[-1] : end].min()
    assert pairs[-1].max() >= single[cuts[-1] : end].max()
    beyond = single[cuts[-1] : end + int(per / 3) + 2]
    assert pairs[-1].min() >= beyond.min() and pairs[-1].max() <= beyond.max()
    middles = 0.5 * (at[:-2:2] + at[2::2])
    np.testing.assert_allclose(at[1:-1:2], middles)


def test_every_level_has_the_least_and_most_of_its_readings() -> None:
    """Steps of eight up to a few dozen entries; what is left over at the end is in none."""
    time, values = _walk(2)
    values[50:70] = np.nan  # a gap that covers an entry of the finest level
    single = values.astype(np.float32)
    levels = Pyramid(time, values)._levels
    assert [level.size for level in levels] == [8, 64, 512, 4096, 32768]
    for level in levels:
        count = N // level.size
        rows = single[: count * level.size].reshape(count, level.size)
        empty = np.isnan(rows).all(axis=1)
        assert empty.any() == (level.size == 8)
        np.testing.assert_array_equal(level.least[~empty], np.nanmin(rows[~empty], axis=1))
        np.testing.assert_array_equal(level.most[~empty], np.nanmax(rows[~empty], axis=1))
        assert np.isnan(level.least[empty]).all() and np.isnan(level.most[empty]).all()


@pytest.mark.parametrize("more", [0, 1])
def test_up_to_two_readings_to_a_column_are_shown_themselves(more: int) -> None:
    time = np.arange(1000.0)
    values = np.sin(time)
    at, shown = Pyramid(time, values).shown(100.0, 297.0 + more, 100)
    if more:  # 201 readings with one beyond either end
        assert at.size == 200 and at[0] == 99.0
    else:
        np.testing.assert_array_equal(at, time[99:299])
        np.testing.assert_array_equal(shown, values[99:299].astype(np.float32))


def test_a_slope_is_drawn_without_teeth() -> None:
    time = np.arange(10_000.0)
    for values in (time, -time):
        shown = Pyramid(time, values).shown(0.0, 1e4, 100)[1]
        assert np.all(np.diff(shown) * np.sign(values[-1]) > 0.0)


def test_few_readings_are_shown_as_they_are() -> None:
    time, values = _walk()
    at, shown = Pyramid(time, values).shown(10.0, 10.2, 1000)
    first = np.searchsorted(time, 10.0) - 1
    np.testing.assert_array_equal(at, time[first : first + at.size])
    np.testing.assert_array_equal(shown, values[first : first + at.size].astype(np.float32))
    assert at[0] < 10.0 and at[-1] > 10.2  # a line goes on beyond the edges


def test_gaps_and_empty_signals() -> None:
    time = np.arange(100_000.0)
    values = np.sin(time / 1000.0)
    values[20_000:60_000] = np.nan
    at, shown = Pyramid(time, values).shown(0.0, 1e5, 500)
    lost = np.isnan(shown)
    assert lost.any() and not lost.all()
    assert at[lost].min() > 19_000.0 and at[lost].max() < 61_000.0
    nothing = Pyramid(np.zeros(0), np.zeros(0))
    assert nothing.span_s == (0.0, 0.0)
    assert nothing.shown(0.0, 1.0, 100)[0].size == 0


def test_a_column_rises_where_its_readings_do() -> None:
    """From least to most; the other way where they fall, and upwards where they do neither."""
    values = np.concatenate([np.repeat([0.0, 5.0], 8), np.repeat([5.0, 0.0], 8)])
    values = np.concatenate([np.tile(values, 16), np.tile([1.0, 3.0, 2.0, 1.0], 128)])
    _, shown = Pyramid(np.arange(1024.0), values).shown(0.0, 1023.0, 64)
    pairs = shown.reshape(-1, 2).tolist()
    assert pairs[:32] == [[0.0, 5.0], [5.0, 0.0]] * 16
    assert pairs[32:] == [[1.0, 3.0]] * 32


def test_bytes_tell_readings_an_hour_on_apart() -> None:
    time, values = 3600.0 + np.array([0.0, 1e-3, 2e-3]), np.array([1.0, 2.0, np.nan])
    raw = packed([(time, values.astype(np.float32))], 3600.0)
    assert np.frombuffer(raw, np.uint32, 2).tolist() == [1, 3]
    np.testing.assert_allclose(np.frombuffer(raw, np.float32, 3, 8), [0.0, 1e-3, 2e-3], atol=1e-7)
    np.testing.assert_array_equal(np.frombuffer(raw, np.float32, 3, 20), [1.0, 2.0, np.nan])
