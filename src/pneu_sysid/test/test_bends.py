# SPDX-License-Identifier: Apache-2.0
"""How much curves bend is read off those of their points that are seen."""

import numpy as np
import pytest

from pneu_sysid.bends import STRAIGHTEST, bends_told
from pneu_sysid.curves import Bends, Ties
from pneu_sysid.gauss_newton import Estimate, minimise
from pneu_sysid.slopes import Variable

POINTS, SEEN = 40, 30


def curve(bend: float, seed: int, noise: float = 1e-3) -> tuple[Estimate, list[Variable], Ties]:
    """Points of a curve whose second differences have a deviation; the last ones are hardly seen.

    Args:
        bend: Standard deviation of the second differences, in units of what is expected.
        seed: Of the curve and of the noise.
        noise: Of the readings of the points that are seen.
    """
    rng = np.random.default_rng(seed)
    truth = np.cumsum(np.cumsum(bend * rng.normal(size=POINTS)))
    sigma = np.where(np.arange(POINTS) < SEEN, noise, 1e3)
    read = truth + sigma * rng.normal(size=POINTS)
    matrix = np.diff(np.eye(POINTS), 2, axis=0)
    ties = Ties(matrix, np.zeros(POINTS - 2), np.zeros(POINTS - 2, dtype=np.int64))
    variables = [Variable(f"y{k}", 0.0, -1e4, 1e4, 1e-3) for k in range(POINTS)]

    def residuals(points: list[np.ndarray]) -> np.ndarray:
        return np.stack([((read - x) / sigma).reshape(10, -1) for x in points])

    estimate = minimise(residuals, variables, ties=ties[:2])  # type: ignore[arg-type]
    return estimate, variables, ties


@pytest.mark.parametrize("bend", [0.2, 0.5])
def test_the_evidence_finds_how_much_curves_bend(bend: float) -> None:
    """Of 28 second differences the deviation is known to 13 %, one sigma."""
    found = [bends_told(*curve(bend, seed)).change for seed in range(8)]
    assert np.mean(found) == pytest.approx(bend, rel=0.15)


def test_it_stays_within_what_is_believed() -> None:
    assert bends_told(*curve(1e-3, 1)).change == STRAIGHTEST
    assert bends_told(*curve(5.0, 1)).change == 1.0


def test_what_is_not_seen_says_nothing() -> None:
    """A curve that the data do not show follows its prior, which is no evidence that it does."""
    assert bends_told(*curve(0.2, 1, noise=1e3)) == Bends()


def test_without_ties_nothing_is_told() -> None:
    estimate, variables, _ = curve(0.2, 1)
    none = Ties(np.zeros((0, POINTS)), np.zeros(0), np.zeros(0, dtype=np.int64))
    assert bends_told(estimate, variables, none) == Bends()
