# SPDX-License-Identifier: Apache-2.0
"""The controller of a joint and its targets: textbook sums, and a Kokoro that goes all over."""

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from pneu_common.errors import InputError
from pneu_policy.control.joint import JointGains, JointPid
from pneu_policy.task.joint_targets import JointTargets
from pneu_sim.rig import load_rig
from pneu_sim.simulator import Simulator

ROOT = Path(__file__).parents[3]


def test_the_voltage_is_the_sum_of_its_transfer_functions():
    """P, I, filtered speed and force as discrete transfer functions, by scipy's filters."""
    rng = np.random.default_rng(2)
    target, position, force = rng.normal(size=(3, 50)) * [[0.3], [0.2], [30.0]]
    dt_s, cut = 0.006, 13.0
    gains = JointGains(
        kp_v=4.0,
        ki_v_s=2.5,
        kd_v_s=0.2,
        kf_v_n=0.013,
        derivative_hz=cut,
        integral_v=40.0,
        most_v=90.0,
    )
    pid = JointPid(gains)
    rows = list(zip(target, position, force, strict=True))
    found = [pid.step(*row, dt_s) for row in rows]
    share = 1.0 - math.exp(-2.0 * math.pi * cut * dt_s)
    rising = lfilter([dt_s], [1.0, -1.0], np.where(np.arange(50), target - position, 0.0))
    filtered = [share / dt_s, -share / dt_s], [1.0, share - 1.0]
    speed = lfilter(*filtered, position - position[0])
    wanted = 4.0 * (target - position) + 2.5 * rising - 0.2 * speed - 0.013 * force
    assert found == pytest.approx(wanted, rel=1e-12)
    pid.reset()
    assert [pid.step(*row, dt_s) for row in rows] == found


@pytest.mark.parametrize(
    ("begun", "error", "force", "integral", "volts"),
    [
        # volts are 2 error + integral - 0.1 force, within 3; an error of 0.1 adds 0.2 V
        (0.5, 0.1, 0.0, 0.7, 0.9),
        (0.5, -0.1, 0.0, 0.3, 0.1),
        (0.5, 0.1, -21.0, 0.7, 3.0),  # up to the limit and no farther
        (0.5, 0.1, -21.001, 0.5, 2.8001),
        (0.5, 0.1, -90.0, 0.5, 3.0),
        (-0.5, 0.1, -90.0, -0.3, 3.0),  # towards zero
        (0.5, -0.1, -90.0, 0.3, 3.0),
        (-0.5, -0.1, 21.0, -0.7, -3.0),
        (-0.5, -0.1, 21.001, -0.5, -2.8001),
        (-0.5, -0.1, 90.0, -0.5, -3.0),
        (0.5, -0.1, 90.0, 0.3, -3.0),
        (0.95, 0.1, 0.0, 1.1, 1.3),  # the integral's own limits
        (-0.95, -0.1, 0.0, -1.1, -1.3),
    ],
)
def test_the_integral_waits_while_it_would_drive_the_valve_beyond_its_limit(
    begun, error, force, integral, volts
):
    pid = JointPid(JointGains(kp_v=2.0, ki_v_s=200.0, kf_v_n=0.1, integral_v=1.1, most_v=3.0))
    pid.step(0.4, 0.4, 0.0, 0.01)
    pid.integral_v = begun
    assert pid.step(0.4 + error, 0.4, force, 0.01) == pytest.approx(volts, abs=1e-9)
    assert pid.integral_v == pytest.approx(integral, abs=1e-9)


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("place", [0, 1, 2])
def test_numbers_that_are_no_measurement_are_refused(place, wrong):
    pid = JointPid(JointGains(kp_v=2.0))
    told = [0.3, 0.2, 10.0]
    pid.step(*told, 0.01)
    for dt_s in (0.0, -0.01, math.nan):
        with pytest.raises(ValueError, match="time must advance"):
            pid.step(*told, dt_s)
    told[place] = wrong
    with pytest.raises(ValueError, match="found target"):
        pid.step(*told, 0.01)


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
