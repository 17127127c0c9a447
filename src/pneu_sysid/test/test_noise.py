# SPDX-License-Identifier: Apache-2.0
"""The noise floor is that of the sensor, whatever the pressure does and whenever it is read."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from pneu_sim.channels import Channel
from pneu_sysid.records import NoiseFloor, Signal, noise_floor, read_recording

Floats = NDArray[np.float64]
BAGS = Path(__file__).parents[3] / "data" / "bags"
TAPS = ("supply", "valve_out", "middle", "end", "exhaust")
TRUE_PA = float(np.hypot(250.0, 170.0 / np.sqrt(12.0)))  # data/bags/README.md


@pytest.fixture(scope="module")
def recorded() -> dict[str, Signal]:
    """Every tap of the labelled recordings, at 500 Hz."""
    channels = {tap: Channel(topic=f"/taps/{tap}/pressure", field="fluid_pressure") for tap in TAPS}
    return {
        f"{bag.name} {tap}": signal
        for bag in sorted(BAGS.iterdir())
        if bag.is_dir()
        for tap, signal in read_recording(bag, commands={}, pressures=channels).pressures.items()
    }


def thinned(recorded: dict[str, Signal], every: int) -> Iterator[tuple[str, NoiseFloor]]:
    """Noise floors of recordings of which one reading of so many is left; 0: 20 to 50 ms apart."""
    rng = np.random.default_rng(11)
    for name, signal in recorded.items():
        steps = rng.integers(10, 26, len(signal)) if every == 0 else np.full(len(signal), every)
        index = np.cumsum(steps) - steps[0]
        index = index[index < len(signal)]
        yield name, noise_floor(signal.time_s[index], signal.values[index])


def instants(kind: str, count: int, rng: np.random.Generator) -> Floats:
    if kind == "even":
        return np.arange(count) * 0.008
    return np.cumsum(rng.uniform(0.02, 0.05, count))


# ---- white noise --------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize("kind", ["even", "uneven"])
@pytest.mark.parametrize("count", [40, 300, 2000])
def test_white_noise_is_found_within_its_standard_error(kind: str, count: int) -> None:
    rng = np.random.default_rng(count)
    runs = 400 if count < 2000 else 100
    z, motion = np.zeros(runs), np.zeros(runs, dtype=bool)
    for i in range(runs):
        values = 3e5 + rng.normal(0.0, 250.0, count)
        found = noise_floor(instants(kind, count, rng), values)
        z[i] = (found.sigma_pa - 250.0) / found.std_error_pa
        motion[i] = found.motion
    assert abs(z.mean()) < 0.3
    assert 0.7 < z.std() < 1.25
    assert motion.mean() <= 0.01


def test_five_readings_are_one_prediction_from_four_neighbours() -> None:
    """Lagrange's formula written out, normalised so that white noise keeps its variance."""
    time = np.array([0.0, 0.021, 0.058, 0.079, 0.125])
    values = np.array([1e5, 1.003e5, 0.998e5, 1.001e5, 1.006e5])
    others = [0, 1, 3, 4]
    weights = np.array(
        [
            np.prod([(time[2] - time[k]) / (time[j] - time[k]) for k in others if k != j])
            for j in others
        ]
    )
    error = (values[2] - weights @ values[others]) / np.sqrt(1.0 + weights @ weights)
    assert noise_floor(time, values).sigma_pa == pytest.approx(abs(error), rel=1e-9)


def test_what_is_smooth_is_no_noise() -> None:
    rng = np.random.default_rng(12)
    time = instants("uneven", 1000, rng)
    cubic = 3e5 + 5e4 * (time - 9.0) - 2e4 * (time - 9.0) ** 2 + 3e3 * (time - 9.0) ** 3
    values = rng.normal(0.0, 250.0, time.size)
    still, moved = noise_floor(time, values), noise_floor(time, values + cubic)
    assert moved.sigma_pa == pytest.approx(250.0, abs=3.0 * moved.std_error_pa)
    assert still.sigma_pa == pytest.approx(moved.sigma_pa, rel=0.1)
    assert not moved.motion


# ---- noise under motion -------------------------------------------------------------------------


def test_quantised_white_noise_on_transients() -> None:
    rng = np.random.default_rng(4)
    estimates = []
    for _ in range(20):
        t = np.arange(7500) / 500.0
        # Fills with 20 ms fronts every half second: they pass through most windows' quiet.
        true = 3e5 + 2e5 * np.tanh(np.sin(2.0 * np.pi * t) / 0.1)
        measured = true + rng.normal(0.0, 250.0, t.size)
        found = noise_floor(t, np.round(measured / 170.0) * 170.0)
        assert found.resolution_pa == pytest.approx(170.0)
        estimates.append(found.sigma_pa)
    assert np.mean(estimates) == pytest.approx(TRUE_PA, rel=0.03)
    assert np.std(estimates) < 0.05 * TRUE_PA


