# SPDX-License-Identifier: Apache-2.0
"""On recordings with a hidden effect the missing physics is named, placed and added."""

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from studies.synthetic import NOISE_PA, RATE_HZ, commands, synthetic

from pneu_common.errors import InputError
from pneu_sim.effects.registry import BUILT_IN
from pneu_sim.rig import load_rig
from pneu_sim.rig.schema import AttachedEffect, Calibration, Rig
from pneu_sim.run import add_noise, run_rig
from pneu_sysid.compare import compare
from pneu_sysid.diagnose import diagnose
from pneu_sysid.learn import add_effect, learn, refit_added
from pneu_sysid.problem import make_problem, record_for
from pneu_sysid.records import Recording, Signal, even_recording

pytestmark = pytest.mark.takes(20)

ROOT = Path(__file__).resolve().parent.parent
BAGS = ROOT / "data" / "bags"
SECONDS = 3.0
"""Length of recordings made here."""
PART_S = 3.0
"""How much of a bag is used: the steps at its beginning and some tracking; docs/bags.md has all."""


@pytest.fixture(scope="module")
def rig() -> Rig:
    """Rig A, calibrated on a healthy recording of an independent plant."""
    return load_rig(ROOT / "rigs" / "rig_a_fitted.yaml")


@pytest.fixture(scope="module")
def exact(rig: Rig) -> Rig:
    """The same on cheap cells, for recordings made from it: its calibration is exact there."""
    assert rig.calibration is not None
    floor = dict.fromkeys(rig.taps, NOISE_PA)
    return rig.model_copy(
        update={
            "calibration": rig.calibration.model_copy(update={"rmse_pa": floor}),
            "grid": rig.grid.model_copy(update={"dx_m": 0.125, "memory": False}),
        }
    )


def part_of_bag(rig: Rig, name: str) -> Recording:
    """The first seconds of a bag."""

    def part(signal: Signal) -> Signal:
        early = signal.time_s < PART_S
        return Signal(signal.time_s[early], signal.values[early])

    whole = record_for(rig, str(BAGS / name))
    return dataclasses.replace(
        whole,
        commands={name: part(signal) for name, signal in whole.commands.items()},
        pressures={name: part(signal) for name, signal in whole.pressures.items()},
    )


def with_effects(rig: Rig, *effects: AttachedEffect) -> Rig:
    """The rig with effects attached."""
    return rig.model_copy(update={"effects": list(effects)})


def test_healthy_bag_is_predicted_and_nothing_is_missing(rig: Rig) -> None:
    """A recording the calibration never saw: near the noise, far below the thin plate."""
    recording = part_of_bag(rig, "a_healthy_2")
    plate = load_rig(ROOT / "rigs" / "rig_a_thin_plate.yaml")
    result = compare(recording, [("pde", rig, None), ("plate", plate, None)], refine=False)
    pde, lumped = (model.taps for model in result.models)
    for tap in rig.taps:
        assert pde[tap].times_noise < 3.0
    for tap in ("valve_out", "middle", "end"):
        assert lumped[tap].rmse_pa > 4.0 * pde[tap].rmse_pa
    assert diagnose(rig, recording, refine=False).verdict == "nothing_missing"


@pytest.mark.parametrize("calibrated", [True, False])
def test_a_rig_that_was_never_calibrated_is_fitted_first(exact: Rig, calibrated: bool) -> None:
    """Ends at the first stage, which takes its name from what begins."""

    def begun(stage: str, done: float) -> None:
        raise InterruptedError(stage)

    rig = exact if calibrated else exact.model_copy(update={"calibration": None})
    with pytest.raises(InterruptedError) as first:
        learn(rig, synthetic(exact, 0.2, 5, "healthy"), progress=begun)
    assert (str(first.value) == "fit") is not calibrated


