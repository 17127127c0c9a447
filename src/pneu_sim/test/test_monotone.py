# SPDX-License-Identifier: Apache-2.0
"""The monotone cubic is that of SciPy, and goes through its points without overshooting."""

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

from pneu_sim.monotone import monotone_cubic


@pytest.mark.parametrize("points", [3, 4, 7, 30])
@pytest.mark.parametrize("kind", ["rising", "any", "flat parts", "ends that bend back"])
def test_it_is_scipys(points, kind):
    rng = np.random.default_rng([points, len(kind)])
    for _ in range(50):
        x = np.cumsum(rng.uniform(0.01, 2.0, points))
        y = rng.normal(size=points)
        if kind == "rising":
            y = np.cumsum(np.abs(y))
        elif kind == "flat parts":
            y = np.round(y)
        elif kind == "ends that bend back":
            y[0], y[1] = y[2] + 0.01, y[2]
        at = np.concatenate([x, np.linspace(x[0], x[-1], 200)])
        expected = PchipInterpolator(x, y)(at)
        np.testing.assert_allclose(monotone_cubic(x, y, at), expected, rtol=1e-11, atol=1e-11)


def test_two_points_make_a_line():
    at = np.array([1.0, 2.0, 4.0])
    found = monotone_cubic(np.array([1.0, 3.0]), np.array([0.0, 1.0]), at)
    assert found == pytest.approx([0.0, 0.5, 1.5])


def test_an_opening_curve_never_falls():
    x = np.array([5.0, 5.2, 5.6, 7.5, 10.0])
    y = np.array([0.0, 0.03, 0.1, 0.1, 1.0])
    table = monotone_cubic(x, y, np.linspace(5.0, 10.0, 1000))
    assert (np.diff(table) > -1e-15).all()
    assert table[0] == 0.0 and table[-1] == pytest.approx(1.0)
