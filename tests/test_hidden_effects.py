# SPDX-License-Identifier: Apache-2.0
"""On recordings with a hidden effect the missing physics is named, placed and added."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from studies.synthetic import NOISE_PA, RATE_HZ, synthetic

from pneu_sim.effects.registry import BUILT_IN
from pneu_sim.rig import load_rig
from pneu_sim.rig.schema import AttachedEffect, Rig
from pneu_sysid.compare import compare
from pneu_sysid.diagnose import diagnose
from pneu_sysid.learn import learn
from pneu_sysid.problem import record_for
from pneu_sysid.records import Recording, Signal

pytestmark = pytest.mark.takes(20)

ROOT = Path(__file__).resolve().parent.parent
BAGS = ROOT / "data" / "bags"
SECONDS = 3.0
"""Length of recordings made here."""
PART_S = 5.0
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
    assert (hole.added, hole.place, hole.unit) == ("leak", "tube:2.50", "m^2, effective")
    for step, truth in ((delay, 3e-3), (hole, 2e-8)):
        assert step.strength == pytest.approx(truth, rel=0.02)
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
