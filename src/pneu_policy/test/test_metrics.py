# SPDX-License-Identifier: Apache-2.0
"""Figures of a run, against signals whose figures are known on paper."""

import math

import numpy as np
import pytest

from pneu_policy.judge.metrics import ATM_PA, Metrics, Track, measure

BEGIN_S, END_S = 1.0, 12.0
MEAN_PA, SWING_PA, RATE_HZ = 350e3, 100e3, 1.0
TARGET_S = np.arange(0.0, 12.2001, 0.002)


def sine(time_s, frequency_hz=RATE_HZ):
    return MEAN_PA + SWING_PA * np.sin(2.0 * math.pi * frequency_hz * time_s)


def track(pressure, time_s=None, volts=lambda t: np.full(t.size, 5.0)):
    """A run whose target is a sine of 1 Hz and whose pressure is a function of time."""
    time_s = np.arange(0.0, 12.0001, 0.01) if time_s is None else time_s
    command_s = np.arange(0.0, 12.0, 0.001)
    return Track(time_s, pressure(time_s), TARGET_S, sine(TARGET_S), command_s, volts(command_s))


def figures(*args, **kwargs):
    return measure(track(*args, **kwargs), BEGIN_S, END_S, 5.0, 5.0)


def test_a_perfect_run_has_no_error():
    found = figures(sine)
    assert found.rmse_atm < 2e-5 and found.adjusted_rmse_atm <= found.rmse_atm
    assert abs(found.latency_s) < 1e-5
    assert found.effort_v == 0.0 and found.effort_rate_v_s == 0.0 and found.reversals_hz == 0.0


def test_an_offset_is_the_error_and_no_latency():
    found = figures(lambda t: sine(t) + 0.1 * ATM_PA)
    assert found.rmse_atm == pytest.approx(0.1, rel=1e-4)
    assert found.adjusted_rmse_atm == pytest.approx(0.1, rel=1e-4)
    assert found.worst_atm == pytest.approx(0.1, rel=2e-3)
    assert found.latency_s == pytest.approx(0.0, abs=2e-4)


@pytest.mark.parametrize("delay_s", [-0.0213, 0.0004, 0.0137, 0.1])
def test_a_shift_is_found_finer_than_the_samples(delay_s):
    found = figures(lambda t: sine(t - delay_s))
    assert found.latency_s == pytest.approx(delay_s, abs=2e-5)
    # The difference of two shifted sines of amplitude A is a sine of 2 A sin(pi f d).
    amplitude = 2.0 * SWING_PA * abs(math.sin(math.pi * RATE_HZ * delay_s))
    assert found.rmse_atm * ATM_PA == pytest.approx(amplitude / math.sqrt(2.0), rel=1e-3, abs=1.0)
    assert found.adjusted_rmse_atm < 5e-5


def test_noise_is_left_after_the_shift():
    rng = np.random.default_rng(1)
    found = figures(lambda t: sine(t - 0.03) + 2e3 * rng.normal(size=t.size))
    assert found.latency_s == pytest.approx(0.03, abs=2e-4)
    assert found.adjusted_rmse_atm * ATM_PA == pytest.approx(2e3, rel=0.08)


def test_uneven_samples_count_for_their_time():
    dense = np.arange(0.0, 6.0, 0.001)
    uneven = np.concatenate([dense, np.arange(6.0, 12.0001, 0.02)])
    # An error of 1 atm in the second half alone: 6 of the 11 seconds that are judged.
    found = figures(lambda t: sine(t) + ATM_PA * (t >= 6.0), time_s=uneven)
    assert found.rmse_atm == pytest.approx(math.sqrt(6.0 / 11.0), rel=2e-3)


def test_the_effort_of_a_sine_of_the_valve():
    def volts(t):
        return 5.0 + 2.0 * np.sin(2.0 * math.pi * 2.0 * t)

    found = figures(sine, volts=volts)
    assert found.effort_v == pytest.approx(2.0 / math.sqrt(2.0), rel=1e-3)
    # Over 10 ms the derivative of a sine of 2 Hz loses sinc(0.02).
    rate = 2.0 / math.sqrt(2.0) * 2.0 * math.pi * 2.0 * np.sinc(0.02)
    assert found.effort_rate_v_s == pytest.approx(rate, rel=1e-2)


def test_the_effort_does_not_depend_on_how_often_is_commanded():
    def stairs(step_s):
        return lambda t: 5.0 + np.sin(2.0 * math.pi * np.floor(t / step_s + 1e-9) * step_s)

    fine, coarse = (figures(sine, volts=stairs(step)) for step in (0.002, 0.01))
    assert fine.effort_rate_v_s == pytest.approx(coarse.effort_rate_v_s, rel=0.02)


def test_oscillation_is_what_lies_above_the_band():
    found = figures(lambda t: sine(t) + 8e3 * np.sin(2.0 * math.pi * 20.0 * t))
    assert found.oscillation_atm * ATM_PA == pytest.approx(8e3 / math.sqrt(2.0), rel=0.01)
    late = figures(lambda t: sine(t - 0.05))
    assert late.oscillation_atm < 0.002 < 0.1 < late.rmse_atm
    assert late.reversals_hz == pytest.approx(0.0, abs=0.1)


def test_two_reversals_are_an_oscillation():
    def ringing(swing_pa):
        run = track(lambda t: 2e5 + 0.5 * swing_pa * np.sin(2.0 * math.pi * 7.0 * t))
        still = Track(run.time_s, run.pressure_pa, TARGET_S, np.full(TARGET_S.size, 2e5),
                      run.command_time_s, run.volts)  # fmt: skip
        return measure(still, BEGIN_S, END_S, 5.0, 5.0).reversals_hz

    assert ringing(12e3) == pytest.approx(14.0, abs=0.1)
    assert ringing(4e3) == 0.0


def test_noise_makes_no_reversals():
    rng = np.random.default_rng(2)
    assert figures(lambda t: sine(t) + 250.0 * rng.normal(size=t.size)).reversals_hz == 0.0


def test_a_still_target_has_no_latency():
    run = track(sine)
    still = Track(run.time_s, np.full(run.time_s.size, 2e5), TARGET_S,
                  np.full(TARGET_S.size, 2e5), run.command_time_s, run.volts)  # fmt: skip
    found = measure(still, BEGIN_S, END_S, 5.0, 5.0)
    assert math.isnan(found.latency_s) and found.rmse_atm == found.adjusted_rmse_atm == 0.0


def test_what_cannot_be_judged_is_refused():
    whole = track(sine)
    hole = (whole.time_s < 5.0) | (whole.time_s > 5.2)
    gap = Track(whole.time_s[hole], whole.pressure_pa[hole], *list(vars(whole).values())[2:])
    with pytest.raises(ValueError, match="no reading for 0\\.220 s"):
        measure(gap, BEGIN_S, END_S, 5.0, 5.0)
    with pytest.raises(ValueError, match="target is known"):
        measure(whole, 0.1, END_S, 5.0, 5.0)
    broken = np.where(whole.time_s == 3.0, math.nan, whole.pressure_pa)
    with pytest.raises(ValueError, match="not finite"):
        measure(Track(whole.time_s, broken, *list(vars(whole).values())[2:]), 1.0, 12.0, 5.0, 5.0)


def test_figures_survive_being_written():
    found = figures(lambda t: sine(t - 0.01))
    assert Metrics.from_dict(found.to_dict()) == found
