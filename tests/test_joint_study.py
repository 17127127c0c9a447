# SPDX-License-Identifier: Apache-2.0
"""Joints drawn at random for the studies: what they are, is recorded of them, effects change."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from studies import confusion_cases
from studies.bags import KNOWN, rig_file
from studies.calibration_rigs import Case, draw_asked, draw_case, noises, run_plant, sampled
from studies.confusion import CLASSES, of_one_kind
from studies.confusion_cases import apart, load_recording, recordings_of
from studies.joint_runs import RESTART_S, Excitation

from pneu_sim.effects import registry
from pneu_sim.plant import Plant
from pneu_sim.rig import load_rig
from pneu_sim.rig.schema import AttachedEffect, Rig

SECONDS = 1.0
MECHANICAL = {"cylinder", "side of a cylinder", "joint", "joint with a crank", "encoder"}


def joint(seed: int) -> Case:
    """A joint on cheap cells, without recordings."""
    case = draw_case("joint", seed, count=0)
    case.truth.grid = case.truth.grid.model_copy(update={"dx_m": 0.1, "flux": "hllc"})
    return case


def with_effect(rig: Rig, effect: str, place: str, **values: float) -> Rig:
    """A rig with an effect attached."""
    attached = AttachedEffect(effect=effect, place=place, parameters=values)
    return rig.model_copy(update={"effects": [attached]})


@pytest.mark.parametrize("seed", range(4))
def test_pistons_reach_both_stops_and_no_cylinder_head(seed: int) -> None:
    case = draw_case("joint", seed, count=0)
    for rig in (case.truth, case.datasheet):
        body, stroke = rig.bodies["arm"], rig.cylinders["forearm"].stroke_m
        slider, theta = body.slider, body.theta  # type: ignore[attr-defined]
        for stop in (theta.lower, theta.upper):
            pin = slider.crank_m * np.array([math.cos(stop), math.sin(stop)])
            length = math.hypot(pin[0], pin[1] + slider.pivot_m)
            assert 1e-3 < length - slider.closed_length_m < stroke - 1e-3
        Plant([rig])
    assert case.truth.cylinders["forearm"].friction.presliding_m_n > 0.0
    assert case.datasheet.cylinders["forearm"].friction.presliding_m_n == 0.0
    assert case.datasheet.encoders["elbow"].noise == 0.0


def test_a_recording_is_of_the_joint_in_its_own_loop() -> None:
    case = joint(3)
    asked = draw_asked(case.truth, 4.0, np.random.default_rng(1))
    assert isinstance(asked, Excitation)
    run = run_plant(case.truth, asked, 200.0)
    own = np.isnan(asked.volts["head"])
    assert 0.3 < own.mean() < 0.7
    head, rod = run.volts["head"], run.volts["rod"]
    np.testing.assert_array_equal(head[~own], asked.volts["head"][~own])
    np.testing.assert_allclose(head[own] + rod[own], 10.0)
    assert np.ptp(head[own]) > 0.1 and head.min() >= 0.0 and head.max() <= 10.0
    made = [
        sampled(case.truth, run, np.random.default_rng(2), case.rate_hz, 200.0, "joint")
        for _ in range(2)
    ]
    assert set(made[0].encoders) == {"elbow"} and len(made[0].pressures) == 4
    read = made[0].encoders["elbow"]
    np.testing.assert_array_equal(read.values, made[1].encoders["elbow"].values)
    true = np.interp(read.time_s, run.time_s, run.readings["elbow"])
    sigma = noises(case.truth, 200.0)["elbow"]
    assert np.std(read.values - true) == pytest.approx(sigma, rel=0.1)
    theta = case.truth.bodies["arm"].joints[1]
    assert theta.lower is not None and theta.upper is not None
    assert theta.lower - 0.2 < true.min() and true.max() < theta.upper + 0.2


def test_gains_steer_the_joint_to_its_target() -> None:
    case = joint(3)
    drawn = draw_asked(case.truth, 4.0, np.random.default_rng(1))
    assert isinstance(drawn, Excitation)
    asked = drawn._replace(
        volts={name: np.full_like(v, np.nan) for name, v in drawn.volts.items()},
        target_rad=np.full_like(drawn.target_rad, 0.3),
        gains=drawn.gains._replace(kp=2.0, kd=0.2, ki=2.0, k_pressure=0.01),
    )
    run = run_plant(case.truth, asked)
    assert run.readings["elbow"][-1] == pytest.approx(0.3, abs=0.05)


def test_a_joint_beside_tells_what_an_effect_changes() -> None:
    case = joint(5)
    plant = case.truth
    asked = draw_asked(plant, SECONDS, np.random.default_rng(1))
    noise = noises(plant, 200.0)
    same = run_plant(plant, asked, 200.0, plant)
    assert apart(same.readings, same.beside, noise) == 0.0
    biased = run_plant(with_effect(plant, "encoder_bias", "elbow", bias=0.01), asked, 200.0, plant)
    assert apart(biased.readings, biased.beside, noise) == pytest.approx(0.01 / noise["elbow"])
    ahead = with_effect(plant, "clock_offset", "head_port", offset_s=-0.01)
    early = run_plant(ahead, asked, 200.0, plant)
    shift = round(0.01 / (early.time_s[1] - early.time_s[0]))
    later = early.beside["head_port"][shift:]
    steady = round(RESTART_S / (early.time_s[1] - early.time_s[0]))
    np.testing.assert_allclose(
        early.readings["head_port"][1 : steady - shift], later[1 : steady - shift], rtol=1e-9
    )


def test_every_effect_that_has_a_place_runs_beside_a_healthy_joint() -> None:
    plant = joint(5).truth
    hit = set()
    for effect in registry().values():
        for place in effect.places(plant)[:1]:
            values = {p.name: p.typical for p in effect.parameters}
            assert Plant([with_effect(plant, effect.name, place, **values), plant]).lanes == 2
            hit.add(effect.where)
    assert hit >= MECHANICAL


def test_recordings_of_a_joint_are_made_once_and_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = replace(joint(6), rate_hz=250.0)
    chosen = {name: registry()[name] for name in ("payload", "encoder_gain", "chamber_leak")}
    monkeypatch.setattr(confusion_cases, "registry", lambda: chosen)
    monkeypatch.setattr(confusion_cases, "draw_case", lambda *_, **__: case)
    monkeypatch.setattr(confusion_cases, "SECONDS", SECONDS)
    monkeypatch.setattr(confusion_cases, "HEALTHY", 1)
    made = recordings_of("joint", 6, tmp_path)
    assert [i.effect for i, _ in made] == ["", "payload", "encoder_gain"]
    assert made[1][0].place == "elbow" and made[2][0].felt > 3.0
    before = made[1][1].stat().st_mtime_ns
    again = recordings_of("joint", 6, tmp_path)
    assert again[1][0] == made[1][0] and made[1][1].stat().st_mtime_ns == before
    assert len(load_recording(made[1][1]).encoders["elbow"]) == round(SECONDS * 250.0) - 1


def test_look_alikes_of_mechanics_are_of_one_kind() -> None:
    assert of_one_kind("piston_friction", "joint_friction")
    assert of_one_kind("payload", "external_spring")
    assert not of_one_kind("piston_leak", "piston_friction")
    assert set().union(*CLASSES) <= set(registry())


def test_labels_of_the_joint_s_bags_are_places_of_its_rig() -> None:
    rig = load_rig(rig_file("j"))
    labels = {name: label for name, label in KNOWN.items() if name.startswith("j_")}
    assert len(labels) == 8
    for label in labels.values():
        assert label.place in registry()[label.effect].places(rig)
