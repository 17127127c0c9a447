# SPDX-License-Identifier: Apache-2.0
"""Random targets: the same for the same seed, within range, and of the shape named."""

import numpy as np
import pytest

from pneu_common.errors import InputError
from pneu_policy.task.targets import KINDS, Target

T = np.linspace(0.0, 30.0, 30001)


@pytest.mark.parametrize("kind", KINDS)
def test_targets_repeat_stay_in_range_and_can_be_looked_ahead_in(kind):
    target = Target(kind, 150e3, 500e3, 0.6, seed=7)
    values = target.at(T)
    assert values.min() >= 150e3 and values.max() <= 500e3
    assert np.ptp(values) > 0.6 * 350e3
    assert np.array_equal(values, Target(kind, 150e3, 500e3, 0.6, seed=7).at(T))
    assert not np.array_equal(values, Target(kind, 150e3, 500e3, 0.6, seed=8).at(T))
    some = [12345, 17, 29999]  # in any order, one at a time
    # (a sine of one number and of many may differ by a bit, by the processor's vector units)
    assert [float(target.at(T[i])) for i in some] == pytest.approx(values[some], rel=1e-12)


def test_a_smooth_target_has_no_corners_a_jagged_one_only_at_its_points():
    slope = np.diff(Target("smooth", 1e5, 5e5, 0.5, seed=1).at(T)) / np.diff(T)
    assert np.abs(np.diff(slope)).max() < 0.05 * np.abs(slope).max()
    bends = np.abs(np.diff(Target("jagged", 1e5, 5e5, 0.5, seed=1).at(T), n=2)) > 1.0
    at = T[1:-1][bends]
    assert np.allclose(np.mod(at + 0.002, 0.5), 0.002, atol=2e-3)
    assert 50 <= bends.sum() <= 2 * 60


def test_holds_are_levels_of_the_length_asked_for():
    values = Target("hold", 1e5, 5e5, 0.5, seed=2).at(T)
    jumps = T[1:][np.diff(values) != 0.0]
    assert np.allclose(np.diff(jumps), 0.5, atol=2e-3)


def test_mixed_takes_turns():
    mixed = Target("mixed", 1e5, 5e5, 0.5, seed=2, turn_s=4.0)
    for turn, kind in enumerate(("smooth", "jagged", "hold")):
        at = 4.0 * turn + np.linspace(0.1, 3.9, 50)
        alone = Target(kind, 1e5, 5e5, 0.5, seed=2).at(at)
        np.testing.assert_allclose(mixed.at(at), alone, rtol=1e-12)


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"kind": "wavy"}, "smooth, jagged, hold, mixed"),
        ({"low_pa": 5e5, "high_pa": 1e5}, "low_pa is the smaller"),
        ({"low_pa": 0.0}, "absolute"),
        ({"period_s": 0.0}, "period_s"),
        ({"seed": -1}, "seed"),
    ],
)
def test_bad_input_is_refused_in_a_sentence(changed, told):
    with pytest.raises(InputError, match=told):
        Target(**{"kind": "smooth", "low_pa": 1e5, "high_pa": 5e5, **changed})
