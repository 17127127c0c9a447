# SPDX-License-Identifier: Apache-2.0
"""The controller of a joint and its targets: textbook sums, and a Kokoro that goes all over."""

import math
from pathlib import Path

import numpy as np
import pytest

from pneu_common.errors import InputError
from pneu_policy.control.joint import JointGains, JointPid
from pneu_policy.task.joint_targets import JointTargets
from pneu_sim.rig import load_rig
from pneu_sim.simulator import Simulator

ROOT = Path(__file__).parents[3]


def test_each_term_is_the_sum_it_stands_for():
    pid = JointPid(JointGains(kp_v=4.0, ki_v_s=2.0, kf_v_n=0.01))
    volts = [pid.step(0.5, 0.1, 20.0, 0.01) for _ in range(11)]
    assert volts[0] == pytest.approx(4.0 * 0.4 - 0.01 * 20.0)
    assert volts[10] == pytest.approx(volts[0] + 10 * 0.01 * 2.0 * 0.4)
    pid = JointPid(JointGains(kp_v=0.0, kd_v_s=0.2))
    for k in range(200):
        damped = pid.step(0.0, 3.0 * 0.004 * k, 0.0, 0.004)
    assert damped == pytest.approx(-0.2 * 3.0, rel=1e-6)


def test_the_integral_does_not_wind_up_while_the_valve_is_at_its_limit():
    pid = JointPid(JointGains(kp_v=20.0, ki_v_s=10.0))
    for _ in range(100):
        assert pid.step(1.0, 0.0, 0.0, 0.01) == 5.0
    assert pid.integral_v == 0.0


@pytest.mark.parametrize("wrong", [{"kp_v": -1.0}, {"kp_v": 1.0, "most_v": 0.0}])
def test_gains_that_make_no_controller_are_refused(wrong):
    with pytest.raises(InputError, match=r"found (-1|0), it must be"):
        JointGains(**wrong)


def test_targets_are_those_of_their_seed_and_go_in_jumps_slowly_and_rest():
    times = np.arange(0.0, 60.0, 0.004)
    told = [JointTargets(-0.8, 0.8, seed) for seed in (1, 1, 2)]
    one, same, other = (np.array([t.at(s) for s in times]) for t in told)
    assert np.array_equal(one, same) and not np.array_equal(one, other)
    assert -0.8 <= one.min() < -0.7 and 0.7 < one.max() <= 0.8
    speed = np.abs(np.diff(one)) / 0.004
    assert np.mean(speed == 0.0) > 0.2 and speed.max() > 50.0
    assert np.mean((speed > 0.0) & (speed < 1.2)) > 0.2


def test_a_kokoro_follows_over_its_range_and_hardly_meets_its_stops():
    rig = load_rig(ROOT / "rigs" / "kokoro.yaml")
    head_m2, rod_m2 = math.pi / 4 * 0.025**2, math.pi / 4 * (0.025**2 - 0.010**2)
    pid = JointPid(JointGains(kp_v=4.0, ki_v_s=2.0, kd_v_s=0.2, kf_v_n=0.01))
    targets, plant = JointTargets(-0.8, 0.8, 0), Simulator(rig, dx_m=0.25)
    place, force_n, off, places = 0.0, 0.0, [], []
    for k in range(3750):
        target = targets.at(0.004 * k)
        volts = pid.step(target, place, force_n, 0.004)
        read = plant.run(0.004, {"head": 5.0 + volts, "rod": 5.0 - volts}, 0.004)
        place = float(read.encoders["elbow"][-1])
        head_pa, rod_pa = (float(read.taps[f"{side}_port"][-1]) for side in ("head", "rod"))
        force_n = head_pa * head_m2 - rod_pa * rod_m2 - 101e3 * (head_m2 - rod_m2)
        places.append(place)
        off.append(abs(target - place))
    assert min(places) < -0.5 and max(places) > 0.5
    assert np.mean(np.abs(places) > 0.84) < 0.1
    assert np.median(off) < 0.1