@pytest.mark.long
def test_two_effects_are_added_one_after_the_other(exact: Rig, tmp_path: Path) -> None:
    """The whole loop, with few other effects to try, on a recording of 2 s."""
    leak = AttachedEffect(
        effect="leak", place="tube", parameters={"area_m2": 2e-8, "position_m": 2.5}
    )
    late = AttachedEffect(effect="valve_delay", place="valve", parameters={"delay_s": 3e-3})
    tried = {"leak", "valve_delay", "sensor_gain", "sensor_lag"}
    others = {effect.name for effect in BUILT_IN} - tried
    recording = synthetic(with_effects(exact, leak, late), 2.0, 5, "two effects")
    learned = learn(exact, recording, out=tmp_path, without=others)
    assert learned.verdict == "effect"
    assert "valve transport delay at valve" in learned.sentence and "leak" in learned.sentence
    assert [step.step for step in learned.steps] == [0, 1, 2]
    first, delay, hole = learned.steps
    assert (first.added, first.place, first.strength) == (None, None, None)
    assert (delay.added, delay.place, delay.unit) == ("valve_delay", "valve", "s")
    assert (hole.added, hole.unit) == ("leak", "m^2, effective")
    pipe, _, position_m = hole.place.partition(":")
    # A small leak sets the gas of a whole line in motion: two seconds tell its half, and no more.
    assert pipe == "tube" and float(position_m) == pytest.approx(2.5, abs=0.4)
    for step, truth, within in ((delay, 3e-3, 0.02), (hole, 2e-8, 0.05)):  # on cells of 0.125 m
        assert step.strength == pytest.approx(truth, rel=within)
    left = [step.held_out_times_noise for step in learned.steps]
    assert left[0] > 1.5 * left[1] and left[1] > 5.0 * left[2] and left[2] < 1.3
    # Each step is a rig file that predicts as well as the step says.
    assert [e.effect for e in learned.rig.effects] == ["valve_delay", "leak"]
    for step in learned.steps:
        saved = load_rig(tmp_path / f"step_{step.step}.yaml")
        assert len(saved.effects) == step.step
        found = compare(recording, [("saved", saved, None)], refine=False).models[0].taps
        for tap, rmse_pa in step.rmse_pa.items():
            both = (rmse_pa, step.held_out_rmse_pa[tap])
            assert min(both) < 1.1 * found[tap].rmse_pa and found[tap].rmse_pa < 1.1 * max(both)
    told = json.loads((tmp_path / "learn.json").read_text(encoding="utf-8"))
    assert [step["step"] for step in told["steps"]] == [0, 1, 2]


LATE = AttachedEffect(effect="valve_delay", place="valve", parameters={"delay_s": 3e-3})


def all_but(*names: str) -> set[str]:
    """Names of all effects of the catalogue but some."""
    return {effect.name for effect in BUILT_IN} - set(names)


def test_an_effect_of_one_recording_is_absent_in_the_others(exact: Rig, tmp_path: Path) -> None:
    """The rig then predicts both recordings; only the one that differs was learned from."""
    recordings = [
        synthetic(exact, 1.0, 5, "monday"),
        synthetic(with_effects(exact, LATE), 1.9, 6, "tuesday"),
    ]
    others = all_but("valve_delay", "sensor_gain")
    learned = learn(exact, recordings, out=tmp_path, without=others)
    assert learned.sentence.startswith("In tuesday alone: Missing: valve transport delay at valve")
    first, after = learned.steps
    assert first.held_out_times_noise > 10.0 * after.held_out_times_noise
    assert (
        f"the held-out error falls from {first.held_out_times_noise:.2f} to"
        f" {after.held_out_times_noise:.2f} times the noise." in learned.sentence
    )
    (found,) = learned.diagnoses
    assert found.unchanged == ["monday"]
    assert [r.name for r in found.problem.recordings] == ["tuesday"]
    changed, _, about = found.statements
    assert changed == ("Something changed in tuesday since the calibration, and nothing in monday.")
    assert about == "The verdict is of tuesday; the model without it explains monday."
    assert found.sentence.startswith("In tuesday alone: Missing: ")
    saved = load_rig(tmp_path / "step_1.yaml")
    for rig in (learned.rig, learned.rigs[-1], saved):
        assert rig.recordings == {"monday": {"effects.0.parameters.delay_s": 0.0}}
        assert rig.effects[0].parameters["delay_s"] == pytest.approx(3e-3, rel=0.02)
    errors = compare(recordings, [("saved", saved, None)], refine=False).models[0].by_recording
    assert set(errors) == {"monday", "tuesday"} and max(errors.values()) < 2.0  # by the cells


