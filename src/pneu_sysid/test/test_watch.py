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
RIG.grid.dx_m = 0.1  # cheap: plant and model have the same cells


def run(
    watch: Watch,
    plant: Rig,
    seconds: float,
    begin_s: float = 0.0,
    rate_hz: float = RATE_HZ,
    swing_v: float = 1.2,
) -> list[Window]:
    """Runs a plant along a swinging command and shows it to the watch, sample by sample.

    One that does not swing is told once.
    """
    simulator = Simulator(plant)
    rng = np.random.default_rng(1)
    windows = []
    for k in range(round(seconds * rate_hz)):
        at = begin_s + k / rate_hz
        volts = 5.4 if swing_v == 0.0 else 5.0 + swing_v * np.sin(6.0 * at) + 0.3 * np.sin(17 * at)
        if k == 0 or swing_v > 0.0:
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


@pytest.mark.long
def test_the_right_model_leaves_the_noise():
    windows = run(Watch(RIG, RATE_HZ), RIG, 3.0)
    assert len(windows) >= 4
    assert np.allclose(np.diff([w.end_s for w in windows]), 0.5, atol=0.02)
    rms = np.mean([w.rms for w in windows], axis=0)
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
    newest = [w.residual[list(RIG.taps).index("end")] for w in windows]
    assert min(newest) < -1000.0 and max(newest) < 4.0 * NOISE_PA
    assert windows[-1].worst in ("valve_out", "middle", "end")


@pytest.mark.long
def test_a_model_that_reads_too_low_leaves_a_positive_residual():
    windows = run(Watch(leaking(3e-8), RATE_HZ), RIG, 3.0)
    newest = [w.residual[list(RIG.taps).index("end")] for w in windows]
    assert max(newest) > 1000.0 and min(newest) > -4.0 * NOISE_PA


@pytest.mark.long
def test_time_set_back_makes_a_new_start():
    watch = Watch(RIG, RATE_HZ)
    assert run(watch, RIG, 1.0, begin_s=100.0)
    windows = run(watch, RIG, 1.5)  # from rest at time zero: the past must not be mixed in
    assert windows and all(w.end_s < 2.0 for w in windows)
    assert np.all(np.mean([w.rms for w in windows], axis=0) < 1.5 * NOISE_PA)


@pytest.mark.long
def test_readings_need_not_fall_on_the_ends_of_a_window():
    windows = run(Watch(RIG, RATE_HZ), RIG, 2.5, rate_hz=240.7)
    assert len(windows) >= 3
    assert np.mean([w.rms for w in windows], axis=0) == pytest.approx(NOISE_PA, rel=0.25)


def test_a_silent_tap_has_no_residual_and_hides_no_other():
    watch = Watch(RIG, RATE_HZ)
    reading = watch.reading
    watch.reading = lambda name, at, value: (  # type: ignore[method-assign]
        None if name == "middle" else reading(name, at, value)
    )
    (window, *_) = run(watch, RIG, 1.5)
    silent = np.array([name == "middle" for name in window.sensors])
    assert np.isnan(window.rms[silent]).all()
    assert np.isfinite(window.rms[~silent]).all()
    assert window.times_expected < 2.0


def test_a_command_that_was_told_once_holds():
    windows = run(Watch(RIG, RATE_HZ), RIG, 1.5, swing_v=0.0)
    assert len(windows) > 1
    assert np.all(np.mean([w.rms for w in windows], axis=0) < 1.5 * NOISE_PA)


def test_without_commands_there_is_no_verdict():
    watch = Watch(RIG, RATE_HZ)
    for k in range(1000):
        watch.reading("end", k / RATE_HZ, 2e5)
    assert watch.window() is None


def test_a_window_of_a_few_samples_is_refused():
    with pytest.raises(InputError, match="window_s"):
        Watch(RIG, RATE_HZ, window_s=0.02)


@pytest.mark.long
def test_an_encoder_is_judged_beside_the_taps():
    """A robot whose joint carries more than its model knows: its angle tells, in rad."""
    model = load_rig(Path(__file__).parents[3] / "rigs/kokoro.yaml")
    loaded = load_rig(Path(__file__).parents[3] / "rigs/kokoro.yaml")
    loaded.bodies["arm"].mass_kg *= 1.5  # type: ignore[union-attr]
    found = []
    for plant in (model, loaded):
        watch = Watch(model, RATE_HZ)
        simulator = Simulator(plant)
        rng = np.random.default_rng(1)
        windows = []
        for k in range(round(2.0 * RATE_HZ)):
            at = k / RATE_HZ
            swing = 0.4 * np.sign(np.sin(18.0 * at))
            volts = {"head": 5.0 + swing, "rod": 5.0 - swing}
            for name, value in volts.items():
                watch.command(name, at, value)
            given = {name: np.full(32, value) for name, value in volts.items()}
            seen = simulator.run(1.0 / RATE_HZ, given, 1.0 / RATE_HZ / 32)
            for name, series in seen.taps.items():
                watch.reading(name, at + 1.0 / RATE_HZ, series[-1] + NOISE_PA * rng.normal())
            elbow = seen.joints["elbow"][-1] + 3e-4 * rng.normal()
            watch.reading("elbow", at + 1.0 / RATE_HZ, elbow)
            windows += [window] if (window := watch.window()) is not None else []
        assert windows and windows[0].sensors == [*model.taps, "elbow"]
        found.append(float(np.mean([window.rms[-1] for window in windows])))
        assert np.mean([window.noise[-1] for window in windows]) < 1e-3  # rad, no Pa
    assert found[0] < 1e-3 and found[1] > 5.0 * found[0]
