# SPDX-License-Identifier: Apache-2.0
"""Which command acted when: as it was told, and as the bridge says that it was applied."""

import math
from pathlib import Path

import numpy as np
import pytest

from pneu_policy.control.horizon import Aim, Horizon
from pneu_policy.control.in_force import InForce
from pneu_policy.control.predictive import PredictiveController
from pneu_policy.control.predictive_settings import JointPredictiveSettings, PredictiveSettings
from pneu_policy.task.plants import ControlPlant
from pneu_sim.rig import load_rig

ROOT = Path(__file__).parents[3]
NULL_V = 5.0


def of(*told):
    one = InForce(NULL_V)
    for time_s, volts in told:
        one.tell(time_s, volts)
    return one


def test_what_is_told_acts_until_the_next():
    one = of((0.0, 6.0), (0.01, 7.0))
    assert [one.at(t) for t in (-1.0, 0.0, 0.005, 0.01, 1.0)] == [5.0, 6.0, 6.0, 7.0, 7.0]
    assert one.mean(-0.01, 0.03) == pytest.approx((5.0 + 6.0 + 7.0) / 3.0)
    assert one.mean(0.0025, 0.01) == pytest.approx(0.75 * 6.0 + 0.25 * 7.0)
    one.forget_before(0.0)
    assert one.mean(0.0, 0.02) == pytest.approx(6.5)


def test_what_came_late_acts_late_and_what_was_told_since_is_still_to_come():
    one = of((0.0, 6.0), (0.01, 7.0))
    one.apply(0.004, 6.002)  # a register's steps
    assert [one.at(t) for t in (0.0, 0.003, 0.004, 0.01)] == [5.0, 5.0, 6.002, 7.0]
    one.apply(0.013, 7.0)
    assert one.at(0.01) == 6.002 and one.at(0.013) == 7.0 and one.followed


def test_a_bridge_that_closes_the_valve_is_believed_until_it_follows_again():
    one = of((0.0, 9.0), (0.01, 9.0), (0.02, 9.0))
    one.apply(0.001, 9.0)
    one.apply(0.012, NULL_V)
    assert not one.followed
    assert one.at(0.011) == 9.0
    assert one.at(0.025) == NULL_V  # what was told since is not followed
    one.tell(0.03, 8.0)
    assert one.at(0.04) == NULL_V
    one.apply(0.032, 8.0)
    assert one.followed and one.at(0.04) == 8.0


def test_what_is_written_again_is_no_news_and_what_was_passed_over_never_acts():
    one = of((0.0, 6.0), (0.01, 7.0), (0.02, 6.0))
    one.apply(0.001, 6.0)
    one.apply(0.003, 6.0)  # written twice: not what is told for later
    assert one.at(0.015) == 7.0
    one.tell(0.03, 8.0)
    one.apply(0.031, 8.0)  # 7 and 6 V were overtaken on the way
    assert one.at(0.025) == 6.0 and one.at(0.031) == 8.0
    one.apply(0.018, 9.0)  # of before what is known
    assert one.at(0.1) == 8.0


def test_commands_that_differ_by_little_are_not_taken_for_one_another():
    """A slow ramp, of which every third command is overtaken on the way."""
    one = InForce(NULL_V)
    for n in range(100):
        one.tell(0.01 * n, NULL_V + 0.008 * n)
        if n % 3 != 2:
            one.apply(0.01 * n + 0.004, NULL_V + 0.008 * n)
        one.forget_before(0.01 * n)
        assert one.followed
        assert one.at(0.01 * n + 0.005) == pytest.approx(NULL_V + 0.008 * n, abs=0.0081)


def test_a_bridge_that_says_nothing_more_does_not_follow():
    one = of((0.0, 6.0), (0.01, 6.0), (0.02, 7.0))
    one.apply(0.001, 6.0)
    one.forget_before(0.045)
    assert one.followed and one.at(0.045) == 7.0  # still on its way
    one.forget_before(0.06)
    assert not one.followed and one.at(0.06) == 6.0


def test_nobody_says_what_was_applied():
    one = InForce(NULL_V)
    for n in range(200):
        one.tell(0.01 * n, 5.0 + math.sin(n))
        one.forget_before(0.01 * n)
        assert one.at(0.01 * n) == 5.0 + math.sin(n)
    assert one.mean(1.98, 0.02) == pytest.approx(5.0 + 0.5 * (math.sin(198) + math.sin(199)))


@pytest.mark.parametrize("heard", [False, True])
def test_the_model_holds_where_a_bridge_that_closed_the_valve_says_so(heard):
    """A plant whose valve others close again and again."""
    lab = load_rig(ROOT / "rigs/lab.yaml")
    settings = PredictiveSettings(dx_m=0.5, every=4, delay_s=0.0)
    one = PredictiveController(lab, "end", ["valve_out"], settings)
    plant = ControlPlant([lab], one.period_s, 0.1)
    seen = plant.reset(101325.0)
    for k in range(100):
        ahead = 0.01 * k + np.array(one.preview_s)
        target = 3e5 - 1.5e5 * np.cos(2.0 * np.pi * ahead)
        read = dict(zip(plant.taps, seen[0].tolist(), strict=True))
        asked = one.step({"valve_out": read["valve_out"]}, target.tolist())
        taken = NULL_V if k % 25 > 15 else asked
        if heard:
            one.applied(0.0, {"voltage": taken})
        seen = plant.step(taken)
    assert (not one.observer.watch.wrong) == heard


def test_valves_at_both_sides_of_a_piston_are_one_voltage():
    rig = load_rig(ROOT / "rigs/kokoro_fitted.yaml")
    aim = Aim("elbow", ("elbow",), {"head": 1.0, "rod": -1.0})
    horizon = Horizon(rig, aim, JointPredictiveSettings(), 1)
    for volts in (0.0, 4.0, 9.5):
        head, rod = horizon.each(np.array([volts]))[:, 0]
        assert horizon.voltage_of({"head": head, "rod": rod}) == pytest.approx(volts)
    assert horizon.voltage_of({"head": 5.0, "rod": 5.0}) == NULL_V
    assert horizon.voltage_of({"head": 5.0}) is None
