# SPDX-License-Identifier: Apache-2.0
"""A robot's recordings with a hidden mechanical effect: it is named, sized and added."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from pneu_sim.rig import load_rig
from pneu_sim.rig.schema import AttachedEffect, Calibration, Rig
from pneu_sim.simulator import Simulator
from pneu_sysid.diagnose import diagnose
from pneu_sysid.records import Recording
from pneu_sysid.records.recording import even_recording

RIG = Path(__file__).resolve().parents[1] / "rigs" / "kokoro.yaml"
SECONDS, RATE_HZ = 6.0, 250
NOISE_PA, NOISE_RAD = 250.0, 2.5e-4


def robot(dx_m: float) -> Rig:
    """A joint whose seals give way before they slide, calibrated exactly."""
    rig = load_rig(RIG)
    rig.grid.dx_m = dx_m
    seals = rig.cylinders["forearm"].friction
    seals.coulomb_n, seals.breakaway_n, seals.stribeck_m_s = 8.0, 3.0, 0.02
    seals.presliding_m_n, seals.presliding_n_s_m = 5e-6, 400.0
    joint = rig.bodies["arm"].joints[1]
    joint.stop_damping, joint.stop_hold = 8.0, 0.5
    rig.encoders["elbow"].noise = NOISE_RAD
    for tap in rig.taps.values():
        tap.noise_pa = NOISE_PA
    floor = dict.fromkeys(rig.taps, NOISE_PA)
    rig.calibration = Calibration(
        recording="itself",
        rmse_pa=floor,
        noise_floor_pa=floor,
        rmse={"elbow": NOISE_RAD},
        noise_floor={"elbow": NOISE_RAD},
    )
    return rig


def recorded(seed: int, dx_m: float = 0.125, **effects: tuple[str, dict[str, float]]) -> Recording:
    """What the sensors of a plant record while its two valves sway and step."""
    plant = robot(dx_m)
    plant.effects = [
        AttachedEffect(effect=name, place=place, parameters=values)
        for name, (place, values) in effects.items()
    ]
    rng = np.random.default_rng(seed)
    samples = round(SECONDS * RATE_HZ)
    time = np.arange(samples) / RATE_HZ
    levels = np.repeat(rng.uniform(-0.6, 0.6, samples // 60 + 1), 60)[:samples]
    sway = 1.6 * np.sin(2.0 * np.pi * np.cumsum(0.7 + 0.5 * np.sin(0.9 * time)) / RATE_HZ)
    head = 5.0 + sway + levels
    volts = {"head": head, "rod": 10.0 - head + 0.3 * rng.standard_normal(1)}
    out = Simulator(plant).run(SECONDS, volts, 1.0 / RATE_HZ)
    keep = slice(0, samples)
    return even_recording(
        "robot",
        time,
        volts,
        {n: p[keep] + NOISE_PA * rng.standard_normal(samples) for n, p in out.taps.items()},
        {n: q[keep] + NOISE_RAD * rng.standard_normal(samples) for n, q in out.encoders.items()},
    )


@cache
def model() -> Rig:
    return robot(0.25)


@pytest.mark.long
def test_nothing_is_missing_of_a_healthy_robot() -> None:
    found = diagnose(model(), recorded(5, dx_m=model().grid.dx_m), refine=False)
    assert found.verdict == "nothing_missing", found.sentence


HIDDEN = {
    "payload": ("elbow", {"mass_kg": 0.11, "distance_m": 0.38}),
    "seal_friction": ("forearm", {"force_n_per_pa": 2e-5}),
    "piston_leak": ("forearm", {"area_m2": 4e-8}),
    "backlash": ("elbow", {"width": 0.015}),
}


@pytest.mark.long
@pytest.mark.parametrize("name", HIDDEN)
def test_a_mechanical_effect_is_named_and_sized(name: str) -> None:
    place, values = HIDDEN[name]
    found = diagnose(model(), recorded(3, **{name: (place, values)}), refine=False)
    top = found.finalists[0]
    assert found.verdict in ("effect", "ambiguous", "unknown")
    assert (top.site.effect.name, top.site.place) == (name, place)
    strength = values[top.site.effect.strength.name]
    assert top.strength == pytest.approx(strength, rel=0.2)
