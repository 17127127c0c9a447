# SPDX-License-Identifier: Apache-2.0
"""The live residual: at the noise for the right model, above it once the plant has changed."""

from pathlib import Path

import numpy as np
import pytest

from pneu_common.errors import InputError
from pneu_sim.rig import load_rig
from pneu_sim.rig.schema import AttachedEffect, Rig
from pneu_sim.simulator import Simulator
from pneu_sysid.watch import Verdict, Watch, Window

RATE_HZ = 250.0
NOISE_PA = 250.0
RIG = load_rig(Path(__file__).parents[3] / "rigs/lab.yaml")


def run(
    watch: Watch, plant: Rig, seconds: float, begin_s: float = 0.0, rate_hz: float = RATE_HZ
) -> list[Window]:
    """Runs a plant along a swinging command and shows it to the watch, sample by sample."""
    simulator = Simulator(plant)
    rng = np.random.default_rng(1)
    windows = []
    for k in range(round(seconds * rate_hz)):
        at = begin_s + k / rate_hz
        volts = 5.0 + 1.2 * np.sin(6.0 * at) + 0.3 * np.sin(17.0 * at)
        watch.command("voltage", at, volts)
        readings = simulator.run(1 / rate_hz, {"voltage": volts}, 1 / rate_hz)
        for name, series in readings.taps.items():
            watch.reading(name, at + 1 / rate_hz, series[-1] + NOISE_PA * rng.normal())
        window = watch.window()
        if window is not None:
            windows.append(window)
    return windows


def leaking(area_m2: float) -> Rig:
    effect = AttachedEffect(
        effect="leak", place="tube", parameters={"area_m2": area_m2, "position_m": 1.0}
    )
    return RIG.model_copy(update={"effects": [effect]})


def test_the_right_model_leaves_the_noise():
    windows = run(Watch(RIG, RATE_HZ), RIG, 3.0)
    assert len(windows) >= 4
    assert np.allclose(np.diff([w.end_s for w in windows]), 0.5, atol=0.02)
    rms = np.mean([w.rms_pa for w in windows], axis=0)
    assert rms == pytest.approx(NOISE_PA, rel=0.25)
    verdict = Verdict(3.0, 10.0)
    assert verdict.level == -1
    for window in windows:
        verdict.add(window)
    assert verdict.level == 0


def test_a_leak_shows_and_its_level_grows_with_it():
    levels = []
    for area_m2 in (3e-9, 3e-8):
        verdict = Verdict(3.0, 10.0)
        windows = run(Watch(RIG, RATE_HZ), leaking(area_m2), 3.0)
        for window in windows:
            verdict.add(window)
        levels.append(verdict.level)
    assert levels == [1, 2]
    # Gas is missing in the tube, so what is measured lies below the model.
    newest = [w.residual_pa[list(RIG.taps).index("end")] for w in windows]
    assert min(newest) < -1000.0 and max(newest) < 4.0 * NOISE_PA
    assert windows[-1].worst_tap in ("valve_out", "middle", "end")


def test_a_model_that_reads_too_low_leaves_a_positive_residual():
    windows = run(Watch(leaking(3e-8), RATE_HZ), RIG, 3.0)
    newest = [w.residual_pa[list(RIG.taps).index("end")] for w in windows]
    assert max(newest) > 1000.0 and min(newest) > -4.0 * NOISE_PA


def test_time_set_back_makes_a_new_start():
    watch = Watch(RIG, RATE_HZ)
    assert run(watch, RIG, 1.0, begin_s=100.0)
    windows = run(watch, RIG, 1.5)  # from rest at time zero: the past must not be mixed in
    assert windows and all(w.end_s < 2.0 for w in windows)
    assert np.all(np.mean([w.rms_pa for w in windows], axis=0) < 1.5 * NOISE_PA)


def test_readings_need_not_fall_on_the_ends_of_a_window():
    windows = run(Watch(RIG, RATE_HZ), RIG, 2.5, rate_hz=240.7)
    assert len(windows) >= 3
    assert np.mean([w.rms_pa for w in windows], axis=0) == pytest.approx(NOISE_PA, rel=0.25)


def test_a_silent_tap_has_no_residual_and_hides_no_other():
    watch = Watch(RIG, RATE_HZ)
    reading = watch.reading
    watch.reading = lambda name, at, value: (  # type: ignore[method-assign]
        None if name == "middle" else reading(name, at, value)
    )
    (window, *_) = run(watch, RIG, 1.5)
    silent = np.array([name == "middle" for name in window.taps])
    assert np.isnan(window.rms_pa[silent]).all()
    assert np.isfinite(window.rms_pa[~silent]).all()
    assert window.times_expected < 2.0


def test_without_commands_there_is_no_verdict():
    watch = Watch(RIG, RATE_HZ)
    for k in range(1000):
        watch.reading("end", k / RATE_HZ, 2e5)
    assert watch.window() is None


def test_a_window_of_a_few_samples_is_refused():
    with pytest.raises(InputError, match="window_s"):
        Watch(RIG, RATE_HZ, window_s=0.02)