def test_a_recording_of_one_stretch_is_judged_on_all_of_it(exact: Rig) -> None:
    """Nothing can be held out of it, so the error that falls is that of all readings."""
    recording = synthetic(with_effects(exact, LATE), 1.0, 6, "short")
    learned = learn(exact, recording, without=all_but("valve_delay", "sensor_gain"))
    assert learned.diagnoses[0].problem.stretches == 1
    assert learned.verdict == "effect"
    first, after = learned.steps
    assert (first.held_out_times_noise, after.held_out_times_noise) == (None, None)
    assert after.strength == pytest.approx(3e-3, rel=0.02)
    assert (
        f"with that the error falls from {first.total_times_noise:.2f} to"
        f" {after.total_times_noise:.2f} times the noise." in learned.sentence
    )
    assert first.total_times_noise > 10.0 * after.total_times_noise


def _lumped(effects: Sequence[AttachedEffect], seconds: float, seed: int) -> tuple[Rig, Recording]:
    """Rig A as a thin plate, and a recording of it with effects, made by itself."""
    plate = load_rig(ROOT / "rigs" / "rig_a_thin_plate.yaml")
    noise = dict.fromkeys(plate.taps, NOISE_PA)
    told = Calibration(recording="before", rmse_pa=noise, noise_floor_pa=noise)
    plate = plate.model_copy(update={"calibration": told})
    rng = np.random.default_rng(seed)
    volts = commands(seconds, rng)
    taps = run_rig(with_effects(plate, *effects), {"voltage": volts}, 1.0 / RATE_HZ)
    taps = add_noise(plate, taps, rng, NOISE_PA)
    time = np.arange(len(taps["end"])) / RATE_HZ
    return plate, even_recording("plate", time, {"voltage": volts[: time.size]}, taps)


def test_a_lumped_model_learns_too() -> None:
    """It has no cells that could be longer, nor any place along a line."""
    plate, recording = _lumped([LATE], 2.0, 4)
    others = all_but("valve_delay", "sensor_gain", "leak")
    learned = learn(plate, recording, without=others)
    assert learned.verdict == "effect"
    (step,) = learned.steps[1:]
    assert (step.added, step.place) == ("valve_delay", "valve")
    assert step.strength == pytest.approx(3e-3, rel=0.01)
    assert learned.steps[0].held_out_times_noise > 10.0 and step.held_out_times_noise < 1.1
    bench = learned.diagnoses[0].bench
    assert bench.coarser(plate) is bench.problem and bench.grid_pa is None
    problem, wrong = bench.faithful(learned.rig, bench.readings)
    assert problem is bench.problem and not wrong.any()


def test_an_effect_that_is_asked_for_is_added() -> None:
    """Where it explains most, or where it is asked for."""
    gain = AttachedEffect(effect="sensor_gain", place="end", parameters={"error": 0.03})
    plate, recording = _lumped([gain], 2.0, 5)
    better, before, after = add_effect(plate, recording, "sensor_gain")
    (found,) = better.effects
    assert (found.effect, found.place) == ("sensor_gain", "end")
    assert found.parameters["error"] == pytest.approx(0.03, rel=0.02)
    assert (before.step, before.added) == (0, None)
    assert (after.step, after.added, after.place) == (1, "sensor_gain", "end")
    assert after.strength == found.parameters["error"] and after.std_error < 1e-3
    assert before.held_out_times_noise > 3.0 > 1.1 > after.held_out_times_noise
    assert before.held_out_rmse_pa["end"] > 3.0 * before.held_out_rmse_pa["middle"]
    # Elsewhere it explains nothing.
    better, _, after = add_effect(plate, recording, "sensor_gain", "middle")
    assert better.effects[0].place == after.place == "middle"
    assert abs(after.strength) < 4.0 * after.std_error
    # A lumped model does not show where a leak is: it is left where it was asked for.
    _, _, after = add_effect(plate, recording, "leak", "tube", 0.7)
    assert after.place == "tube:0.70"
    with pytest.raises(InputError, match="place 'nowhere' is not one of supply, valve_out"):
        add_effect(plate, recording, "sensor_gain", "nowhere")
    with pytest.raises(InputError, match=f"rig {plate.name!r} has no place for it"):
        add_effect(plate, recording, "chamber_leak")


