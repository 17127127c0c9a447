# SPDX-License-Identifier: Apache-2.0
"""The physical limit: it finds runs that are known to be possible, and what no command could do."""

from pathlib import Path

import numpy as np
import pytest

from pneu_common.errors import InputError
from pneu_policy.judge.limit import LimitSettings, physical_limit
from pneu_policy.task.plants import ControlPlant
from pneu_sim.rig import load_rig
from pneu_sim.rig.schema import AttachedEffect

RIG = load_rig(Path(__file__).parents[3] / "rigs" / "rig_a_fitted.yaml")
DX_M, PERIOD_S, SECONDS, START_PA = 0.25, 0.01, 0.4, 200e3
QUICK = LimitSettings(dx_m=DX_M, period_s=PERIOD_S, knot_s=0.02, horizon_s=0.2, first_iterations=12)


def run_with(rig, volts):
    """What the end of the tube shows under known voltages, the start included."""
    plant = ControlPlant([rig], PERIOD_S, DX_M)
    at = plant.taps.index("end")
    return np.array([plant.reset(START_PA)[0, at], *(plant.step(v)[0, at] for v in volts)])


@pytest.mark.long
@pytest.mark.parametrize("hidden", [[], ["hysteresis"]])
def test_a_target_that_the_plant_made_itself_is_followed(hidden):
    effects = [
        AttachedEffect(effect=name, place="valve", parameters={"width_v": 0.05}) for name in hidden
    ]
    rig = RIG.model_copy(update={"effects": [*RIG.effects, *effects]})
    knots = np.arange(round((SECONDS + 0.3) / QUICK.knot_s)) * QUICK.knot_s
    volts = 5.25 + 1.2 * np.sin(2.0 * np.pi * knots / 0.45)
    known = run_with(rig, np.repeat(volts, 2))
    times = np.arange(known.size) * PERIOD_S

    found = physical_limit(
        rig, "end", lambda t: np.interp(t, times, known), SECONDS, START_PA, QUICK
    )
    error = found.pressure_pa - found.target_pa
    assert np.ptp(found.target_pa) > 60e3  # there was something to follow
    assert np.sqrt(np.mean(error**2)) < 600.0
    # It is no mere claim: the plant does that under these voltages.
    assert np.allclose(run_with(rig, found.volts), found.pressure_pa, rtol=1e-9)


def test_beyond_reach_it_is_at_least_as_near_as_a_valve_wide_open():
    # Of a target above the supply's pressure nothing but an early wide opening comes near. Once the
    # wave is back the end swings about the supply's (to 654 kPa of 635, on cells of 5 cm too), and
    # from then on a valve that is less open keeps it 0.02 % nearer.
    found = physical_limit(RIG, "end", lambda t: np.full(np.shape(t), 2e6), 0.1, START_PA, QUICK)
    fastest = run_with(RIG, np.full(found.volts.size, 10.0))
    assert np.allclose(found.volts[:2], 10.0, atol=1e-6) and found.volts[:6].min() > 7.0
    assert np.mean((found.pressure_pa - 2e6) ** 2) <= np.mean((fastest - 2e6) ** 2) * (1 + 1e-6)


def test_bad_settings_are_refused():
    with pytest.raises(InputError, match=r"knot_s: found 0\.015, it must be a multiple of 0\.002"):
        LimitSettings(knot_s=0.015)
    with pytest.raises(InputError, match="tap 'nose': rig 'rig_a' has supply"):
        physical_limit(RIG, "nose", np.zeros_like, 0.1, START_PA, QUICK)