@pytest.mark.parametrize("kind", ["even", "uneven"])
def test_rests_between_moves_are_enough_for_sparse_readings(kind: str) -> None:
    rng = np.random.default_rng(13)
    motions = 0
    for _ in range(20):
        time = np.arange(600) * 0.05 if kind == "even" else instants(kind, 800, rng)
        since, level = np.modf(time / 1.5)
        goals = rng.uniform(1.2e5, 6e5, 40)
        before, after = goals[level.astype(int)], goals[level.astype(int) + 1]
        true = after + (before - after) * np.exp(-since * 1.5 / 0.03)
        found = noise_floor(time, true + rng.normal(0.0, 250.0, time.size))
        assert found.sigma_pa == pytest.approx(250.0, abs=4.0 * found.std_error_pa)
        assert found.sigma_pa == pytest.approx(250.0, rel=0.35)
        motions += found.motion
    assert motions <= 5  # the moves' tails are no rests


def test_motion_without_rest_is_called_motion() -> None:
    rng = np.random.default_rng(14)
    for _ in range(20):
        time = instants("uneven", 430, rng)
        waves = rng.uniform(0.5, 6.0, 12), rng.uniform(0.0, 6.3, 12), rng.normal(0.0, 2e4, 12)
        true = 3e5 + sum(a * np.sin(6.3 * f * time + p) for f, p, a in zip(*waves, strict=True))
        found = noise_floor(time, true + rng.normal(0.0, 250.0, time.size))
        assert found.sigma_pa > 375.0 and found.motion
        assert "at most" in found.sentence and "\n" not in found.sentence


@pytest.mark.long
@pytest.mark.parametrize(("every", "most"), [(1, 1.08), (4, 1.15), (5, 1.2), (10, 1.5)])
def test_recordings_of_a_known_sensor(recorded: dict[str, Signal], every: int, most: float) -> None:
    ratios = [found.sigma_pa / TRUE_PA for _, found in thinned(recorded, every)]
    assert min(ratios) > 0.8
    assert max(ratios) < most
    assert np.median(ratios) < 1.1


@pytest.mark.parametrize("every", [10, 25, 0])
def test_sparse_readings_of_a_known_sensor(recorded: dict[str, Signal], every: int) -> None:
    """Where the pressure moves too much between readings, that is said."""
    for name, found in thinned(recorded, every):
        assert found.motion or found.sigma_pa < 1.5 * TRUE_PA, name
        if "exhaust" in name:  # rests for two thirds of the time
            assert found.sigma_pa == pytest.approx(TRUE_PA, abs=3.5 * found.std_error_pa), name
            assert found.sigma_pa == pytest.approx(TRUE_PA, rel=0.25), name


# ---- edges --------------------------------------------------------------------------------------


def test_silent_and_few_readings() -> None:
    flat = noise_floor(np.arange(500.0), np.full(500, 1e5))
    assert (flat.sigma_pa, flat.std_error_pa, flat.motion) == (0.0, 0.0, False)
    for values in (np.full(500, np.nan), np.array([1.0, 2.0, 4.0]), np.zeros(0)):
        few = noise_floor(np.arange(float(values.size)), values)
        assert np.isnan(few.sigma_pa) and not few.motion
        assert "too few" in few.sentence


def test_noise_below_the_resolution_counts_as_rounding() -> None:
    slow = np.round(np.linspace(1e5, 1.02e5, 5000) / 100.0) * 100.0
    found = noise_floor(np.arange(5000) * 0.002, slow)
    assert found.sigma_pa == pytest.approx(100.0 / np.sqrt(12.0), rel=0.05)
    assert found.resolution_pa == 100.0 and not found.motion
    assert "finer than the readings' scale of 100 Pa" in found.sentence


def test_few_readings_of_many_levels_show_their_resolution() -> None:
    rng = np.random.default_rng(15)
    values = np.round(rng.uniform(1e5, 6e5, 300) / 170.0) * 170.0
    assert 2 * np.unique(values).size > 300
    assert noise_floor(np.arange(300) * 0.05, values).resolution_pa == pytest.approx(170.0)
    assert noise_floor(np.arange(300) * 0.05, rng.normal(1e5, 250.0, 300)).resolution_pa == 0.0


def test_gaps_and_values_that_are_missing_do_no_harm() -> None:
    rng = np.random.default_rng(16)
    time = np.arange(6000) * 0.002
    values = 1e5 + 4e5 * (time > 6.0) + rng.normal(0.0, 80.0, time.size)
    values[rng.integers(0, 6000, 20)] = np.nan
    keep = (time < 5.9) | (time > 6.1)
    found = noise_floor(time[keep], values[keep])
    assert found.sigma_pa == pytest.approx(80.0, abs=3.5 * found.std_error_pa)
    assert found.std_error_pa < 3.0 and not found.motion


def test_a_sensor_that_stuck_for_a_while_is_still_noisy() -> None:
    rng = np.random.default_rng(17)
    values = rng.normal(2e5, 250.0, 2000)
    values[500:1200] = values[500]
    found = noise_floor(np.arange(2000) * 0.002, values)
    assert found.sigma_pa == pytest.approx(250.0, rel=0.08)