def test_a_ripple_that_is_asked_for_has_the_frequency_of_the_residual(exact: Rig) -> None:
    """Far from the frequency that it is usually tried with, fits would not find the way."""
    ripple = AttachedEffect(
        effect="supply_ripple",
        place="supply",
        parameters={"amplitude_pa": 2e4, "frequency_hz": 23.0, "phase_rad": 0.4},
    )
    longer = exact.model_copy(update={"grid": exact.grid.model_copy(update={"dx_m": 0.25})})
    recording = synthetic(with_effects(longer, ripple), 2.0, 6, "pump", np.full(1000, 6.0))
    better, before, after = add_effect(longer, recording, "supply_ripple")
    (found,) = better.effects
    assert found.parameters["frequency_hz"] == pytest.approx(23.0, abs=0.05)
    assert found.parameters["amplitude_pa"] == pytest.approx(2e4, rel=0.05)
    assert before.held_out_times_noise > 5.0 * after.held_out_times_noise


def test_added_effects_are_fitted_again_until_that_gains_nothing() -> None:
    """It is said what is left without the last of them, with it, and after each iteration."""
    gain = AttachedEffect(effect="sensor_gain", place="end", parameters={"error": 0.03})
    plate, recording = _lumped([LATE, gain], 2.0, 7)
    problem = make_problem(plate, recording)
    told: list[tuple[float, float]] = []

    def note(done: float, errors: dict[str, float]) -> None:
        told.append((done, errors["end"]))

    near = [
        LATE.model_copy(update={"parameters": {"delay_s": 1e-3}}),
        gain.model_copy(update={"parameters": {"error": 0.001}}),
    ]
    found = refit_added(problem, with_effects(plate, *near), 2, note)
    assert found.effects[0].parameters["delay_s"] == pytest.approx(3e-3, rel=0.01)
    assert found.effects[1].parameters["error"] == pytest.approx(0.03, rel=0.02)
    assert [done for done, _ in told] == [0.0, 0.0, *(k / 4 for k in range(1, len(told) - 1))]
    assert told[0][1] > told[1][1] > told[2][1] and told[-1][1] < 1.1
    # Where all is as it should be nothing is changed, or by less than it is known to.
    told.clear()
    again = refit_added(problem, found, 1, note)
    assert len(told) == 3
    assert again.effects[0] == found.effects[0]
    assert again.effects[1].parameters["error"] == pytest.approx(0.03, rel=0.02)


@pytest.mark.long
def test_tap_lag_is_named_and_measured(rig: Rig) -> None:
    """A bag of the independent plant whose ``end`` sensor lags by 6 ms."""
    found = diagnose(rig, part_of_bag(rig, "a_tap_lag"), refine=False)
    top = found.finalists[0]
    assert found.verdict in ("effect", "ambiguous")
    assert (top.site.effect.name, top.site.place) == ("sensor_lag", "end")
    assert top.strength == pytest.approx(6e-3, rel=0.2)


@pytest.mark.long
def test_two_effects_at_once_are_both_found(exact: Rig) -> None:
    """A leak and a late valve together, recorded on a finer grid."""
    leak = AttachedEffect(
        effect="leak", place="tube", parameters={"area_m2": 2e-8, "position_m": 2.5}
    )
    late = AttachedEffect(effect="valve_delay", place="valve", parameters={"delay_s": 3e-3})
    recording = synthetic(with_effects(exact, leak, late), SECONDS, 5, "two effects")
    learned = learn(exact, recording)
    found = {step.added: step for step in learned.steps[1:]}
    assert {"leak", "valve_delay"} <= set(found)
    assert learned.rig.effects[-1].effect in found
    strengths = {e.effect: e.parameters for e in learned.rig.effects}
    assert strengths["leak"]["area_m2"] == pytest.approx(2e-8, rel=0.2)
    assert strengths["valve_delay"]["delay_s"] == pytest.approx(3e-3, rel=0.2)
    # What is left is what a healthy recording on that finer grid leaves too.
    healthy = synthetic(exact, SECONDS, 5, "healthy")
    after = compare(recording, [("after", learned.rig, None)], refine=False).models[0]
    alone = compare(healthy, [("healthy", exact, None)], refine=False).models[0]
    assert after.times_noise <= 1.2 * alone.times_noise


