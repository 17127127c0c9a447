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
def test_every_column_has_its_least_and_most(columns: int) -> None:
    time, values = _walk()
    values[123_456] = 1e6  # a single reading that stands out
    values[400_001] = -1e6
    for begin, end in ((0.0, time[-1]), (100.0, 250.0), (123.4, 123.9)):
        shown_at, shown = Pyramid(time, values).shown(begin, end, columns)
        inside = (time >= begin) & (time <= end)
        assert len(shown) <= 2 * columns + 4
        assert np.all(np.diff(shown_at) >= 0.0)
        assert shown.max() >= values[inside].max().astype(np.float32)
        assert shown.min() <= values[inside].min().astype(np.float32)


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


def test_a_whole_range_is_within_a_column_of_the_true_envelope() -> None:
    """Against the envelope taken reading by reading over each column, a column wider."""
    time, values = _walk(3)
    columns = 800
    at, shown = Pyramid(time, values).shown(0.0, time[-1], columns)
    width = 2.5 * time[-1] / columns
    for k in range(0, at.size, 97):
        near = np.abs(time - at[k]) <= width
        assert values[near].min() - 1e-2 <= shown[k] <= values[near].max() + 1e-2


def test_bytes_tell_readings_an_hour_on_apart() -> None:
    time, values = 3600.0 + np.array([0.0, 1e-3, 2e-3]), np.array([1.0, 2.0, np.nan])
    raw = packed([(time, values.astype(np.float32))], 3600.0)
    assert np.frombuffer(raw, np.uint32, 2).tolist() == [1, 3]
    np.testing.assert_allclose(np.frombuffer(raw, np.float32, 3, 8), [0.0, 1e-3, 2e-3], atol=1e-7)
    np.testing.assert_array_equal(np.frombuffer(raw, np.float32, 3, 20), [1.0, 2.0, np.nan])