@pytest.mark.long
def test_what_no_catalogue_holds_is_called_unknown(exact: Rig) -> None:
    """A sensor with a wavy characteristic: no effect fits, but what it depends on is named."""
    clean = synthetic(exact, SECONDS, 6, "wavy sensor")
    end = clean.pressures["end"]
    wave = 8e3 * np.sin(2.0 * np.pi * (end.values - 101e3) / 130e3)
    wavy = Signal(end.time_s, end.values + wave)
    recording = dataclasses.replace(clean, pressures={**clean.pressures, "end": wavy})
    found = diagnose(exact, recording, refine=False)
    assert found.verdict == "unknown"
    variable, tap, gain = found.depends_on[0]
    assert tap == "end"
    assert "pressure" in variable
    assert gain > 0.3


@pytest.mark.long
def test_healthy_synthetic_recording_raises_no_alarm(exact: Rig) -> None:
    """Noise alone is not taken for physics."""
    found = diagnose(exact, synthetic(exact, SECONDS, 7, "healthy"), refine=False)
    assert found.verdict == "nothing_missing"


@pytest.mark.long
def test_an_effect_that_a_few_steps_show_is_found(exact: Rig) -> None:
    """A spool limited in speed is felt where the command moves far, here within half a second."""
    rng = np.random.default_rng(8)
    time = np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ
    volts = 5.0 + np.repeat(rng.uniform(-0.5, 0.5, 30), time.size // 30)
    for begin, value in ((2.0, 10.0), (2.2, 0.0), (2.4, 10.0), (2.6, 0.0), (2.75, 5.0)):
        volts[time >= begin] = value
    slow = AttachedEffect(
        effect="spool_speed_limit", place="valve", parameters={"slowness_s_v": 3e-3}
    )
    recording = synthetic(with_effects(exact, slow), SECONDS, 8, "few steps", volts)
    found = diagnose(exact, recording, refine=False)
    top = found.finalists[0]
    assert found.verdict in ("effect", "ambiguous")
    assert top.site.effect.name == "spool_speed_limit"
    assert top.strength == pytest.approx(3e-3, rel=0.2)


@pytest.mark.long
def test_an_effect_far_stronger_than_usual_is_found(exact: Rig) -> None:
    """A line that yields five times as much as lines do is another thing than one that yields."""
    soft = AttachedEffect(
        effect="wall_compliance", place="supply_line", parameters={"compliance_per_pa": 5e-7}
    )
    learned = learn(exact, synthetic(with_effects(exact, soft), SECONDS, 5, "soft"))
    step = learned.steps[1]
    assert (step.added, step.place) == ("wall_compliance", "supply_line")
    assert step.strength == pytest.approx(5e-7, rel=0.2)


@pytest.mark.long
def test_a_place_is_told_with_how_far_it_may_be_from_there(exact: Rig) -> None:
    """A volume between two taps does nearly the same wherever it is; a leak does not."""
    volume = AttachedEffect(
        effect="dead_volume", place="tube", parameters={"volume_m3": 2e-6, "position_m": 0.7}
    )
    leak = AttachedEffect(
        effect="leak", place="tube", parameters={"area_m2": 3e-8, "position_m": 1.8}
    )
    errors = {}
    for hidden in (volume, leak):
        learned = learn(exact, synthetic(with_effects(exact, hidden), SECONDS, 5, "somewhere"))
        found, step = learned.rig.effects[-1], learned.steps[-1]
        assert (found.effect, found.place) == (hidden.effect, hidden.place)
        off_m = abs(found.parameters["position_m"] - hidden.parameters["position_m"])
        errors[found.effect] = step.position_error_m
        assert off_m <= 2.0 * step.position_error_m
        assert f"± {step.position_error_m:.2f} m" in learned.sentence
    assert errors["dead_volume"] > errors["leak"]


@pytest.mark.long
@pytest.mark.parametrize("begin_s", [1.0, 2.5])
def test_what_happens_once_is_not_nothing(exact: Rig, begin_s: float) -> None:
    """A sensor is jolted for a moment: no effect is named, and when it was is said."""
    clean = synthetic(exact, SECONDS, 7, "jolted")
    end = clean.pressures["end"]
    jolt = 2e4 * np.exp(-0.5 * ((end.time_s - begin_s - 0.2) / 0.03) ** 2)
    jolted = Signal(end.time_s, end.values + jolt)
    recording = dataclasses.replace(clean, pressures={**clean.pressures, "end": jolted})
    found = diagnose(exact, recording, refine=False)
    assert found.verdict == "unknown"
    assert "most of it is at" in found.sentence
